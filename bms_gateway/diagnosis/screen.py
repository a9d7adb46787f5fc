"""Which effects could explain the residual of a fit: the score test, at the cost of a few trajectories for all.

The response of the readings to a candidate is found by simulating the model with the effect at a small probe value,
about the fitted trajectory. Its gain is the fall of the cost if the effect's strength and all numbers of the fit were
free and everything were linear: the Gauss–Newton step of the joint problem, projected off the columns of the fit, so
that what these numbers have absorbed counts in favour of the effect (Rao's score test with nuisances).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.effort import beat
from bms_gateway.identify.map_fit import MapFit, stacked
from bms_gateway.identify.problem import Problem, signals_at
from bms_gateway.identify.quadratic import solved
from bms_gateway.thermal import Floats
from bms_gateway.thermal.effects import EffectParameter
from bms_gateway.thermal.physics import Numbers, Physics, with_effect
from bms_gateway.thermal.recursion import Recursion
from bms_gateway.thermal.system import System
from bms_gateway.thermal.trajectory import reference, simulate

AMPLITUDE_SD = 3.0
"""Prior sd, in units of the probe, of an effect whose strength is a logarithm: how much stronger it may be."""
FINE = 2
"""Largest factor of the fit's places for which responses are computed in the record's own intervals."""
TOGETHER = 16
"""Number of candidates whose responses are computed at once."""


@dataclass(frozen=True, slots=True)
class Gain:
    """Score of one candidate.

    Attributes
    ----------
    candidate : Candidate
    gain : float
        Fall of the cost (−2 log posterior); infinite for an effect that never vanishes, for which there is no score.
    values : mapping of parameter to float, SI
        End values of its strengths: the start of a fit.
    columns : ndarray (M', p)
        Response of the readings at the fit's places to its strengths, K per unit.
    """

    candidate: Candidate
    gain: float
    values: Mapping[str, float]
    columns: Floats


def screen(fit: MapFit, candidates: Sequence[Candidate]) -> list[Gain]:
    """Score candidates against a fit, best first."""
    used = stacked(fit.problem)[4]
    steep = np.sqrt(fit.steep)  # as in the fit's H
    free = fit.free  # a number at its bound cannot adjust to a candidate
    r = fit.gathered(np.where(used, fit.r, 0.0)) / steep
    prior = np.array([c.prior for c in fit.problem.coordinates])
    sd = np.array([c.sd for c in fit.problem.coordinates])
    pull = np.concatenate([(fit.theta - prior) / sd**2, fit.nu / fit.linear.sd**2])
    rest = steep * fit.products(r[:, None])[free, 0] - pull[free]  # zero at a converged optimum inside its bounds
    responses = Responses(fit)
    scored = [c for c in candidates if c.strengths]
    found = [Gain(c, np.inf, c.begin, fit.J[:, :0]) for c in candidates if not c.strengths]
    if not scored:
        return found
    columns = responses.columns([(c, p) for c in scored for p in c.strengths])
    J = fit.weighed(columns) * steep
    cross = steep * fit.products(J)[free]
    absorbed = solved(fit.H[np.ix_(free, free)], cross)
    score = J.T @ r - absorbed.T @ rest
    last = 0
    for c in scored:
        ps = c.strengths
        own = slice(last, last + len(ps))
        last = own.stop
        scales = np.array([AMPLITUDE_SD if p.log else p.sd for p in ps])
        S = J[:, own].T @ J[:, own] + np.diag(1.0 / scales**2) - cross[:, own].T @ absorbed[:, own]
        step = np.linalg.solve(S, score[own])
        gain = float(score[own] @ step)
        if c.effect.one_sided and step[0] < 0.0:
            gain = 0.0
        found.append(Gain(c, gain, _start(c, ps, step), columns[:, own]))
    return sorted(found, key=lambda g: -g.gain)


def _start(c: Candidate, strengths: Sequence[EffectParameter], step: Floats) -> dict[str, float]:
    values = c.begin
    for p, s in zip(strengths, step, strict=True):
        if not p.log and p.name not in c.start:
            values[p.name] = float(np.clip(s, max(p.lower, -1.5 * p.sd), min(p.upper, 1.5 * p.sd)))
    if c.effect.one_sided and not strengths[0].log:
        least = 0.3 * strengths[0].sd
        values[strengths[0].name] = max(values[strengths[0].name], least)
    return values


@dataclass(frozen=True, slots=True)
class _Probe:
    """A candidate with one parameter at its probe value, and the starts that each record then has."""

    candidate: Candidate
    values: dict[str, float]
    unit: float
    physics: Physics
    begins: list[tuple[Floats, ...]]


@dataclass(frozen=True, slots=True)
class _Fitted:
    """One record at the fit's numbers: its trajectory `X`, readings `y` (M,), and the `rates` of each span."""

    measured: Measured
    system: System
    starts: tuple[Floats, ...]
    X: Floats
    recursion: Recursion
    y: Floats
    rates: list[Floats]


class Responses:
    """Responses of one fit's readings to candidates; what they share is computed once."""

    def __init__(self, fit: MapFit) -> None:
        self._fit = fit
        self._problem = fit.problem
        self._records = []
        # the places of a long string, where all columns are taken, save most of the work
        self._at_places = all(p.factor > FINE for p in fit.problem.places)
        for r, (own, p) in enumerate(zip(fit.problem.records, fit.problem.places, strict=True)):
            m = p.at if self._at_places else own
            system, starts = fit.problem.system(r, fit.theta, fit.nu, m)
            X = fit.prediction.X[r]
            X = X[p.rows] if self._at_places else X
            f = [part.rates(x) for x, part in _spans(system, X)]
            recursion = reference(system, X.mean(axis=0))
            self._records.append(_Fitted(m, system, starts, X, recursion, signals_at(m, system, X), f))

    def columns(self, wanted: Sequence[tuple[Candidate, EffectParameter]]) -> Floats:
        """Return the response at the fit's places (M', p) to each parameter, per unit (per probe if a logarithm)."""
        out = np.empty((sum(len(x.first) for x in self._problem.places), len(wanted)))
        for first in range(0, len(wanted), TOGETHER):
            probes = [self._probe(c, p) for c, p in wanted[first : first + TOGETHER]]
            read = np.concatenate([self._read(r, probes) for r in range(len(self._records))], axis=1)
            for j, (probe, y) in enumerate(zip(probes, read, strict=True), first):
                out[:, j] = (y if self._at_places else self._problem.averaged(y)) / probe.unit
        return out

    def column(self, c: Candidate, p: EffectParameter) -> Floats:
        """Return the response to one parameter of all readings (M,) of a short string, as in `columns`."""
        probe = self._probe(c, p)
        return np.concatenate([self._read(r, [probe])[0] for r in range(len(self._records))]) / probe.unit

    def _probe(self, c: Candidate, p: EffectParameter) -> _Probe:
        beat()
        values = c.begin
        for q in c.effect.parameters:
            if q.neutral is not None and q.name != p.name:
                values[q.name] = q.neutral
        values[p.name] = p.probe
        assert p.neutral is not None  # noqa: S101 - strengths only
        unit = 1.0 if p.log else p.probe - p.neutral
        physics = Physics(c.put_into(self._problem.model, values))
        return _Probe(c, values, unit, physics, self._begins(c, values))

    def _read(self, r: int, probes: Sequence[_Probe]) -> Floats:
        """Change of the readings (P, M) of one record by each probe."""
        fitted = self._records[r]
        m, X = fitted.measured, fitted.X
        systems = []
        for probe in probes:
            u, v = fitted.system.u, with_effect(fitted.system.v, probe.candidate.key, probe.values)
            systems.append(System(probe.physics, u, v, probe.physics.memory(u, v)[0], fitted.system.spans))
        plain = [j for j, probe in enumerate(probes) if not probe.candidate.effect.states]
        moved = {j: self._whole(s, fitted.starts, X) for j, s in enumerate(systems) if j not in plain}
        if plain:
            parts = []
            rest = [_spans(systems[j], X) for j in plain]
            for i, (f0, a) in enumerate(zip(fitted.rates, fitted.starts, strict=True)):
                w = np.empty((len(plain), X.shape[1], len(f0)))  # time runs fastest, as in a column of the recursion
                for k, spans in enumerate(rest):
                    x, part = next(spans)
                    np.subtract(part.rates(x).T, f0.T, out=w[k])
                b = np.stack([probes[j].begins[r][i] - a for j in plain], axis=1)
                parts.append(fitted.recursion.run(b, w.transpose(2, 1, 0)))
            shift = np.concatenate(parts)
            moved |= {j: X + shift[..., k] for k, j in enumerate(plain)}
        return np.stack([signals_at(m, s, moved[j]) - fitted.y for j, s in enumerate(systems)])

    def _begins(self, c: Candidate, values: Mapping[str, float]) -> list[tuple[Floats, ...]]:
        """Return the starts with the effect: a start taken from a thermocouple contains the thermocouple's error."""
        if c.effect.states or "reading" not in c.effect.hooks():
            return [fitted.starts for fitted in self._records]
        with_it = Problem(c.put_into(self._problem.model, values), self._problem.records, self._problem.beliefs)
        theta = np.concatenate([self._fit.theta, with_it.begin[len(self._fit.theta) :]])
        return [with_it.numbers(r, theta, self._fit.nu)[1] for r in range(len(self._records))]

    @staticmethod
    def _whole(system: System, starts: Sequence[Floats], X: Floats) -> Floats:
        """Trajectory with an effect that has states of its own."""
        # the new effect's states are appended after the existing ones
        physics, v, n = system.physics, system.v, system.physics.cells
        guess = extended(physics, X, v, n)
        recursion = reference(system, guess.mean(axis=0))
        return simulate(system, [extended(physics, s, v, n) for s in starts], recursion, guess)[0]


def extended(physics: Physics, X: Floats, v: Numbers, n: int) -> Floats:
    """States extended by the new effect's own states, in balance with core and surface."""
    full = physics.start(X[..., 0 : 2 * n : 2], X[..., 1 : 2 * n : 2], v)
    full[..., : X.shape[-1]] = X
    return full


def _spans(system: System, X: Floats) -> Iterator[tuple[Floats, System]]:
    """Yield the mean states of each span's intervals, and its balances."""
    for rows, part in system.parts():
        x = X[rows]
        yield (x[1:] + x[:-1]) / 2.0, part
