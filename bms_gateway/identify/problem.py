"""One or several records of a string, the numbers that are free, and what the model reads with them.

Free numbers are coordinates with a Gaussian prior: logarithms of the parameters about their prior's median, numbers of
the effects, and what each record knows on its own (start, and with several records the cooling). Scatter within the
declared tolerances (cells, sensors, inlet) and the start of each cell are nuisances: small, so that the model is
linear in them and their columns are taken once.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from bms_gateway.thermal import CELL_SYMBOLS, KINDS, Floats, StringModel, StringParameters
from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects import EffectParameter, effect_named
from bms_gateway.thermal.physics import Numbers, Physics
from bms_gateway.thermal.trajectory import Recursion, Span, Variation, cut, readings, reference, sensitivities, simulate

Channel = tuple[Literal["surface", "core"], int]
"""What a thermocouple measures, and on which cell (from 1)."""
LIMIT = 4.0
"""sd: a prior's tails end here; a number that ends there is an alarm, not an answer."""
LATE = {"T_in": 0.3, "flow": 0.5}
"""s: how late inlet and flow may be read against the current; half an interval of a logger, or another device's filter."""
OWN = ("R_u",)
"""Parameters that each of several records has for itself: the same cells are cooled differently."""


@dataclass(frozen=True, slots=True)
class Measured:
    """Readings of one record and what drove the string, ready for a fit.

    Attributes
    ----------
    drive : Drive, N intervals
    spans : tuple of Span
        Stretches with a start of their own.
    channels : tuple of (kind, cell), m of them
    channel, row : ndarray (M,) of int
        Channel of each reading, and the row of the trajectory (instants of all spans stacked) before it.
    share : ndarray (M,)
        Where between that row and the next the reading was taken, 0…1.
    y : ndarray (M,), °C
    used : ndarray (M,) of bool
        False for held-out blocks.
    sigma0, step : ndarray (m,), K
        White noise and resolution of each channel.
    start : tuple of ndarray (n,), °C
        Surfaces at the start of each span, from the first readings.
    start_sd : tuple of ndarray (n,), K
        How well these are known, cell by cell.
    source : str
    """

    drive: Drive
    spans: tuple[Span, ...]
    channels: tuple[Channel, ...]
    channel: np.ndarray
    row: np.ndarray
    share: Floats
    y: Floats
    used: np.ndarray
    sigma0: Floats
    step: Floats
    start: tuple[Floats, ...]
    start_sd: tuple[Floats, ...]
    source: str = "record"

    @property
    def sigma(self) -> Floats:
        """Standard deviation (M,) of each reading, noise and rounding together."""
        return np.asarray(np.sqrt(self.sigma0**2 + self.step**2 / 12.0)[self.channel])


@dataclass(slots=True)
class Draft:
    """Numbers of one record while the coordinates are put into them."""

    string: dict[str, Floats]
    effects: dict[str, dict[str, float]]
    inlet_offset: float
    surface_offset: Floats
    late: dict[str, float]
    core_start: list[Floats]
    surface_start: list[Floats]


@dataclass(frozen=True, slots=True)
class Coordinate:
    """One free number.

    Attributes
    ----------
    name : str
        Symbol, `effect.parameter`, `T_c0`, …; with `@r` for record r of several.
    prior, sd, lower, upper : float
        In the coordinate: the logarithm over the prior's median for parameters, of the value where the effect says so.
    step : float
        For finite differences.
    begin : float
        Where a fit starts.
    put : callable
        Puts a value into a draft.
    record : int or None
        The record it belongs to; None for all.
    effect : str or None
        Key of its effect.
    reach : float
        Longest step of a fit.
    vanishing : bool
        Its lower bound is where the effect vanishes and its other numbers mean nothing: a fit comes near by shares.
    """

    name: str
    prior: float
    sd: float
    lower: float
    upper: float
    step: float
    begin: float
    put: Callable[[Draft, float], None]
    record: int | None = None
    effect: str | None = None
    reach: float = np.inf
    vanishing: bool = False


@dataclass(frozen=True, slots=True)
class Belief:
    """A prior that takes the place of a coordinate's own.

    Attributes
    ----------
    prior, sd : float
        In the coordinate. Its bounds stay.
    """

    prior: float
    sd: float


