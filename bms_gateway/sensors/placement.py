"""Best places of m surface sensors on a string: those with the smallest sd of the least certain core.

If there are few sets, all are tried. If there are many, a static model of the string proposes sets. In this model the
errors of heat and inlet never change, and the noise of a sensor is averaged over the time that such errors last. The
search adds the best sensor until there are m, and then exchanges sensors one by one. The sets that it finds, even
spacing, and even spacing improved by exchanges are judged by the exact measure. On strings where this is cheap, the
sensors of the best set are then moved one by one. A modal decomposition could not be used here, because equal cells
make A defective.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import comb

import numpy as np

from bms_gateway.errors import UsageError, counted
from bms_gateway.sensors.exact import exact_ranks
from bms_gateway.sensors.paper import paper_ranks
from bms_gateway.sensors.steady import Steady
from bms_gateway.thermal import Disturbance, Floats, StringParameters, continuous

EXHAUSTIVE = 5_000
"""Number of sets up to which all are tried: seconds on twenty cells."""
TRIED_CELLS = 200
"""Cells up to which all sets are tried and the best set is improved sensor by sensor; beyond, it would take minutes."""
SHOWN = 10
"""Placements that are reported, best first."""
ANYWHERE = 400
"""Product of cells and sensors up to which a sensor is tried on every cell, and not only on near ones."""
COUNTED_CELLS = 60
"""Cells up to which sets are counted exactly."""
DECOMPOSED = 5e8
"""Sets times sensors times n³ up to which the singular values of the paper's rank are computed."""
ROUNDS = 50
"""Most exchanges or moves. Each one improves the set, so this bound is not reached in practice."""

Sensors = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Placement:
    """A set of sensors and the standard deviation of each core with it.

    Attributes
    ----------
    sensors : tuple of int
        1-based cells, ascending.
    core_sd : ndarray (n,), K
        Steady standard deviation of each core.
    """

    sensors: Sensors
    core_sd: Floats

    @property
    def worst_cell(self) -> int:
        """Cell (1-based) with the least certain core."""
        return int(np.argmax(self.core_sd)) + 1

    @property
    def worst_sd(self) -> float:
        """Standard deviation of that core, K."""
        return float(self.core_sd.max())


@dataclass(frozen=True, slots=True)
class Placements:
    """The best places for m sensors.

    Attributes
    ----------
    cells, sensors : int
        n and m.
    sets : int
        C(n, m).
    exhaustive : bool
        Whether all of them were tried.
    best : tuple of Placement
        Best first.
    even : Placement
        The best of the evenly spaced sets.
    losses : tuple of Placement
        The best set without its first, second, … sensor: the result if that sensor fails.
    nothing : Placement
        The string without any sensor.
    """

    cells: int
    sensors: int
    sets: int
    exhaustive: bool
    best: tuple[Placement, ...]
    even: Placement
    losses: tuple[Placement, ...]
    nothing: Placement


