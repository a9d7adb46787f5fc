"""The frames that our node sends each tick: layouts and columns are looked up once, then filled as numpy arrays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_gateway import __version__
from bms_gateway.engine.estimators import Estimators
from bms_gateway.engine.plan import Plan
from bms_gateway.engine.string_estimator import StringEstimator
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.database import Database
from bms_gateway.frames.encode import Encoder
from bms_gateway.frames.own_dbc import (
    GATEWAY_INFO,
    GATEWAY_STATUS,
    PARAMETER_MUX,
    core_message,
    flags_message,
    forecast_message,
    growth_message,
    health_message,
    heat_message,
    hottest_message,
    parameters_message,
    summary_message,
)
from bms_gateway.identify.contract import FIXED, IDENTIFIED, LEARNING
from bms_gateway.thermal import KINDS, Floats
from bms_gateway.thermal.centre import hottest_of


class State(IntEnum):
    """Value table `GatewayState` of our DBC."""

    STARTING = 0
    RUNNING = 1
    DEGRADED = 2
    SILENT = 3


STATUS_CODES = {LEARNING: 0, IDENTIFIED: 1, FIXED: 3}
NOT_IDENTIFIABLE = 2  # code of every other status; the text after its colon is for people


@dataclass(frozen=True, slots=True)
class Counts:
    """Content of the status frames: frames and rejected samples of this tick, frames lost and seconds since start."""

    frames: int
    rejected: int
    dropped: int
    uptime_s: float


Value = float | Floats | NDArray[np.uint8]
"""One value for all rows of a part, or one for each row."""
Content = tuple[Value, ...]
"""A value for every column of a part."""


class Core(NamedTuple):
    """Signals of the first cell's message; they stand in the columns of all other cells too."""

    core_01: Value
    core_sd_01: Value
    surface_01: Value
    quality_01: Value


class Summary(NamedTuple):
    """Signals of a string's summary; without a core none is available."""

    hottest_core: Value = nan
    hottest_cell: Value = nan
    hottest_sd: Value = nan
    hottest_quality: Value = nan
    coldest_core: Value = nan


class Hottest(NamedTuple):
    """Signals of a string's hottest point."""

    hottest_point: Value = nan
    hottest_point_cell: Value = nan
    hottest_point_sd: Value = nan
    hottest_point_quality: Value = nan
    hottest_point_core: Value = nan


class Health(NamedTuple):
    """Signals of a string's health."""

    R_e_flag: Value
    R_e_growth: Value
    R_e_growth_sd: Value
    innovation: Value
    mismatch_flag: Value


class Flags(NamedTuple):
    """Signals of a string's flags."""

    ageing_flag: Value
    cooling_flag: Value
    thermocouple_flag: Value
    current_flag: Value
    mismatch_flag: Value
    thermocouple_cell: Value
    R_u_growth: Value
    runaway_flag: Value
    hot_flag: Value


class Growth(NamedTuple):
    """Signals of the first cell's growth of resistance; they stand in the columns of all other cells too."""

    flag_01: Value = nan
    growth_01: Value = nan
    growth_sd_01: Value = nan


class Heat(NamedTuple):
    """Signals of the first cell's unexplained heat; they stand in the columns of all other cells too."""

    heat_flag_01: Value
    heat_01: Value
    heat_sd_01: Value


class Status(NamedTuple):
    """Signals of the gateway's status."""

    state: Value
    frame_rate: Value
    rejected_samples: Value
    dropped_frames: Value


class Info(NamedTuple):
    """Signals of the gateway's version."""

    version_major: Value
    version_minor: Value
    version_patch: Value
    uptime: Value


POINTS = tuple(f"point_in_{part}" for part in ("1min", "5min", "10min"))
NEXT = (*(f"point_sd_{part}" for part in ("1min", "5min", "10min")), "limit_cell", "limit_in")
WAYS = ("discharge", "charge")
FOR = ("10s", "1min", "10min")
WIDEST_K = 25.0
"""Greatest standard deviation that the signal can hold; greater ones are sent as this value."""
WITHIN_S = 600.0
"""Value of `limit_in` if the limit is not reached within ten minutes."""
ALARM = 2
"""Entry of the value table `Fault` of our DBC."""


