"""The forecast of a string, and the state from which it started, with which a later comparison can judge it."""

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from bms_gateway.health.nearing import Approach
from bms_gateway.observe.ahead import Ahead, Certainty
from bms_gateway.observe.forecast_start import Coming, Profile, Standing
from bms_gateway.thermal import Floats

TOLD_S: Final = {1: "60", 2: "300", 3: "600"}
"""Horizons, s, at which temperatures are reported, by their index among the horizons of a forecast."""
FOR_S: Final = ("10", "60", "600")
"""Durations, s, for which permitted currents are given."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """Forecast of one string of n cells under the present load.

    Attributes
    ----------
    time_ns : int
    load : float
        Root mean square of the current that the forecast assumes, A, with the sign of the mean current.
    steady : bool
        Whether this current is constant, and not the mean of the last minutes.
    core, core_sd, centre, centre_sd : ndarray (H, n)
        At `HORIZONS_S`, °C and K, given that load; NaN where the core is not known.
    load_sd : ndarray (3, H, n), K
        Errors of cores, surfaces and hottest points that a change of the load would cause.
    surface, surface_sd : ndarray (H, n)
    course : ndarray (K + 1, n)
        Hottest points at `PATH_S`, °C.
    soonest_s, latest_s : ndarray (n,)
        Time to the limit, one standard deviation earlier and later; infinite if it is over ten minutes.
    limit_s : ndarray (n,)
        Time to the limit; 0 if the limit is reached already, infinite if it is over ten minutes.
    discharge, charge : ndarray (3,)
        Greatest constant current for 10 s, 1 and 10 min that keeps every hottest point two standard deviations below
        the limit, A.
    doubtful : ndarray of bool (n,)
        Cells whose cores are sent as doubtful.
    limiting : int
        Cell (from 0) that limits the current for 10 min in the present direction.
    """

    time_ns: int
    load: float
    steady: bool
    core: Floats
    core_sd: Floats
    centre: Floats
    centre_sd: Floats
    load_sd: Floats
    surface: Floats
    surface_sd: Floats
    course: Floats
    soonest_s: Floats
    latest_s: Floats
    limit_s: Floats
    discharge: Floats
    charge: Floats
    doubtful: np.ndarray[tuple[int], np.dtype[np.bool_]]
    limiting: int

    @property
    def first(self) -> int | None:
        """Cell (from 0) that reaches the limit first; None if none does within ten minutes."""
        k = int(np.argmin(self.limit_s))
        return k if np.isfinite(self.limit_s[k]) else None

    @property
    def peak(self) -> float:
        """The hottest of all points within ten minutes, °C; NaN if nothing is known."""
        return float(np.fmax.reduce(self.course, axis=None))

    @property
    def unknown(self) -> tuple[int, ...]:
        """Cells, from 1, whose hottest points are not known."""
        return tuple((np.flatnonzero(np.isnan(self.course).any(axis=0)) + 1).tolist())

    def approach(self) -> Approach | None:
        """Describe the cell that reaches the limit first; None if no cell does within ten minutes."""
        if (k := self.first) is None:
            return None
        permitted = self.charge if self.load < 0.0 else self.discharge
        return Approach(
            k + 1,
            float(self.course[0, k]),
            float(self.limit_s[k]),
            float(self.soonest_s[k]),
            float(self.latest_s[k]),
            self.load,
            float(permitted[-1]),
            bool(self.doubtful[k]),
        )

    @property
    def hottest(self) -> int | None:
        """Cell (from 0) with the hottest point in ten minutes; None if nothing is known."""
        last = self.centre[-1]
        return None if np.isnan(last).all() else int(np.nanargmax(last))


class LooksAhead(Protocol):
    """A forecaster for the strings of a group."""

    def ahead(self, s: Standing, coming: Coming, known: Certainty | None = None) -> Ahead:
        """Forecast from the present state; `known` are the variances of a recent forecast."""
        ...

    def under(self, s: Standing, coming: Coming, profile: Profile) -> Ahead:
        """Forecast under a given profile of the load."""
        ...


@dataclass(frozen=True, slots=True)
class Origin:
    """Starting state of the forecasts of a group.

    Attributes
    ----------
    members : tuple of int
        Numbers of its strings in the plan.
    outlook : LooksAhead
    standing : Standing
    coming : Coming
    """

    members: tuple[int, ...]
    outlook: LooksAhead
    standing: Standing
    coming: Coming


@dataclass(frozen=True, slots=True)
class Load10:
    """Means over the ten seconds that end now, of S strings; NaN where unknown.

    Attributes
    ----------
    current, square, inlet : ndarray (S,)
        Means of I, A, and I², A²; newest inlet, °C.
    """

    current: Floats
    square: Floats
    inlet: Floats


@dataclass(frozen=True, slots=True)
class Foreseen:
    """The forecasts of a step; given only if `engine.foreseeing` is set.

    Attributes
    ----------
    load : Load10
        Load of the ten seconds before.
    forecasts : tuple of Forecast or None
        By string.
    origins : tuple of Origin
    """

    time_ns: int
    load: Load10
    forecasts: tuple[Forecast | None, ...]
    origins: tuple[Origin, ...]
