"""One ranking of all effects of a diagnosis: the named ones, further ones, and their alternatives.

The worth of one of several effects is found by a refit without it: by the loss of evidence and the remaining error.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import nan
from typing import Literal

import numpy as np

from bms_gateway.diagnosis.adding_bench import all_used, fit_with
from bms_gateway.diagnosis.bounds import at_bound
from bms_gateway.diagnosis.candidates import Candidate, candidates
from bms_gateway.diagnosis.diagnosis import Diagnosis
from bms_gateway.diagnosis.filed import seen_on
from bms_gateway.diagnosis.residuals import rmse, structure
from bms_gateway.diagnosis.search import without
from bms_gateway.diagnosis.second_search import SecondSearch
from bms_gateway.diagnosis.verdict_parts import Number, Ranked, numbers
from bms_gateway.diagnosis.weighing import HALF, Settings, Trial, believed_share, prior_odds, worth
from bms_gateway.identify.map_fit import MapFit, stacked

Role = Literal["named", "tied", "next", "instead", ""]
"""Part of the verdict; not distinguishable from a part; a further effect; an alternative to one; no verdict."""
OTHERS = 8
"""Number of hypotheses of the second search that are reported besides the chosen one."""


@dataclass(frozen=True, slots=True)
class Standing:
    """Place of an effect, or of several together, in the ranking.

    Attributes
    ----------
    effects : tuple of str
        Keys as in model files.
    role : Role
    evidence : float
        Log-odds: for a named effect against leaving it out, for the rest against the model with the effects `beside`.
    share : float
        Posterior probability; NaN if it was not computed, or if a number is at its bound.
    heldout_rmse_K : float
        From the fits of the search, like all errors here: with the effect; for a named effect, with all named ones; NaN
        if nothing was held out for it.
    error_K : float
        With the effect, on held-out readings; on all readings if the second search decided, which holds nothing out.
    without_K : float
        The same without this one of the named effects; NaN for the rest.
    parameters : mapping of str to Number
    tied_with : tuple of str
    refused : str
        Why it was refused, or why a named effect is not proven; empty if nothing contradicts it.
    beside : tuple of str
        Keys of the other effects in the model of the comparison; for a named effect, all other named ones.
    """

    effects: tuple[str, ...]
    role: Role
    evidence: float
    share: float
    heldout_rmse_K: float
    error_K: float
    without_K: float
    parameters: Mapping[str, Number]
    tied_with: tuple[str, ...]
    refused: str
    beside: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name for people."""
        return " + ".join(self.effects)


def ranking(d: Diagnosis) -> tuple[Standing, ...]:
    """Rank all effects of a diagnosis, each effect at each place once.

    Returns
    -------
    tuple of Standing
        The named effects in the order in which they were found, then those tied with them, further effects, and
        alternatives; the last three by decreasing probability.

    Notes
    -----
    It costs a refit for each effect if several are named.
    """
    if not d.selected:
        # the second search compares with leaving an effect out, the first one with nothing
        keys = [_key(r) for r in d.ranking] if d.decided_by_second else []
        return tuple(_once(_alone(r, "", [k for k in keys if k != _key(r)]) for r in d.ranking))
    second = d.second if d.decided_by_second else None
    named = list(_named_by_second(d, second) if second else _named(d))
    rest = list(_hypotheses(d, second)) if second else [*_next(d), *_tied(d), *_instead(d)]
    order: tuple[Role, ...] = ("tied", "next", "instead")
    found = [*named, *(x for role in order for x in rest if x.role == role)]
    return tuple(_once(found))


def _once(found: Iterable[Standing]) -> Iterator[Standing]:
    """Leave out repeated effects: each is reported with its likeliest start and in its first role."""
    there = set()
    for x in found:
        if x.effects not in there:
            there.add(x.effects)
            yield x


def _key(r: Ranked) -> str:
    return r.effect if r.cell is None else f"{r.effect}:{r.cell}"


def _alone(r: Ranked, role: Role, beside: Iterable[str] = ()) -> Standing:
    held, tied, there = r.heldout_rmse_K, r.tied_with, tuple(beside)
    return Standing((_key(r),), role, r.evidence, r.share, held, held, nan, r.parameters, tied, r.refused, there)


