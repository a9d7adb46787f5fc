"""Effective resistance of a pack over a drive: the one with which I²R is the heat, polarisation included.

The voltage of a cell falls at once with a current, and further within minutes. All of this fall makes heat. The change
of the open-circuit voltage with the charge does not. So the voltage is fitted by a polynomial of the charge, the
current, and the current smoothed over some times; the heat of the fitted overvoltage over ∫I² dt is the resistance.
"""

from typing import Final

import numpy as np

from bms_gateway.frames.ammeter import UNUSUAL
from bms_gateway.thermal import Floats

TIMES_S: Final = (8.0, 30.0, 120.0)
"""Times of polarisation: of the double layer, and of diffusion."""
DEGREE: Final = 3
"""Degree of the polynomial for the open-circuit voltage over the charge."""
LEAST_S: Final = 300.0
"""A shorter log does not separate polarisation from the effect of the charge."""
UNEXPLAINED: Final = 0.2
"""Greatest rms error of the fit, relative to the rms of the voltage minus the open-circuit voltage."""
MOST_OVER_STEPS: Final = 4.0
"""Greatest ratio to the resistance by steps of a second; a greater ratio means that the model of the charge is
wrong."""


def heat_resistance(I: Floats, V: Floats, step_s: float) -> float | None:  # noqa: E741
    """Estimate the resistance, Ω, with which I²R is the heat; None if the log does not determine it.

    Parameters
    ----------
    I, V : ndarray (n,)
        Means over intervals, A (discharge positive) and V; NaN where unknown.
    step_s : float
        Length of an interval.
    """
    if len(I) * step_s < LEAST_S or not np.isfinite(V).any():
        return None
    known = np.isfinite(I) & np.isfinite(V) & (np.abs(V / np.nanmedian(V) - 1.0) < UNUSUAL)
    if known.mean() < 0.9:
        return None
    flow = np.where(np.isfinite(I), I, 0.0)
    charge = np.cumsum(flow) * step_s
    span = float(np.ptp(charge)) or 1.0
    level = 2.0 * (charge - charge.min()) / span - 1.0
    open_circuit = np.polynomial.legendre.legvander(level, DEGREE)
    drops = np.stack([flow, *(_smoothed(flow, step_s / tau) for tau in TIMES_S)], axis=1)
    columns = np.concatenate([open_circuit, -drops], axis=1)[known]
    size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    R = _not_negative(columns / size, V[known], open_circuit.shape[1]) / size
    over = drops[known] @ R[open_circuit.shape[1] :]
    error = V[known] - columns @ R
    squares = float(np.sum(flow[known] ** 2))
    if squares == 0.0 or not error.std() < UNEXPLAINED * over.std():
        return None
    found = float(np.sum(flow[known] * over)) / squares
    at_once = float(R[open_circuit.shape[1]])
    return found if at_once > 0.0 and found < MOST_OVER_STEPS * at_once else None


def _smoothed(x: Floats, share: float) -> Floats:
    """First-order lag; `share` is the step divided by the time constant."""
    y, keep = np.empty(len(x)), float(np.exp(-share))
    last = 0.0
    for k, value in enumerate(x.tolist()):
        last = keep * last + (1.0 - keep) * value
        y[k] = last
    return y


def _not_negative(A: Floats, y: Floats, free: int) -> Floats:
    """Least squares with non-negative numbers after the first `free`: drop the most negative, repeat."""
    use = np.ones(A.shape[1], np.bool_)
    while True:
        b = np.zeros(A.shape[1])
        b[use] = np.linalg.lstsq(A[:, use], y, rcond=None)[0]
        worst = free + int(b[free:].argmin())
        if b[worst] >= 0.0:
            return b
        use[worst] = False
