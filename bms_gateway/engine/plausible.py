"""Whether a stored state is physically possible; a check sum does not show this.

A state with a right check sum can still be wrong: written by a version with a bug, edited by hand, or from another
vehicle. An observer that starts from 5000 °C would falsify every estimate of a drive, so such a state is refused as a
whole.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from bms_gateway.errors import ConfigError, StateError
from bms_gateway.identify import Posterior
from bms_gateway.observe import Estimate as States
from bms_gateway.thermal import KINDS, Floats, StringParameters

LOWEST_C, HIGHEST_C = -60.0, 200.0
"""Limits wider than what cells survive and what the guard accepts, with a margin for a core above its surface."""
WIDEST_SD_K = 200.0
"""Greatest standard deviation; an unknown string starts with 22 K."""
WIDEST_LN_SD = 5.0
"""A parameter known only to a factor of 150 is not known at all; the sd of priors is far smaller."""
PAST_BOUND = 1.0
"""ln: margin of a posterior beyond a bound, less than a factor of e."""
NEGATIVE = -1e-6
"""Rounding may make the smallest eigenvalue of a covariance negative by this share of the largest one."""


@contextmanager
def fitting() -> Iterator[None]:
    """Restore a stored state; an exception because of an unknown form becomes a `StateError`.

    Raises
    ------
    StateError
        The state does not fit.
    """
    try:
        yield
    except (TypeError, ValueError, LookupError, AttributeError, ArithmeticError, ConfigError) as e:
        raise StateError(f"stored state does not fit this program: {type(e).__name__} {e}") from None


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
    """Refuse a matrix that is not a covariance: not symmetric, or with a negative variance in some direction.

    Raises
    ------
    StateError
    """
    size = float(np.abs(P).max(initial=0.0))
    sound = bool(np.isfinite(P).all()) and float(np.abs(P - P.T).max(initial=0.0)) <= 1e-6 * size
    if not sound or float(np.linalg.eigvalsh(P).min(initial=0.0)) < NEGATIVE * size:
        raise StateError(
            f"stored state: {name}: the matrix of its {what} is no covariance: it is not symmetric, or has a negative "
            "variance"
        )


def check_numbers(name: str, p: StringParameters) -> None:
    """Refuse numbers of an observer's cells beyond their physical bounds.

    Raises
    ------
    StateError
        Which string, which parameter, what value.
    """
    for symbol in KINDS:
        value = np.atleast_1d(getattr(p, symbol))
        value = value[value != np.inf]  # the string has no conduction or no coolant node
        low, high = KINDS[symbol].lower * np.exp(-PAST_BOUND), KINDS[symbol].upper * np.exp(PAST_BOUND)
        bad = ~((value >= low) & (value <= high))
        if bad.any():
            raise _beyond(name, symbol, float(value[int(bad.argmax())]))


def check_parameters(name: str, posterior: Posterior) -> None:
    """Refuse parameters beyond their physical bounds, or with a standard deviation that is not a number.

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
                raise _beyond(name, symbol, float(np.exp(mean)), f" ± {100.0 * spread:.0f} %")


def _beyond(name: str, symbol: str, value: float, spread: str = "") -> StateError:
    kind = KINDS[symbol]
    return StateError(
        f"stored state: {name}: {symbol} is {value / kind.to_si:.4g} {kind.unit}{spread}; possible: "
        f"{kind.lower / kind.to_si:g} to {kind.upper / kind.to_si:g} {kind.unit}"
    )
