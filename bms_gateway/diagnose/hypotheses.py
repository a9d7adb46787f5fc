"""Hypotheses on what a model lacks, one to three effects each: scored, fitted, judged in the regime of model error."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from bms_gateway.diagnose.candidates import Candidate, candidates
from bms_gateway.diagnose.model_error import REFINEMENTS, Bench, Fit, fit
from bms_gateway.diagnose.screen import AMPLITUDE_SD, Responses, extended
from bms_gateway.identify.problem import Coordinate, Problem
from bms_gateway.thermal import AddedEffect, Floats, StringModel

COST = 1.0
"""Log-odds that any effect costs, however common it is: a hypothesis of fewer effects is the likelier one."""
WILD_GAP = 4.0
"""Times the baseline's mean distance core to surface (or 0.5 K): from there a core is absurd."""
LEAST_GAP = 0.5
HOTTEST = 120.0
"""°C: separators shut down above."""
FAR = 4.0
"""sd of a current offset: beyond what its sensor can have."""
INSTEAD = frozenset({"voltage_heat"})
"""No missing effect, but another way to the same heat: kept as a witness."""


@dataclass(frozen=True, slots=True)
class Option:
    """One effect, where it sits, where its fit starts, and which of its numbers are free.

    Attributes
    ----------
    candidate : Candidate
    free : tuple of str
    """

    candidate: Candidate
    free: tuple[str, ...]

    @property
    def key(self) -> str:
        """Of the effect, and how many of its numbers are free: variants of one effect are different hypotheses."""
        return f"{self.candidate.key}/{len(self.free)}"

    def put_into(self, model: StringModel, values: Mapping[str, float]) -> StringModel:
        """Add the effect to a model, last; what is not free stays at its neutral value."""
        effect = self.candidate.effect
        numbers = {p.name: values.get(p.name, self.candidate.start.get(p.name, p.probe)) for p in effect.parameters}
        for p in effect.parameters:
            if p.name not in self.free and p.neutral is not None:
                numbers[p.name] = p.neutral
        sd = {p.name: p.sd if p.name in self.free else 0.0 for p in effect.parameters}
        added = AddedEffect(effect.name, self.candidate.cell, numbers, sd)
        return replace(model, effects=(*model.effects, added))


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Some effects, fitted.

    Attributes
    ----------
    options : tuple of Option
        In the order in which the model has them.
    fit : Fit
    score : float
        Log evidence and log prior odds.
    refused : str
        Why it is not believed, however well it fits; empty where it may be.
    """

    options: tuple[Option, ...]
    fit: Fit
    score: float
    refused: str = ""

    @property
    def key(self) -> tuple[str, ...]:
        """Effects, sorted: the order in which they came in does not matter."""
        return tuple(sorted(o.key for o in self.options))

    @property
    def names(self) -> tuple[str, ...]:
        """Effects by name, sorted."""
        return tuple(sorted(o.candidate.name for o in self.options))

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


def options(model: StringModel, bench: Bench) -> tuple[Option, ...]:
    """List all that could be added, given what every record knows."""
    drive = bench.records[0].drive
    known = frozenset.intersection(*(m.drive.known for m in bench.records))
    y = np.concatenate([m.y for m in bench.records])
    surfaces = float(np.quantile(y, 0.05)), float(np.quantile(y, 0.95))
    found = []
    for c in candidates(model, replace(drive, known=known), surfaces):
        if c.name in INSTEAD:
            continue
        told: set[str] = set()
        for m in bench.records:
            told |= set(c.effect.determined(m.drive))
        free = tuple(p.name for p in c.effect.parameters if p.name in told)
        if not free:
            continue
        found.append(Option(c, free))
        if c.name == "entropic_heat" and len(free) > 1:
            found.append(Option(c, ("dUdT",)))  # a level may explain what a curve explains at more cost
    return tuple(found)


def log_prior(o: Option, offered: Sequence[Option]) -> float:
    """Log prior odds of one effect at one place with one start."""
    ways = max(sum(other.candidate.name == o.candidate.name for other in offered), 1)
    return o.candidate.effect.plausibility - COST - float(np.log(ways))


def judged(options_: tuple[Option, ...], found: Fit, offered: Sequence[Option], base: Hypothesis | None) -> Hypothesis:
    """Score a fit and say whether it is to be refused."""
    score = found.log_evidence + sum(log_prior(o, offered) for o in options_)
    h = Hypothesis(options_, found, score)
    return h if base is None else replace(h, refused=_absurd(h, base))


def _absurd(h: Hypothesis, base: Hypothesis) -> str:
    problem, theta = h.fit.map.problem, h.fit.map.theta
    for c, z in zip(problem.coordinates, theta, strict=True):
        if c.effect is None:
            continue
        name = c.effect.partition(":")[0]
        p = next(o for o in h.options if o.candidate.name == name).candidate.effect.parameter(c.name.rpartition(".")[2])
        if p.neutral is not None and _at_bound(c, float(z), p.lower == p.neutral or p.upper == p.neutral):
            return f"{c.name} ends at its bound"
        if name == "current_offset" and abs(z) > FAR * c.sd:
            return f"a current offset of {z:.2g} A is none that a sensor has"
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
    """All hypotheses tried on some records.

    Parameters
    ----------
    model : StringModel
    bench : Bench
    """

    def __init__(self, model: StringModel, bench: Bench) -> None:
        self.bench = bench
        problem = Problem(model, bench.records, bench.beliefs)
        self.offered = options(model, bench)
        self.base = judged((), fit(bench, problem, problem.begin, iterations=12), self.offered, None)
        self.found: dict[tuple[str, ...], Hypothesis] = {(): self.base}

    def of(self, effects: int) -> list[Hypothesis]:
        """Hypotheses of so many effects, best first."""
        return sorted((h for h in self.found.values() if len(h.options) == effects), key=lambda h: (-h.score, h.key))

    def accepted(self) -> list[Hypothesis]:
        """Those that are not refused, best first."""
        return sorted((h for h in self.found.values() if not h.refused), key=lambda h: (-h.score, h.key))

    def prospects(self, parents: Sequence[Hypothesis], most: int) -> list[tuple[Hypothesis, Option, dict[str, float]]]:
        """Which effects to add to which hypotheses, by the score that a linear step promises."""
        best: dict[tuple[str, ...], tuple[float, Hypothesis, Option, dict[str, float]]] = {}
        for h in parents:
            there = {o.candidate.key for o in h.options} | {
                o.candidate.name for o in h.options if o.candidate.effect.place == "string"
            }
            for o, gain, values in _scores(
                h.fit, [o for o in self.offered if not {o.candidate.key, o.candidate.name} & there]
            ):
                key = tuple(sorted((*h.key, o.key)))
                promise = h.score + 0.5 * gain + log_prior(o, self.offered)
                if key not in self.found and (key not in best or promise > best[key][0]):
                    best[key] = (promise, h, o, values)
        ranked = sorted(best.items(), key=lambda x: (-x[1][0], x[0]))[:most]
        return [(h, o, values) for _, (_, h, o, values) in ranked]

    def add(self, h: Hypothesis, o: Option, values: Mapping[str, float]) -> None:
        """Fit one more hypothesis."""
        self._keep(self.fitted(h, o, values))

    def fitted(self, h: Hypothesis, o: Option, values: Mapping[str, float]) -> Hypothesis:
        """Fit a hypothesis and one effect more."""
        parent = h.fit.map
        problem = Problem(o.put_into(parent.problem.model, values), self.bench.records, self.bench.beliefs)
        theta = np.concatenate([parent.theta, problem.begin[len(parent.theta) :]])
        guess = [
            extended(problem.physics, X, problem.numbers(r, theta)[0], problem.model.cells)
            for r, X in enumerate(parent.prediction.X)
        ]
        found = fit(self.bench, problem, theta, parent=h.fit, guess=guess)
        return judged((*h.options, o), found, self.offered, self.base)

    def finish(self, h: Hypothesis, digits: float) -> None:
        """Fit a hypothesis to the end, and once more from the priors' medians.

        A strong effect biases the optimum that it started from, and along a flat valley the last digits of the cost
        are still kelvins of the core.
        """
        problem = h.fit.map.problem
        nominal = problem.begin
        for i, c in enumerate(problem.coordinates):
            if c.effect is not None:
                nominal[i] = h.fit.map.theta[i]
        for theta in (h.fit.map.theta, nominal):
            found = fit(self.bench, problem, theta, iterations=40, least_gain=digits, refinements=REFINEMENTS)
            self._keep(judged(h.options, found, self.offered, self.base if h.options else None))
        if not h.options:
            self.base = self.found[()]

    def without(self, h: Hypothesis, o: Option) -> Hypothesis:
        """Best hypothesis made of some of the other effects alone."""
        rest = {x.candidate.name for x in h.options} - {o.candidate.name}
        return max((x for x in self.accepted() if set(x.names) <= rest), key=lambda x: x.score)

    def _keep(self, h: Hypothesis) -> None:
        if np.isfinite(h.score) and (h.key not in self.found or h.score > self.found[h.key].score):
            self.found[h.key] = h


def _scores(f: Fit, offered: Sequence[Option]) -> list[tuple[Option, float, dict[str, float]]]:
    """By how much −2 log posterior would fall with each option, were all linear, and where its numbers would go."""
    m = f.map
    base = m.weighed(np.concatenate([m.J, m.linear.J], axis=1))
    factor = scipy.linalg.cho_factor(m.H)
    prior, sd = (np.array([getattr(c, k) for c in m.problem.coordinates]) for k in ("prior", "sd"))
    pull = np.concatenate([(m.theta - prior) / sd**2, m.nu / m.linear.sd**2])
    rest = base.T @ m.r - pull
    responses = Responses(m)
    columns: dict[tuple[str, str, str], Floats] = {}
    found = []
    for o in offered:
        effect, start = o.candidate.effect, o.candidate.start
        strengths = [p for p in effect.parameters if p.neutral is not None and p.name in o.free]
        if not strengths:
            continue
        stack = []
        for p in strengths:
            at = (o.candidate.key, p.name, repr(sorted(start.items())))
            if at not in columns:
                columns[at] = m.weighed(responses.column(o.candidate, p)[:, None])[:, 0]
            stack.append(columns[at])
        J = np.stack(stack, axis=1)
        width = np.array([AMPLITUDE_SD if p.log else p.sd for p in strengths])
        cross = base.T @ J
        S = J.T @ J + np.diag(1.0 / width**2) - cross.T @ scipy.linalg.cho_solve(factor, cross)
        b = J.T @ m.r - cross.T @ scipy.linalg.cho_solve(factor, rest)
        step = np.linalg.solve(S, b)
        gain = 0.0 if effect.one_sided and step[0] < 0.0 else float(b @ step)
        values: dict[str, float] = {}
        for p, s in zip(strengths, step.tolist(), strict=True):
            if not p.log and p.name not in start:
                values[p.name] = float(np.clip(s, max(p.lower, -1.5 * p.sd), min(p.upper, 1.5 * p.sd)))
        first = strengths[0]
        if effect.one_sided and not first.log and first.name in values:
            values[first.name] = max(values[first.name], 0.3 * first.sd)
        found.append((o, gain, values))
    return found
