"""The search for missing effects: screen all, refit the best, let evidence and held-out readings decide, repeat.

Evidence is compared over {nothing, each effect} with half of the prior on nothing, and tempered by how much the best
hypothesis' residual is inflated by autocorrelation. Held-out readings are a gate, never a score: an effect must not be
worse there, and must take its part of what is too much there. After each addition the earlier ones are tried again:
dropped when superfluous, exchanged when another does their work better.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bms_gateway.diagnose.candidates import Candidate, candidates
from bms_gateway.diagnose.residuals import log_density, rmse, structure, within
from bms_gateway.diagnose.screen import Gain, extended, screen
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.map_fit import MapFit, annealed, converged, fitted, map_fit, refreshed, stacked
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import StringModel
from bms_gateway.thermal.effects import effect_named

Progress = Callable[[float, str], None]
HALF = float(np.log(0.5))
STRAINED = 3.0
"""sd of a tolerance: one in four hundred, and what a missing effect is put down to."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Constants of the search.

    Attributes
    ----------
    refits, per_family : int
        Candidates refitted per round, and of one effect among them.
    first_odds, further_odds : float
        Log-odds an effect needs: 3 is 20 to 1; further ones must earn more, for the first has been fitted to the rest.
    effects : int
        Most effects that one search adds.
    promise : float
        Share of the gain an effect needs that the screening must promise before it is refitted: the score is linear,
        and effects that are not do better than it says.
    excess, relief : float
        With it the held-out mean square must lie within this share above the noise floor, or at this share of what it
        had above it.
    strong : float
        z of the structure from which a biased optimum is a bad start: unless the best fit leaves no structure, the best
        are fitted from nominal too.
    restarts : int
        How many of the best.
    proof, sure : float
        Log-likelihood that a further effect must gain on the held-out readings, at log-odds `sure`; half a unit less
        for each that it has more, for a small effect's share of a third of the record is within chance.
    form, memory : float, s
        Error of what effects move, a share of it, and how long it lasts: the lumped form of a strong one is no better.
    ahead : float
        Log-odds from which an effect that fails the gates is kept on trial for one round.
    """

    refits: int = 14
    per_family: int = 2
    first_odds: float = 3.0
    further_odds: float = 6.0
    effects: int = 3
    promise: float = 0.3
    excess: float = 0.25
    relief: float = 0.7
    strong: float = 8.0
    restarts: int = 3
    proof: float = 3.0
    sure: float = 10.0
    form: float = 0.01
    memory: float = 300.0
    ahead: float = 15.0

    def odds(self, number: int) -> float:
        """Log-odds that the next effect needs where `number` were added before: each more must earn more."""
        return self.first_odds if number == 0 else self.further_odds * number

    def least_gain(self, number: int, odds: float) -> float:
        """Log-likelihood that the next effect must gain on held-out readings."""
        if number == 0:
            return -(5.0 + 0.03 * odds)
        allowed = self.proof if number == 1 else 0.0
        return float(np.clip(self.proof - 0.5 * (odds - self.sure), -allowed, self.proof))


@dataclass(frozen=True, slots=True)
class Trial:
    """One hypothesis of a round: the current model and one effect more.

    Attributes
    ----------
    candidate : Candidate
    fit : MapFit
    log_odds : float
        Against nothing more, tempered.
    share : float
        Posterior probability of its effect in the round.
    passed : bool
        Whether evidence and held-out readings let it in.
    why : str
        Why not; empty where it passed.
    """

    candidate: Candidate
    fit: MapFit
    log_odds: float
    share: float
    passed: bool
    why: str


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
    """What a search found.

    Attributes
    ----------
    baseline, final : MapFit
    chosen : list of Chosen
    rounds : list of list of Trial
        Ranked by probability, the first round's first.
    gains : list of Gain
        Scores of all candidates against the baseline.
    orphan : bool
        Strong evidence for something, and nothing that the gates let in.
    """

    baseline: MapFit
    final: MapFit
    chosen: list[Chosen] = field(default_factory=list)
    rounds: list[list[Trial]] = field(default_factory=list)
    gains: list[Gain] = field(default_factory=list)
    orphan: bool = False


def search(
    model: StringModel,
    records: Sequence[Measured],
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> Search:
    """Search for the effects that a model lacks.

    Parameters
    ----------
    model : StringModel
        With the priors from which it is fitted.
    records : sequence of Measured
    settings : Settings, optional
    progress : callable, optional
        Told the share of the work done and what is being done.

    Returns
    -------
    Search
        The same for the same arguments, to the last bit.
    """
    s = settings or Settings()
    tell = progress or (lambda _share, _text: None)
    tell(0.0, "fitting the model as it is")
    baseline = fitted(Problem(model, records))
    found = Search(baseline, baseline)
    y = stacked(baseline.problem)[0]
    surfaces = (float(np.quantile(y, 0.002)), float(np.quantile(y, 0.998)))
    offered = candidates(model, records[0].drive, surfaces)
    on_trial = False
    for number in range(s.effects):
        current = found.final
        tell(0.15 + 0.8 * number / s.effects, "screening the catalogue")
        there = {c.candidate.key for c in found.chosen}
        gains = screen(current, [c for c in offered if c.key not in there])
        if number == 0:
            found.gains = gains
        trials = _round(current, baseline, gains, offered, s, number, tell)
        if not trials:
            break
        found.rounds.append(trials)
        accepted = next((t for t in trials if t.passed), None)
        if accepted is None and number == 0 and trials[0].log_odds > s.ahead:
            accepted, on_trial = trials[0], True  # two effects may only generalise together
        if accepted is None:
            break
        found.chosen.append(_chosen(accepted, trials))
        found.final = _settled(accepted.fit, baseline, s)
        if len(found.chosen) > 1:
            _exchange(found, offered, s)
    if on_trial and not _redeemed(found):
        found.chosen, found.final = [], baseline
    found.orphan = not found.chosen and any(t.log_odds > s.ahead for r in found.rounds for t in r)
    tell(1.0, "done")
    return found


def refit(parent: MapFit, gain: Gain, *, iterations: int = 8, give_up: float = np.inf) -> MapFit:
    """Fit a model with one effect more, from the optimum without it."""
    problem = Problem(gain.candidate.put_into(parent.problem.model, gain.values), parent.problem.records)
    theta = np.concatenate([parent.theta, problem.begin[len(parent.theta) :]])
    guess = [
        extended(problem.physics, X, problem.numbers(r, theta, parent.nu)[0], problem.model.cells)
        for r, X in enumerate(parent.prediction.X)
    ]
    return map_fit(
        problem,
        theta,
        linear=parent.linear,
        nu=parent.nu,
        guess=guess,
        J=parent.J,
        iterations=iterations,
        give_up=give_up,
    )


def refit_from_nominal(fit: MapFit, parent: MapFit, *, give_up: float = np.inf) -> MapFit:
    """Fit the same model from the priors' medians: a strong effect biases the optimum that others start from."""
    P = len(parent.theta)
    theta = fit.problem.begin
    theta[P:] = fit.theta[P:]
    rough = annealed(fit.problem, theta)
    return map_fit(
        fit.problem,
        rough.theta,
        linear=rough.linear,
        nu=rough.nu,
        guess=rough.prediction.X,
        iterations=8,
        give_up=give_up,
    )