@dataclass(frozen=True, slots=True)
class _Part:
    """Rows of the encoder that are filled alike and sent together, and the columns to fill."""

    rows: NDArray[np.intp]
    columns: tuple[int, ...]
    cycle_ns: int
    single: bool
    """Whether the part has one row with numbers as values; otherwise a value may be an array, one entry per cell."""


class Broadcast:
    """Frames of our node for a plan.

    Parameters
    ----------
    plan : Plan
    database : Database
        Must hold our DBC.

    Attributes
    ----------
    cycles : dict of int to int
        Identifiers that we send and their cycles, ns: the only ones that a port may put on the bus for us.
    """

    def __init__(self, plan: Plan, database: Database) -> None:
        parts = (core_message, summary_message, hottest_message, parameters_message, health_message, flags_message)
        names = [
            part(s.number) for s in plan.strings for part in (*parts, growth_message, heat_message, forecast_message)
        ]
        names += [GATEWAY_STATUS, GATEWAY_INFO]
        self._encoder = Encoder(database, names)
        self._cycle = {name: database.message(name).cycle_ns or plan.tick_ns for name in names}
        self.cycles = {database.message(name).can_id: self._cycle[name] for name in names}
        self._strings = [self._parts(s.number, s.model.cells) for s in plan.strings]
        self._status, self._info = self._part(GATEWAY_STATUS, Status._fields), self._part(GATEWAY_INFO, Info._fields)

    def _part(self, message: str, signals: tuple[str, ...], *mux: int) -> _Part:
        return self._rows(message, signals, [mux], single=True)

    def _each_cell(self, message: str, signals: tuple[str, ...], cells: int) -> _Part:
        return self._rows(message, signals, [(k,) for k in range(1, cells + 1)], single=False)

    def _rows(self, message: str, signals: tuple[str, ...], muxes: Sequence[tuple[int, ...]], *, single: bool) -> _Part:
        rows = [self._encoder.row(message, *mux) for mux in muxes]
        columns = tuple(self._encoder.column(rows[0], signal) for signal in signals)
        return _Part(np.array(rows, np.intp), columns, self._cycle[message], single)

    def _parts(self, number: int, cells: int) -> list[tuple[_Part, Callable[[StringEstimator], Content]]]:
        """Lay out one string's messages, in the order in which they are sent."""
        parameters = parameters_message(number)
        return [
            (self._each_cell(core_message(number), Core._fields, cells), _cores),
            (self._part(summary_message(number), Summary._fields), _summary),
            (self._part(hottest_message(number), Hottest._fields), _hottest),
            *(
                (self._part(parameters, (name, f"{name}_sd", f"{name}_status"), mux), partial(_parameter, name))
                for name, mux in PARAMETER_MUX.items()
            ),
            (self._part(health_message(number), Health._fields), _health),
            (self._part(flags_message(number), Flags._fields), _flags),
            (self._each_cell(growth_message(number), Growth._fields, cells), _growth),
            (self._each_cell(heat_message(number), Heat._fields, cells), _heat),
            (self._part(forecast_message(number), POINTS, 0), _points),
            (self._part(forecast_message(number), NEXT, 1), _next),
            *(
                (self._part(forecast_message(number), tuple(f"{way}_{x}" for x in FOR), m), partial(_current, way))
                for m, way in enumerate(WAYS, start=2)
            ),
        ]

    def encode(self, t1: int, estimators: Estimators, state: State, counts: Counts) -> FrameBatch:
        """Frames that are due at the tick `t1`, stamped with it, in the order of the strings."""
        due = [
            (part, content(s))
            for parts, s in zip(self._strings, estimators.strings, strict=True)
            for part, content in parts
            if t1 % part.cycle_ns == 0
        ]
        gateway = ((self._status, _status(state, counts)), (self._info, _info(counts)))
        due += [(part, content) for part, content in gateway if t1 % part.cycle_ns == 0]
        if not due:
            return FrameBatch.empty()
        rows = np.concatenate([part.rows for part, _ in due])
        values = np.full((len(rows), self._encoder.width), nan)
        start = 0
        for part, content in due:
            end = start + len(part.rows)
            where = start if part.single else slice(start, end)  # writing a single number is faster
            for column, value in zip(part.columns, content, strict=True):
                values[where, column] = value
            start = end
        can_id, length, data = self._encoder.encode(rows, values)
        return FrameBatch(np.full(len(can_id), t1, np.int64), can_id, length, data)


