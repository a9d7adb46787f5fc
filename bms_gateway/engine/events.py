"""The engine's vocabulary: read this first.

Inputs: `FrameBatch` (frames) and the bus time. Outputs, in one ordered queue: the events below. Two drivers that give
the engine the same frames get the same events in the same order, however the frames were cut into batches.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from math import nan
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.forecast_result import Foreseen
from bms_gateway.engine.readings import Layout
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.health.alerts import Change
from bms_gateway.identify import Estimate
from bms_gateway.thermal import Floats


class Level(IntEnum):
    """Severity of a notice; the numbers are those of syslog, so journald can sort by them."""

    WARNING = 4
    NOTICE = 5
    INFO = 6


class Job(Protocol):
    """Heavy identification: a pure function of its data, so it may run in a thread, later, or inline."""

    def run(self) -> object:
        """Compute the result without using the engine."""
        ...


@dataclass(frozen=True, slots=True)
class SendFrames:
    """Frames of our node for the bus, stamped with the deadline that made them."""

    time_ns: int
    batch: FrameBatch


@dataclass(frozen=True, slots=True)
class StartJob:
    """Work for outside the engine: `engine.finish(job_id, job.run())`, before bus time `due_ns` if possible.

    The result takes effect at `due_ns`, however early it comes, so a live service and an inline replay give the same
    estimates. A later result takes effect when it comes.
    """

    time_ns: int
    job_id: int
    due_ns: int
    job: Job


@dataclass(frozen=True, slots=True)
class Cells:
    """Cells of one string at one tick; see `Estimated`."""

    time_ns: int
    string: str
    core: Floats
    core_sd: Floats
    surface: Floats
    quality: NDArray[np.uint8]
    centre: Floats
    centre_sd: Floats
    heat: Floats
    heat_sd: Floats


@dataclass(frozen=True, slots=True)
class Estimated:
    """All N cells of all strings at one tick, string after string in the order of the plan.

    Attributes
    ----------
    layout : Layout
        Names of the strings, and the place of each string's cells.
    core, core_sd, surface : ndarray (N,)
        °C, K, °C; NaN where not available.
    quality : ndarray of uint8 (N,)
        `Quality` of each estimate.
    centre, centre_sd : ndarray (N,), °C, K
        Hottest point of each cell (`thermal.centre`), never below core or surface; NaN where the core is.
    heat, heat_sd : ndarray (N,), W
        Heat of the cell that no current makes; NaN if no sensor shows it.
    """

    time_ns: int
    layout: Layout
    core: Floats
    core_sd: Floats
    surface: Floats
    quality: NDArray[np.uint8]
    centre: Floats
    centre_sd: Floats
    heat: Floats
    heat_sd: Floats

    def strings(self) -> Iterator[Cells]:
        """Yield the cells string by string."""
        for name, mine in zip(self.layout.names, self.layout.parts, strict=True):
            core, core_sd, surface, quality = (
                self.core[mine],
                self.core_sd[mine],
                self.surface[mine],
                self.quality[mine],
            )
            more = self.centre[mine], self.centre_sd[mine], self.heat[mine], self.heat_sd[mine]
            yield Cells(self.time_ns, name, core, core_sd, surface, quality, *more)


@dataclass(frozen=True, slots=True)
class Parameters:
    """New parameters of one string.

    Attributes
    ----------
    constant : ndarray (n,) or None
        Constant error of each cell's thermocouple that came with them, K; None if none was sought.
    """

    time_ns: int
    string: str
    estimates: tuple[Estimate, ...]
    constant: Floats | None = None


@dataclass(frozen=True, slots=True)
class Notice:
    """A message for a person, in one sentence.

    Attributes
    ----------
    code : str
        Stable word for machines ("sensor", "clock", "silent", "ageing", "mismatch", …).
    string : str or None
    cell : int or None
        1-based.
    part : str
        Distinguishes several matters of one code, as in `Condition`: of a sensor, its quantity.
    """

    time_ns: int
    level: Level
    code: str
    text: str
    string: str | None = None
    cell: int | None = None
    part: str = ""


@dataclass(frozen=True, slots=True)
class Alerted:
    """An alert was raised, has changed, or has ended."""

    time_ns: int
    change: Change


@dataclass(frozen=True, slots=True)
class Decoded:
    """Samples of one tick that the guard has accepted; given only if `engine.recording` is set.

    Attributes
    ----------
    sample_ns : ndarray of int64 (K,)
        Bus time of each.
    input : ndarray of intp (K,)
        Index of the input, as in `engine.wires`.
    value : ndarray (K,)
        SI, °C.
    """

    time_ns: int
    sample_ns: NDArray[np.int64]
    input: NDArray[np.intp]
    value: Floats


@dataclass(frozen=True, slots=True)
class Judgement:
    """Error of the model of one string at one tick, with the load of the string.

    Attributes
    ----------
    innovation, innovation_sd : ndarray (n,), K
        Reading minus prediction, and its expected standard deviation; NaN for cells without a reading.
    current, square : float
        Means of I and I² over the tick, A, A²; NaN where unknown.
    inlet, flow : float
        Coolant at the tick: inlet temperature, °C, and flow over nominal flow; NaN if unknown.
    growth, growth_sd : float
        Growth of R_e since commissioning, as a share, and its standard deviation; NaN before it is known.
    excess : float
        Mean square of the normalised innovation over ten minutes; 1 if the model is right, NaN at first.
    flags : tuple of str
        Names of the raised flags.
    soc : float
        State of charge at the tick, 0…1; NaN where unknown.
    voltage : float
        Mean over the tick, V: of the string, or of its cells where only theirs are read; NaN where unknown.
    surface, age : ndarray (n,), °C, s
        Readings of the surfaces that are used, NaN without a new one; time between each and the tick.
    """

    string: str
    innovation: Floats
    innovation_sd: Floats
    current: float
    square: float
    inlet: float
    flow: float
    growth: float
    growth_sd: float
    excess: float
    flags: tuple[str, ...]
    soc: float = nan
    voltage: float = nan
    surface: Floats = field(default_factory=lambda: np.empty(0))
    age: Floats = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True, slots=True)
class Judged:
    """All strings at one tick, in the order of the plan; given only if `engine.judging` is set.

    Attributes
    ----------
    frames : int
        Wanted frames so far.
    rejected : mapping
        Refused samples so far, by reason.
    """

    time_ns: int
    frames: int
    rejected: Mapping[str, int]
    strings: tuple[Judgement, ...]


Event = SendFrames | StartJob | Estimated | Parameters | Notice | Alerted | Decoded | Judged | Foreseen
