"""Hypotheses on missing effects, one to three effects each: scored, fitted, judged with a model error."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.diagnosis.bounds import below_least
from bms_gateway.diagnosis.candidates import INSTEAD, Candidate, candidates, excluded
from bms_gateway.diagnosis.current_sensor import charge_too_much
from bms_gateway.diagnosis.geometry import odd_fitted
from bms_gateway.diagnosis.model_error import REFINEMENTS, Bench, Fit, fit
from bms_gateway.diagnosis.screen import Gain, extended, screen
from bms_gateway.identify.coordinates import Coordinate, Measured
from bms_gateway.identify.map_fit import FitEffort
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import Floats, StringModel
from bms_gateway.thermal.effects import effect_named

COST = 1.0
"""Log-odds that every effect costs, because a hypothesis with fewer effects is more probable."""
WILD_GAP = 4.0
"""Multiple of the baseline's mean of core minus surface (or of 0.5 K) above which a core is absurd."""
LEAST_GAP = 0.5
HOTTEST = 120.0
"""°C: separators shut down above."""
FAR = 4.0
"""Current offset, in sd of its prior, that no sensor has."""
SPECIAL = -2.5
"""Plausibility below which an effect needs a special cause: a bad sensor, a melting sheet, a bracket."""
UNCLEAN = "it needs a special cause, and leaves what no such cause explains"


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Some effects, fitted.

    Attributes
    ----------
    effects : tuple of Candidate
        In the order in which the model has them.
    fit : Fit
    score : float
        Log evidence and log prior odds.
    refused : str
        Why it is refused, however well it fits; empty if it is not.
    """

    effects: tuple[Candidate, ...]
    fit: Fit
    score: float
    refused: str = ""

    @property
    def key(self) -> tuple[str, ...]:
        """Keys of the effects in sorted order, because the order of adding does not matter."""
        return tuple(sorted(variant(c) for c in self.effects))

    @property
    def names(self) -> tuple[str, ...]:
        """Effects by name, sorted."""
        return tuple(sorted(c.name for c in self.effects))

    @property
    def special(self) -> bool:
        """Whether one of the effects needs a special cause."""
        return any(c.effect.plausibility <= SPECIAL for c in self.effects)

    def core(self, record: int = 0) -> Floats:
        """Cores (N + spans, n) along the fitted trajectory, °C."""
        n = self.fit.map.problem.model.cells
        return self.fit.map.prediction.X[record][:, 0 : 2 * n : 2]

    def gap(self) -> float:
        """Mean distance between core and surface over all records, K."""
        n = self.fit.map.problem.model.cells
        return float(
            np.mean(
                np.concatenate(
                    [np.abs(X[:, 0 : 2 * n : 2] - X[:, 1 : 2 * n : 2]).ravel() for X in self.fit.map.prediction.X]
                )
            )
        )


def variant(c: Candidate) -> str:
    """Key of an effect, and its number of free parameters: one number or a curve are different hypotheses."""
    return c.key if c.free is None else f"{c.key}/{len(c.free)}"


def offered_by(model: StringModel, bench: Bench) -> tuple[Candidate, ...]:
    """List all candidates, given the columns that every record has."""
    known = frozenset.intersection(*(m.drive.known for m in bench.records))
    y = np.concatenate([m.y for m in bench.records])
    surfaces = float(np.quantile(y, 0.05)), float(np.quantile(y, 0.95))
    found = []
    for c in candidates(model, replace(bench.records[0].drive, known=known), surfaces):
        if c.name in INSTEAD or any(excluded(c.effect, m.drive) for m in bench.records):
            continue
        c = freed(c, bench.records)
        found.append(c)
        if c.name == "entropic_heat" and len(c.free or ()) > 1:
            found.append(replace(c, free=("dUdT",)))  # a level may explain as much as a curve, which costs more
    return tuple(found)


def freed(c: Candidate, records: Sequence[Measured]) -> Candidate:
    """Free the numbers that at least one of the records can determine."""
    told = {name for m in records for name in c.effect.determined(m.drive)}
    return replace(c, free=tuple(p.name for p in c.effect.parameters if p.name in told))


def log_prior(c: Candidate, offered: Sequence[Candidate]) -> float:
    """Log prior odds of one effect at one place with one start."""
    ways = max(sum(other.name == c.name for other in offered), 1)
    return c.effect.plausibility - COST - float(np.log(ways))


def judged(
    effects: tuple[Candidate, ...], found: Fit, offered: Sequence[Candidate], base: Hypothesis | None
) -> Hypothesis:
    """Score a fit and decide whether it is refused."""
    score = found.log_evidence + sum(log_prior(c, offered) for c in effects)
    h = Hypothesis(effects, found, score)
    return h if base is None else replace(h, refused=below_least(found.map) or _absurd(h, base))


def _absurd(h: Hypothesis, base: Hypothesis) -> str:
    problem, theta = h.fit.map.problem, h.fit.map.theta
    for c, z in zip(problem.coordinates, theta, strict=True):
        if c.effect is None:
            continue
        name = c.effect.partition(":")[0]
        p = effect_named(name).parameter(c.name.rpartition(".")[2])
        if p.neutral is not None and _at_bound(c, float(z), p.lower == p.neutral or p.upper == p.neutral):
            return f"{c.name} ends at its bound"
        if name == "current_offset" and abs(z) > FAR * c.sd:
            return f"a current offset of {z:.2g} A is more than any sensor has"
        if name == "current_offset":
            for m in problem.records:
                if said := charge_too_much(m.drive, float(z), problem.model.capacity_Ah):
                    return said
    there = {odd.name for odd in odd_fitted(base.fit.map)}
    if against := [odd.says for odd in odd_fitted(h.fit.map) if odd.excluded and odd.name not in there]:
        return against[0].rstrip(".")
    gap, usual = h.gap(), max(base.gap(), LEAST_GAP)
    if gap > WILD_GAP * usual:
        return f"its core stands {gap:.1f} K from the surface, {gap / usual:.1f} times as far as without it"
    hottest = max(float(h.core(r).max()) for r in range(len(problem.records)))
    return f"its core reaches {hottest:.0f} °C" if not hottest < HOTTEST else ""


def _at_bound(c: Coordinate, z: float, one_sided: bool) -> bool:
    width = 1e-3 * (c.upper - c.lower)
    low, high = z <= c.lower + width, z >= c.upper - width
    return (low or high) if not one_sided else high if c.prior < c.upper - width else low


class Board:
    """All hypotheses tried on some records."""

    def __init__(self, model: StringModel, bench: Bench) -> None:
        self.bench = bench
        problem = Problem(model, bench.records, bench.beliefs)
        self.offered = offered_by(model, bench)
        self.base = judged((), fit(bench, problem, problem.begin, FitEffort(12)), self.offered, None)
        self.found: dict[tuple[str, ...], Hypothesis] = {(): self.base}

    def of(self, effects: int) -> list[Hypothesis]:
        """Hypotheses with this number of effects, best first."""
        return sorted((h for h in self.found.values() if len(h.effects) == effects), key=lambda h: (-h.score, h.key))

    def accepted(self) -> list[Hypothesis]:
        """Hypotheses that are not refused, best first."""
        return sorted((h for h in self.found.values() if not h.refused), key=lambda h: (-h.score, h.key))

    def prospects(self, parents: Sequence[Hypothesis], most: int) -> list[tuple[Hypothesis, Gain]]:
        """Choose which effects to add to which hypotheses, by the promised score of a linear step."""
        best: dict[tuple[str, ...], tuple[float, Hypothesis, Gain]] = {}
        for h in parents:
            there = {c.key for c in h.effects} | {c.name for c in h.effects if c.effect.place == "string"}
            for g in screen(h.fit.map, [c for c in self.offered if not {c.key, c.name} & there]):
                key = tuple(sorted((*h.key, variant(g.candidate))))
                promise = h.score + 0.5 * g.gain + log_prior(g.candidate, self.offered)
                if key not in self.found and (key not in best or promise > best[key][0]):
                    best[key] = (promise, h, g)
        ranked = sorted(best.items(), key=lambda x: (-x[1][0], x[0]))[:most]
        return [(h, g) for _, (_, h, g) in ranked]

    def add(self, h: Hypothesis, c: Candidate, values: Mapping[str, float]) -> None:
        """Fit one more hypothesis."""
        self._keep(self.fitted(h, c, values))

    def fitted(self, h: Hypothesis, c: Candidate, values: Mapping[str, float]) -> Hypothesis:
        """Fit a hypothesis with one more effect."""
        parent = h.fit.map
        problem = Problem(c.put_into(parent.problem.model, values), self.bench.records, self.bench.beliefs)
        theta = np.concatenate([parent.theta, problem.begin[len(parent.theta) :]])
        guess = [
            extended(problem.physics, X, problem.numbers(r, theta)[0], problem.model.cells)
            for r, X in enumerate(parent.prediction.X)
        ]
        found = fit(self.bench, problem, theta, parent=h.fit, guess=guess)
        return judged((*h.effects, c), found, self.offered, self.base)

    def finish(self, h: Hypothesis, digits: float) -> None:
        """Fit a hypothesis to the end, and once more from the priors' medians.

        A strong effect biases the optimum from which it started, and along a flat valley the last digits of the cost
        are still kelvins of the core.
        """
        problem = h.fit.map.problem
        nominal = problem.begin
        for i, c in enumerate(problem.coordinates):
            if c.effect is not None:
                nominal[i] = h.fit.map.theta[i]
        for theta in (h.fit.map.theta, nominal):
            found = fit(self.bench, problem, theta, FitEffort(40, least_gain=digits, refinements=REFINEMENTS))
            self._keep(judged(h.effects, found, self.offered, self.base if h.effects else None))
        if not h.effects:
            self.base = self.found[()]

    def without(self, h: Hypothesis, c: Candidate) -> Hypothesis:
        """Best hypothesis with some of the other effects alone."""
        rest = set(h.names) - {c.name}
        return max((x for x in self.accepted() if set(x.names) <= rest), key=lambda x: x.score)

    def refuse_special(self) -> None:
        """Refuse all hypotheses with a special cause from now on: they only absorb the model error."""
        for key, h in self.found.items():
            if h.special and not h.refused:
                self.found[key] = replace(h, refused=UNCLEAN)

    def _keep(self, h: Hypothesis) -> None:
        if np.isfinite(h.score) and (h.key not in self.found or h.score > self.found[h.key].score):
            self.found[h.key] = h
