"""One or several records of a string, the free numbers, and the model's readings with them.

The string is that of Lin et al., Eq 16-18, with effects that the paper lacks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bms_gateway.identify.coordinates import (
    LATE,
    Belief,
    Coordinate,
    Draft,
    Measured,
    believed,
    effect_numbers,
    nuisances,
    parameters,
    starts,
)
from bms_gateway.identify.effort import beat
from bms_gateway.identify.fit_columns import Places, places
from bms_gateway.thermal import CELL_SYMBOLS, KINDS, Floats, StringModel, StringParameters
from bms_gateway.thermal.drive import Drive, cut
from bms_gateway.thermal.effects import effect_named
from bms_gateway.thermal.physics import Numbers, Physics
from bms_gateway.thermal.recursion import Recursion
from bms_gateway.thermal.system import System
from bms_gateway.thermal.trajectory import Variation, readings, reference, sensitivities, simulate

MEMORIES = 32
"""Number of sets of numbers whose memories are kept."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """Values of the model with one set of coordinates.

    Attributes
    ----------
    y : ndarray (M,), °C
        For the readings of all records, stacked.
    X : tuple of ndarray (N + spans, D)
        Trajectory of each record.
    settled : bool
    """

    y: Floats
    X: tuple[Floats, ...]
    settled: bool


@dataclass(slots=True)
class Problem:
    """A model, records, and the coordinates of a fit.

    Parameters
    ----------
    model : StringModel
        Including its effects; effects with sd 0 keep their numbers.
    records : sequence of Measured
    beliefs : mapping of coordinate to Belief
        Priors that replace those of the coordinates; names without cell, span and record. A nuisance of sd 0 is left
        out.
    """

    model: StringModel
    records: Sequence[Measured]
    beliefs: Mapping[str, Belief] = field(default_factory=dict)
    physics: Physics = field(init=False)
    coordinates: tuple[Coordinate, ...] = field(init=False)
    nuisances: tuple[Coordinate, ...] = field(init=False)
    _places: tuple[Places, ...] | None = field(init=False, default=None)
    _recursion: list[Recursion | None] = field(init=False)
    _alters_readings: bool = field(init=False)
    _nominal: StringParameters = field(init=False)
    _begins: list[list[Drive]] = field(init=False)
    _memories: dict[tuple[object, ...], Mapping[str, Floats]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.physics = Physics(self.model)
        self.coordinates = tuple(parameters(self.model, len(self.records)))
        self.coordinates += tuple(c for r, m in enumerate(self.records) for c in starts(r, m, len(self.records)))
        # last, so that one more effect only appends coordinates
        self.coordinates += tuple(c for e in self.model.effects for c in effect_numbers(e.key, e.name, e.values, e.sd))
        self.coordinates = tuple(believed(c, self.beliefs) for c in self.coordinates)
        small = (believed(c, self.beliefs) for c in nuisances(self.model, self.records))
        self.nuisances = tuple(c for c in small if c.sd > 0.0)
        self._recursion = [None] * len(self.records)
        self._nominal = self.model.nominal
        self._begins = [[cut(m.drive, s.first, s.first + 1) for s in m.spans] for m in self.records]
        self._alters_readings = any("reading" in effect_named(e.name).hooks() for e in self.model.effects)

    @property
    def begin(self) -> Floats:
        """Start of a fit."""
        return np.array([c.begin for c in self.coordinates])

    @property
    def places(self) -> tuple[Places, ...]:
        """Places at which the records' columns are computed in a fit."""
        if self._places is None:
            self._places = tuple(places(m) for m in self.records)
        return self._places

    def forget(self) -> None:
        """Delete what can be computed again."""
        self._places = None
        self._memories.clear()

    def gathered(self, r: Floats) -> Floats:
        """Residuals (M,) in units of the noise in the form of the columns at the places (M',)."""
        return np.concatenate([p.gathered(x) for p, x in zip(self.places, self._by_record(r), strict=True)])

    def averaged(self, columns: Floats) -> Floats:
        """Return means at the places (M', P) of columns at the readings (M, P)."""
        return np.concatenate([p.averaged(x) for p, x in zip(self.places, self._by_record(columns), strict=True)])

    def spread(self, columns: Floats) -> Floats:
        """Return for every reading (M, P) the column of its place (M', P)."""
        edges = np.cumsum([0, *(len(p.first) for p in self.places)])
        return np.asarray(
            columns[np.concatenate([p.place + first for p, first in zip(self.places, edges, strict=False)])]
        )

    def _by_record(self, x: Floats) -> list[Floats]:
        return np.split(x, np.cumsum([len(m.y) for m in self.records])[:-1])

    def index(self, name: str) -> int:
        """Position of a coordinate."""
        return [c.name for c in self.coordinates].index(name)

    def numbers(self, r: int, theta: Floats, nu: Floats | None = None) -> tuple[Numbers, tuple[Floats, ...]]:
        """Numbers of record `r` and the start (D,) of each of its spans."""
        draft = self._draft(r)
        for c, value in zip(self.coordinates, theta, strict=True):
            if c.record in (None, r):
                c.put(draft, float(value))
        if nu is not None and len(nu):
            for c, value in zip(self.nuisances, nu, strict=True):
                if c.record in (None, r):
                    c.put(draft, float(value))
        return self._close(r, draft)

    def system(
        self, r: int, theta: Floats, nu: Floats | None = None, m: Measured | None = None
    ) -> tuple[System, tuple[Floats, ...]]:
        """Balances of record `r` (or of `m` instead), and the start (D,) of each of its spans."""
        v, starts = self.numbers(r, theta, nu)
        m = m or self.records[r]
        return System(self.physics, m.drive, v, self._memory(m.drive, r, v), m.spans), starts

    def predict(self, theta: Floats, guess: Sequence[Floats] | None = None, nu: Floats | None = None) -> Prediction:
        """Simulate all records and compute the readings; `guess`: trajectories near the result."""
        ys, Xs, settled = [], [], True
        for r, m in enumerate(self.records):
            beat()
            system, starts = self.system(r, theta, nu)
            about = np.mean(np.stack(starts), axis=0) if guess is None else guess[r].mean(axis=0)
            recursion = self._recursion[r] or self._refer(r, system.v, about)
            start = None if guess is None else guess[r]
            # pieces have references of their own, so a steep span needs no second attempt as a whole
            X, ok = simulate(system, starts, recursion, start, pieces=self.physics.steep)
            if not ok and not self.physics.steep:  # these numbers are far from those of the reference
                recursion = self._refer(r, system.v, about)
                X, ok = simulate(system, starts, recursion, start)
            ys.append(signals_at(m, system, X))
            Xs.append(X)
            settled = settled and ok
        return Prediction(np.concatenate(ys), tuple(Xs), settled)

    def renew(self, prediction: Prediction, theta: Floats, nu: Floats | None = None) -> None:
        """Renew the reference of the recursions about a trajectory; before a fit, not within one."""
        for r in range(len(self.records)):
            self._refer(r, self.numbers(r, theta, nu)[0], prediction.X[r].mean(axis=0))

    def _refer(self, r: int, v: Numbers, about: Floats) -> Recursion:
        """Build the recursion of record `r` about a state (D,)."""
        u = self.records[r].drive
        recursion = self._recursion[r] = reference(System(self.physics, u, v, self._memory(u, r, v)), about)
        return recursion

    def jacobian(
        self,
        theta: Floats,
        prediction: Prediction,
        coordinates: Sequence[Coordinate],
        refinements: int = 1,
        nu: Floats | None = None,
        records: Sequence[Measured] | None = None,
    ) -> Floats:
        """Return the derivative (M, P) of the readings with respect to coordinates or nuisances, °C per unit.

        `records` are the same records at other places or with longer intervals; `prediction` must then have the same.
        """
        records = self.records if records is None else records
        J = np.zeros((len(coordinates), sum(len(m.y) for m in records)))
        last = 0
        for r, m in enumerate(records):
            own = slice(last, last + len(m.y))
            last = own.stop
            mine = [j for j, c in enumerate(coordinates) if c.record in (None, r)]
            system, starts = self.system(r, theta, nu, m)
            here = _Here(r, theta, nu, system, starts)
            X = prediction.X[r]
            recursion = self._recursion[r] or self._refer(r, system.v, X.mean(axis=0))
            if recursion.dt != m.drive.dt:
                recursion = recursion.with_steps(m.drive.dt, m.drive.N)
            for first in range(0, len(mine), 16):  # few columns at a time stay in the cache
                beat()
                some = mine[first : first + 16]
                variations = [self._variation(here, coordinates[j]) for j in some]
                S = sensitivities(system, X, recursion, variations, refinements)
                for j, signals in zip(some, self._moved(m, system, X, S, variations), strict=True):
                    _at(m, signals, J[j, own])
        return J.T

    def columns(
        self,
        theta: Floats,
        prediction: Prediction,
        coordinates: Sequence[Coordinate],
        refinements: int = 1,
        nu: Floats | None = None,
    ) -> Floats:
        """Return `jacobian` (M', P) at the records' `places`, which is exact enough for a step."""
        at = [p.at for p in self.places]
        there = replace(prediction, X=tuple(X[p.rows] for p, X in zip(self.places, prediction.X, strict=True)))
        slow = [c for c in coordinates if not c.sudden]
        J = self.jacobian(theta, there, slow, refinements, nu, at)
        for j, c in enumerate(coordinates):
            if c.sudden:
                exact = self.averaged(self.jacobian(theta, prediction, [c], refinements, nu))
                J = np.concatenate([J[:, :j], exact, J[:, j:]], axis=1)
        return J

    def _moved(self, m: Measured, system: System, X: Floats, S: Floats, variations: Sequence[Variation]) -> Floats:
        """Differentiate (P, m, rows) the channels' signals by the states, from `S` (rows, D, P)."""
        if not self.physics.reads:
            state = [2 * k - 1 if kind == "surface" else 2 * k - 2 for kind, k in m.channels]
            S = S.transpose(2, 1, 0)
            moved = S[:, state]
            for j, (kind, k) in enumerate(m.channels):
                if kind == "probe":
                    moved[:, j] += self.physics.probe * (S[:, 2 * k - 2] - S[:, 2 * k - 1])
            for G, c in zip(moved, variations, strict=True):
                offset = (np.zeros(self.physics.cells) + c.numbers.surface_offset - system.v.surface_offset) / c.step
                if offset.any():
                    G += np.array([offset[k - 1] if kind == "surface" else 0.0 for kind, k in m.channels])[:, None]
            return moved
        now = _channels(m, system, X)
        varied = [replace(system, v=c.numbers, memory=c.memory) for c in variations]
        return np.stack(
            [
                (_channels(m, s, X + c.step * S[..., j]) - now) / c.step
                for j, (c, s) in enumerate(zip(variations, varied, strict=True))
            ]
        )

    def _variation(self, here: "_Here", c: Coordinate) -> Variation:
        r, nu = here.r, here.nu
        draft = self._draft(r)
        step = c.step
        nuisances = zip(self.nuisances, np.zeros(len(self.nuisances)) if nu is None or not len(nu) else nu, strict=True)
        for other, value in (*zip(self.coordinates, here.theta, strict=True), *nuisances):
            if other is c:
                step = c.step if value + c.step <= c.upper else -c.step
                c.put(draft, float(value) + step)
            elif other.record in (None, r) and (value or other.effect is not None):
                other.put(draft, float(value))
        new, moved = self._close(r, draft)
        memory = here.system.memory if c.effect is None else self._memory(here.system.u, r, new)
        start = tuple((b - a) / step for a, b in zip(here.starts, moved, strict=True))
        return Variation(new, memory, step, start, c.only_start)

    def _memory(self, u: Drive, r: int, v: Numbers) -> Mapping[str, Floats]:
        """Effects' memories of the inputs of record `r`, cached because a fit often returns to the same numbers."""
        key = (r, u.dt, *((name, *v.effects[name].values()) for name in self.physics.remembering))
        if key not in self._memories:
            if len(self._memories) >= MEMORIES:
                self._memories.clear()
            self._memories[key] = self.physics.memory(u, v)[0]
        return self._memories[key]

    def _draft(self, r: int) -> Draft:
        p, n = self._nominal, self.model.cells
        string = {name: np.array(getattr(p, name), dtype=np.float64) for name in KINDS}
        effects = {e.key: dict(e.values) for e in self.model.effects}
        start = [s.copy() for s in self.records[r].start]
        return Draft(string, effects, 0.0, np.zeros(n), dict.fromkeys(LATE, 0.0), [s.copy() for s in start], start)

    def _close(self, r: int, d: Draft) -> tuple[Numbers, tuple[Floats, ...]]:
        s = d.string
        string = StringParameters(
            **{name: s[name] for name in CELL_SYMBOLS},
            R_cc=float(s["R_cc"]),
            C_f=float(s["C_f"]),
            coolant=self.model.coolant,
        )
        v = Numbers(string, d.effects, d.inlet_offset, d.surface_offset, d.late["T_in"], d.late["flow"])
        starts = tuple(self.physics.start(c, s, v) for c, s in zip(d.core_start, d.surface_start, strict=True))
        if self._alters_readings or np.any(d.surface_offset):
            return v, tuple(
                self.physics.start(c - e, s - e, v)
                for c, s, e in zip(d.core_start, d.surface_start, self._reading_errors(r, v, starts), strict=True)
            )
        return v, starts

    def _reading_errors(self, r: int, v: Numbers, starts: Sequence[Floats]) -> list[Floats]:
        """Return the thermocouples' errors at each start, per cell: starts were taken from their readings."""
        m, n = self.records[r], self.model.cells
        sensed = sorted({k for kind, k in m.channels if kind == "surface"})
        found = []
        for X, u in zip(starts, self._begins[r], strict=True):
            memory = self.physics.memory(u, v)[0] if self._alters_readings else {}
            read = self.physics.readings(X[None], u, v, memory)[0]
            error = (read - X[1 : 2 * n : 2])[[k - 1 for k in sensed]]
            found.append(np.interp(np.arange(1, n + 1), sensed, error))
        return found