def _settled(fit: MapFit, baseline: MapFit, s: Settings) -> MapFit:
    """Fit to the end; an effect with a shape is led in anew as long as it leaves structure and that helps."""
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


def _round(
    current: MapFit,
    baseline: MapFit,
    gains: Sequence[Gain],
    offered: Sequence[Candidate],
    s: Settings,
    number: int,
    tell: Progress,
) -> list[Trial]:
    chosen: list[Gain] = []
    for g in gains:
        family = sum(c.candidate.name == g.candidate.name for c in chosen)
        if _promising(g, offered, s, number) and family < s.per_family and len(chosen) < s.refits:
            chosen.append(g)
    fits: list[tuple[Candidate, MapFit]] = []
    best = np.inf
    for i, g in enumerate(chosen):
        tell(0.15 + 0.8 * (number + 0.1 + 0.8 * i / len(chosen)) / s.effects, f"refitting with {g.candidate.key}")
        fit = refit(current, g, give_up=best + 60.0)
        best = min(best, fit.cost)
        fits.append((g.candidate, fit))
    if not fits:
        return []

    def posterior(c: Candidate, fit: MapFit) -> float:
        return fit.log_evidence + prior_odds(c, offered)

    fits.sort(key=lambda x: -posterior(*x))
    # later rounds start from an optimum that holds the strongest effect already
    biased = number == 0 and structure(current).z > s.strong
    if biased and structure(fits[0][1]).z > s.strong:
        fits[0] = (fits[0][0], converged(fits[0][1]))
    if strained(current) or (biased and structure(fits[0][1]).z > s.strong):
        for i in range(min(s.restarts, len(fits))):
            c, fit = fits[i]
            other = refit_from_nominal(fit, current, give_up=fits[0][1].cost + 60.0)
            if other.log_evidence > fit.log_evidence:
                fits[i] = (c, other)
        fits.sort(key=lambda x: -posterior(*x))
    return _judge(current, baseline, fits, offered, s, number)


