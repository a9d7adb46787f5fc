"""One message and one signal of a DBC, without the parser's objects."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from bms_gateway.frames.bits import Place
from bms_gateway.frames.quality import Quality

__all__ = ["E2E", "MessageInfo", "SignalInfo", "Switch", "j1939_limits", "label_quality"]

_NOT_AVAILABLE = re.compile(r"^(sna|n/?a|not[ _-]?avail(able)?|signal[ _-]?not[ _-]?avail(able)?|unavailable)$", re.I)
_ERROR = re.compile(r"^((sensor|signal|line)[ _-]?)?(error|invalid|defect)([ _-]?indicator)?$", re.I)


@dataclass(frozen=True, slots=True)
class Switch:
    """One step to a multiplexed signal: the multiplexer and its values that carry the signal."""

    signal: str
    values: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class E2E:
    """End-to-end protection of a message, AUTOSAR profile 1 variant 1A: CRC in byte 0, counter in bits 8…11."""

    data_id: int


@dataclass(frozen=True, slots=True)
class SignalInfo:
    """One signal.

    Attributes
    ----------
    scale, offset : float
        Physical = raw · scale + offset.
    minimum, maximum : float or None
        As declared; None if the DBC declares none.
    mux : tuple of Switch
        From the outermost multiplexer inwards; empty for a signal in every frame.
    start_raw : float or None
        GenSigStartValue.
    j1939 : bool
        All ones means not available, 0xFE in the top byte means error (J1939-71, for 2, 4, 8, 16, 24 and 32 bits).
    """

    database: str
    message: str
    name: str
    place: Place
    is_float: bool
    scale: float
    offset: float
    minimum: float | None
    maximum: float | None
    unit: str
    comment: str
    choices: Mapping[int, str]
    mux: tuple[Switch, ...]
    is_multiplexer: bool
    start_raw: float | None
    j1939: bool
    can_id: int
    cycle_ns: int | None

    @property
    def path(self) -> str:
        """Name as the config writes it: Message.Signal."""
        return f"{self.message}.{self.name}"

    @property
    def resolution(self) -> float:
        """Smallest step of the physical value; 0 for floating-point signals."""
        return 0.0 if self.is_float else abs(self.scale)

    @property
    def raw_limits(self) -> tuple[float, float]:
        """Lowest and highest raw value that the bits can hold."""
        if self.is_float:
            return -math.inf, math.inf
        if self.place.signed:
            return float(-(1 << (self.place.size - 1))), float((1 << (self.place.size - 1)) - 1)
        return 0.0, float((1 << self.place.size) - 1)

    @property
    def raw_valid(self) -> tuple[float, float]:
        """Raw values for measurements, by the declared range and the J1939 convention.

        Rounded to whole raw steps with a slack of 1e-6 step: a declared 555.35 is the raw value 65535 of 0.01 − 100
        although neither number is exact in binary. -inf, inf where nothing is declared.
        """
        if self.scale == 0.0:
            return self.raw_limits
        least = -math.inf if self.minimum is None else self.minimum
        most = math.inf if self.maximum is None else self.maximum
        low, high = sorted(((least - self.offset) / self.scale, (most - self.offset) / self.scale))
        if not self.is_float:
            low = math.ceil(low - 1e-6) if math.isfinite(low) else low
            high = math.floor(high + 1e-6) if math.isfinite(high) else high
        if self.j1939:
            high = min(high, j1939_limits(self.place.size)[0] - 1)
        return float(low), float(high)

    @property
    def labelled(self) -> dict[int, Quality]:
        """Raw values whose label in the value table says that there is no measurement."""
        found = {raw: label_quality(text) for raw, text in self.choices.items()}
        return {raw: quality for raw, quality in found.items() if quality is not None}


@dataclass(frozen=True, slots=True)
class MessageInfo:
    """One message and its signals in the order of the DBC."""

    database: str
    name: str
    can_id: int
    length: int
    senders: tuple[str, ...]
    cycle_ns: int | None
    e2e: E2E | None
    comment: str
    signals: Mapping[str, SignalInfo] = field(default_factory=dict)
    any_sender: bool = False
    """Whether it is a parameter group of J1939, which any address may send."""

    def turns(self, signal: SignalInfo) -> int:
        """Count the frames of a period in which each multiplexed part comes once, with this signal in one of them.

        Returns
        -------
        int
            1 for a signal in every frame. Nested multiplexers count as if all their values took turns.
        """
        count = 1
        for step in signal.mux:
            count *= len({v for s in self.signals.values() for m in s.mux if m.signal == step.signal for v in m.values})
        return count


def j1939_limits(size: int) -> tuple[int, int]:
    """First raw value of the error range and of the not-available range for an unsigned signal of `size` bits.

    Examples
    --------
    >>> [hex(x) for x in j1939_limits(16)]
    ['0xfe00', '0xff00']
    >>> j1939_limits(2), j1939_limits(4)
    ((2, 3), (14, 15))
    """
    unit = 1 << max(size - 8, 0)
    ones = 0xFF if size >= 8 else (1 << size) - 1
    return (ones - 1) * unit, ones * unit


def label_quality(label: str) -> Quality | None:
    """Quality that a value-table label states, None for an ordinary value.

    Examples
    --------
    >>> label_quality("SNA"), label_quality("Not available"), label_quality("CONTACTOR_OPEN")
    (<Quality.NOT_AVAILABLE: 3>, <Quality.NOT_AVAILABLE: 3>, None)
    """
    text = label.strip()
    if _NOT_AVAILABLE.match(text):
        return Quality.NOT_AVAILABLE
    return Quality.ERROR if _ERROR.match(text) else None