@dataclass(frozen=True, slots=True)
class _Here:
    """Point at which a record is differentiated: coordinates, nuisances, and what follows from them."""

    r: int
    theta: Floats
    nu: Floats | None
    system: System
    starts: tuple[Floats, ...]


def _channels(m: Measured, system: System, X: Floats) -> Floats:
    """Signals (m, rows) of the record's channels along a trajectory."""
    surface = readings(system, X)
    n, probe = 2 * system.physics.cells, system.physics.probe
    core = X[:, 0:n:2]
    inside = {"surface": surface, "core": core, "probe": core + probe * (core - X[:, 1:n:2])}
    return np.stack([inside[kind][:, k - 1] for kind, k in m.channels])


def signals_at(m: Measured, system: System, X: Floats) -> Floats:
    """Return readings (M,), °C, of the record's thermocouples along a trajectory, at the readings' time stamps."""
    return _at(m, _channels(m, system, X), np.empty(len(m.y)))


def _at(m: Measured, signals: Floats, out: Floats) -> Floats:
    """Signals (m, rows) at the time stamps of the readings (M,), into `out`."""
    rise = np.zeros_like(signals)  # none after the last row
    np.subtract(signals[:, 1:], signals[:, :-1], out=rise[:, :-1])
    place = m.channel * signals.shape[1] + m.row
    np.take(rise, place, out=out, mode="clip")
    out *= m.share
    out += np.take(signals, place, mode="clip")
    return out
