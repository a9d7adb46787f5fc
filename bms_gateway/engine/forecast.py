"""Forecasts every ten seconds of bus time: temperatures ahead, the time to the limit, the permitted current.

A forecast starts from the engine's state at that tick: the observer's state and covariance, its parameters with their
uncertainty, and the common heat; the cores of the watch over heat if they are better, and the heat that it has found in
a cell; the doubts about the model. The load is the present one (`load_ahead`), or a constant current given by the user.
Temperatures are computed every ten seconds. Their variances change slowly and take most of the time; they are computed
once a minute.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bms_gateway.engine.forecast_result import Forecast, Foreseen, LooksAhead, Origin
from bms_gateway.engine.load_ahead import Load
from bms_gateway.frames.quality import Quality
from bms_gateway.observe.ahead import (
    AT_ENDS,
    CENTRE,
    CORE,
    HORIZONS_S,
    PATH_S,
    STEP_S,
    SURFACE,
    Ahead,
    Certainty,
    first_crossing,
)
from bms_gateway.observe.forecast_start import Coming, Standing
from bms_gateway.observe.model import Bools
from bms_gateway.observe.unseen import SPREAD
from bms_gateway.thermal import Floats

if TYPE_CHECKING:
    from bms_gateway.engine.group import Group
    from bms_gateway.engine.readings import Readings
    from bms_gateway.engine.string_estimator import StringEstimator

STEP_NS: Final = round(STEP_S * 1e9)
DOUBTFUL: Final = np.uint8(Quality.DOUBTFUL)
ANEW: Final = 6  # number of steps after which the variances are computed again
GROWN: Final = 1.2  # the same where the standard deviation of a core has grown by this factor: a thermocouple came off
LOST_K: Final = 50.0  # sd of a core of which nothing is known: its thermocouple came off
LIMITED: Final = (0, 1, 3)  # horizons with permitted currents: 10 s, 1 min, 10 min
MOST_A: Final = 6400.0  # largest current that the signal can hold; no string carries more
NEVER_S: Final = float("inf")


@dataclass(slots=True)
class _Watched:
    """Outlook of one group; the variances last computed, their age in steps, and the sd of the cores then (S, n), K."""

    group: "Group"
    outlook: LooksAhead
    certainty: Certainty | None = None
    age: int = 0
    sd: Floats | None = None


class Forecasts:
    """Forecasts of all strings.

    Parameters
    ----------
    groups : sequence of Group
    strings : sequence of StringEstimator
        All, in the order of the plan.
    limit_C : float
        Of the hottest points.

    Attributes
    ----------
    wanted : bool
        Whether the starting states of the forecasts are given as `Foreseen`, for comparison with the measurements.
    """

    def __init__(self, groups: "Sequence[Group]", strings: "Sequence[StringEstimator]", limit_C: float) -> None:
        self._watched = [_Watched(g, g.observed.looks_ahead()) for g in groups]
        self._load, self._limit = Load(len(strings)), limit_C
        self._by_voltage = any(g.voltage for g in groups)
        self._means: list[Floats] = []
        self._heat: list[Floats] = []
        self._all = tuple(strings)
        self.wanted = False

    def forget(self) -> None:
        """Start again after a time without frames."""
        self._means.clear()
        self._heat.clear()
        self._load.forget()
        for w in self._watched:
            w.certainty = None
            for s in w.group.strings:
                s.forecast = None

    def snapshot(self) -> dict[str, Any]:
        """Return the memory of past loads, as lists of numbers."""
        return {"strings": [s.plan.name for s in self._all], "load": self._load.snapshot()}

    def restore(self, state: Mapping[str, Any] | None, same: "set[str]") -> None:
        """Restore the memory of past loads from a snapshot of the same strings; states of older versions have none.

        Raises
        ------
        KeyError, TypeError, ValueError
            `state` is not such a snapshot.
        """
        if (
            state is not None
            and state["strings"] == [s.plan.name for s in self._all]
            and same.issuperset(state["strings"])
        ):
            self._load.restore(state["load"])

    def take(self, readings: "Readings", t1: int) -> Foreseen | None:
        """Include a tick that ends at `t1`, ns; make a forecast every ten seconds.

        Returns
        -------
        Foreseen or None
            If `wanted` is set and ten seconds have passed.
        """
        self._means.append(readings.means)
        if self._by_voltage:
            heat = np.full(len(self._all), np.nan)
            for w in self._watched:
                if w.group.heat is not None:
                    heat[w.group.rows] = w.group.heat
            self._heat.append(heat)
        if t1 % STEP_NS:
            return None
        step = self._load.take(np.stack(self._means), readings.inlet, self._heat)
        self._means.clear()
        self._heat.clear()
        unknown = np.isnan(step.square)
        square_sd, inlet_sd = self._load.square_sd(), self._load.inlet_sd()
        origins = []
        for w in self._watched:
            rows = w.group.rows
            lost = np.isnan(readings.inlet[rows])
            origin = self._look(w, t1, unknown[rows], square_sd[:, rows], inlet_sd[:, rows], lost)
            if origin is not None:
                origins.append(origin)
        if not self.wanted:
            return None
        forecasts = tuple(s.forecast for s in self._all)
        return Foreseen(t1, step, forecasts, tuple(origins))

    def _look(
        self, w: _Watched, t1: int, unknown: Bools, square_sd: Floats, inlet_sd: Floats, lost: Bools
    ) -> Origin | None:
        group, rows = w.group, w.group.rows
        s = group.observed.observer.standing()
        if not s.available.any():
            return None
        if lost.any():
            held = s.disturbance.inlet_unknown * np.sqrt(-np.expm1(-2.0 * _AT_S / s.disturbance.correlation))
            inlet_sd = np.where(lost, np.hypot(inlet_sd, held[:, None]), inlet_sd)
        coming = self._coming(group, s, inlet_sd)
        w.age += 1
        n = group.cells
        sd = np.sqrt(_core_sd(s, n) ** 2 + coming.shift_sd**2 + coming.heat_sd**2)
        grown = w.sd is not None and bool((sd > GROWN * w.sd + 0.1).any())
        known = w.certainty if w.age < ANEW and not grown else None
        ahead = w.outlook.ahead(s, coming, known)
        if known is None:
            w.certainty, w.age, w.sd = ahead.certainty, 0, sd
        square = np.nan_to_num(self._load.square[rows])
        surely = None
        if unknown.any():  # the usual load, with the scatter of a drive
            R_e = np.array([float(np.mean(p.R_e)) for p in s.parameters])
            work = np.maximum(square, s.disturbance.heat_unknown / R_e)
            surely = np.where(unknown, SPREAD * work, 0.0) * np.ones_like(square_sd)
        self._tell(group, ahead, t1, square, square_sd, surely)
        return Origin(tuple(group.members), w.outlook, s, coming) if self.wanted else None

    def _coming(self, group: "Group", s: Standing, inlet_sd: Floats) -> Coming:
        """Collect the assumptions about the time ahead, besides the observer's state."""
        S, n = len(group.members), group.cells
        heat, heat_sd, shift, shift_sd = np.zeros((4, S, n))
        core, watch = s.x[:, 0 : 2 * n : 2], group.watch
        lost: Bools = _core_sd(s, n) > LOST_K
        if lost.any():  # the estimate is anything: its neighbours do not feel it, only how little is known of it
            others = np.where(lost, 0.0, core).sum(axis=1) / np.maximum((~lost).sum(axis=1), 1)
            usual = np.where((~lost).any(axis=1), others, s.inlet)
            shift = np.where(lost, usual[:, None] - core, 0.0)
        if watch is not None and watch.told.some:
            shift = np.where(np.isfinite(watch.told.core), watch.told.core - core, shift)
            shift_sd = np.nan_to_num(watch.told.core_sd)
        if group.misread is not None:
            shift_sd = np.hypot(shift_sd, group.misread)
        for j, string in enumerate(group.strings):
            for f in string.health.heat:
                if f.code == "unexplained_heat" and f.cell is not None and f.heat == f.heat:
                    heat[j, f.cell - 1], heat_sd[j, f.cell - 1] = f.heat, f.heat_sd
        doubt = np.zeros((S, 1)) if group.doubt is None else group.doubt
        per_square, current = self._load.heat_per_square[group.rows], np.nan_to_num(self._load.current[group.rows])
        return Coming(per_square, inlet_sd, heat, heat_sd, shift, shift_sd, doubt, current)

    def _tell(
        self, group: "Group", ahead: Ahead, t1: int, square: Floats, square_sd: Floats, surely: Floats | None
    ) -> None:
        """Give each string its forecast under the mean squares (S,) of the load."""
        T, sd = ahead.under(square), ahead.sd(square, surely)
        off = np.abs(ahead.load.three(ahead.phi)[:, AT_ENDS]) * square_sd[:, :, None]
        course = T[CENTRE]
        width = np.einsum("kh,hsn->ksn", _BETWEEN, sd[CENTRE])
        at = [first_crossing(c, self._limit) for c in (course, course + width, course - width)]
        same, other = (np.sqrt(ahead.permitted(self._limit, way=way))[list(LIMITED)] for way in (1, -1))
        same, other = np.minimum(same, MOST_A), np.minimum(other, MOST_A)
        tight = ahead.limiting(self._limit)
        known = group.by_cell(group.strings[0].newest.core)
        quality = np.isnan(known)
        doubtful = group.by_cell(group.strings[0].newest.quality == DOUBTFUL)
        ends = T[:, AT_ENDS]
        if quality.any():
            ends, course = (np.where(quality, np.nan, a) for a in (ends, course))
            at = [np.where(quality, NEVER_S, a) for a in at]
        for j, s in enumerate(group.strings):
            i, charging = group.members[j], bool(self._load.current[group.members[j]] < 0.0)
            load = sqrt(float(square[j]))
            s.forecast = Forecast(
                t1,
                -load if charging else load,
                bool(self._load.steady[i]),
                ends[CORE, :, j],
                sd[CORE, :, j],
                ends[CENTRE, :, j],
                sd[CENTRE, :, j],
                off[:, :, j],
                ends[SURFACE, :, j],
                sd[SURFACE, :, j],
                course[:, j],
                at[1][j],
                at[2][j],
                at[0][j],
                (other if charging else same)[:, j],
                (same if charging else other)[:, j],
                doubtful[j],
                int(tight[j]),
            )


def _core_sd(s: Standing, n: int) -> Floats:
    """Return the standard deviations (S, n) of the cores if the numbers were exact, K."""
    variance: Floats = np.diagonal(s.P, axis1=1, axis2=2)[:, 0 : 2 * n : 2]
    return np.sqrt(variance)


def _between() -> Floats:
    """Weights (K + 1, H) for linear interpolation from the horizons to the instants of the path."""
    ends, eye = np.array(HORIZONS_S), np.eye(len(HORIZONS_S))
    return np.stack([np.interp(PATH_S, ends, row) for row in eye], axis=1)


_AT_S, _BETWEEN = np.array(HORIZONS_S), _between()
