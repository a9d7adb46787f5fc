"""What a verdict consists of: effects with their numbers, and errors before and after."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import nan

import numpy as np

from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.core_band import posterior
from bms_gateway.diagnosis.residuals import Structure, noise_floor, rmse, structure
from bms_gateway.identify.map_fit import MapFit, stacked


@dataclass(frozen=True, slots=True)
class Number:
    """A fitted number of an effect as people read it: value, standard deviation, unit."""

    value: float
    sd: float
    unit: str


@dataclass(frozen=True, slots=True)
class Ranked:
    """An effect in the ranking.

    Attributes
    ----------
    effect : str
    cell : int or None
    heldout_rmse_K : float
    evidence : float
        Tempered log-odds against nothing.
    share : float
        Posterior probability of the effect within its round.
    parameters : mapping of str to Number
    tied_with : tuple of str
        Effects that these records cannot tell from this one.
    refused : str
        Why it was refused; empty if it was not.
    """

    effect: str
    cell: int | None
    heldout_rmse_K: float
    evidence: float
    share: float
    parameters: Mapping[str, Number]
    tied_with: tuple[str, ...]
    refused: str


@dataclass(frozen=True, slots=True)
class Errors:
    """Root mean squares in K: trained readings, held-out readings, and what the noise alone would leave.

    `closest_K` is that of the held-out readings to which other numbers of the same model come.
    """

    train_rmse_K: float
    heldout_rmse_K: float
    noise_floor_K: float
    structure: Structure
    closest_K: float = nan


@dataclass(frozen=True, slots=True)
class Selected:
    """An effect of the verdict, with the effects tied with it, and which of its numbers ends at a bound."""

    candidate: Candidate
    tied_with: tuple[str, ...]
    parameters: Mapping[str, Number]
    log_odds: float
    bound: str = ""


def errors(fit: MapFit) -> Errors:
    """Errors of a fit on trained and held-out readings."""
    used = stacked(fit.problem)[4]
    everything = np.ones_like(used)
    return Errors(rmse(fit, used), rmse(fit, ~used), noise_floor(fit, everything), structure(fit))


def numbers(fit: MapFit, c: Candidate) -> dict[str, Number]:
    """Numbers of one effect of a fit in the units shown to people; sd by the delta method if it is a logarithm."""
    sd = np.sqrt(np.diag(posterior(fit)))
    found = {}
    for p in filter(c.is_free, c.effect.parameters):
        i = fit.problem.index(f"{c.key}.{p.name}")
        value = float(np.exp(fit.theta[i])) if p.log else float(fit.theta[i])
        spread = value * float(sd[i]) if p.log else float(sd[i])
        found[p.name] = Number(value / p.to_si, spread / p.to_si, p.unit)
    return found