@dataclass(frozen=True, slots=True)
class Prediction:
    """What the model says with one set of coordinates.

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
    """A model, records, and the coordinates in which it is fitted.

    Parameters
    ----------
    model : StringModel
        Its effects are part of it; effects with sd 0 keep their numbers.
    records : sequence of Measured
    beliefs : mapping of coordinate to Belief
        Priors in place of the coordinates' own; named without cell, span and record. A nuisance of sd 0 is none.
    """

    model: StringModel
    records: Sequence[Measured]
    beliefs: Mapping[str, Belief] = field(default_factory=dict)
    physics: Physics = field(init=False)
    coordinates: tuple[Coordinate, ...] = field(init=False)
    nuisances: tuple[Coordinate, ...] = field(init=False)
    _recursion: list[Recursion | None] = field(init=False)
    _alters_readings: bool = field(init=False)

    def __post_init__(self) -> None:
        self.physics = Physics(self.model)
        self.coordinates = tuple(_parameters(self.model, len(self.records)))
        self.coordinates += tuple(c for r, m in enumerate(self.records) for c in _starts(r, m, len(self.records)))
        # last: a model with one more effect has the same coordinates and some at the end
        self.coordinates += tuple(c for e in self.model.effects for c in _effect(e.key, e.name, e.values, e.sd))
        self.coordinates = tuple(_believed(c, self.beliefs) for c in self.coordinates)
        believed = (_believed(c, self.beliefs) for c in _nuisances(self.model, self.records))
        self.nuisances = tuple(c for c in believed if c.sd > 0.0)
        self._recursion = [None] * len(self.records)
        self._alters_readings = any("reading" in effect_named(e.name).hooks() for e in self.model.effects)

    @property
    def begin(self) -> Floats:
        """Where a fit starts."""
        return np.array([c.begin for c in self.coordinates])

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

    def predict(self, theta: Floats, guess: Sequence[Floats] | None = None, nu: Floats | None = None) -> Prediction:
        """Run the model freely over all records and read it; `guess` are trajectories near the result."""
        ys, Xs, settled = [], [], True
        for r, m in enumerate(self.records):
            v, starts = self.numbers(r, theta, nu)
            memory, _ = self.physics.memory(m.drive, v)
            about = np.mean(np.stack(starts), axis=0) if guess is None else guess[r].mean(axis=0)
            recursion = self._recursion[r]
            if recursion is None:
                recursion = self._recursion[r] = reference(self.physics, m.drive, v, memory, about)
            start = None if guess is None else guess[r]
            X, ok = simulate(self.physics, m.drive, v, memory, starts, m.spans, recursion, start, halve=False)
            if not ok:  # these numbers are far from those of the reference
                recursion = self._recursion[r] = reference(self.physics, m.drive, v, memory, about)
                X, ok = simulate(self.physics, m.drive, v, memory, starts, m.spans, recursion, start)
            ys.append(signals_at(m, self.physics, v, memory, X))
            Xs.append(X)
            settled = settled and ok
        return Prediction(np.concatenate(ys), tuple(Xs), settled)

    def renew(self, prediction: Prediction, theta: Floats, nu: Floats | None = None) -> None:
        """Take the reference of the recursions anew, about a trajectory; before a fit, not within one."""
        for r, m in enumerate(self.records):
            v, _ = self.numbers(r, theta, nu)
            memory, _ = self.physics.memory(m.drive, v)
            self._recursion[r] = reference(self.physics, m.drive, v, memory, prediction.X[r].mean(axis=0))

    def jacobian(
        self,
        theta: Floats,
        prediction: Prediction,
        coordinates: Sequence[Coordinate],
        refinements: int = 1,
        nu: Floats | None = None,
    ) -> Floats:
        """Derivative (M, P) of the readings with respect to coordinates or nuisances, °C per unit."""
        blocks = []
        for r, m in enumerate(self.records):
            J = np.zeros((len(m.y), len(coordinates)))
            mine = [j for j, c in enumerate(coordinates) if c.record in (None, r)]
            v, starts = self.numbers(r, theta, nu)
            memory, _ = self.physics.memory(m.drive, v)
            variations = [self._variation(r, theta, nu, coordinates[j], memory, starts) for j in mine]
            recursion = self._recursion[r]
            if recursion is None:
                recursion = self._recursion[r] = reference(
                    self.physics, m.drive, v, memory, prediction.X[r].mean(axis=0)
                )
            now = _channels(m, self.physics, v, memory, prediction.X[r])
            for first in range(0, len(mine), 16):  # few columns at a time stay in the cache
                some = variations[first : first + 16]
                S = sensitivities(
                    self.physics, m.drive, v, memory, prediction.X[r], m.spans, recursion, some, refinements
                )
                moved = [
                    (_channels(m, self.physics, c.numbers, c.memory, prediction.X[r] + c.step * S[..., k]) - now)
                    / c.step
                    for k, c in enumerate(some)
                ]
                J[:, mine[first : first + 16]] = _at(m, np.stack(moved, axis=-1))
            blocks.append(J)
        return np.concatenate(blocks)

    def _variation(
        self,
        r: int,
        theta: Floats,
        nu: Floats | None,
        c: Coordinate,
        memory: Mapping[str, Floats],
        starts: Sequence[Floats],
    ) -> Variation:
        draft = self._draft(r)
        step = c.step
        nuisances = zip(self.nuisances, np.zeros(len(self.nuisances)) if nu is None or not len(nu) else nu, strict=True)
        for other, value in (*zip(self.coordinates, theta, strict=True), *nuisances):
            if other is c:
                step = c.step if value + c.step <= c.upper else -c.step
                c.put(draft, float(value) + step)
            elif other.record in (None, r) and (value or other.effect is not None):
                other.put(draft, float(value))
        v, moved = self._close(r, draft)
        m = memory if c.effect is None else self.physics.memory(self.records[r].drive, v)[0]
        return Variation(v, m, step, tuple((b - a) / step for a, b in zip(starts, moved, strict=True)))

    def _draft(self, r: int) -> Draft:
        p, n = self.model.nominal, self.model.cells
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
        """What the thermocouples add at the start of each span, cell by cell: starts were taken from their readings."""
        m, n = self.records[r], self.model.cells
        sensed = sorted({k for kind, k in m.channels if kind == "surface"})
        found = []
        for X, span in zip(starts, m.spans, strict=True):
            u = cut(m.drive, span.first, span.first + 1)
            read = self.physics.readings(X[None], u, v, self.physics.memory(u, v)[0])[0]
            error = (read - X[1 : 2 * n : 2])[[k - 1 for k in sensed]]
            found.append(np.interp(np.arange(1, n + 1), sensed, error))
        return found


def _channels(m: Measured, physics: Physics, v: Numbers, memory: Mapping[str, Floats], X: Floats) -> Floats:
    """Signals (rows, m) of the record's channels along a trajectory."""
    surface = readings(physics, m.drive, v, memory, X, m.spans)
    return np.stack([surface[:, k - 1] if kind == "surface" else X[:, 2 * k - 2] for kind, k in m.channels], axis=1)


