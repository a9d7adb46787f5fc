"""The search for missing effects: screen all, refit the best, decide by evidence and held-out readings, repeat.

The rules are in `weighing`. After each addition the earlier effects are tried again: an effect is dropped if it is
superfluous, and exchanged if another one explains its part better.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bms_gateway.diagnosis.bounds import below_least
from bms_gateway.diagnosis.candidates import INSTEAD, Candidate, candidates
from bms_gateway.diagnosis.coarse_rows import HOPELESS, left_open
from bms_gateway.diagnosis.residuals import log_density, rmse, structure, within
from bms_gateway.diagnosis.screen import Gain, extended, screen
from bms_gateway.diagnosis.weighing import HALF, Settings, Trial, inexact, judge, prior_odds, worth
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.map_fit import (
    FitEffort,
    FitStart,
    MapFit,
    annealed,
    converged,
    fitted,
    map_fit,
    refreshed,
    stacked,
)
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import StringModel
from bms_gateway.thermal.effects import effect_named

Progress = Callable[[float, str], None]
EXPLAINED = 1.05
"""Cost per reading of a fit that explains everything."""
OUTCLASSED = 0.25
"""Largest part of the best fit's gain that another fit may lack, after its next promised step, to be completed."""
ALL_OR_ENDS = {"surface_joule": "busbar_joule", "ambient_loss": "end_plate"}
ALL_OR_ENDS |= {ends: every for every, ends in ALL_OR_ENDS.items()}
"""Effects of all cells, and of the end cells alone, which only a thermocouple between them distinguishes."""
AS_GOOD = 0.9
"""Share of the log-odds above which the other one of two such effects explains the readings equally well."""
NEAR = 0.95
"""Share of the first effect's log-odds above which another is tried in its place if structure is left."""
STRAINED = 3.0
"""sd of a tolerance: one in four hundred; beyond, a missing effect is assumed."""


@dataclass(frozen=True, slots=True)
class Chosen:
    """An effect that the search added.

    Attributes
    ----------
    candidate : Candidate
    tied : tuple of str
        Other effects that this record cannot tell from it.
    log_odds : float
    """

    candidate: Candidate
    tied: tuple[str, ...]
    log_odds: float


@dataclass(slots=True)
class Search:
    """Result of a search.

    Attributes
    ----------
    baseline, final : MapFit
    chosen : list of Chosen
    rounds : list of list of Trial
        Ranked by probability, the first round's first.
    gains : list of Gain
        Scores of all candidates against the baseline.
    orphan : bool
        Strong evidence for a missing effect, none of which passes the gates.
    left_open : float, K
        Possible error of the readings because the current is not known between its rows.
    hopeless : bool
        Whether this error is too large to name any effect.
    physical : list of list of Trial, or None
        Rounds of the earlier search, which offered no other source of the heat; None if this is that search.
    """

    baseline: MapFit
    final: MapFit
    chosen: list[Chosen] = field(default_factory=list)
    rounds: list[list[Trial]] = field(default_factory=list)
    gains: list[Gain] = field(default_factory=list)
    orphan: bool = False
    left_open: float = 0.0
    hopeless: bool = False
    physical: list[list[Trial]] | None = None

    @property
    def asked(self) -> list[list[Trial]]:
        """Rounds over physical effects, without another source of the heat."""
        return self.rounds if self.physical is None else self.physical


