"""The watch over unexplained heat of strings of equal length: collects ticks to steps, filters, judges and reports.

Ticks of a second are collected to steps of ten: heat acts more slowly, and the filter's covariance is most of the work.
All strings of a group step together, counted in ticks, so that the result does not depend on the batches of frames.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from bms_gateway.errors import ConfigError
from bms_gateway.health.heat import kept
from bms_gateway.health.heat.course import USUAL_S, Course
from bms_gateway.health.heat.fault_evidence import LATE_S, ONE_FAULT_S, Evidence, Kind, Weighed
from bms_gateway.health.heat.filter import HeatFilter, Linear, Step
from bms_gateway.health.heat.finding import Finding, SeenStep
from bms_gateway.health.heat.frozen import alone
from bms_gateway.health.heat.heat_tick import HeatTick
from bms_gateway.health.heat.layout import Bools
from bms_gateway.health.heat.lost_inlet import LostInlet
from bms_gateway.health.heat.many_heats import SURE
from bms_gateway.health.heat.positive import not_cooled
from bms_gateway.health.heat.reading_times import merged, weights
from bms_gateway.health.heat.rest import LONGEST_S, REST_RATE, STRAYED_K, Rest, strides
from bms_gateway.health.heat.standing import SUSPECT
from bms_gateway.health.heat.suspicion import suspicion
from bms_gateway.health.heat.thermocouples import Thermocouples
from bms_gateway.health.heat.told_heat import DOUBTED, Told
from bms_gateway.health.heat.verdict import Verdict
from bms_gateway.thermal import Floats, StringModel, StringParameters

STEP_S = 10.0
SETTLE_S = 300.0
"""s after a start in which nothing is judged: the filter first finds the state."""
SEEN_S = 180.0
"""Age, s, of the heat for which the reported sd holds."""
APART = 0.02  # ln: cells whose identified resistances differ by more must find their state anew
NEWS = 0.15  # ln: a greater change of identified resistances shows that they were not known
AT_CASING, AT_CASING_BESIDE = 0.5, 1.0
"""Sd of the core of a cell with unexplained heat, as a share of its rise over R_c, because fires and heaters heat a
cell from outside. The second number is for cells that warm beside one with more heat."""
COOLS_K_S = 0.003
"""Rate at which a thermocouple of a string at rest falls while its cell still loses the heat of the drive."""
FLOW_GRID = 0.1  # ln: a smaller change of the flow is ignored


def step_of(dt: float) -> float:
    """Length of a step of the watch, s: the multiple of `dt` seconds nearest to `STEP_S`."""
    return max(1, round(STEP_S / dt)) * dt


class Share(Protocol):
    """Influence of the effects of a string's model on its thermocouples; see `EffectShare`."""

    def begin(self, level: float) -> None:
        """Start with all temperatures at `level`, °C."""
        ...

    def pause(self) -> None:
        """Start again after a time without frames."""
        ...

    def course(self, ticks: int) -> Floats:
        """Influence (2 ticks + 1, n), K, of the effects on the thermocouples at the ends of the ticks.

        The step that ends now has `ticks` ticks; those of the previous step come first.
        """
        ...


@dataclass(frozen=True, slots=True)
class _Grid:
    """Steps of the filter in ticks.

    Attributes
    ----------
    tick_s : float
    ticks : int
        Number of ticks in a step.
    merged : ndarray (L, ticks)
        Means over the L intervals of a step.
    """

    tick_s: float
    ticks: int
    merged: Floats

    @classmethod
    def of(cls, tick_s: float) -> "_Grid":
        ticks = round(step_of(tick_s) / tick_s)
        return cls(tick_s, ticks, merged(ticks))


