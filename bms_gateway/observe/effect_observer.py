"""The observer of a string whose model holds effects of the catalogue, linear or not.

The mean follows the balances of the string, which the offline simulation and fit use too. The covariance follows their
Jacobian (`tangent`), renewed when the string has moved away from the point at which it was taken. What the model states
as uncertain, its parameters and those of the effects, is considered and not estimated (`consider`). The stated variance
is the sum of three parts: the filter with all numbers known, their covariance through the sensitivities, and the
scatter of the cells by the model's tolerances.

In place of Lin et al., Eq 11-12, where a model has effects that the paper lacks.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from math import exp, isfinite, nan
from typing import Any

import numpy as np

from bms_gateway.errors import StateError
from bms_gateway.observe.consider import Belief, Readings, conditioned
from bms_gateway.observe.considered import Considered, Forced, Linearised, slopes_of_readings
from bms_gateway.observe.covariance_steps import READ_WITHIN
from bms_gateway.observe.effect_bands import deviations, unlike_of
from bms_gateway.observe.effect_inputs import Inputs
from bms_gateway.observe.estimate import Errors, Estimate
from bms_gateway.observe.gap import phases, resumed, steps, strayed, unknown_heat, unseen_heat
from bms_gateway.observe.measured import SOC_UNKNOWN, Measured
from bms_gateway.observe.model import OFFSETS, start_covariance
from bms_gateway.observe.outlook_effects import EffectStanding
from bms_gateway.observe.statistic_check import surprise_of
from bms_gateway.observe.stored import like, plain
from bms_gateway.observe.tangent import ROW, Tangent, disturbed, drive_of, heated, jacobian
from bms_gateway.observe.uncertain import EffectNumber, Uncertain, effect_numbers
from bms_gateway.observe.unseen import JUST_LEFT_S, RESTED_S, either, opened
from bms_gateway.thermal import Disturbance, Floats, Start, StringModel, StringParameters
from bms_gateway.thermal.centre import followed, hottest, time_constant
from bms_gateway.thermal.physics import Memory, Numbers
from bms_gateway.thermal.system import System

COLDEST, HOTTEST = -100.0, 400.0
"""°C: limit for a model that runs away; the readings go on correcting it."""
FLOW_UNSEEN = 0.1
"""ln of the flow: sd about the line between the values before and after a time in which it was not read."""
LITTLE = 0.01
"""Step of ln(flow) for a finite difference."""
REST_SD = 0.1
"""K: sd of an effect's own states at the start, about their balance with core and surface."""