def signals_at(m: Measured, physics: Physics, v: Numbers, memory: Mapping[str, Floats], X: Floats) -> Floats:
    """What the record's thermocouples read (M,) along a trajectory, at the readings' own time stamps, °C."""
    return _at(m, _channels(m, physics, v, memory, X))


def _at(m: Measured, signals: Floats) -> Floats:
    """Signals (rows, m) or (rows, m, P) at the time stamps of the readings: (M,) or (M, P)."""
    rows, channels = signals.shape[:2]
    flat = signals.reshape(rows * channels, *signals.shape[2:])
    before = m.row * channels + m.channel
    after = np.minimum(m.row + 1, rows - 1) * channels + m.channel
    share = m.share if signals.ndim == 2 else m.share[:, None]
    out = np.take(flat, after, axis=0)
    start = np.take(flat, before, axis=0)
    out -= start
    out *= share
    out += start
    return out


def _parameters(model: StringModel, records: int) -> list[Coordinate]:
    found = []
    for name, prior in model.priors.items():
        if prior.fixed:
            continue
        kind, value = KINDS[name], np.asarray(prior.value)
        low = max(float(np.log(kind.lower / value.min())), -LIMIT * prior.rel_sd)
        high = min(float(np.log(kind.upper / value.max())), LIMIT * prior.rel_sd)

        def put(d: Draft, z: float, name: str = name) -> None:
            d.string[name] = d.string[name] * np.exp(z)

        one = Coordinate(name, 0.0, prior.rel_sd, low, high, min(0.02, 0.1 * prior.rel_sd), 0.0, put)
        if records > 1 and name in OWN:
            found += [replace(one, name=f"{name}@{r + 1}", record=r) for r in range(records)]
        else:
            found.append(one)
    return found


def _effect(key: str, name: str, values: Mapping[str, float], sd: Mapping[str, float]) -> list[Coordinate]:
    found = []
    for p in effect_named(name).parameters:
        if sd.get(p.name, p.sd) == 0.0:
            continue
        found.append(_effect_coordinate(key, p, values.get(p.name, p.probe)))
    return found


