"""Why a sample or an input is not used, in words for people."""

from collections.abc import Mapping
from typing import Final

from bms_gateway.frames.quality import Quality

REASONS: Final[Mapping[Quality, str]] = {
    Quality.STALE: "nothing new is received",
    Quality.OUT_OF_RANGE: "out of its plausible range",
    Quality.NOT_AVAILABLE: "its sender says that the value is not available",
    Quality.ERROR: "its sender says that the sensor failed, or the frame is too short",
    Quality.STUCK: "it stands still while current flows",
    Quality.OPEN: "at its upper rail, as a broken wire reads",
    Quality.SHORT: "at its lower rail, as a short circuit or a missing sensor reads",
    Quality.JUMPY: "it has jumped faster than a cell can",
    Quality.COUNTER: "the alive counter of its frame is wrong",
    Quality.CRC: "the check sum of its frame is wrong",
    Quality.NEVER: "the sensor has not moved yet",
}
HELD: Final = "it has jumped down beside its neighbours and not come back"
UNKNOWN_MUX, REPEATED = "unknown_multiplexer", "repeated"
COUNTED: Final[Mapping[str, str]] = {q.name.lower(): text for q, text in REASONS.items()} | {
    "stuck": "a temperature stands still while current flows, or a current while the voltage moves",
    UNKNOWN_MUX: "the DBC does not know the multiplexer value of the frame",
    REPEATED: "the frame repeats the one before",
}
"""Words for each key of the counters of samples that are not used."""
CURRENT_REFUSED: Final = "the voltage moves while it stands at one value: stuck, saturated or clipped"
CURRENT_STANDS: Final = "it stands at {} A while the voltage moves: stuck, saturated or clipped"
WRONG_SIGN: Final = (
    "current and voltage rise together: the sign of the current is wrong (scale = -1 in its entry changes it)"
)
RIGHT_SIGN: Final = "current and voltage move against each other again, as they should"


def why_not(quantity: str, quality: Quality) -> str:
    """Say why samples of a quantity are not used; a current that stands still is found by its voltage.

    Examples
    --------
    >>> why_not("current", Quality.STUCK)
    'the voltage moves while it stands at one value: stuck, saturated or clipped'
    >>> why_not("surface", Quality.STUCK)
    'it stands still while current flows'
    """
    return CURRENT_REFUSED if (quantity, quality) == ("current", Quality.STUCK) else REASONS[quality]


def unused(rejected: Mapping[str, int]) -> dict[str, int]:
    """Replace the keys of the counters of samples that are not used by words, the most frequent reason first.

    Examples
    --------
    >>> unused({"crc": 3, "never": 10})
    {'the sensor has not moved yet': 10, 'the check sum of its frame is wrong': 3}
    """
    return {COUNTED[key]: n for key, n in sorted(rejected.items(), key=lambda item: (-item[1], item[0]))}