def search(
    model: StringModel,
    records: Sequence[Measured],
    settings: Settings | None = None,
    progress: Progress | None = None,
    doubts: Sequence[float] = (),
    baseline: MapFit | None = None,
) -> Search:
    """Search for the effects that a model lacks.

    Parameters
    ----------
    model : StringModel
        With the priors of its fit.
    records : sequence of Measured
    settings : Settings, optional
    progress : callable, optional
        Gets the share of the work done and the present step.
    doubts : sequence of float, optional
        Relative sd of a minute's heat in each record, if rows of the current are too far apart (`coarse_rows`).
    baseline : MapFit, optional
        Fit of the present model to these records, if there is one.

    Returns
    -------
    Search
        The same for the same arguments, to the last bit.
    """
    s = settings or Settings()
    tell = progress or (lambda _share, _text: None)
    if baseline is None:
        tell(0.0, "fitting the model as it is")
        baseline = fitted(Problem(model, records))
    found = Search(baseline, baseline)
    found.left_open, found.hopeless = left_open(baseline, doubts), max(doubts, default=0.0) > HOPELESS
    s = replace(s, left_open=found.left_open)
    y = stacked(baseline.problem)[0]
    surfaces = (float(np.quantile(y, 0.002)), float(np.quantile(y, 0.998)))
    offered = [c for c in candidates(model, records[0].drive, surfaces) if s.voltage or c.name not in INSTEAD]
    _climb(found, offered, s, tell)
    for rival in _rivals(found, s):
        tell(0.9, f"beginning with {rival.candidate.key}")
        other = Search(baseline, _settled(rival.fit, baseline, s), gains=found.gains, rounds=found.rounds[:1])
        other.chosen.append(chosen_of(rival, found.rounds[0]))
        _climb(other, offered, s, tell)
        if structure(other.final).z <= s.white and _posterior(other, offered) > _posterior(found, offered) + s.ahead:
            other.left_open, other.hopeless, found = found.left_open, found.hopeless, other
            break
    found.orphan = not found.chosen and any(t.log_odds > s.ahead for r in found.rounds for t in r)
    tell(1.0, "done")
    return found


def _climb(found: Search, offered: Sequence[Candidate], s: Settings, tell: Progress) -> None:
    """Add effects one by one as long as evidence and held-out readings accept one."""
    baseline, on_trial = found.baseline, False
    for number in range(len(found.chosen), s.effects):
        current = found.final
        tell(0.15 + 0.8 * number / s.effects, "screening the catalogue")
        there = {c.candidate.key for c in found.chosen}
        gains = screen(current, [c for c in offered if c.key not in there])
        if number == 0:
            found.gains = gains
        trials = _round(_Round(current, baseline, offered, s, number), gains, tell)
        trials = [replace(t, fit=t.fit.light) for t in trials]
        if not trials:
            break
        found.rounds.append(trials)
        accepted = next((t for t in trials if t.passed), None)
        if accepted is None and number == 0 and trials[0].log_odds > s.ahead:
            accepted, on_trial = trials[0], True  # two effects may generalise only together
        if accepted is None:
            break
        found.chosen.append(chosen_of(accepted, trials))
        found.final = _settled(accepted.fit, baseline, s)
        if len(found.chosen) > 1:
            _exchange(found, offered, s)
    if on_trial and not _redeemed(found):
        found.chosen, found.final = [], baseline


def _rivals(found: Search, s: Settings) -> list[Trial]:
    """Other first effects that explained nearly as much, if the found ones leave structure.

    If two effects are missing, the one that resembles both best comes first. With it in the model, neither of the two
    gains much; the search must then start from another one.
    """
    if not found.chosen or structure(found.final).z <= s.white:
        return []
    there = {c.candidate.name for c in found.chosen}
    near = [t for t in found.rounds[0] if t.candidate.name not in there]
    near = [t for t in near if t.log_odds > NEAR * found.rounds[0][0].log_odds]
    return list({t.candidate.name: t for t in reversed(near)}.values())[::-1][: s.ways]


def _posterior(found: Search, offered: Sequence[Candidate]) -> float:
    return found.final.log_evidence + sum(prior_odds(c.candidate, offered) for c in found.chosen)


def refit(
    parent: MapFit, gain: Gain, *, iterations: int = 8, give_up: float = np.inf, outclassed: float = np.inf
) -> MapFit:
    """Fit a model with one more effect, from the optimum without it."""
    problem = Problem(gain.candidate.put_into(parent.problem.model, gain.values), parent.problem.records)
    theta = np.concatenate([parent.theta, problem.begin[len(parent.theta) :]])
    guess = [
        extended(problem.physics, X, problem.numbers(r, theta, parent.nu)[0], problem.model.cells)
        for r, X in enumerate(parent.prediction.X)
    ]
    return map_fit(
        problem,
        FitStart(theta, parent.nu, guess, parent.J),
        FitEffort(iterations, give_up, outclassed),
        linear=parent.linear,
    )


