r"""Temperatures of strings some minutes ahead, their uncertainty, and the current that keeps them below a limit.

Temperatures ahead are linear in the square u of the current, T(h) = T_0(h) + u T_1(h). T_0 is the course without a
load, and T_1 the response to one A² from now on. One part of the uncertainty is the same for every load: the present
state, drifting heat, the inlet, unexplained heat. Another part depends on the course: the uncertain parameters, the
scatter of the cells, the share of R_c within the roll. As slopes are linear in u too,

.. math:: \operatorname{var} T(h) = w(h) + q_0(h) + 2 u \, q_1(h) + u^2 q_2(h)

so the greatest load that keeps a cell z standard deviations below a limit L is the smaller root of
:math:`(L - T_0 - u T_1)^2 = z^2 \operatorname{var} T`.

Beyond Lin et al., whose observer estimates only the present.
"""

from dataclasses import dataclass

import numpy as np

from bms_gateway.thermal import Floats
from bms_gateway.thermal.centre import hottest_point

STEP_S = 10.0
"""Finest step of a forecast: a surface follows in about nine seconds, a core in minutes."""
PATH = (1, 2, 3, 4, 6, 9, 12, 18, 24, 30, 45, 60)
"""Steps ahead at which the course is computed, for the time to a limit."""
ENDS = (1, 6, 30, 60)
"""Instants of `PATH` at which bands are given."""
HORIZONS_S = tuple(STEP_S * k for k in ENDS)
PATH_S = np.array([0.0, *(STEP_S * k for k in PATH)])
AT_ENDS = [1 + PATH.index(k) for k in ENDS]
CORE, SURFACE, CENTRE = 0, 1, 2
SURE = 2.0
"""Distance in standard deviations that a permitted current keeps below the limit: 1 in 44 of a Gaussian lies beyond."""


@dataclass(frozen=True, slots=True)
class Course:
    """Cores, surfaces and lags (K + 1, S, n) at the instants `PATH_S`."""

    core: Floats
    surface: Floats
    lag: Floats

    def centre(self, phi: Floats) -> Floats:
        """Temperature of the roll's centre; of a response to a load, per A²."""
        return np.asarray(self.core + phi * self.lag, dtype=np.float64)

    def three(self, phi: Floats) -> Floats:
        """Cores, surfaces, centres (3, K + 1, S, n)."""
        return np.stack((self.core, self.surface, self.centre(phi)))


@dataclass(frozen=True, slots=True)
class Unlike:
    """Scatter of the cells, and the uncertainty of their jelly rolls.

    Attributes
    ----------
    heat, cooling, inside : ndarray (S, 1)
        Standard deviations of a cell's own ln R_e, ln R_u, ln R_c.
    phi, phi_sd : ndarray (S, 1)
        Share of R_c within the roll.
    doubt : ndarray (S, 1)
        Share of the difference core to surface that may be wrong in addition.
    now : ndarray (3, S, n), K²
        Variance of the present core, surface and centre by the scatter of cells.
    """

    heat: Floats
    cooling: Floats
    inside: Floats
    phi: Floats
    phi_sd: Floats
    doubt: Floats
    now: Floats


@dataclass(frozen=True, slots=True)
class Spread:
    """Uncertainty of S strings ahead, at the H instants `HORIZONS_S`.

    Attributes
    ----------
    still : ndarray (3, H, S, n), K²
        Variances of cores and surfaces, and their covariance, that do not depend on the load.
    gram : ndarray (H, S, n, 4, 4)
        Part of the uncertain parameters: products of the slopes of core without a load, core per A², surface without a
        load, surface per A².
    """

    still: Floats
    gram: Floats


@dataclass(frozen=True, slots=True)
class Certainty:
    """Variances of cores, surfaces and centres, w + q_0 + 2 u q_1 + u² q_2, K², (3, H, S, n) each."""

    w: Floats
    q0: Floats
    q1: Floats
    q2: Floats


