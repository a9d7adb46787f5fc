"""Minimising a deviance: Gauss–Newton steps with Levenberg's damping, within bounds.

Every maximum a posteriori fit uses it: whole records (`map_fit`) and windows of a drive (`window_problem`). A `Valley`
gives the deviance and its curvature; `descend` makes the steps.

In place of the least squares of Lin et al., Eq 3-10, where a model is not linear in its numbers.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from bms_gateway.identify.quadratic import Quadratic
from bms_gateway.thermal import Floats

FORETOLD = 0.8
"""Share of its predicted gain that a step must reach for its slopes to be used once more."""
INWARDS = 1e-6
"""Gradient at a bound, in sd of a number, below which it is rounding and the bound is kept."""
HOPEFUL = 0.3
"""Share of the deviance above its mark that a step must gain, or promise, to continue."""


class Place(Protocol):
    """A point of the descent."""

    @property
    def z(self) -> Floats:
        """The numbers (Z,)."""
        ...

    @property
    def deviance(self) -> float:
        """Twice the negative logarithm of the posterior at the numbers, up to a constant."""
        ...


P = TypeVar("P", bound=Place)


class Valley(Protocol[P]):
    """A deviance over numbers within bounds.

    Attributes
    ----------
    lower, upper : ndarray (Z,)
    """

    lower: Floats
    upper: Floats

    def at(self, z: Floats, near: P) -> P | None:
        """Return the place at numbers (Z,) near another place; None if the model has no solution there."""
        ...

    def slopes(self, here: P, fresh: bool) -> Quadratic | None:
        """Return the quadratic at a place, with earlier columns unless `fresh`; None if derivatives are not finite."""
        ...

    def stiffness(self, H: Floats) -> Floats:
        """Return the addition of one unit of damping to the diagonal (Z,) of a precision (Z, Z)."""
        ...

    def share(self, z: Floats, step: Floats) -> float:
        """Return the share of a step (Z,) from `z` within which a linear response is valid."""
        ...


@dataclass(frozen=True, slots=True)
class Pace:
    """Damping of the steps until the deviance falls.

    Attributes
    ----------
    least, onset : float
        Damping of a first step, and least damping of a repeated step; in units of the valley's `stiffness`.
    growth, ease : float
        Factors on it after a step that raises the deviance, and after one that lowers it.
    tries : int
    halves : bool
        Whether half of a step is tried before the damping rises: useful if one number bends the response, because then
        the length of the step is wrong rather than its direction.
    """

    least: float
    onset: float
    growth: float
    ease: float
    tries: int
    halves: bool = False


@dataclass(frozen=True, slots=True)
class Patience:
    """When a descent ends.

    Attributes
    ----------
    iterations : int
    least_gain : float
        Deviance: a step that gains less ends the descent.
    give_up : float
        Deviance: the descent ends as soon as it is unlikely to fall below this.
    outclassed : float
        Deviance: the descent ends if the promise of the second or a later step is still above this.
    reuse : bool
        Whether slopes are expensive: slopes that predicted a gain well serve for another step, but not for the last.
    """

    iterations: int
    least_gain: float
    give_up: float = np.inf
    outclassed: float = np.inf
    reuse: bool = True


def descend(valley: Valley[P], here: P, pace: Pace, patience: Patience) -> tuple[P, Quadratic | None]:
    """Minimise the deviance from a place.

    Returns
    -------
    Place
        The lowest place found.
    Quadratic or None
        At a place at most one short step from it; None if derivatives were not finite.
    """
    damping, fresh = pace.least, True
    slopes: Quadratic | None = None
    for iteration in range(patience.iterations):
        slopes = valley.slopes(here, fresh)
        if slopes is None or (iteration and _outclassed(here, slopes, patience.outclassed)):
            break
        before, promised = here.deviance, 0.0
        for new, damped in _steps(valley, slopes, here.z, damping, pace):
            there = valley.at(new, here)
            if there is not None and np.isfinite(there.deviance) and there.deviance <= before:
                promised = slopes.gained(there.z - here.z)
                here, damping = there, max(pace.ease * damped, pace.least)
                break
        gain = before - here.deviance
        far = here.deviance - patience.give_up
        settled = gain < patience.least_gain or (iteration > 0 and far > 0.0 and max(gain, promised) < HOPEFUL * far)
        if settled and fresh:
            break
        fresh = settled or not patience.reuse or gain <= FORETOLD * promised
    return here, slopes


def _outclassed(here: Place, slopes: Quadratic, mark: float) -> bool:
    return mark < np.inf and here.deviance - slopes.promise > mark


def _steps(
    valley: Valley[P], slopes: Quadratic, z: Floats, damping: float, pace: Pace
) -> Iterator[tuple[Floats, float]]:
    """Yield the ends of ever shorter steps, each with its damping."""
    for _ in range(pace.tries):
        stiff = Quadratic(slopes.H + np.diag(damping * valley.stiffness(slopes.H)), slopes.pull)
        step = _step(stiff, z, valley.lower, valley.upper)
        share = valley.share(z, step)
        for part in (share, 0.5 * share) if pace.halves else (share,):
            yield np.clip(z + part * step, valley.lower, valley.upper), damping
        damping = max(pace.growth * damping, pace.onset)


def _step(q: Quadratic, z: Floats, lower: Floats, upper: Floats) -> Floats:
    """Step (Z,) to the minimum of a quadratic within the bounds, by the primal active-set method.

    References
    ----------
    J. Nocedal and S. J. Wright, Numerical Optimization, 2nd ed., Algorithm 16.3.
    """
    low, high = lower - z, upper - z
    free, step = np.ones(len(z), np.bool_), np.zeros(len(z))
    for _ in range(3 * len(z) + 3):
        there = step.copy()
        rest = q.pull[free] - q.H[np.ix_(free, ~free)] @ step[~free]
        there[free] = np.linalg.solve(q.H[np.ix_(free, free)], rest)
        out = free & ((there < low) | (there > high))
        if out.any():  # to the first bound, then along it
            bound = np.where(there < low, low, high)
            shares = np.full(len(z), np.inf)
            shares[out] = (bound[out] - step[out]) / (there[out] - step[out])
            first = int(np.argmin(shares))
            step[free] += shares[first] * (there[free] - step[free])
            step[first], free[first] = bound[first], False
            continue
        step = there
        inwards = np.where(step == low, 1.0, -1.0) * (q.pull - q.H @ step) / np.sqrt(np.diag(q.H))
        inwards[free] = 0.0
        if inwards.max(initial=0.0) < INWARDS:
            break
        free[int(np.argmax(inwards))] = True
    return step