def refit_from_nominal(fit: MapFit, parent: MapFit, *, give_up: float = np.inf) -> MapFit:
    """Fit the same model from the priors' medians: a strong effect biases the optimum at which others start."""
    P = len(parent.theta)
    theta = fit.problem.begin
    theta[P:] = fit.theta[P:]
    rough = annealed(fit.problem, theta)
    return map_fit(
        fit.problem,
        FitStart(rough.theta, rough.nu, rough.prediction.X),
        FitEffort(8, give_up),
        linear=rough.linear,
    )


def _settled(fit: MapFit, baseline: MapFit, s: Settings) -> MapFit:
    """Fit to the end; a shape effect is annealed again as long as it leaves structure and this helps."""
    best = converged(fit)
    shaped = any(p.neutral is None for e in fit.problem.model.effects for p in effect_named(e.name).parameters)
    for _ in range(s.restarts if shaped else 0):
        if structure(best).z <= s.strong:
            break
        other = converged(refit_from_nominal(best, baseline))
        if other.log_evidence <= best.log_evidence:
            break
        best = other
    return best


@dataclass(frozen=True, slots=True)
class _Round:
    """Start of one round of the search: the present model, the first model, and the candidates."""

    current: MapFit
    baseline: MapFit
    offered: Sequence[Candidate]
    settings: Settings
    number: int


def _round(start: _Round, gains: Sequence[Gain], tell: Progress) -> list[Trial]:
    current, offered, s, number = start.current, start.offered, start.settings, start.number
    chosen: list[Gain] = []
    # gain by relaxed tolerances counts in full
    tempered = 1.0 if strained(current) else 1.0 + inexact(current, start.baseline, s)
    for g in gains:
        family = sum(c.candidate.name == g.candidate.name for c in chosen)
        if _promising(g, offered, s, number, tempered) and family < s.per_family and len(chosen) < s.refits:
            chosen.append(g)
    fits: list[tuple[Candidate, MapFit]] = []
    best = np.inf
    for i, g in enumerate(chosen):
        # if one effect explains everything, another one that does not soon come close is no rival
        explained = best < EXPLAINED * current.readings < current.cost
        outclassed = best + OUTCLASSED * (current.cost - best) if explained else np.inf
        if current.cost - g.gain / s.promise > outclassed:
            continue
        tell(0.15 + 0.8 * (number + 0.1 + 0.8 * i / len(chosen)) / s.effects, f"refitting with {g.candidate.key}")
        fit = refit(current, g, give_up=best + 60.0, outclassed=outclassed)
        best = min(best, fit.cost)
        fits.append((g.candidate, fit))
    if not fits:
        return []

    def posterior(c: Candidate, fit: MapFit) -> float:
        return fit.log_evidence + prior_odds(c, offered)

    fits.sort(key=lambda x: -posterior(*x))
    # later rounds start from an optimum that already contains the strongest effect
    biased = number == 0 and structure(current).z > s.strong
    if biased and structure(fits[0][1]).z > s.strong:
        fits[0] = (fits[0][0], converged(fits[0][1]))
    if strained(current) or (biased and structure(fits[0][1]).z > s.strong):
        _restart(fits, current, s)
        fits.sort(key=lambda x: -posterior(*x))
    return judge(current, start.baseline, fits, offered, s, number)


def _restart(fits: list[tuple[Candidate, MapFit]], current: MapFit, s: Settings) -> None:
    """Fit the best (which come first) from nominal too, and keep the better result.

    If the first then explains everything, distant others are not refitted: their starts had the same bias, and a
    restart brings them nearer, but not past it.
    """
    first, gained, whole = fits[0][1], 0.0, False
    for i in range(min(s.restarts, len(fits))):
        c, fit = fits[i]
        if whole and first.log_evidence - fit.log_evidence > s.far + 10.0 * gained:
            continue
        other = refit_from_nominal(fit, current, give_up=fits[0][1].cost + 60.0)
        if other.log_evidence > fit.log_evidence:
            fits[i] = (c, other)
        if i == 0:
            gained = fits[0][1].log_evidence - first.log_evidence
            whole = structure(fits[0][1]).z <= s.strong


