"""Rules by which a search judges an effect: tempered evidence, and held-out readings.

Evidence is compared over {nothing, each effect} with half of the prior on nothing. It is tempered by the inflation of
the best hypothesis' residual by autocorrelation. Held-out readings are a gate, never a score: an effect must not
increase their error, and must remove its share of their excess.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import nan

import numpy as np

from bms_gateway.diagnosis.bounds import at_bound, below_least
from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.current_sensor import charge_too_much
from bms_gateway.diagnosis.residuals import log_density, rmse, structure, within
from bms_gateway.identify.map_fit import MapFit, stacked

HALF = float(np.log(0.5))
EXACT_K = 1e-3
"""Error of the surfaces of a right model over minutes, by its intervals and two nodes per cell: sixty thermocouples at
1 Hz resolve a millikelvin, and such an error is no missing effect."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Constants of the search.

    Attributes
    ----------
    refits, per_family : int
        Number of candidates refitted per round, and of candidates of one effect among them.
    first_odds, further_odds : float
        Log-odds that an effect needs: 3 is 20 to 1; further effects need more, because the first one was fitted to the
        rest.
    effects : int
        Greatest number of effects that one search adds.
    promise : float
        Share of the needed gain that the screening must promise before a refit: the score is linear, and nonlinear
        effects gain more.
    excess, relief : float
        With the effect, the held-out mean square must be within the first share above the noise floor, or its excess
        must fall to the second share.
    strong : float
        z of the structure above which a biased optimum is a bad start: unless the best fit leaves no structure, the
        best candidates are also fitted from nominal.
    restarts : int
        Number of these best candidates.
    far : float
        Log-evidence behind the best above which a fit is not restarted; ten times the best one's gain is added.
    proof, sure : float
        Log-likelihood that a further effect must gain on held-out readings, at log-odds `sure`; half a unit less for
        each additional log-odds, because a small effect's share of a third of the record is within chance.
    form, memory : float, s
        Relative error of the response to effects, and its duration: the lumped form of a strong effect is not more
        exact.
    left_open : float, K
        Possible error of the readings because the current is not known between its rows.
    white : float
        Greatest z of the structure for which a residual counts as white.
    ways : int
        Number of other effects tried instead of the first one if structure is left.
    ahead : float
        Log-odds above which an effect that fails the gates is kept on trial for one round.
    voltage : bool
        Whether heat from the voltage is also offered instead of I²R_e: it gives the amount of heat, not its cause.
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
    ways: int = 2
    ahead: float = 15.0
    voltage: bool = False

    def odds(self, number: int) -> float:
        """Log-odds that the next effect needs after `number` additions: each one needs more."""
        return self.first_odds if number == 0 else self.further_odds * number

    def least_gain(self, number: int, odds: float) -> float:
        """Log-likelihood that the next effect must gain on held-out readings."""
        if number == 0:
            return -(5.0 + 0.03 * odds)
        allowed = self.proof if number == 1 else 0.0
        return float(np.clip(self.proof - 0.5 * (odds - self.sure), -allowed, self.proof))


@dataclass(frozen=True, slots=True)
class Trial:
    """One hypothesis of a round: the current model with one more effect.

    Attributes
    ----------
    candidate : Candidate
    fit : MapFit
    log_odds : float
        Against no further effect, tempered.
    share : float
        Posterior probability of its effect in the round.
    passed : bool
        Whether evidence and held-out readings accept it.
    why : str
        Reason if not; empty if it passed.
    """

    candidate: Candidate
    fit: MapFit
    log_odds: float
    share: float
    passed: bool
    why: str


def prior_odds(c: Candidate, offered: Sequence[Candidate]) -> float:
    """Log prior probability of one candidate: half is on nothing, the rest divided over effects, then over places."""
    families = len({o.name for o in offered})
    return HALF - float(np.log(families * sum(o.name == c.name for o in offered)))


def inexact(fit: MapFit, baseline: MapFit, s: Settings) -> float:
    """Variance of a sum over a model's inexactness, over that of the noise: it tempers the gain of one more effect.

    Parameters
    ----------
    fit, baseline : MapFit
        With the effects that were found before, and without.
    s : Settings
    """
    y, sigma, _, _, used = stacked(fit.problem)
    seconds = sum(m.drive.N * m.drive.dt for m in fit.problem.records)
    moved = float(np.mean(((fit.y - baseline.y) / sigma)[used] ** 2))
    unknown = s.form**2 * moved + (s.left_open**2 + EXACT_K**2) * float(np.mean(1.0 / sigma[used] ** 2))
    return len(y) / seconds * s.memory * unknown