def _cores(s: StringEstimator) -> Content:
    return Core(s.core, s.core_sd, s.surface, s.quality)


def _summary(s: StringEstimator) -> Content:
    k = hottest_of(s.core)
    if k is None:
        return Summary()
    return Summary(float(s.core[k]), k + 1, float(s.core_sd[k]), float(s.quality[k]), float(np.fmin.reduce(s.core)))


def _hottest(s: StringEstimator) -> Content:
    k = s.hottest
    if k is None:
        return Hottest()
    return Hottest(float(s.centre[k]), k + 1, float(s.centre_sd[k]), float(s.quality[k]), float(s.core[k]))


def _parameter(name: str, s: StringEstimator) -> Content:
    estimate = next((e for e in s.estimates if e.name == name), None)
    if estimate is None:
        return nan, nan, nan
    to_si = KINDS[name].to_si
    return (
        estimate.value / to_si,
        estimate.sd / to_si,
        STATUS_CODES.get(estimate.status.split(":")[0], NOT_IDENTIFIABLE),
    )


def _health(s: StringEstimator) -> Content:
    return Health(
        R_e_flag=s.ageing.flag.level if s.ageing.commissioned else nan,
        R_e_growth=100.0 * s.ageing.growth,
        R_e_growth_sd=100.0 * s.ageing.growth_sd,
        innovation=s.mismatch.excess**0.5,
        mismatch_flag=s.mismatch.flag.level,
    )


def _flags(s: StringEstimator) -> Content:
    h, known = s.health, s.health.commissioned
    return Flags(
        ageing_flag=h.ageing.flag.level if h.ageing.commissioned else nan,
        cooling_flag=h.cooling.flag.level if known else nan,
        thermocouple_flag=h.drift.flag.level if known else nan,
        current_flag=h.current.flag.level if known else nan,
        mismatch_flag=h.mismatch.flag.level,
        thermocouple_cell=h.drift.worst if h.drift.flag.level else nan,
        R_u_growth=100.0 * h.cooling.growth,
        runaway_flag=ALARM * s.runaway,
        hot_flag=ALARM * s.hot,
    )


def _growth(s: StringEstimator) -> Content:
    if s.health.cells is None:
        return Growth()
    cells = s.health.cells.ageing
    return Growth(
        np.array([a.flag.level if a.commissioned else nan for a in cells]),
        100.0 * np.array([a.growth for a in cells]),
        100.0 * np.array([a.growth_sd for a in cells]),
    )


def _heat(s: StringEstimator) -> Content:
    flag = np.where(np.isfinite(s.own_heat), 0.0, nan)
    for f in s.health.heat:
        if f.code == "unexplained_heat" and f.cell is not None:
            flag[f.cell - 1] = f.level
    return Heat(flag, s.own_heat, s.own_heat_sd)


def _points(s: StringEstimator) -> Content:
    if s.forecast is None or (k := s.forecast.hottest) is None:
        return (nan,) * len(POINTS)
    return tuple(s.forecast.centre[1:, k].tolist())


def _next(s: StringEstimator) -> Content:
    if s.forecast is None or (k := s.forecast.hottest) is None:
        return (nan,) * len(NEXT)
    first, sd = s.forecast.first, np.minimum(s.forecast.centre_sd[1:, k], WIDEST_K).tolist()
    return (*sd, 0, WITHIN_S) if first is None else (*sd, first + 1, float(s.forecast.limit_s[first]))


def _current(way: str, s: StringEstimator) -> Content:
    return (nan,) * len(FOR) if s.forecast is None else tuple(getattr(s.forecast, way).tolist())


def _status(state: State, counts: Counts) -> Content:
    return Status(state.value, counts.frames, counts.rejected, counts.dropped)


def _info(counts: Counts) -> Content:
    major, minor, patch = (float(part) for part in __version__.split("."))
    return Info(major, minor, patch, counts.uptime_s)