def strained(fit: MapFit) -> bool:
    """Whether cells or sensors stand at the limits of their tolerances: the way back from there is long and curved."""
    return bool(np.any(np.abs(fit.nu) > STRAINED * fit.linear.sd))


def _promising(g: Gain, offered: Sequence[Candidate], s: Settings, number: int) -> bool:
    needed = s.odds(number) + HALF - prior_odds(g.candidate, offered)
    return g.gain >= 2.0 * s.promise * needed


def prior_odds(c: Candidate, offered: Sequence[Candidate]) -> float:
    """Log prior probability of one candidate: half is on nothing, the rest even over effects, then over places."""
    families = len({o.name for o in offered})
    return HALF - float(np.log(families * sum(o.name == c.name for o in offered)))


def worth(less: MapFit, fit: MapFit, baseline: MapFit, inflation: float, s: Settings) -> float:
    """Log evidence for what a fit has more than another, tempered.

    The residual's autocorrelation tempers all of it. What effects that are there already move is right to a per cent
    only, for minutes on end and at all sensors alike: readings that resolve that tell of the form of these effects, not
    of one more.
    """
    y, sigma, _, _, used = stacked(fit.problem)
    seconds = sum(m.drive.N * m.drive.dt for m in fit.problem.records)
    moved = float(np.mean(((less.y - baseline.y) / sigma)[used] ** 2))
    form = len(y) / seconds * s.memory * s.form**2 * moved
    read = max(log_density(fit, used) - log_density(less, used), 0.0)
    gain = (fit.log_evidence - less.log_evidence) / inflation
    return gain - read * (1.0 / inflation - 1.0 / (inflation + form))


def _judge(
    current: MapFit,
    baseline: MapFit,
    fits: Sequence[tuple[Candidate, MapFit]],
    offered: Sequence[Candidate],
    s: Settings,
    number: int,
) -> list[Trial]:
    inflation = structure(fits[0][1]).inflation
    odds = np.array([worth(current, fit, baseline, inflation, s) + prior_odds(c, offered) - HALF for c, fit in fits])
    weight = np.exp(np.concatenate([[0.0], odds]) - max(0.0, float(odds.max())))
    weight /= weight.sum()
    share: dict[str, float] = {}
    for (c, _), w in zip(fits, weight[1:], strict=True):
        share[c.name] = share.get(c.name, 0.0) + float(w)
    trials = []
    for (c, fit), odd in zip(fits, odds, strict=True):
        why = gate(current, fit, float(odd), inflation, s, number)
        trials.append(Trial(c, fit, float(odd), share[c.name], not why, why))
    # by the probability of the effect, then of the place; the gates speak for the three most probable effects
    trials.sort(key=lambda t: (-t.share, -t.log_odds))
    names = list(dict.fromkeys(t.candidate.name for t in trials))
    likely = {n for i, n in enumerate(names) if i < 3 and (i == 0 or share[n] >= 0.02)}
    return [
        t if t.candidate.name in likely or not t.passed else replace(t, passed=False, why="another effect is likelier")
        for t in trials
    ]