@dataclass(frozen=True, slots=True)
class _Seen:
    """The newest step of S strings.

    Attributes
    ----------
    used : ndarray of bool (S, m)
        Thermocouples whose readings were used.
    gaps : ndarray (S, m), K
        Surface over coolant.
    cools : ndarray of bool (S,)
        All thermocouples fall although little heat is made.
    """

    used: Bools
    gaps: Floats
    cools: Bools


class HeatWatch:
    """Watch over S strings of n cells.

    Parameters
    ----------
    models : sequence of StringModel
        Equal numbers of cells, each with a sensor.
    dt : float, s
        Period of a tick.
    constant_inlet : sequence of bool
        Strings whose inlet is a constant of the configuration.
    shares : sequence of Share
        Of each string, if the models have effects; none by default.
    """

    def __init__(
        self,
        models: Sequence[StringModel],
        dt: float,
        constant_inlet: Sequence[bool] = (),
        shares: Sequence[Share] = (),
    ) -> None:
        self._grid, self._shares = _Grid.of(dt), shares
        self.filter = HeatFilter(models, self._grid.ticks * dt, len(self._grid.merged))
        self.evidence = Evidence(self.filter)
        S, m = len(models), self.filter.at.sensed
        fixed = tuple(constant_inlet) or (False,) * S
        self.course = Course.of(self.filter, fixed)
        self.verdicts = [Verdict(s, self.filter, self.evidence, self.course) for s in range(S)]
        self._age = np.zeros(S)
        self._row, self._nearest = np.arange(S)[:, None], self.filter.at.nearest()
        self._inlet = np.full(S, np.nan)
        self._lost = LostInlet.of(self.filter)
        self._sensors = Thermocouples(S, m)
        self._rest, self._now_ns = Rest.of(S), 0
        self._blind = np.zeros(S, np.bool_)
        self._seen = _Seen(np.ones((S, m), np.bool_), np.zeros((S, m)), np.zeros(S, np.bool_))
        self._ticked: list[HeatTick] = []
        nothing = np.full((S, self.filter.at.cells), np.nan)
        self._first = self.filter.z.copy(), self.filter.P.copy()
        self._nothing = Told(nothing, nothing, nothing, nothing, np.zeros((S, 1)), some=False)
        self.told = self._nothing

    def cores(self, core: Floats, sd: Floats) -> tuple[Floats, Floats]:
        """Cores (S, n), °C, and their sd, K: those of this watch where heat is accepted, else the given ones.

        If another fault is accepted or suspected, its possible change is added to the sd of the given cores.

        The observer's uncertainty of its numbers applies here too. If a core is further above its surface than in the
        observer's estimate, its sd grows in proportion.
        """
        return self.told.cores(core, sd)

    def set_parameters(self, s: int, p: StringParameters) -> None:
        """Use identified numbers of string `s`; if they have changed much, the state is found anew."""
        before = self.filter.parameters(s)
        R_e, R_u = np.log(p.R_e / before.R_e), np.log(p.R_u / before.R_u)
        try:
            self.filter.set_parameters(s, p)
        except ConfigError:  # this flow has no valid coolant model: keep the earlier numbers
            return
        if float(np.ptp(R_e)) > APART or max(abs(float(R_e.mean())), abs(float(R_u.mean()))) > NEWS:
            self._age[s] = 0.0
            self.evidence.forget(s)

    def pass_time(self, gap_s: float | None, *, unseen: bool = False) -> None:
        """Pass over a time without frames: strings at rest continue, others start again.

        Knowledge of cells and sensors, and findings, are kept.

        Parameters
        ----------
        gap_s : float or None
            None if the length is unknown.
        unseen : bool
            The gateway was off and a current may have flowed: a string starts again unless rest explains its readings.
        """
        rest = self._rest
        if gap_s is None or self._shares:
            rest.resting[:] = False
        else:
            rest.sleep(gap_s, len(self._ticked) * self._grid.tick_s)
        self.filter.running &= rest.resting & ~(self.filter.usual.alone & unseen)
        for share in self._shares:
            share.pause()
        self._ticked = []
        self.told = self._nothing
        self._sensors.pause()

    def add(self, now_ns: int, tick: HeatTick) -> list[tuple[int, Finding]] | None:
        """Include a tick; none of its arrays may change afterwards.

        Returns
        -------
        list of (int, Finding) or None
            By string: findings that are new or have ended. None within a step.
        """
        square, current = self._rest.take(tick.square, tick.current, self._least_square, tick.y, self._grid.tick_s)
        self._lost.newest = np.where(np.isfinite(tick.inlet), tick.inlet, self._lost.newest)
        self._ticked.append(tick._replace(square=square, current=current))
        return self._step(now_ns, self._lost.newest, tick.flow) if len(self._ticked) >= self._grid.ticks else None

    @property
    def _least_square(self) -> Floats:
        """Mean square of the current (S,), A², below which no current flows."""
        b = self.filter.balances
        return np.asarray((REST_RATE * b.C / b.R_e).min(axis=1), dtype=np.float64)

    def _heats(self) -> tuple[Floats, Floats, Any]:
        """Heat of the ticks (L, S, n), W, and mean current (S,), A; which strings (S,) had ticks without both."""
        square = np.stack([t.square for t in self._ticked])
        heat = square[:, :, None] * (self.filter.balances.R_e * self.filter.falls)
        known = np.isfinite(heat)
        current = np.stack([t.current for t in self._ticked])
        heat = np.tensordot(self._grid.merged, np.where(known, heat, 0.0), 1)
        return heat, np.where(np.isfinite(current), current, 0.0).mean(axis=0), ~known.all(axis=(0, 2))

    def _step(self, now_ns: int, inlet: Floats, flow: Floats | None) -> list[tuple[int, Finding]]:
        f, self._now_ns = self.filter, now_ns
        sensors = np.s_[:, self._row, f.at.sensors]
        read = np.stack([t.y for t in self._ticked])[sensors]
        ages = np.stack([t.age for t in self._ticked])[sensors]
        (y, R), (heat, current, unknown) = self._sensors.take(read), self._heats()
        self.course.voltage.take(heat.mean(axis=(0, 2)), [t.by_voltage for t in self._ticked], f.dt)
        when = weights(read, ages, self._grid.tick_s, len(self._grid.merged))
        read_inlet = np.asarray(np.isfinite([t.inlet for t in self._ticked]).any(axis=0), np.bool_)
        self._ticked = []
        for place, share in enumerate(self._shares):
            y[place] -= (when[place] * share.course(len(self._grid.merged)).T[f.at.sensors[place]]).sum(axis=1)
        inlet1 = np.where(np.isfinite(inlet), inlet, self._inlet)
        usable: Bools = np.asarray(np.isfinite(y).any(axis=1), np.bool_)
        if self._rest.slept_s and usable.any():
            self._wake(inlet1, y, now_ns)
        new = usable & (~f.running | (self._blind & ~unknown))
        for s in np.flatnonzero(new):
            level = float(np.nanmean(y[s]))
            f.begin(int(s), level)
            if self._shares:
                self._shares[int(s)].begin(level)
            self.evidence.forget(int(s))
            self._age[s] = 0.0
            if inlet1[s] != inlet1[s]:
                inlet1[s] = level
        self._blind = unknown
        if flow is not None:
            for s in np.flatnonzero(
                np.isfinite(flow) & (np.abs(np.log(np.clip(flow, 0.02, 50) / f.flows)) > FLOW_GRID)
            ):
                ratio = float(np.clip(flow[s], 0.02, 50))
                grown = abs(float(np.log(ratio / f.flows[s])))
                try:
                    f.set_flow(int(s), ratio)
                except ConfigError:  # so small a flow has no valid coolant model: keep the earlier flow
                    continue
                f.P[s, f.at.flow, f.at.flow] += (0.5 * grown) ** 2
        inlet1 = np.where(np.isfinite(inlet1), inlet1, 25.0)
        self._lost.hear(f, read_inlet | self.course.constant_inlet, usable)
        self._lost.free(f, self.evidence, self.course)
        inlet0 = np.where(np.isfinite(self._inlet) & ~self._lost.found, self._inlet, inlet1)
        self._inlet = np.where(np.isfinite(inlet) | np.isfinite(self._inlet), inlet1, np.nan)
        heard = f.running & ~unknown
        aside = np.stack([v.aside for v in self.verdicts])
        self.course.hear(inlet1, read_inlet, f.dt)
        self.course.compare(f, f.at.fitted & ~aside, np.stack([v.jumped for v in self.verdicts]))
        off = aside | self._still(aside)
        use = np.where(heard[:, None] & ~off, y, np.nan)
        used = np.isfinite(use)
        f.film = self.course.film
        x = f.step(Step(heat, current, inlet0, inlet1, use, R, when))
        cools = f.calm & (np.where(used, x.rate, -np.inf).max(axis=1) < -COOLS_K_S)
        self._seen = _Seen(used, x.surface - x.coolant, np.asarray(cools, np.bool_))
        self._mend()
        if off.any():
            self._beside(x, y, R)
        self.evidence.take(x, read=bool(usable.any()))
        self._age += f.dt
        w = self.evidence.weigh(None if flow is None else np.isfinite(flow))
        found = self._look(w, heat.mean(axis=0), inlet1, heard, usable, now_ns)
        self.told = self._tell(w)
        quiet = (
            heard
            & ~self._lost.lost
            & (self._age >= SETTLE_S)
            & np.array([not (v.suspects or v.findings) for v in self.verdicts])
        )
        self._sensors.learn(x.nu, x.var, used & quiet[:, None], f.calm, f.dt)
        return found

    def _still(self, aside: Bools) -> Bools:
        """Find thermocouples (S, m), of those that are not set aside, that stand unusually still."""
        still_s = self._sensors.still * self._grid.tick_s
        still = alone(still_s, self.filter.at.fitted & ~aside)
        for v in self.verdicts:
            now = np.where(still[v.s] | aside[v.s], still_s[v.s], 0.0)
            if ((v.still > 0.0) & (now == 0.0) & ~v.aside).any():  # what it read before it stood still is no evidence
                self.evidence.forget(v.s)
                v.pass_over()
            v.still = now
        return still

    def _wake(self, inlet: Floats, y: Floats, now_ns: int) -> None:
        """Go through a sleep that ends with an inlet (S,) and readings (S, m); restart strings that did not rest."""
        f, at, rest = self.filter, self.filter.at, self._rest
        before, after = (np.where(np.isfinite(a), a, b) for a, b in ((self._inlet, inlet), (inlet, self._inlet)))
        before, after = np.nan_to_num(before, nan=25.0), np.nan_to_num(after, nan=25.0)
        S, nothing = at.strings, np.full((at.strings, at.sensed), np.nan)
        zero, whole, passed = np.zeros(S), min(rest.slept_s, LONGEST_S), 0.0
        none, at_end = (
            np.zeros((len(self._grid.merged), S, at.cells)),
            np.zeros((*nothing.shape, 2 * len(self._grid.merged) + 1)),
        )
        at_end[..., -1] = 1.0
        for h in strides(rest.slept_s):
            f.stride(h)
            inlet0, inlet1 = (before + (after - before) * min(1.0, t / whole) for t in (passed, passed + h))
            x = f.step(Step(none, zero, inlet0, inlet1, nothing, nothing, at_end))
            self.evidence.take(x, read=False)
            self._mend()
            passed += h
        f.stride(self._grid.ticks * self._grid.tick_s)
        self._age += whole
        self._inlet = np.where(np.isfinite(self._inlet), after, self._inlet)
        self.course.sleep(rest.slept_s)
        off = y - f.z[self._row, 2 * at.sensors + 1] - f.z[:, at.bias]
        strayed = np.array([np.isfinite(o).any() and abs(float(np.nanmedian(o))) > STRAYED_K for o in off])
        calm = np.array([not v.suspects for v in self.verdicts])  # deviations by a fault are evidence
        f.running &= ~(strayed & ~f.usual.alone & calm) & ~rest.flows
        for v in self.verdicts:
            v.woke_ns = now_ns
        rest.slept_s = 0.0

    def _mend(self) -> None:
        """Start strings again whose numbers are no longer valid by rounding, as the readings of a fire can cause."""
        f = self.filter
        sound = np.isfinite(f.z).all(axis=1) & np.isfinite(f.P).all(axis=(1, 2))
        sound &= (np.einsum("skk->sk", f.P) >= 0.0).all(axis=1)
        for s in np.flatnonzero(~sound).tolist():
            f.z[s], f.P[s] = self._first[0][s], self._first[1][s]
            f.running[s] = False
            self.evidence.forget(s)

    def _beside(self, x: Linear, y: Floats, R: Floats) -> None:
        """Compare the thermocouples that are not used with their predictions."""
        f, at = self.filter, self.filter.at
        row = self._row
        k = 2 * at.sensors + 1
        value = y - (x.mean + f.z[row, k] - x.surface) - f.z[:, at.bias]
        sd = np.sqrt(f.P[row, k, k] + R + 0.1)
        late, loose = -x.rate * LATE_S, x.coolant - x.surface
        for v in self.verdicts:
            v.residuals(value[v.s], sd[v.s], {Kind.LAG: late[v.s], Kind.LOOSE: loose[v.s]})

    def _look(
        self,
        w: Weighed,
        heat: Floats,
        inlet: Floats,
        heard: Bools,
        read: Bools,
        now_ns: int,
    ) -> list[tuple[int, Finding]]:
        new = heard & (self._age < SETTLE_S)
        for s in np.flatnonzero(new):
            self.evidence.forget(int(s))
        settled = heard & ~new & (self._age < SETTLE_S + self.filter.dt)
        for s in np.flatnonzero(settled & self.filter.hot_by_offset()):
            self.filter.unlearn(int(s))
            self.evidence.forget(int(s))
        self.course.forget(new)
        self.course.fine = self._sensors.step
        top = w.ln.max(axis=(1, 2))
        of_note = self.course.take(self.filter, heat, inlet, heard) | (top > SUSPECT)
        of_note |= self._sensors.still.any(axis=1)
        sound = heard & ~new & ~self._lost.lost & np.array([not v.of_string for v in self.verdicts])
        usual = self.evidence.usual(w, self._age > ONE_FAULT_S)
        learnt = np.clip(usual, 0.0, SURE) - self.course.ln
        self.course.ln = self.course.ln + np.where(sound, learnt * (self.filter.dt / USUAL_S), 0.0)
        found = []
        seen, lost = self._seen, self._lost.lost
        for v in self.verdicts:
            v.seen = SeenStep(
                seen.used[v.s], seen.gaps[v.s], bool(seen.cools[v.s]), float(self._age[v.s]), not lost[v.s]
            )
            if not heard[v.s] or new[v.s] or not read[v.s]:
                continue  # without a reading, a finding neither begins nor ends
            if of_note[v.s] or v.findings:
                found += [(v.s, f) for f in v.look(w, now_ns)]
            else:
                v.pass_over()
        return found

    def _tell(self, w: Weighed) -> Told:
        f, at = self.filter, self.filter.at
        S, n = at.strings, at.cells
        heat, sd, core, core_sd = np.full((4, S, n), np.nan)
        h = np.arange(at.heat.start, at.heat.stop)
        seen = np.square(self.evidence.resolution(SEEN_S))
        value, var = f.z[:, h].copy(), f.P[:, h, h] + seen
        top = w.ln.max(axis=(1, 2)) / self.course.doubt
        some = False
        for v in self.verdicts:
            s = v.s
            suspect = top[s] > 6.0
            if not f.running[s] or not (suspect or v.findings):
                continue
            z, P = f.z[s], f.P[s]
            if f.open[s].any():
                z, P = not_cooled(z, P, h[f.open[s]])
                value[s], var[s] = z[h], P[h, h] + seen[s]
            mean, more = z.copy(), np.zeros(at.nodes)
            if suspect:
                _, of_note = suspicion(v, w)
                for onset, fault, chance in of_note:
                    along, a = self.evidence.moved(s, onset, fault), float(w.amplitude[s, onset, fault])
                    mean = mean + chance * a * along
                    spread = chance * (1.0 - chance) * a * a + chance * float(w.var[s, onset, fault])
                    more += spread * np.square(along[: at.nodes])
                    if self.evidence.kinds[fault] == Kind.HEAT:
                        j = int(self.evidence.place[fault])
                        value[s, j] += chance * a
                        var[s, j] += chance * (1.0 - chance) * a * a
                some = some or bool(of_note)
            some, T = True, np.arange(0, at.nodes, 2)
            if not v.leads:
                core_sd[s] = np.sqrt(more[T] + np.square(mean[T] - z[T]))
            else:
                gap = f.usual.gap_sd[s] * (mean[T] - mean[T + 1])
                heats, R_c = f.open[s] & at.seen[s], f.parameters(s).R_c
                here = at.told[s, heats]
                main = {at.told[s, j] for g in v.findings[:1] for j in g.places}
                share = np.where(np.isin(here, list(main)), AT_CASING, AT_CASING_BESIDE)
                gap[here] = np.hypot(gap[here], share * z[h][heats] * R_c[here])
                beside = f.usual.beside_sd[s] * (mean[T + 1] - mean[T + 1][self._nearest[s]])
                core[s], core_sd[s] = mean[T], np.sqrt(P[T, T] + more[T] + np.square(gap) + np.square(beside))
        row, place = at.seen.nonzero()
        running = f.running[row]
        heat[row, at.told[row, place]] = np.where(running, value[row, place], np.nan)
        sd[row, at.told[row, place]] = np.where(running, np.sqrt(var[row, place]), np.nan)
        doubted = np.array([[0.0 if v.hot else DOUBTED] for v in self.verdicts])
        return Told(heat, sd, core, core_sd, doubted, some)

    def snapshot(self) -> dict[str, Any]:
        """Return the state for a restart, as numbers, words and lists; see `kept`."""
        resting = self._rest.resting & self.filter.running & (not self._shares)
        return {
            **kept.numbers(self.filter),
            "now_ns": self._now_ns,
            "readings": self._sensors.snapshot(),
            "rest": [
                kept.at_rest(self.filter, v.s, float(self._age[v.s]), float(self._inlet[v.s])) if resting[v.s] else None
                for v in self.verdicts
            ],
            "found": [kept.found(v) for v in self.verdicts],
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a snapshot of strings like these; a time without frames may follow (`pass_time`).

        Raises
        ------
        KeyError, TypeError, ValueError
            `state` is not such a snapshot, or belongs to other strings.
        """
        kept.take_numbers(self.filter, state)
        self._now_ns = int(state.get("now_ns", 0))
        if "readings" in state:
            self._sensors.restore(state["readings"])
        nothing = [None] * len(self.verdicts)  # states of older versions have none
        for v, rest, found in zip(self.verdicts, state.get("rest", nothing), state.get("found", nothing), strict=True):
            if rest is not None and not self._shares and (told := kept.take_rest(self.filter, v.s, rest)) is not None:
                self._age[v.s], self._inlet[v.s] = told
                self._rest.go_on(v.s)
            kept.take_found(v, found or (), self._now_ns)