def worth(less: MapFit, fit: MapFit, baseline: MapFit, inflation: float, s: Settings) -> float:
    """Tempered log evidence for the additional effects of a fit over another fit.

    The residual's autocorrelation tempers all of it. The response to present effects is right only to a per cent, for
    minutes and at all sensors alike: readings that resolve this show the form of these effects, not one more effect.
    The same holds for the unknown current between its rows, and for the inexactness of any model.
    """
    form, used = inexact(less, baseline, s), stacked(fit.problem)[4]
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
    """Compare the fits of a round with each other and with no further effect.

    Parameters
    ----------
    current, baseline : MapFit
        Without them, and without all added effects.
    fits : sequence of Candidate and MapFit
        The likeliest first: its residual gives the inflation.
    offered : sequence of Candidate
        All that could be added.
    s : Settings
    number : int
        Number of effects added before.

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
    # by the probability of the effect, then of the place; the gates apply to the three most probable effects
    trials.sort(key=lambda t: (-t.share, -t.log_odds))
    names = list(dict.fromkeys(t.candidate.name for t in trials))
    likely = {n for i, n in enumerate(names) if i < 3 and (i == 0 or share[n] >= 0.02)}
    return [
        t if t.candidate.name in likely or not t.passed else replace(t, passed=False, why="another effect is likelier")
        for t in trials
    ]


def _impossible(c: Candidate, fit: MapFit) -> str:
    """Say why physics or a record rules out the fitted size of an effect; empty if neither does."""
    if impossible := below_least(fit):
        return impossible
    if c.name != "current_offset":
        return ""
    b = float(fit.theta[fit.problem.index(f"{c.key}.b")])
    said = (charge_too_much(m.drive, b, fit.problem.model.capacity_Ah) for m in fit.problem.records)
    return next((x for x in said if x), "")


def gate(current: MapFit, fit: MapFit, odds: float, inflation: float, s: Settings, number: int = 0) -> str:
    """Say why evidence or held-out readings refuse an effect; empty if they accept it.

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
        Number of effects that this search has added before.
    """
    held = within(current)
    sigma = stacked(current.problem)[1]
    floor = float(np.mean(sigma[held] ** 2)) + s.left_open**2
    before, after = rmse(current, held), rmse(fit, held)
    gain = log_density(fit, held) - log_density(current, held)
    excess = max(before**2 - floor, 0.0)
    if odds <= s.odds(number):
        needed = f", and one more effect needs {s.odds(number):.3g}" if odds > s.odds(0) else ""
        return f"evidence too weak (log-odds {odds:.1f}{needed})"
    if gain < _needed(current, fit, odds, s, number) * inflation:
        return "worse on the held-out blocks" if number == 0 else "no better on the held-out blocks"
    if after**2 - floor > max(s.relief * excess, s.excess * floor):
        noise = f"noise {np.sqrt(np.mean(sigma**2)):.3g} K"
        noise += f", and {s.left_open:.3g} K that the current between rows leaves open" if s.left_open > 0.0 else ""
        return f"however closely fitted, it leaves a held-out error of {after:.3g} K ({noise})"
    return ""


def _needed(current: MapFit, fit: MapFit, odds: float, s: Settings, number: int) -> float:
    """Log-likelihood that an effect must gain on held-out readings.

    Evidence may come from tolerances that are no longer strained: cells explained the readings equally well, but with
    implausible numbers. This part gains nothing on held-out readings.
    """
    least = s.least_gain(number, odds)
    if number == 0:
        return least
    used = stacked(fit.problem)[4]
    read = log_density(fit, used) - log_density(current, used)
    share = float(np.clip(read / max(0.5 * (current.cost - fit.cost), 1e-9), 0.0, 1.0))
    return share * least - (1.0 - share) * s.proof


def believed_share(t: Trial) -> tuple[float, str]:
    """Probability of a trial, and why it is refused; NaN if one of its numbers is at its bound."""
    said = at_bound(t.fit, t.candidate)
    return (nan, "; ".join(filter(None, (t.why, f"{said}: no proof")))) if said else (t.share, t.why)