def _named(d: Diagnosis) -> Iterator[Standing]:
    passed = [t for trials in d.search.rounds for t in trials if t.passed]
    several = len(d.selected) > 1
    for s in d.selected:
        key = s.candidate.key
        less = without(d.search.final, key) if several else d.search.baseline
        odds = _odds(d, s.candidate, less) if several else s.log_odds
        said = at_bound(d.search.final, s.candidate)
        share = nan if said else next((t.share for t in passed if t.candidate.key == key), nan)
        held = _held(d.search.final)
        without_K, others = _held(less), tuple(x.candidate.key for x in d.selected if x is not s)
        refused = f"{said}: no proof" if said else ""
        yield Standing((key,), "named", odds, share, held, held, without_K, s.parameters, s.tied_with, refused, others)


def _odds(d: Diagnosis, c: Candidate, less: MapFit) -> float:
    """Log-odds for an effect in addition to all other named ones, tempered as in the search."""
    base, final = d.search.baseline.problem, d.search.final
    y = stacked(base)[0]
    offered = candidates(
        base.model, base.records[0].drive, (float(np.quantile(y, 0.002)), float(np.quantile(y, 0.998)))
    )
    gained = worth(less, final, d.search.baseline, structure(final).inflation, Settings())
    return gained + prior_odds(c, offered) - HALF


def _next(d: Diagnosis) -> Iterator[Standing]:
    """List the effects that the last round compared and refused, in addition to all named ones."""
    rounds = d.search.rounds
    if len(rounds) > 1 and not any(t.passed for t in rounds[-1]):
        yield from (_weighed(d, t, "next") for t in rounds[-1])


def _tied(d: Diagnosis) -> Iterator[Standing]:
    """List the effects that these records cannot tell from a named one, with their evidence as a replacement."""
    for s in d.selected:
        trials = next(
            (r for r in d.search.rounds if any(t.candidate.key == s.candidate.key and t.passed for t in r)), []
        )
        yield from (_weighed(d, t, "tied") for t in trials if t.candidate.name in s.tied_with)


def _weighed(d: Diagnosis, t: Trial, role: Role) -> Standing:
    """Return the place of an effect that a round of the search has compared with the model of that round."""
    there = {e.key for e in d.search.baseline.problem.model.effects} | {t.candidate.key}
    beside = tuple(e.key for e in t.fit.problem.model.effects if e.key not in there)
    held, found = _held(t.fit), numbers(t.fit, t.candidate)
    share, why = believed_share(t)
    return Standing((t.candidate.key,), role, t.log_odds, share, held, held, nan, found, (), why, beside)


def _instead(d: Diagnosis) -> Iterator[Standing]:
    for r in d.ranking:
        yield _alone(r, "instead")


def _named_by_second(d: Diagnosis, second: SecondSearch) -> Iterator[Standing]:
    error = _over_all(d, second.best)
    keys = {s.candidate.key for s in d.selected}
    for s in d.selected:
        key = s.candidate.key
        others = sorted(keys - {key})
        less = fit_with(second, others) if others else second.baseline
        # even if the others alone are refused, their error is known
        bare = _over_all(d, without(second.best, key) if less is None else less)
        held = second.held_K[1]
        share = second.probability.get(key, nan)
        numbers_of, tied = s.parameters, s.tied_with
        yield Standing((key,), "named", s.log_odds, share, held, error, bare, numbers_of, tied, "", tuple(others))


def _hypotheses(d: Diagnosis, second: SecondSearch) -> Iterator[Standing]:
    """List the hypotheses nearest to the chosen one: those with one more effect, and others."""
    chosen = {s.candidate.key for s in d.selected}
    tied = {frozenset(chosen - {s.candidate.key} | {t}) for s in d.selected for t in s.tied_with}
    for r in [r for r in second.ranking if r.effects and set(r.effects) != chosen][:OTHERS]:
        mine = set(r.effects)
        effects = tuple(sorted(mine - chosen)) if mine > chosen else tuple(sorted(mine))
        names = frozenset(e.partition(":")[0] for e in mine)
        role: Role = "next" if mine > chosen else "tied" if names in tied and not r.refused else "instead"
        fit = fit_with(second, r.effects)
        error = nan if fit is None else _over_all(d, fit)
        named = tuple(s.candidate.key for s in d.selected)
        yield Standing(effects, role, r.log_odds, r.share, nan, error, nan, {}, (), r.refused, named)


def _over_all(d: Diagnosis, fit: MapFit) -> float:
    """RMSE on all readings as they came, K."""
    found = seen_on(fit, all_used(d.search.baseline.problem.records))
    return rmse(found, stacked(found.problem)[4])


def _held(fit: MapFit) -> float:
    return rmse(fit, ~stacked(fit.problem)[4])