@dataclass(frozen=True, slots=True)
class Ahead:
    """Forecast of S strings of n cells.

    Attributes
    ----------
    still, load : Course
        Without a load, and the response to one A² in the present direction of the current.
    certainty : Certainty
    phi : ndarray (S, 1)
    other : Course or None
        Response to one A² in the other direction; None if it is the same.
    """

    still: Course
    load: Course
    certainty: Certainty
    phi: Floats
    other: Course | None = None

    def under(self, square: Floats) -> Floats:
        """Cores, surfaces and hottest points (3, K + 1, S, n), °C, at `PATH_S` under mean squares (S,), A²."""
        u, a, b = square[:, None], self.still, self.load
        core, surface, lag = a.core + u * b.core, a.surface + u * b.surface, a.lag + u * b.lag
        return np.stack((core, surface, hottest_point(core, surface, lag, self.phi)))

    def sd(self, square: Floats, square_sd: Floats | None = None) -> Floats:
        """Return standard deviations (3, H, S, n), K, under mean squares (S,), A², with sd `square_sd` (H, S)."""
        u, c = square[:, None], self.certainty
        var = c.w + c.q0 + u * (2.0 * c.q1 + u * c.q2)
        if square_sd is not None:
            var = var + np.square(self.load.three(self.phi)[:, AT_ENDS] * square_sd[:, :, None])
        return np.asarray(np.sqrt(np.maximum(var, 0.0)), dtype=np.float64)

    def permitted(self, limit_C: float, sds: float = SURE, way: int = 1) -> Floats:
        """Greatest constant squares of the current (H, S), A², that keep each cell's hottest point below a limit.

        The current flows from now on until each horizon. 0 if every current is too much, infinite if none is, NaN if a
        cell of the string is not known.

        Parameters
        ----------
        limit_C : float
        sds : float
            Number of standard deviations by which the hottest point must stay below.
        way : {1, -1}
            1 for a current in the present direction, -1 for the other direction.
        """
        square = self._squares(limit_C, sds, way)[0].min(axis=2)
        return np.asarray(np.minimum.accumulate(square, axis=0), dtype=np.float64)

    def limiting(self, limit_C: float, sds: float = SURE, way: int = 1) -> np.ndarray:
        """Cell (S,), from 0, that limits the current which is permitted until the last horizon.

        Where none is permitted, it is the cell that lies, with its `sds` standard deviations, farthest above the limit
        without a load. Cells of which nothing is known are skipped. The parameters are those of `permitted`.
        """
        square, over = self._squares(limit_C, sds, way)
        rank = np.where(square > 0.0, square, -over)
        return np.asarray(np.where(np.isnan(rank), np.inf, rank).min(axis=0).argmin(axis=1))

    def _squares(self, limit_C: float, sds: float, way: int) -> tuple[Floats, Floats]:
        """Return permitted squares (H, S, n), A², and by how much each cell is above the limit without a load, K."""
        load = self.load if way > 0 or self.other is None else self.other
        s, certain, z = self.still, self.certainty, sds**2
        room = limit_C - hottest_point(s.core[AT_ENDS], s.surface[AT_ENDS], s.lag[AT_ENDS], self.phi)
        slope = np.maximum(load.centre(self.phi)[AT_ENDS], load.surface[AT_ENDS])
        a = np.square(slope) - z * certain.q2[CENTRE]
        half = room * slope + z * certain.q1[CENTRE]
        c = np.maximum(room, 0.0) ** 2 - z * (certain.w[CENTRE] + certain.q0[CENTRE])
        below = half + np.sqrt(np.maximum(half * half - a * c, 0.0))
        square = np.divide(c, below, out=np.full(c.shape, np.inf), where=below > 0.0)
        over = sds * np.sqrt(certain.w[CENTRE] + certain.q0[CENTRE]) - room
        return np.where(np.isnan(c), np.nan, np.where(c > 0.0, square, 0.0)), over


def certainty(still: Course, load: Course, spread: Spread, unlike: Unlike) -> Certainty:
    """Put together the uncertainty of a forecast.

    Parameters
    ----------
    still, load : Course
        Without a load, and the response to one A².
    spread : Spread
    unlike : Unlike
    """
    core, surface, both = spread.still
    G = spread.gram
    made = [_three(core, surface, both, both, unlike)]
    for i, j in ((0, 0), (0, 1), (1, 1)):
        made.append(_three(G[..., i, j], G[..., 2 + i, 2 + j], G[..., i, 2 + j], G[..., j, 2 + i], unlike))
    T = [c.three(unlike.phi) for c in (still, load)]
    moved = [(t - t[:, :1])[:, AT_ENDS] for t in T]
    apart = [(t - t[SURFACE])[:, AT_ENDS] for t in T]
    lag = [c.lag[AT_ENDS] for c in (still, load)]
    for q, (i, j) in enumerate(((0, 0), (0, 1), (1, 1)), start=1):
        over = moved[i][SURFACE] * moved[j][SURFACE]
        inner = (moved[i] - moved[i][SURFACE]) * (moved[j] - moved[j][SURFACE])
        made[q] += np.square(unlike.heat) * moved[i] * moved[j] + np.square(unlike.cooling) * over
        made[q] += np.square(unlike.inside) * inner + np.square(unlike.doubt) * apart[i] * apart[j]
        made[q][CENTRE] += np.square(unlike.phi_sd) * lag[i] * lag[j]
    made[0] += unlike.now[:, None]
    return Certainty(*made)


def _three(core: Floats, surface: Floats, one: Floats, other: Floats, unlike: Unlike) -> Floats:
    """Products of two slopes of core, surface, and centre = core + φ (core - surface), from those of core and surface.

    `one`: first core with second surface; `other`: second core with first surface.
    """
    phi, mixed = unlike.phi, one + other
    centre = (1.0 + phi) ** 2 * core + phi**2 * surface - phi * (1.0 + phi) * mixed
    return np.stack((core, surface, centre + np.square(unlike.phi_sd) * (core + surface - mixed)))


def first_crossing(course: Floats, limit_C: float) -> Floats:
    """Seconds until each of the courses (K + 1, …) first reaches a limit; infinite if it does not within the forecast.

    Examples
    --------
    >>> course = np.interp(PATH_S, [0.0, 600.0], [50.0, 62.0])
    >>> float(first_crossing(course, 60.0).round(3)), float(first_crossing(course, 65.0))
    (500.0, inf)
    """
    above = course >= limit_C
    k = above.argmax(axis=0)
    never = ~above.any(axis=0)
    before = np.maximum(k - 1, 0)
    low, high = (np.take_along_axis(course, i[None], 0)[0] for i in (before, k))
    share = np.divide(limit_C - low, high - low, out=np.zeros_like(low), where=(k > 0) & (high > low))
    at = PATH_S[before] + share * (PATH_S[k] - PATH_S[before])
    return np.where(never, np.inf, np.where(k == 0, 0.0, at))
