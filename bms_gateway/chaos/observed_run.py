"""Record of a gateway as seen from outside: its frames on the bus, its lines for people, its counters; tick by tick."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.plan import Plan
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.database import Database
from bms_gateway.frames.decode import decode
from bms_gateway.frames.own_dbc import GATEWAY_STATUS, string_message
from bms_gateway.frames.quality import Quality
from bms_gateway.thermal import Floats

ABSENT = np.uint8(Quality.NEVER)
SLACK_K = 1.5
"""A core with a smaller error counts as right whatever its band is: neither sensors nor models are more exact."""
BAND = 3.0
"""Half width of the band, sd. A correct filter is outside in about one tick of a hundred, by less than `SLACK_K`."""


@dataclass(frozen=True, slots=True)
class Seen:
    """One second of the bench.

    Attributes
    ----------
    time_s : float
        Bench time, the end of the second.
    frames : int
        Frames of the gateway in this second.
    state : int or None
        `GatewayState`, None where no status came.
    quality : ndarray of uint8 (cells of all strings,)
    error, sd : ndarray (cells of all strings,)
        Core as sent minus the true core, K, and its stated sd; NaN if not available.
    counts : mapping of str to int
        Counters of the engine and the port.
    """

    time_s: float
    frames: int
    state: int | None
    quality: NDArray[np.uint8]
    error: Floats
    sd: Floats
    counts: Mapping[str, int]

    @property
    def in_band(self) -> bool:
        """Whether every core that was sent lies inside its own band."""
        sent = np.isfinite(self.error)
        return bool((np.abs(self.error[sent]) <= np.maximum(SLACK_K, BAND * self.sd[sent])).all())


@dataclass(frozen=True, slots=True)
class Line:
    """One line for people: bench time, code, text."""

    time_s: float
    code: str
    text: str


@dataclass(slots=True)
class Record:
    """A whole run of one scenario.

    Attributes
    ----------
    start_s, end_s : float
        Begin and end of the fault, bench time.
    """

    start_s: float
    end_s: float
    seen: list[Seen] = field(default_factory=list)
    lines: list[Line] = field(default_factory=list)

    def before(self) -> Seen:
        """Last second before the fault."""
        return max((s for s in self.seen if s.time_s <= self.start_s), key=lambda s: s.time_s)

    def since(self) -> Iterable[Seen]:
        """Seconds after the beginning of the fault."""
        return (s for s in self.seen if s.time_s > self.start_s)


class Bystander:
    """Decodes what the gateway sends.

    Parameters
    ----------
    plan : Plan
    database : Database
        With our own DBC.
    """

    def __init__(self, plan: Plan, database: Database) -> None:
        self._cells = [(s.number, k) for s in plan.strings for k in range(1, s.model.cells + 1)]
        names = [f"{GATEWAY_STATUS}.state"]
        for number, k in self._cells:
            message = string_message(number, "core")
            names += [f"{message}.{part}_{k:02d}" for part in ("core", "core_sd", "quality")]
        self._table = database.compile(names)
        self.frames = 0
        self._values = np.full(len(names), np.nan)

    @property
    def cells(self) -> Sequence[tuple[int, int]]:
        """(number of the string, cell) of each column."""
        return self._cells

    @property
    def state(self) -> int | None:
        """The state that was sent last."""
        return None if np.isnan(self._values[0]) else int(self._values[0])

    @property
    def known(self) -> bool:
        """Whether the core of every cell was sent."""
        return bool(np.isfinite(self._values[1::3]).all())

    def take(self, frames: FrameBatch) -> None:
        """Read frames of the bus."""
        if not len(frames):
            return
        samples = decode(self._table, frames)
        self.frames += int(np.isin(frames.can_id, self._table.can_ids).sum())
        self._values[samples.signal] = np.where(samples.flag == Quality.GOOD, samples.value, np.nan)

    def close_second(self, time_s: float, truth: Floats, counts: Mapping[str, int]) -> Seen:
        """Sum up what came since the last call.

        Parameters
        ----------
        time_s : float
        truth : ndarray (cells of all strings,)
            True cores, °C; NaN where not known.
        counts : mapping
        """
        core, sd, quality = (self._values[1 + part :: 3] for part in range(3))
        told = np.where(np.isfinite(quality), quality, ABSENT).astype(np.uint8)
        seen = Seen(time_s, self.frames, self.state, told, core - truth, sd.copy(), dict(counts))
        self.frames = 0
        self._values[:] = np.nan
        return seen