def _effect_coordinate(key: str, p: EffectParameter, value: float) -> Coordinate:
    def to(x: float) -> float:
        return float(np.log(x)) if p.log else x

    def put(d: Draft, z: float) -> None:
        d.effects[key][p.name] = float(np.exp(z)) if p.log else z

    return Coordinate(
        f"{key}.{p.name}",
        to(p.prior),
        p.sd,
        to(p.lower),
        to(p.upper),
        0.02 * p.sd if p.log else min(0.02 * p.sd, 0.02 * (p.upper - p.lower)),
        min(max(to(value), to(p.lower)), to(p.upper)),
        put,
        effect=key,
        reach=p.reach,
        vanishing=p.neutral == p.lower,
    )


def _believed(c: Coordinate, beliefs: Mapping[str, Belief]) -> Coordinate:
    plain = c.name.split("@")[0].split("[")[0]
    if c.effect is not None:
        plain = c.name.replace(c.effect, c.effect.partition(":")[0], 1)
    b = beliefs.get(plain)
    return c if b is None else replace(c, prior=b.prior, sd=b.sd)


# K: how far the cores may be from the surfaces, and the surfaces from the first readings, when a record starts
CORE_START = (1.0, 15.0)
SURFACE_START = (0.5, 5.0)


def _starts(r: int, m: Measured, records: int) -> list[Coordinate]:
    found = []
    for i in range(len(m.spans)):
        tail = ("" if len(m.spans) == 1 else f"[{i + 1}]") + ("" if records == 1 else f"@{r + 1}")

        def core(d: Draft, z: float, i: int = i) -> None:
            d.core_start[i] = d.core_start[i] + z

        def both(d: Draft, z: float, i: int = i) -> None:
            d.core_start[i] = d.core_start[i] + z
            d.surface_start[i] = d.surface_start[i] + z

        sd, limit = CORE_START
        found.append(Coordinate(f"T_c0{tail}", 0.0, sd, -limit, limit, 0.1, 0.0, core, r))
        sd, limit = SURFACE_START
        found.append(Coordinate(f"T_s0{tail}", 0.0, sd, -limit, limit, 0.1, 0.0, both, r))
    return found


def _nuisances(model: StringModel, records: Sequence[Measured]) -> list[Coordinate]:
    found = []
    n, tol = model.cells, model.tolerances
    if n > 1:
        for symbol in ("R_e", "R_u", "R_c"):
            sd = tol.get(f"cell_{symbol}", 0.0)
            for k in range(n):

                def scatter(d: Draft, z: float, symbol: str = symbol, k: int = k) -> None:
                    d.string[symbol] = d.string[symbol] * (1.0 + z * (np.arange(len(d.string[symbol])) == k))

                found.append(_nuisance(f"{symbol}[{k + 1}]", sd, scatter))
    for r, m in enumerate(records):
        tail = "" if len(records) == 1 else f"@{r + 1}"
        for k in sorted({cell for kind, cell in m.channels if kind == "surface"}):

            def offset(d: Draft, z: float, k: int = k) -> None:
                d.surface_offset = d.surface_offset + z * (np.arange(len(d.surface_offset)) == k - 1)

            found.append(_nuisance(f"surface_offset[{k}]{tail}", tol.get("surface_offset_K", 0.0), offset, r))

        def inlet(d: Draft, z: float) -> None:
            d.inlet_offset += z

        found.append(_nuisance(f"inlet_offset{tail}", tol.get("inlet_offset_K", 0.0), inlet, r))
        for signal, sd in LATE.items():
            x = getattr(m.drive, signal)
            if np.ptp(x) > 0.0:

                def late(d: Draft, z: float, signal: str = signal) -> None:
                    d.late[signal] += z

                found.append(_nuisance(f"{signal}_late{tail}", sd, late, r))
        for i, sds in enumerate(m.start_sd):
            for k, sd in enumerate(sds):

                def start(d: Draft, z: float, i: int = i, k: int = k) -> None:
                    here = np.arange(len(d.core_start[i])) == k
                    d.core_start[i] = d.core_start[i] + z * here
                    d.surface_start[i] = d.surface_start[i] + z * here

                found.append(_nuisance(f"T_0[{k + 1}]{tail}", float(sd), start, r))
    return [c for c in found if c.sd > 0.0]


def _nuisance(name: str, sd: float, put: Callable[[Draft, float], None], record: int | None = None) -> Coordinate:
    return Coordinate(name, 0.0, sd, -LIMIT * sd, LIMIT * sd, sd, 0.0, put, record)