def strained(fit: MapFit) -> bool:
    """Whether cells or sensors are at the limits of their tolerances: the path back is long and curved."""
    return bool(np.any(np.abs(fit.nu) > STRAINED * fit.linear.sd))


def _promising(g: Gain, offered: Sequence[Candidate], s: Settings, number: int, tempered: float = 1.0) -> bool:
    needed = s.odds(number) + HALF - prior_odds(g.candidate, offered)
    return g.gain >= 2.0 * s.promise * needed * tempered


def chosen_of(accepted: Trial, trials: Sequence[Trial]) -> Chosen:
    """Name the effects that explain nearly as much as the accepted one."""
    likely = [t for t in trials if t.share >= 0.01]
    if _ends_only(accepted.fit):
        other = ALL_OR_ENDS.get(accepted.candidate.name)
        likely += [t for t in trials if t.candidate.name == other and t.log_odds > AS_GOOD * accepted.log_odds]
    tied = [t.candidate.name for t in likely if t.candidate.name != accepted.candidate.name]
    return Chosen(accepted.candidate, tuple(dict.fromkeys(tied)), accepted.log_odds)


def _ends_only(fit: MapFit) -> bool:
    """Whether no thermocouple is between a string's end cells, so that only the end cells show directly."""
    ends = {1, fit.problem.model.cells}
    return all(cell in ends for m in fit.problem.records for _, cell in m.channels)


def _exchange(found: Search, offered: Sequence[Candidate], s: Settings) -> None:
    """Try each earlier effect again: it may now be superfluous, or another may explain its part better."""
    inflation = structure(found.final).inflation
    for old in found.chosen[:-1]:
        keep = [c for c in found.chosen if c is not old]  # an exchange puts the new one last
        less = without(found.final, old.candidate.key)
        odds = worth(less, found.final, found.baseline, inflation, s) + prior_odds(old.candidate, offered) - HALF
        if odds < s.first_odds:
            found.chosen, found.final = keep, converged(less)
            return
        there = {c.candidate.key for c in keep}
        gains = screen(less, [c for c in offered if c.key not in there])
        seen: dict[str, Gain] = {}
        for g in gains:
            if _promising(g, offered, s, 1) and len(seen) < 6:
                seen.setdefault(g.candidate.name, g)
        fits = [(g.candidate, fit) for g in seen.values() if not below_least(fit := refit(less, g))]
        if not fits:
            continue

        def posterior(x: tuple[Candidate, MapFit]) -> float:
            return x[1].log_evidence + prior_odds(x[0], offered)

        fits.sort(key=posterior, reverse=True)
        # a few steps cannot decide which of the near ones is the best
        near = [posterior(x) > posterior(fits[0]) - s.far for x in fits[: s.restarts]]
        fits = [(c, converged(fit)) if ok else (c, fit) for (c, fit), ok in zip(fits, near, strict=False)] + fits[
            len(near) :
        ]
        best, fit = max(fits, key=posterior)
        won = fit.log_evidence + prior_odds(best, offered)
        won -= found.final.log_evidence + prior_odds(old.candidate, offered)
        if won > s.first_odds * inflation and best.key != old.candidate.key:
            trials = judge(less, found.baseline, sorted(fits, key=lambda x: -x[1].log_evidence), offered, s, 1)
            trial = next(t for t in trials if t.candidate is best)
            found.chosen = [*keep, chosen_of(trial, trials)]
            found.final = fit


def without(fit: MapFit, key: str) -> MapFit:
    """Refit without one effect, named by its key in model files."""
    model = fit.problem.model
    less = replace(model, effects=tuple(e for e in model.effects if e.key != key))
    problem = Problem(less, fit.problem.records, fit.problem.beliefs)
    theta = np.array([fit.theta[fit.problem.index(c.name)] for c in problem.coordinates])
    return refreshed(map_fit(problem, FitStart(theta, fit.nu), FitEffort(8), linear=fit.linear))


def _redeemed(found: Search) -> bool:
    """Whether effects accepted on trial generalise together."""
    held = within(found.baseline)
    better = log_density(found.final, held) - log_density(found.baseline, held) >= 10.0
    return len(found.chosen) > 1 and better and rmse(found.final, held) <= 1.05 * rmse(found.baseline, held)
