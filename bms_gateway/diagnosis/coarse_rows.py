"""Uncertainty of the surfaces from rows of the current that are far apart.

Between two rows the current may step at any instant. The heat after the step is then unknown, and its effect on the
surfaces lasts for minutes and is alike at all sensors. It looks like some effects of the catalogue, which did not cause
it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.record_inputs import MINUTE_S
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.identify.problem import Problem

ROWS_S, DOUBT = 1.5, 0.03
"""Distance of rows, above the usual second of a logger, and unknown share of a minute's heat, above which unknown heat
was taken for a missing effect."""
HOPELESS = 0.2
"""Unknown share of a minute's heat above which no effect is named: the fit itself is then wrong, and even strong
effects were given wrong names."""
DRAWS = 8


def doubt(r: Record) -> float:
    """Relative sd of a minute's heat where the current jumps between rows too far apart; 0 elsewhere."""
    return r.sampling.doubt if r.sampling.seconds > ROWS_S and r.sampling.doubt > DOUBT else 0.0


def left_open(fit: MapFit, doubts: Sequence[float]) -> float:
    """Tell how far readings may lie from a right model because nobody knows the current between its rows.

    Parameters
    ----------
    fit : MapFit
    doubts : sequence of float
        Of its records, as `doubt` tells them.

    Returns
    -------
    float, K
        Root mean square over all readings.
    """
    if not any(doubts):
        return 0.0
    rng = np.random.default_rng(0)
    problem = fit.problem
    as_it_is = problem.predict(fit.theta, fit.prediction.X, fit.nu).y
    moved = 0.0
    for _ in range(DRAWS):
        drawn = [_drawn(m, d, rng) for m, d in zip(problem.records, doubts, strict=True)]
        other = Problem(problem.model, drawn, problem.beliefs).predict(fit.theta, fit.prediction.X, fit.nu)
        moved += float(np.mean((other.y - as_it_is) ** 2)) / DRAWS
    return float(np.sqrt(moved))


def _drawn(m: Measured, doubt: float, rng: np.random.Generator) -> Measured:
    """Draw a record whose heat is off in each minute by what is not known of it."""
    u = m.drive
    minute = (np.arange(u.N) * u.dt // MINUTE_S).astype(int)
    off = rng.standard_normal(minute[-1] + 1)[minute]
    return replace(m, drive=replace(u, I2=np.maximum(u.I2 + doubt * float(np.mean(u.I2)) * off, 0.0)))
