"""What a search weighs an effect by: evidence, tempered, and what held-out readings say of it.

Evidence is compared over {nothing, each effect} with half of the prior on nothing, and tempered by how much the best
hypothesis' residual is inflated by autocorrelation. Held-out readings are a gate, never a score: an effect must not be
worse there, and must take its part of what is too much there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.current_sensor import charge_too_much
from bms_gateway.diagnosis.residuals import log_density, rmse, structure, within
from bms_gateway.identify.map_fit import MapFit, stacked

HALF = float(np.log(0.5))
EXACT_K = 1e-3
"""What the surfaces of a right model may be off for minutes, by its intervals and two nodes a cell: sixty thermocouples
at 1 Hz resolve a millikelvin, and no such error is a missing effect."""


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
    far : float
        Log-evidence behind the best from which, give or take ten times what the best gained by it, that is not tried.
    proof, sure : float
        Log-likelihood that a further effect must gain on the held-out readings, at log-odds `sure`; half a unit less
        for each that it has more, for a small effect's share of a third of the record is within chance.
    form, memory : float, s
        Error of what effects move, a share of it, and how long it lasts: the lumped form of a strong one is no better.
    left_open : float, K
        What the readings may be off because the current is not known between its rows.
    white : float
        z of the structure up to which a residual counts as white.
    near, ways : float, int
        Share of the first effect's log-odds from which another is tried in its place where structure is left, and how
        many are.
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
    far: float = 300.0
    proof: float = 3.0
    sure: float = 10.0
    form: float = 0.01
    memory: float = 300.0
    left_open: float = 0.0
    white: float = 6.0
    near: float = 0.95
    ways: int = 2
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


def prior_odds(c: Candidate, offered: Sequence[Candidate]) -> float:
    """Log prior probability of one candidate: half is on nothing, the rest even over effects, then over places."""
    families = len({o.name for o in offered})
    return HALF - float(np.log(families * sum(o.name == c.name for o in offered)))


def worth(less: MapFit, fit: MapFit, baseline: MapFit, inflation: float, s: Settings) -> float:
    """Log evidence for what a fit has more than another, tempered.

    The residual's autocorrelation tempers all of it. What effects that are there already move is right to a per cent
    only, for minutes on end and at all sensors alike: readings that resolve that tell of the form of these effects, not
    of one more. So do what a current leaves open between its rows, and what no model is exact to.
    """
    y, sigma, _, _, used = stacked(fit.problem)
    seconds = sum(m.drive.N * m.drive.dt for m in fit.problem.records)
    moved = float(np.mean(((less.y - baseline.y) / sigma)[used] ** 2))
    unknown = s.form**2 * moved + (s.left_open**2 + EXACT_K**2) * float(np.mean(1.0 / sigma[used] ** 2))
    form = len(y) / seconds * s.memory * unknown
    read = max(log_density(fit, used) - log_density(less, used), 0.0)
    gain = (fit.log_evidence - less.log_evidence) / inflation
    return gain - read * (1.0 / inflation - 1.0 / (inflation + form))


def judge(
    current: MapFit,
    baseline: MapFit,
    fits: Sequence[tuple[Candidate, MapFit]],
    offered: Sequence[Candidate],
    s: Settings,
    number: int,
) -> list[Trial]:
    """Weigh the fits of a round against each other and against nothing more.

    Parameters
    ----------
    current, baseline : MapFit
        Without them, and without all that was added.
    fits : sequence of Candidate and MapFit
        The likeliest first: its residual tells the inflation.
    offered : sequence of Candidate
        All that could be added.
    s : Settings
    number : int
        How many effects were added before.

    Returns
    -------
    list of Trial
        Ranked by the probability of the effect, then of its place.
    """
    inflation = structure(fits[0][1]).inflation
    odds = np.array([worth(current, fit, baseline, inflation, s) + prior_odds(c, offered) - HALF for c, fit in fits])
    weight = np.exp(np.concatenate([[0.0], odds]) - max(0.0, float(odds.max())))
    weight /= weight.sum()
    share: dict[str, float] = {}
    for (c, _), w in zip(fits, weight[1:], strict=True):
        share[c.name] = share.get(c.name, 0.0) + float(w)
    trials = []
    for (c, fit), odd in zip(fits, odds, strict=True):
        why = _impossible(c, fit) or gate(current, fit, float(odd), inflation, s, number)
        trials.append(Trial(c, fit, float(odd), share[c.name], not why, why))
    # by the probability of the effect, then of the place; the gates speak for the three most probable effects
    trials.sort(key=lambda t: (-t.share, -t.log_odds))
    names = list(dict.fromkeys(t.candidate.name for t in trials))
    likely = {n for i, n in enumerate(names) if i < 3 and (i == 0 or share[n] >= 0.02)}
    return [
        t if t.candidate.name in likely or not t.passed else replace(t, passed=False, why="another effect is likelier")
        for t in trials
    ]


def _impossible(c: Candidate, fit: MapFit) -> str:
    """Say by what a record rules out the size that an effect was fitted to; empty where it does not."""
    if c.name != "current_offset":
        return ""
    b = float(fit.theta[fit.problem.index(f"{c.key}.b")])
    said = (charge_too_much(m.drive, b, fit.problem.model.capacity_Ah) for m in fit.problem.records)
    return next((x for x in said if x), "")


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
    floor = float(np.mean(stacked(current.problem)[1][held] ** 2)) + s.left_open**2
    before, after = rmse(current, held), rmse(fit, held)
    gain = log_density(fit, held) - log_density(current, held)
    excess = max(before**2 - floor, 0.0)
    if odds <= s.odds(number):
        needed = f", and one more effect needs {s.odds(number):.3g}" if odds > s.odds(0) else ""
        return f"evidence too weak (log-odds {odds:.1f}{needed})"
    if gain < _needed(current, fit, odds, s, number) * inflation:
        return "worse on the held-out blocks" if number == 0 else "no better on the held-out blocks"
    if after**2 - floor > max(s.relief * excess, s.excess * floor):
        return f"however closely fitted, it leaves a held-out error of {after:.3g} K (noise {np.sqrt(floor):.3g} K)"
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