class PlacementProblem:
    """One string whose sensors are to be placed, with everything that its placements share.

    Parameters
    ----------
    p : StringParameters
    disturbance : Disturbance, optional
    dt : float, s
    """

    def __init__(self, p: StringParameters, disturbance: Disturbance | None = None, *, dt: float = 1.0) -> None:
        self._p, self._disturbance, self._dt = p, disturbance or Disturbance(), dt
        self.cells = p.cells
        self.steady = Steady.of(p, self._disturbance, dt=dt)

    def measure(self, sets: Iterable[Sequence[int]]) -> list[Placement]:
        """Compute the standard deviation of each core with each set."""
        chosen = [tuple(sorted(s)) for s in sets]
        return [Placement(s, sd) for s, sd in zip(chosen, self.steady.core_sd(chosen), strict=True)]

    def best(self, sensors: int) -> Placements:
        """Find the places of `sensors` sensors, 1…n, with the smallest sd of the worst core.

        Raises
        ------
        UsageError
            The string cannot have this number of sensors.

        References
        ----------
        The question of Lin et al., Tables 2 and 3, with the sd instead of the rank.

        Examples
        --------
        >>> p = StringParameters.of(12, C_c=268, C_s=18.8, R_e=3.5e-3, R_c=1.266, R_u=0.79, R_cc=32, C_f=11.33)
        >>> found = PlacementProblem(p).best(2)
        >>> found.best[0].sensors, round(found.best[0].worst_sd, 2), [round(x.worst_sd, 2) for x in found.losses]
        ((1, 12), 0.48, [0.73, 1.05])
        """
        n = self.cells
        if not 1 <= sensors <= n:
            raise UsageError(f"{counted(sensors, 'sensor')} on {counted(n, 'cell')}: valid: 1 to {n}")
        sets = comb(n, sensors)
        exhaustive = self._triable(sensors)
        tried = self._all(sensors) if exhaustive else self._searched(sensors)
        even = _ranked(self.measure(even_sets(n, sensors)))[0]
        ranked = _ranked(tried)[:SHOWN]
        chosen = ranked[0].sensors
        *losses, nothing = self.measure([*(chosen[:i] + chosen[i + 1 :] for i in range(sensors)), ()])
        return Placements(n, sensors, sets, exhaustive, tuple(ranked), even, tuple(losses), nothing)

    def fewest(self, wanted: float) -> Placement:
        """Find the fewest sensors that determine every core to `wanted`, and their places.

        Parameters
        ----------
        wanted : float, K
            Standard deviation of the worst core.

        Returns
        -------
        Placement
            With the fewest sensors whose `worst_sd` is at most `wanted`; with one on every cell if even that is not
            enough.

        Notes
        -----
        If all C(n, m − 1) sets can be tried, one sensor less is proved to be too few; otherwise sets are searched.

        Examples
        --------
        >>> p = StringParameters.of(12, C_c=268, C_s=18.8, R_e=3.5e-3, R_c=1.266, R_u=0.79, R_cc=32, C_f=11.33)
        >>> PlacementProblem(p).fewest(0.5).sensors
        (1, 12)
        """
        (nothing,) = self.measure([()])
        if nothing.worst_sd <= wanted:
            return nothing
        short, m = 0, 1  # `short` sensors are known to be too few
        while (found := _ranked(self._searched(m))[0]).worst_sd > wanted:
            if m == self.cells:
                return found
            short, m = m, min(2 * m, self.cells)
        while m - short > 1:
            middle = (short + m) // 2
            nearer = _ranked(self._searched(middle))[0]
            if nearer.worst_sd <= wanted:
                found, m = nearer, middle
            else:
                short = middle
        # The search may have missed a set with one sensor less; if possible, all such sets are tried.
        while m > 1 and self._triable(m - 1):
            less = _ranked(self._all(m - 1))[0]
            if less.worst_sd > wanted:
                break
            found, m = less, m - 1
        return found

    def _triable(self, m: int) -> bool:
        return self.cells <= TRIED_CELLS and comb(self.cells, m) <= EXHAUSTIVE

    def _all(self, m: int) -> list[Placement]:
        return self.measure(combinations(range(1, self.cells + 1), m))

    def _searched(self, m: int) -> list[Placement]:
        """Find promising sets without trying all."""
        even = even_sets(self.cells, m)
        proposed = [self._static.exchanged(self._static.added(m)), *even, *map(self._static.exchanged, even)]
        tried = {x.sensors: x for x in self.measure(dict.fromkeys(proposed))}
        if self.cells > TRIED_CELLS:
            return list(tried.values())
        best = _ranked(tried.values())[0]
        reach = self.cells if m * self.cells <= ANYWHERE else 2
        for _ in range(ROUNDS):
            near = [s for s in _shifted(best.sensors, self.cells, reach) if s not in tried]
            tried |= {x.sensors: x for x in self.measure(near)}
            better = _ranked(tried.values())[0]
            if better is best:
                break
            best = better
        return list(tried.values())

    @cached_property
    def _static(self) -> "_Static":
        return _Static.of(self._p, self._disturbance, self._dt)


def even_sets(cells: int, sensors: int) -> list[Sensors]:
    """Space sensors evenly: with both ends, in the middle of each section, at the end of each section.

    References
    ----------
    Lin et al., Table 3, whose {3, 6, 9, 12} is the third kind.

    Examples
    --------
    >>> even_sets(12, 4)
    [(1, 5, 8, 12), (2, 5, 8, 11), (3, 6, 9, 12)]
    """
    share = cells / sensors
    ends = [1 + round(i * (cells - 1) / (sensors - 1)) for i in range(sensors)] if sensors > 1 else [cells]
    amid = [int((i + 0.5) * share + 0.5) for i in range(sensors)]
    last = [int((i + 1) * share + 1e-9) for i in range(sensors)]
    return list(dict.fromkeys(tuple(s) for s in (ends, amid, last)))


def _ranked(found: Iterable[Placement]) -> list[Placement]:
    """Sort the best first. Sets that agree to a micro-kelvin are sorted by their mean, then by their cells."""
    return sorted(found, key=lambda x: (round(x.worst_sd, 6), round(float(x.core_sd.mean()), 6), x.sensors))


