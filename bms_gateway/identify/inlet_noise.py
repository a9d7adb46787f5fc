r"""Noise of the inlet's readings: the model answers to it as the cells do not.

Least squares would damp that answer, by a slower casing, a thicker film or a smaller swing, the more the less else is
said of them by an inlet that only ramps. What the noise is expected to add to half the sum of squares,

.. math::
    \tfrac12 \sigma_f^2 \sum_{kj} (\partial y_k / \partial T_{f,j})^2,

is therefore taken off it (a corrected score).

For Lin et al., Eq 16-18, whose inlet has no noise. The corrected score: Nakamura, Biometrika 77 (1990) 127-137.
"""

from collections.abc import Callable, Sequence

import numpy as np

from bms_gateway.identify.response import Inputs, respond
from bms_gateway.thermal import Floats, StringParameters

MEAN_S = 4.0
"""Half a casing's time, below which it cannot tell noise with a memory from white noise of the same strength. A line
through the last eight readings has such a memory: neighbouring ticks, being alike, would show a third of its noise."""
QUIET = (0.8, 0.6616)  # share of the inlet's readings, and sd of a normal distribution's innermost part of that share
COMB_S = 128.0  # between impulses at the inlet: casings have forgotten one before the next


def inlet_noise(inlet: Floats, dt: float) -> float:
    """Sd of white noise as strong as that of an inlet's readings (K + 1,) about what they follow, K.

    From the quieter part of what means of `MEAN_S` depart from their neighbours' mean: a flap that opens is not in it;
    steps of the bus are. Noise that lasts longer, as of an inlet that is sent once in five seconds, is told too small.

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


def slopes_by_noise(
    sets: Sequence[StringParameters],
    step: float,
    steps: int,
    dt: float,
    swing: float,
    sensed: Sequence[int],
    see: Callable[[Floats], Floats],
) -> Floats:
    """Slopes of half of what white noise of 1 K at the inlet adds to the squares.

    Impulses that are far enough apart for their answers not to meet stand for all instants.

    Parameters
    ----------
    sets : sequence of StringParameters
        The numbers, then S sets with one logarithm more by `step` each.
    step : float
    steps : int
        K, of `dt` s each.
    swing : float
        Gain of the inlet's departures from its mean.
    sensed : sequence of int
        0-based cells with a thermocouple (m of them).
    see : callable
        From surfaces (K + 1, m, S + 1) to residuals (K, m, S + 1) as the fit weighs them.

    Returns
    -------
    ndarray (S + 1,)
        By the logarithms and by the swing.
    """
    spacing = max(1, min(round(COMB_S / dt), steps))
    comb, still = np.zeros(steps + 1), np.zeros(steps)
    comb[spacing // 2 :: spacing] = 1.0
    inputs = Inputs(still, still, comb, dt, np.zeros((steps, 0)), np.zeros(0))
    answer = see(respond(sets, inputs, np.zeros((len(sets), 2 * sets[0].cells)), sensed).surface.transpose(1, 2, 0))
    energy = spacing * np.einsum("kms,kms->s", answer, answer)
    return np.append(0.5 * swing**2 * (energy[1:] - energy[0]) / step, swing * energy[0])


def of_swing(slope: float, heard: float) -> float:
    """Tell how much of the slope by the swing to take off, where all that is `heard` of it has that much noise in it.

    Where noise is all of it there is no swing to tell, and the swing may shrink.
    """
    return slope * (1.0 - slope / heard) if heard > slope else 0.0