def gate(current: MapFit, fit: MapFit, odds: float, inflation: float, s: Settings, number: int = 0) -> str:
    """Say why evidence or held-out readings keep an effect out of a model; empty where they let it in.

    Parameters
    ----------
    current, fit : MapFit
        Without it and with it.
    odds : float
        Tempered log-odds for it.
    inflation : float
        Of the variance of a sum over the residual.
    s : Settings
    number : int
        How many effects this search has added before.
    """
    held = within(current)
    floor = float(np.mean(stacked(current.problem)[1][held] ** 2))
    before, after = rmse(current, held), rmse(fit, held)
    gain = log_density(fit, held) - log_density(current, held)
    excess = max(before**2 - floor, 0.0)
    if odds <= s.odds(number):
        return f"evidence too weak (log-odds {odds:.1f})"
    if gain < _needed(current, fit, odds, s, number) * inflation:
        return "worse on the held-out blocks" if number == 0 else "no better on the held-out blocks"
    if after**2 - floor > max(s.relief * excess, s.excess * floor):
        return f"held-out error stays at {after:.3g} K (noise {np.sqrt(floor):.3g} K)"
    return ""


def _needed(current: MapFit, fit: MapFit, odds: float, s: Settings, number: int) -> float:
    """Log-likelihood that an effect must gain on held-out readings.

    Evidence may come from tolerances that need not be stretched any more: cells explained the readings as well, only
    by numbers that nobody believes. That share has nothing to gain there.
    """
    least = s.least_gain(number, odds)
    if number == 0:
        return least
    used = stacked(fit.problem)[4]
    read = log_density(fit, used) - log_density(current, used)
    share = float(np.clip(read / max(0.5 * (current.cost - fit.cost), 1e-9), 0.0, 1.0))
    return share * least - (1.0 - share) * s.proof


def _chosen(accepted: Trial, trials: Sequence[Trial]) -> Chosen:
    tied = [t.candidate.name for t in trials if t.share >= 0.01 and t.candidate.name != accepted.candidate.name]
    return Chosen(accepted.candidate, tuple(dict.fromkeys(tied)), accepted.log_odds)


def _exchange(found: Search, offered: Sequence[Candidate], s: Settings) -> None:
    """Try each earlier effect again: it may be superfluous now, or another does its work better."""
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
        fits = [(g.candidate, refit(less, g)) for g in seen.values()]
        if not fits:
            continue
        best, fit = max(fits, key=lambda x: x[1].log_evidence + prior_odds(x[0], offered))
        won = fit.log_evidence + prior_odds(best, offered)
        won -= found.final.log_evidence + prior_odds(old.candidate, offered)
        if won > s.first_odds * inflation and best.key != old.candidate.key:
            trials = _judge(less, found.baseline, sorted(fits, key=lambda x: -x[1].log_evidence), offered, s, 1)
            trial = next(t for t in trials if t.candidate is best)
            found.chosen = [*keep, _chosen(trial, trials)]
            found.final = converged(fit)


def without(fit: MapFit, key: str) -> MapFit:
    """Refit with one effect, called as in model files, taken out of the model."""
    model = fit.problem.model
    less = replace(model, effects=tuple(e for e in model.effects if e.key != key))
    problem = Problem(less, fit.problem.records, fit.problem.beliefs)
    theta = np.array([fit.theta[fit.problem.index(c.name)] for c in problem.coordinates])
    return refreshed(map_fit(problem, theta, linear=fit.linear, nu=fit.nu, iterations=8))


def _redeemed(found: Search) -> bool:
    """Whether effects taken on trial generalise together."""
    held = within(found.baseline)
    better = log_density(found.final, held) - log_density(found.baseline, held) >= 10.0
    return len(found.chosen) > 1 and better and rmse(found.final, held) <= 1.05 * rmse(found.baseline, held)