class EffectObserver:
    """Observer of one string by its full physics.

    Parameters
    ----------
    model : StringModel
        Its priors and the effects' standard deviations give the covariance of the uncertain numbers.
    dt : float, s
        Step.
    disturbance : Disturbance, optional
    start, several : optional
        As for `AdaptiveObserver`.
    soc : float, optional
        State of charge from which counting starts.

    Examples
    --------
    >>> from bms_gateway.thermal import AddedEffect, Prior
    >>> table_1 = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79}
    >>> priors = {symbol: Prior(value) for symbol, value in table_1.items()}
    >>> effect = AddedEffect("resistance_temperature", None, {"B": 3000.0}, {"B": 300.0})
    >>> observer = EffectObserver(StringModel(1, (1,), "single", priors, effects=(effect,)), 1.0)
    >>> e = observer.step(Measured(60.0, 3600.0, 60.0, inlet=25.0), np.array([30.0]), np.zeros(1))
    >>> bool(e.available[0]), round(float(e.surface[0, 0]), 1)
    (True, 30.0)
    """

    def __init__(
        self,
        model: StringModel,
        dt: float,
        disturbance: Disturbance | None = None,
        start: Start | None = None,
        soc: float = SOC_UNKNOWN,
        *,
        several: bool = False,
    ) -> None:
        self._dt = float(dt)
        self._disturbance, self._start = disturbance or Disturbance(), start or Start()
        self._of = Considered.of(model)
        self._sensors = np.array(model.sensors, np.int64) - 1
        n, M, p = model.cells, self._of.physics.states + OFFSETS, len(self.uncertain)
        self.belief = Belief(np.zeros(M), np.eye(M), np.zeros((M, p)))
        self._forced, self._G = Forced.nothing(M, p), np.zeros((n, p))
        self._seen, self._coolant, self._lag = np.zeros(n), np.zeros(n), np.zeros(n)
        self.surprise = surprise_of(self.parameters, self._sensors[None], self._dt, self._disturbance.sensor, several)
        self._effective = (nan, 0.0)
        self._unread, self._available = np.full(len(self._sensors), np.inf), np.array(False)
        self._inputs = Inputs(soc, model.capacity_Ah, self._dt, self._disturbance.correlation)
        self._carry: dict[str, Floats] = {}
        self._line = Linearised(np.zeros(M), self._inputs.row)
        # inputs of the next step are needed: state before the gap, length, whether current may have flowed
        self._before_gap: tuple[dict[str, Any], float, bool] | None = None

    @property
    def uncertain(self) -> tuple[Uncertain, ...]:
        """Numbers of the model that are not known exactly."""
        return self._of.uncertain

    @property
    def parameters(self) -> tuple[StringParameters, ...]:
        """Numbers of the string at nominal flow."""
        return (self._of.now.string,)

    @property
    def covariances(self) -> Floats:
        """Covariance (1, M, M) of temperatures, states of the effects and offsets if the parameters were exact."""
        return self.belief.P[None]

    @property
    def effect_numbers(self) -> list[EffectNumber]:
        """Numbers of the effects that are in force."""
        return effect_numbers(self._of.model, self._of.now, self.uncertain, self._of.cov)

    @property
    def soc(self) -> float:
        """State of charge, 0 to 1, counted from the last measured value."""
        return self._inputs.soc

    @property
    def read(self) -> Floats:
        """Temperature that a thermocouple on each cell (n,) would read at the newest step, °C."""
        return self._seen

    @property
    def effective(self) -> tuple[float, float]:
        """Mean square current, A², that would make the last step's heat by R_e; what effects add to the inlet, K."""
        return self._effective

    @property
    def _usual_heat(self) -> float:
        return float(self._inputs.usual.mean[0, 1] * np.mean(self._of.now.string.R_e))

    def step(self, m: Measured, y: Floats, age: Floats) -> Estimate:
        """Advance one step and use the readings.

        Parameters
        ----------
        m : Measured
        y, age : ndarray (n,), °C, s
            New surface readings (NaN: none) and how long before now they were taken.

        Returns
        -------
        Estimate
            Of S = 1 string.
        """
        if not self._available and not self._begin(m, y):
            return self.estimate()
        if self._before_gap is not None and (isfinite(m.inlet) or isfinite(m.flow)):
            was, gap_s, unseen = self._before_gap
            self.restore(was)
            self._carried(gap_s, unseen, m.inlet, m.flow)
        self._before_gap = None
        knew, known = self._inputs.known, self._inputs.measured(m)
        before = resumed(self.belief, known & ~knew, m.inlet - self._inputs.inlet, self._of.cov, self._disturbance)
        if knew[1] and not known[1]:
            before = unknown_heat(before, self._usual_heat, self._disturbance)
        row = self._inputs.take(m)
        memory = self._remember(row)
        now, tangent = self._predict(before, row, memory)
        instant = row.copy()
        instant[ROW.index("T_in")] = self._inputs.inlet
        seen = self._readings(now.z, instant, memory)
        r, r_sd = np.full((2, 1, len(y)), nan)
        at = self._sensors[np.isfinite(y[self._sensors])]
        after = now
        if len(at):
            w = np.clip(np.nan_to_num(age[at]) / self._dt, 0.0, 1.0)
            r[0, at] = y[at] - ((1.0 - w) * seen[at] + w * self._seen[at])
            read = Readings(tangent.H[at], self._G[at], r[0, at], w, self._disturbance.sensor)
            after, r_sd[0, at] = conditioned(before, now, tangent.Phi, read, self._of.cov)
        self._unread = np.where(np.isfinite(y[self._sensors]), 0.0, self._unread + self._dt)
        if not after.finite:  # only a senseless number of the model leads here: begin anew
            self._available = np.array(False)
            return self.estimate()
        self.belief, self._seen = after, seen + tangent.H @ (after.z - now.z)
        self._widen(now, y, r, r_sd)
        self._forced.add(row, before.z, self._of, self._dt)
        self._follow(self._dt)
        return self._estimate(r, r_sd)

    def _widen(self, now: Belief, y: Floats, r: Floats, r_sd: Floats) -> None:
        """Increase the variances of the cores where readings are odd; see `innovation_check`."""
        k = self._sensors
        sd = np.sqrt(now.P[2 * k + 1, 2 * k + 1] + self._disturbance.sensor**2)[None]
        inputs = self._inputs.known[None], np.array([self._inputs.inlet])
        grown = self.surprise.step(y[None, k], r[:, k], sd, np.maximum(r_sd[:, k], sd), *inputs)
        r_sd[:, k] = self.surprise.rounded(r_sd[:, k])
        if grown is not None:
            self.belief = self.belief.loosened(2 * k, grown[0])

    def estimate(self) -> Estimate:
        """Return the present state of the string, with no innovation; nothing changes."""
        return self._estimate(*np.full((2, 1, self._of.model.cells), nan))

    def standing(self) -> EffectStanding:
        """Return all that a forecast starts from."""
        b, i, there = self.belief, self._inputs, self._available.reshape(1)
        now = b.z[None], b.P[None], b.J[None], self._of.root[None], self.parameters, np.zeros(1, np.int64), np.ones(1)
        unlike = unlike_of(b, self._coolant, self._of.scatter, self._of.centre)
        return EffectStanding(
            *now,
            inlet=np.array([i.inlet]),
            lag=self._lag[None],
            unlike=unlike,
            available=there,
            disturbance=self._disturbance,
            entropic=np.zeros((1, 2)),  # no reversible heat but that of the effects, and R_e is known where they say
            charge=np.zeros(1),
            B=np.zeros(1),
            u_0=np.zeros(1),
            physics=self._of.physics,
            numbers=self._of.now,
            tangent=self._line.tangent,
            forcing=self._forced.F,
            row=i.row,
            usual=float(i.usual.mean[0, 1]),
            carry=dict(self._carry),
            R_e_at=next((k for k, u in enumerate(self.uncertain) if u.name == "R_e"), None),
        )

    def set_parameters(
        self,
        s: int,
        values: Mapping[str, float | Floats],
        names: Sequence[str],
        covariance: Floats,
        own: Floats | None = None,
    ) -> None:
        """Use identified parameters; see `AdaptiveObserver.set_parameters`.

        `s` is 0. A string with effects ignores `own` and the factor on measured heat.
        """
        del s, own
        moved = self._of.exchange(values, names, covariance)
        self.surprise.set_parameters(self.parameters)
        b = self.belief
        self.belief = Belief(b.z + b.J @ moved, b.P, b.J)
        self._lag = self._lag + self._gap(b.J @ moved)
        self._line.tangent = self._before_gap = None
        self.surprise.settle(0)

    def propagate(self, gap_s: float, inlet: Floats | None = None, *, unseen: bool = False) -> Estimate:
        """Carry the string over a time without frames; see `AdaptiveObserver.propagate`, inlet (1,)."""
        if not self._available:
            return self.estimate()
        last = nan if inlet is None else float(inlet[0])
        self._before_gap = None if isfinite(last) else (self.snapshot(), gap_s, unseen)
        return self._carried(gap_s, unseen, last, nan)

    def _carried(self, gap_s: float, unseen: bool, inlet: float, flow: float) -> Estimate:
        """Carry the string over a gap with this inlet, °C, and flow at its end (NaN: unchanged)."""
        b, usual = self.belief, self._usual_heat
        if unseen:
            self.belief = Belief(*opened(b.z, b.P, b.J, gap_s, usual, self._disturbance))
        last, grown = inlet if isfinite(inlet) else self._inputs.inlet, self._inputs.grown(flow)
        turbulent = strayed(self._disturbance, last - self._inputs.inlet, gap_s)
        row, g = self._inputs.row, np.zeros(len(self.belief.z))
        for done, h in steps(gap_s, steep=self._of.physics.steep):
            middle = done + h / 2.0
            row = self._inputs.rest(last, flow, middle / gap_s, h / 3600.0)
            g = self._rest(row, h, phases(middle, usual, self._disturbance) if unseen else 0.0, turbulent, g)
        if isfinite(flow):
            b = self.belief
            self.belief = Belief(b.z, b.P + (grown**2 / 12.0 + FLOW_UNSEEN**2) * np.outer(g, g), b.J)
        self._inputs.resume(last, flow, row, gap_s, unseen=unseen)
        self._follow(gap_s)
        self._unread = self._unread + gap_s
        self._forced.drop()
        self._line.tangent = None
        instant = row.copy()
        instant[ROW.index("T_in")] = last
        self._seen = self._readings(self.belief.z, instant, self._memory(row, self._dt)[0])
        return self.estimate()

    def propagate_unknown(self) -> None:
        """Carry the string over a time of unknown length; the memories of effects are set to those of rest."""
        was, inputs = self.belief, copy(self._inputs)
        self.propagate(JUST_LEFT_S, unseen=True)
        a = self.belief
        self.belief, self._inputs = was, inputs
        self.propagate(RESTED_S)
        b, self._inputs.known, self._before_gap = self.belief, np.array([False, False]), None
        self.belief = Belief(*either(a.z, a.P, b.z, b.P), (a.J + b.J) / 2.0)
        self._lag = self._gap(self.belief.z)

    def snapshot(self) -> dict[str, Any]:
        """Return all that a restart needs, as numbers, lists and None for NaN."""
        own = {name: plain(np.asarray(value)) for name, value in self._kept().items()} | self._inputs.snapshot()
        belief = {name: plain(getattr(self.belief, name)) for name in ("z", "P", "J")}
        memories = {"": self._carry, "at": self._line.memory} | {f"of {k}": c for k, c in self._forced.carries.items()}
        return {
            "own": own,
            "belief": belief,
            "block": [plain(self._forced.rows), plain(self._forced.states)],
            "values": {k: plain(v) for k, v in self._of.values.items()},
            "memories": {k: {e: plain(a) for e, a in m.items()} for k, m in memories.items()},
            "linear": self._line.tangent is not None,
            "surprise": self.surprise.snapshot(),
        }

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Continue from `snapshot`, bit for bit as if the observer had never stopped.

        Raises
        ------
        StateError
            It belongs to another string, is incomplete, or holds values that are not numbers.
        """
        try:
            belief = Belief(*(like(snapshot["belief"][k], getattr(self.belief, k)) for k in ("z", "P", "J")))
            stored = {"lag": plain(self._gap(belief.z)), **snapshot["own"]}  # states of older versions have no lag
            own = {k: like(stored[k], np.asarray(v)) for k, v in self._kept().items()}
            inputs = self._inputs.restored(snapshot["own"])
            rows, states = (np.array(a, np.float64) for a in snapshot["block"])
            rows, states = rows.reshape(-1, len(ROW)), states.reshape(len(rows), len(belief.z))
            values = {k: like(snapshot["values"][k], v) for k, v in self._of.values.items()}
            memories = {k: {e: np.array(a, np.float64) for e, a in m.items()} for k, m in snapshot["memories"].items()}
            carry, at_memory = memories.pop(""), memories.pop("at")
            linear = bool(snapshot["linear"])
            surprise = self.surprise.restored(snapshot.get("surprise"))
        except (KeyError, TypeError, ValueError, AttributeError) as e:
            raise StateError(f"observer state: not of this string ({type(e).__name__}: {e})") from e
        held = [own["cov"], own["F"], own["lag"], states, *values.values(), *carry.values(), *at_memory.values()]
        if not belief.finite or not all(np.isfinite(a).all() for a in held):
            raise StateError("observer state: holds values that are not numbers")
        self._seen, self._coolant, self._lag, self._G = own["seen"], own["coolant"], own["lag"], own["G"]
        self._unread, self._available = own["unread"], own["available"]
        self.belief, self._carry, self._inputs = belief, carry, inputs
        self._forced = Forced(own["F"], rows, states, {k.removeprefix("of "): m for k, m in memories.items()})
        self._line = Linearised(own["at"], own["at_row"], at_memory, own["age"].item())
        self._of.take(values, own["cov"])
        self.surprise = surprise
        self.surprise.set_parameters(self.parameters)
        if linear:
            self._linearise()

    def _kept(self) -> dict[str, Any]:
        """List what a snapshot holds besides inputs, belief, memories and waiting steps."""
        return {
            "age": self._line.age,
            "cov": self._of.cov,
            "F": self._forced.F,
            "seen": self._seen,
            "coolant": self._coolant,
            "lag": self._lag,
            "unread": self._unread,
            "available": self._available,
            "at": self._line.at,
            "at_row": self._line.row,
            "G": self._G,
        }

    def _begin(self, m: Measured, y: Floats) -> bool:
        """Start when the first inlet or reading comes."""
        heard = y[np.isfinite(y)]
        if not len(heard) and not isfinite(m.inlet):
            return False
        level = float(np.mean(heard)) if len(heard) else m.inlet
        n, known = self._of.model.cells, isfinite(m.inlet)
        at = np.full((2 * n + 1, 2 * n), level)
        at[:-1] += np.eye(2 * n)
        X = self._of.physics.start(at[:, 0::2], at[:, 1::2], self._of.now)
        D = X.shape[1]
        T = np.zeros((D + OFFSETS, 2 * n + OFFSETS))
        T[:D, : 2 * n], T[D:, 2 * n :] = (X[:-1] - X[-1]).T, np.eye(OFFSETS)
        P = T @ start_covariance(n, self._start, self._disturbance, inlet_known=known) @ T.T
        own = np.arange(2 * n, D)
        P[own, own] += REST_SD**2
        z = np.concatenate([X[-1], np.zeros(OFFSETS)])
        self.belief = Belief(z, P, np.zeros_like(self.belief.J))
        self._inputs.begin(m.inlet if known else level)
        self._seen, self._coolant, self._available = np.full(n, level), np.full(n, level), np.array(True)
        self._carry, self._line.tangent = {}, None
        self._forced.begin()
        return True

    def _memory(self, row: Floats, dt: float) -> tuple[dict[str, Floats], dict[str, Floats]]:
        return self._of.physics.memory(drive_of(row[None], dt), self._of.now, self._carry or None)

    def _remember(self, row: Floats) -> Memory:
        """Advance the memories of the effects; a memory whose inputs are missing stays as it was."""
        memory, carry = self._memory(row, self._dt)
        if not all(np.isfinite(a).all() for a in (*memory.values(), *carry.values())):
            still = row.copy()
            still[np.isnan(still)] = 0.0
            memory, carry = self._memory(still, self._dt)
        if not len(self._forced.rows):
            self._forced.carries[""] = self._carry
        self._carry = carry
        return memory

    def _predict(self, before: Belief, row: Floats, memory: Memory) -> tuple[Belief, Tangent]:
        rate = self._rates(before.z, row, memory)
        sure = bool(np.isfinite(rate).all())
        if not sure:  # an effect lacks an input: the state is kept, and heat is unknown
            rate = np.zeros_like(rate)
        tangent = self._linear(before.z, row, memory)
        z = before.z + tangent.Gamma @ rate
        z[:-OFFSETS] = np.clip(z[:-OFFSETS], COLDEST, HOTTEST)
        P = tangent.Phi @ before.P @ tangent.Phi.T + tangent.noise(
            bool(self._inputs.known[0]), bool(self._inputs.known[1]) and sure
        )
        return Belief(z, P, tangent.Phi @ before.J + tangent.Gamma @ self._forced.F), tangent

    def _rates(self, z: Floats, row: Floats, memory: Memory, dt: float | None = None) -> Floats:
        """Rates (M,) of the whole state; also stores the coolant temperatures."""
        v = disturbed(self._of.now, z[-OFFSETS:])
        point = self._of.physics.point(z[None, :-OFFSETS], drive_of(row[None], dt or self._dt), v, memory)
        if np.isfinite(point.T_f).all():
            self._coolant = np.array(point.T_f[0])
        heat = float(np.mean((point.core[0] - z[-1]) / v.string.R_e))
        self._effective = heat, float(point.T_in[0, 0] - z[-2] - row[ROW.index("T_in")])
        return np.concatenate([self._of.physics.balances(point, v)[0], -z[-OFFSETS:] / self._disturbance.correlation])

    def _readings(self, z: Floats, row: Floats, memory: Memory, v: Numbers | None = None) -> Floats:
        v = disturbed(v or self._of.now, z[-OFFSETS:])
        seen = self._of.physics.readings(z[None, :-OFFSETS], drive_of(row[None], self._dt), v, memory)[0]
        return np.where(np.isfinite(seen), seen, z[1 : 2 * self._of.model.cells : 2])

    def _linear(self, z: Floats, row: Floats, memory: Memory) -> Tangent:
        """Tangent in force; taken anew if it is out of date."""
        line = self._line
        if line.strayed(z, row[ROW.index("flow")], 2 * self._of.model.cells) or line.tangent is None:
            line.move(z, np.concatenate([self._inputs.usual.mean[0], row[3:]]), memory)
            return self._linearise()
        return line.tangent

    def _linearise(self) -> Tangent:
        """Take Jacobian and slopes at the stored point."""
        line, of = self._line, self._of
        if of.physics.reads:
            here = self._readings(line.at, line.row, line.memory)
            moved = [self._readings(line.at, line.row, line.memory, u.moved(of.now)) for u in of.uncertain]
            self._G = slopes_of_readings(here, moved, of)
        return line.take(of, self._dt, self._disturbance)

    def _rest(self, row: Floats, h: float, phases: float, disturbance: Disturbance, g: Floats) -> Floats:
        """Carry the string over `h` seconds of rest, or of heat with only its intensity `phases` known, W²s.

        The slope of the state by the ln of the flow in the gap, `g` (M,), is carried along and returned.
        """
        self._forced.carries[""] = self._carry
        memory, self._carry = self._memory(row, h)
        b, system = self.belief, System(self._of.physics, drive_of(row[None], h), self._of.now, memory)
        j = jacobian(system, b.z, self._disturbance.correlation)
        rate = np.nan_to_num(self._rates(b.z, row, memory, h))
        faster = row.copy()
        faster[ROW.index("flow")] *= exp(LITTLE)
        by_flow = (np.nan_to_num(self._rates(b.z, faster, memory, h)) - rate) / LITTLE
        if phases:
            equal, j = j.A[:, -1], heated(j, system, b.z)
            rate += (j.A[:, -1] - equal) * b.z[-1]
        t = Tangent.of(j, h, disturbance)
        z = b.z + t.Gamma @ rate
        z[:-OFFSETS] = np.clip(z[:-OFFSETS], COLDEST, HOTTEST)
        P = t.Phi @ b.P @ t.Phi.T + t.noise(False, True) + (unseen_heat(j.A, phases, h)[1] if phases else 0.0)
        F = self._forced.over(row[None], (b.z + z)[None] / 2.0, self._of, h)
        self.belief = Belief(z, (P + P.T) / 2.0, t.Phi @ b.J + t.Gamma @ F)
        return np.asarray(t.Phi @ g + t.Gamma @ by_flow)

    def _estimate(self, r: Floats, r_sd: Floats) -> Estimate:
        n, z, base, of = self._of.model.cells, self.belief.z, self._coolant.copy(), self._of
        at = self._sensors[self._unread <= READ_WITHIN]
        base[at] = z[1 : 2 * n : 2][at]
        found = deviations(self.belief, of.root, base, of.scatter, of.centre, self._lag)
        sd = np.where(self._available, np.stack(found), np.inf)[:, None]
        core, surface = np.where(self._available, z[: 2 * n].reshape(n, 2).T, nan)[:, None]
        e, there = Errors(r, r_sd, np.copy), self._available.reshape(1)
        centre = hottest(core, surface, self._lag, of.centre.value, sd[2], sd[1])
        return Estimate(core, sd[0], surface, sd[1], *centre, e, there)

    def _follow(self, elapsed_s: float) -> None:
        """Advance the profiles within the rolls towards the present difference core to surface."""
        string = self._of.now.string
        tau = time_constant(self._of.centre.value, string.R_c, string.C_c)
        self._lag = self._lag + followed(elapsed_s, tau) * (self._gap(self.belief.z) - self._lag)

    def _gap(self, z: Floats) -> Floats:
        return np.asarray(z[0 : 2 * self._of.model.cells : 2] - z[1 : 2 * self._of.model.cells : 2])
