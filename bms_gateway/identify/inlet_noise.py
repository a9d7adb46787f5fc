r"""Noise of the inlet's readings: the model responds to it, the cells do not.

Least squares would reduce this response by a slower casing, a thicker film or a smaller swing. The less an inlet moves
besides ramps, the stronger is this error. The expected addition of the noise to half the sum of squares,

.. math::
    \tfrac12 \sigma_f^2 \sum_{kj} (\partial y_k / \partial T_{f,j})^2,

is therefore subtracted (a corrected score).

For Lin et al., Eq 16-18, whose inlet has no noise. The corrected score: Nakamura, Biometrika 77 (1990) 127-137.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from bms_gateway.identify.response import Inputs, respond
from bms_gateway.thermal import Floats, StringParameters

MEAN_S = 4.0
"""Half of a casing's time constant: within this time, noise with a memory acts like white noise of the same strength. A
line through the last eight readings has such a memory; differences of neighbouring ticks would show a third of its
noise."""
QUIET = (0.8, 0.6616)  # share of the inlet's readings, and sd of a normal distribution's innermost part of that share
COMB_S = 128.0  # between impulses at the inlet: casings have forgotten one before the next


def inlet_noise(inlet: Floats, dt: float) -> float:
    """Sd, K, of white noise as strong as that of an inlet's readings (K + 1,) about the true inlet.

    From the quieter part of the differences between means over `MEAN_S` and those of their neighbours. This part has no
    flap that opens, but has steps of the bus. Longer noise, as of an inlet sent every five seconds, is underestimated.

    Parameters
    ----------
    inlet : ndarray (K + 1,)
        °C.
    dt : float
        s.

    Examples
    --------
    >>> round(inlet_noise(20.0 + np.random.default_rng(1).normal(0.0, 0.1, 2000), 4.0), 2)
    0.1
    """
    ticks = max(1, round(MEAN_S / dt))
    means = inlet[: len(inlet) // ticks * ticks].reshape(-1, ticks).mean(axis=1)
    bent = np.sort(np.abs(means[1:-1] - 0.5 * (means[:-2] + means[2:])))
    quiet = bent[: round(QUIET[0] * len(bent))]
    return float(np.sqrt(ticks * np.mean(quiet**2) / 1.5)) / QUIET[1] if quiet.size else 0.0


class Sight(NamedTuple):
    """Residuals of a fit from surfaces.

    Attributes
    ----------
    sensed : sequence of int
        0-based cells with a thermocouple (m of them).
    weigh : callable
        From surfaces (K + 1, m, S + 1) to residuals (K, m, S + 1) with the weights of the fit.
    """

    sensed: Sequence[int]
    weigh: Callable[[Floats], Floats]


def slopes_by_noise(
    sets: Sequence[StringParameters], step: float, steps: int, dt: float, swing: float, sight: Sight
) -> Floats:
    """Slopes of half of the addition of white noise of 1 K at the inlet to the squares.

    Impulses represent all instants; they are far enough apart that their responses do not overlap.

    Parameters
    ----------
    sets : sequence of StringParameters
        The numbers, then S sets with one logarithm increased by `step` each.
    step : float
    steps : int
        K, of `dt` s each.
    swing : float
        Gain of the inlet's deviations from its mean.
    sight : Sight

    Returns
    -------
    ndarray (S + 1,)
        By the logarithms and by the swing.
    """
    spacing = max(1, min(round(COMB_S / dt), steps))
    comb, still = np.zeros(steps + 1), np.zeros(steps)
    comb[spacing // 2 :: spacing] = 1.0
    inputs = Inputs(still, still, comb, dt, np.zeros((steps, 0)), np.zeros(0))
    R = respond(sets, inputs, np.zeros((len(sets), 2 * sets[0].cells)), sight.sensed)
    answer = sight.weigh(R.surface.transpose(1, 2, 0))
    energy = spacing * np.einsum("kms,kms->s", answer, answer)
    return np.append(0.5 * swing**2 * (energy[1:] - energy[0]) / step, swing * energy[0])


def of_swing(slope: float, heard: float) -> float:
    """Share of the noise's slope by the swing to subtract, if information `heard` on the swing contains that slope.

    If all of it is noise, the data say nothing of the swing, and the swing may shrink.
    """
    return slope * (1.0 - slope / heard) if heard > slope else 0.0