def _shifted(sensors: Sensors, cells: int, reach: int) -> list[Sensors]:
    """Move each sensor in turn by up to `reach` cells in either direction."""
    near = []
    for i, k in enumerate(sensors):
        rest = sensors[:i] + sensors[i + 1 :]
        near += [
            tuple(sorted((*rest, j))) for j in range(max(1, k - reach), min(cells, k + reach) + 1) if j not in sensors
        ]
    return list(dict.fromkeys(near))


@dataclass(frozen=True, slots=True)
class _Static:
    """The static model: constant Gaussian errors with the size of the real ones.

    Attributes
    ----------
    core : ndarray (n,), K²
        Variance of each core.
    cross, surface : ndarray (n, n), K²
        Covariance of core i and surface j, and of the surfaces.
    noise : float, K²
        Variance of a reading averaged over the duration of the errors.
    """

    core: Floats
    cross: Floats
    surface: Floats
    noise: float

    @classmethod
    def of(cls, p: StringParameters, d: Disturbance, dt: float) -> "_Static":
        s = continuous(p)
        sources = np.column_stack([d.heat_cell * s.B_q, d.heat_common * s.B_q.sum(axis=1), d.inlet * s.B_f])
        rest = np.linalg.solve(s.A, sources)
        T_c, T_s = rest[0::2], rest[1::2]
        noise = d.sensor**2 * dt / (2.0 * d.correlation)
        return cls(np.einsum("ij,ij->i", T_c, T_c), T_c @ T_s.T, T_s @ T_s.T, noise)

    def added(self, m: int) -> Sensors:
        """Add the best sensor to the present set, m times."""
        chosen: list[int] = []
        for _ in range(m):
            score = self._with_one_more(chosen)
            chosen.append(int(np.argmin(score)))
        return tuple(sorted(k + 1 for k in chosen))

    def exchanged(self, sensors: Sensors) -> Sensors:
        """Exchange one sensor at a time for a better one until no exchange is better."""
        chosen = [k - 1 for k in sensors]
        for _ in range(ROUNDS):
            before = list(chosen)
            for i, k in enumerate(before):
                rest = chosen[:i] + chosen[i + 1 :]
                score = self._with_one_more(rest)
                other = int(np.argmin(score))
                if score[other] < score[k] * (1.0 - 1e-9):
                    chosen[i] = other
            if chosen == before:
                break
        return tuple(sorted(k + 1 for k in chosen))

    def _with_one_more(self, chosen: Sequence[int]) -> Floats:
        """Worst variance of a core with each additional sensor (n,); infinite for present sensors.

        A thousandth of the mean is added, to compare sensors none of which influences the worst cell.
        """
        core, cross, own = self.core, self.cross, np.diag(self.surface)
        if chosen:
            at = list(chosen)
            seen = self.surface[np.ix_(at, at)] + self.noise * np.eye(len(at))
            share = np.linalg.solve(seen, self.surface[at])
            told = np.linalg.solve(seen, cross[:, at].T)
            core = core - np.einsum("im,mi->i", cross[:, at], told)
            own = own - np.einsum("mi,mi->i", self.surface[at], share)
            cross = cross - cross[:, at] @ share
        left = core[:, None] - cross**2 / (own + self.noise)
        score: Floats = left.max(axis=0) + 1e-3 * left.mean(axis=0)
        score[list(chosen)] = np.inf
        return score


def observable_sets(p: StringParameters, sensors: int) -> tuple[int | None, int | None]:
    """Count the sets of m sensors that determine a string: exactly, and by the paper's rank.

    Returns
    -------
    exact, paper : int or None
        None if the sets are too many, or the string too long, to be counted in a minute.

    References
    ----------
    Lin et al., Table 3.

    Examples
    --------
    >>> from bms_gateway.sensors.paper import paper_string
    >>> observable_sets(paper_string(12, "no-conduction"), 4)
    (165, 1)
    """
    n, sets = p.cells, comb(p.cells, sensors)
    if sets > EXHAUSTIVE or n > COUNTED_CELLS:
        return None, None
    every = list(combinations(range(1, n + 1), sensors))
    exact = int((exact_ranks(p, every) == 2 * n).sum())
    paper = None
    if sets * sensors * n**3 <= DECOMPOSED:
        paper = int((paper_ranks(p, every) == 2 * n).sum())
    return exact, paper
