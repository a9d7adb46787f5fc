"""Sources of the values of the sent signals; the table is in `engine/sent.py`."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from math import nan
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_gateway import __version__
from bms_gateway.engine.forecast_result import Forecast
from bms_gateway.engine.string_estimator import StringEstimator
from bms_gateway.health.ageing import Ageing
from bms_gateway.health.flag import Flag
from bms_gateway.identify.contract import FIXED, IDENTIFIED, LEARNING, Estimate
from bms_gateway.thermal import KINDS, Floats
from bms_gateway.thermal.centre import hottest_of

WIDEST_K = 25.0
"""Greatest standard deviation of a forecast that its signal can hold; greater ones are sent as this value."""
WITHIN_S = 600.0
"""Value of `limit_in` if the limit is not reached within ten minutes."""
ALARM = 2
"""Entry of the value table `Fault` of our DBC."""
STATUS_CODES: Final = {LEARNING: 0, IDENTIFIED: 1, FIXED: 3}
NOT_IDENTIFIABLE = 2  # code of every other status; the text after its colon is for people


class State(IntEnum):
    """Value table `GatewayState` of our DBC."""

    STARTING = 0
    RUNNING = 1
    DEGRADED = 2
    SILENT = 3


@dataclass(frozen=True, slots=True)
class Counts:
    """Content of the status frames: frames and rejected samples of this tick, lost frames, seconds since start."""

    frames: int
    rejected: int
    dropped: int
    uptime_s: float


class Gateway(NamedTuple):
    """Source of the messages about the gateway itself."""

    state: State
    counts: Counts

    def it(self) -> "Gateway":
        """Return itself: the messages read from it directly."""
        return self


class OneCell(NamedTuple):
    """One cell of a string, `k` from 0."""

    string: StringEstimator
    k: int

    def read(self, cells: Floats | NDArray[np.uint8]) -> float:
        """Value of this cell among those of all cells (n,)."""
        return float(cells[self.k])


class InTenMinutes(NamedTuple):
    """Forecast of a string, and the cell `k` (from 0) that will be hottest in ten minutes."""

    forecast: Forecast
    k: int


def string(s: StringEstimator) -> StringEstimator:
    """Return the string itself, for messages that are always available."""
    return s


def hottest_core(s: StringEstimator) -> OneCell | None:
    """Cell with the hottest core; None if no core is known."""
    return None if (k := hottest_of(s.core)) is None else OneCell(s, k)


def hottest_point(s: StringEstimator) -> OneCell | None:
    """Cell with the hottest point; None if none is known."""
    return None if (k := s.hottest) is None else OneCell(s, k)


def estimate(name: str, s: StringEstimator) -> Estimate | None:
    """Parameter of that name; None if the string does not estimate it."""
    return next((e for e in s.estimates if e.name == name), None)


def status_code(e: Estimate) -> int:
    """Entry of the value table `ParameterStatus`."""
    return STATUS_CODES.get(e.status.split(":")[0], NOT_IDENTIFIABLE)


def in_unit(e: Estimate, value: float) -> float:
    """Convert a value of the parameter from SI to the unit of the DBC."""
    return value / KINDS[e.name].to_si


def ageing_flag(a: Ageing) -> float:
    """Level of the flag; NaN before commissioning."""
    return a.flag.level if a.commissioned else nan


def if_commissioned(s: StringEstimator, flag: Flag) -> float:
    """Level of a flag that means nothing before commissioning: NaN until then."""
    return flag.level if s.health.commissioned else nan


def growth_of_cells(s: StringEstimator) -> Sequence[Ageing] | None:
    """Ageing of each cell; None if single cells are not identified."""
    return None if s.health.cells is None else s.health.cells.ageing


def heat_flags(s: StringEstimator) -> Floats:
    """Level of the flag of unexplained heat of each cell; NaN if no sensor shows its heat."""
    flag = np.where(np.isfinite(s.own_heat), 0.0, nan)
    for f in s.health.heat:
        if f.code == "unexplained_heat" and f.cell is not None:
            flag[f.cell - 1] = f.level
    return flag


def in_ten_minutes(s: StringEstimator) -> InTenMinutes | None:
    """Forecast of the string; None without a forecast, or if no cell of it is known."""
    return None if s.forecast is None or (k := s.forecast.hottest) is None else InTenMinutes(s.forecast, k)


def point_ahead(horizon: int, n: InTenMinutes) -> float:
    """Hottest point of that cell at one of the horizons of the forecast."""
    return float(n.forecast.centre[horizon, n.k])


def point_sd_ahead(horizon: int, n: InTenMinutes) -> float:
    """Return the standard deviation of this hottest point."""
    return min(float(n.forecast.centre_sd[horizon, n.k]), WIDEST_K)


def limit_cell(n: InTenMinutes) -> float:
    """Cell (from 1) that reaches its limit first; 0: none."""
    return 0 if n.forecast.first is None else n.forecast.first + 1


def limit_in(n: InTenMinutes) -> float:
    """Seconds until the first cell reaches its limit."""
    return WITHIN_S if n.forecast.first is None else float(n.forecast.limit_s[n.forecast.first])


def permitted(way: str, s: StringEstimator) -> list[float] | None:
    """Greatest constant currents, `way` being "discharge" or "charge"; None without a forecast."""
    if s.forecast is None:
        return None
    currents: Floats = getattr(s.forecast, way)
    return [float(x) for x in currents]


def version(place: int, _: Gateway) -> float:
    """One of the three numbers of the version."""
    return float(__version__.split(".")[place])
