"""Whether a state that was taken up can be one of a real string: what a sound check sum does not tell.

A state may be whole and yet wrong: written by a version with a bug, edited by hand, or of another vehicle. An observer
started from 5000 °C would drag every estimate with it for the length of a drive, so such a state is refused as a whole.
"""

from collections.abc import Sequence

import numpy as np

from bms_gateway.errors import StateError
from bms_gateway.identify import Posterior
from bms_gateway.observe import Estimate as States
from bms_gateway.thermal import KINDS, Floats

LOWEST_C, HIGHEST_C = -60.0, 200.0
"""Beyond what cells survive, and what the input guards let in; room for a core above its surface."""
WIDEST_SD_K = 200.0
"""A string of which nothing is known starts with 22 K."""
WIDEST_LN_SD = 5.0
"""A parameter known within a factor of 150 is known not at all; priors are far below."""
PAST_BOUND = 1.0
"""ln: posteriors may lean beyond a bound, but not by a factor of e."""
NEGATIVE = -1e-6
"""Share of the largest eigenvalue that rounding may leave of a covariance's smallest."""


def check_temperatures(names: Sequence[str], e: States) -> None:
    """Refuse temperatures and bands that no string can have.

    Parameters
    ----------
    names : sequence of str
        Strings, in the order of the estimate's rows.
    e : observe.Estimate

    Raises
    ------
    StateError
        Which string, which cell, what value.
    """
    for j in np.flatnonzero(e.available).tolist():
        for what, value, sd in (("core", e.core[j], e.core_sd[j]), ("surface", e.surface[j], e.surface_sd[j])):
            bad = ~((value >= LOWEST_C) & (value <= HIGHEST_C))
            if bad.any():
                k = int(bad.argmax())
                raise StateError(
                    f"stored state: {names[j]}: {what} of cell {k + 1} is {value[k]:.4g} °C; possible: "
                    f"{LOWEST_C:g} to {HIGHEST_C:g} °C"
                )
            bad = ~((sd > 0.0) & (sd <= WIDEST_SD_K))
            if bad.any():
                k = int(bad.argmax())
                raise StateError(
                    f"stored state: {names[j]}: {what} of cell {k + 1} has a standard deviation of {sd[k]:.4g} K; "
                    f"possible: above 0, to {WIDEST_SD_K:g} K"
                )


def check_covariance(name: str, what: str, P: Floats) -> None:
    """Refuse a matrix that is no covariance: not symmetric, or with a negative variance in some direction.

    Raises
    ------
    StateError
    """
    size = float(np.abs(P).max(initial=0.0))
    sound = bool(np.isfinite(P).all()) and float(np.abs(P - P.T).max(initial=0.0)) <= 1e-6 * size
    if not sound or float(np.linalg.eigvalsh(P).min(initial=0.0)) < NEGATIVE * size:
        raise StateError(f"stored state: {name}: the covariance of its {what} is none: a variance in it is negative")


def check_parameters(name: str, posterior: Posterior) -> None:
    """Refuse parameters beyond their physical bounds, or known with a certainty that is no number.

    Raises
    ------
    StateError
        Which string, which parameter, what value.
    """
    check_covariance(name, "parameters", posterior.cov)
    sd = np.sqrt(np.maximum(np.diag(posterior.cov), 0.0))
    for symbol, mean, spread in zip(posterior.names, posterior.mean.tolist(), sd.tolist(), strict=True):
        kind = KINDS[symbol]
        low, high = np.log(kind.lower) - PAST_BOUND, np.log(kind.upper) + PAST_BOUND
        if not (low <= mean <= high and spread <= WIDEST_LN_SD):
            with np.errstate(over="ignore"):
                value, part = np.exp(mean), 100.0 * spread
            raise StateError(
                f"stored state: {name}: {symbol} is {value / kind.to_si:.4g} {kind.unit} ± {part:.0f} %; possible: "
                f"{kind.lower / kind.to_si:g} to {kind.upper / kind.to_si:g} {kind.unit}"
            )
