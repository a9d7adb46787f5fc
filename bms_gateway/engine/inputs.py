"""From decoded samples to what the estimators take at a tick: guarded, scaled, aligned in time.

An *input* is one signal of the bus with its scale and offset; strings share inputs (one pack current for all). The
wiring from strings to inputs is worked out once, so that a tick is a few numpy passes however many cells there are.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.cell_voltage import CellVoltages, Run
from bms_gateway.engine.current import Current, Means
from bms_gateway.engine.events import Level, Notice
from bms_gateway.engine.line import Line
from bms_gateway.engine.plan import Channel, Plan, StringPlan
from bms_gateway.engine.readings import Layout, Readings
from bms_gateway.frames.ammeter import Ammeter
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.counter import CounterGuard
from bms_gateway.frames.database import Database
from bms_gateway.frames.decode import decode
from bms_gateway.frames.guard import Guard
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.rules import default_rule
from bms_gateway.identify import PairMeans
from bms_gateway.thermal import Floats

# plain integers: numpy takes many times longer to compare with a member of an enumeration
GOOD, ESTIMATED = int(Quality.GOOD), int(Quality.ESTIMATED)
# What the estimators take in; single cells' voltages where these are identified, the charge where an effect needs it.
USED = frozenset({"current", "voltage", "coolant_inlet", "coolant_flow", "surface"})
USED_BY_EFFECTS = USED | {"soc"}
USED_BY_CELLS = USED | {"cell_voltage"}
RECORDED = frozenset({"soc"})
"""Decoded and guarded in any case, for the record of recent signals; nobody is told of what nothing is made of."""
ACTIVE_A = 1.0  # mean current of a tick above which a sensor that never moves is suspicious

REASONS = {
    Quality.STALE: "nothing new is received",
    Quality.OUT_OF_RANGE: "out of its plausible range",
    Quality.NOT_AVAILABLE: "its sender says not available",
    Quality.ERROR: "its sender says that the sensor failed, or the frame is too short",
    Quality.STUCK: "it stands still while current flows and its neighbours move",
    Quality.OPEN: "at its upper rail, as a broken wire reads",
    Quality.SHORT: "at its lower rail, as a short circuit reads",
    Quality.JUMPY: "it jumps faster than a cell can",
    Quality.COUNTER: "the alive counter of its frame is wrong",
    Quality.CRC: "the check sum of its frame is wrong",
    Quality.NEVER: "not yet seen to move",
}
UNKNOWN_MUX, REPEATED = "unknown_multiplexer", "repeated"
CURRENT_STANDS = "it stands at {} A while the voltage moves: stuck, saturated or clipped"
WRONG_SIGN = "current and voltage rise together: the sign of the current is wrong (scale = -1 in its entry turns it)"
RIGHT_SIGN = "current and voltage move against each other again, as they should"


@dataclass(frozen=True, slots=True)
class Wire:
    """Where one string's quantities come from: indices of inputs, −1 where there is none.

    Attributes
    ----------
    surface, cell_voltage : ndarray of intp (n,)
    constants : mapping
        Quantities that the bus does not carry, by name.
    """

    current: int
    voltage: int
    coolant_inlet: int
    coolant_flow: int
    soc: int
    surface: NDArray[np.intp]
    cell_voltage: NDArray[np.intp]
    constants: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Samples:
    """Decoded samples in the order of the bus."""

    time_ns: NDArray[np.int64]
    input: NDArray[np.intp]
    value: Floats
    flag: NDArray[np.uint8]

    def between(self, start: int, stop: int) -> "Samples":
        """Take samples start…stop − 1."""
        return Samples(self.time_ns[start:stop], self.input[start:stop], self.value[start:stop], self.flag[start:stop])

    def where(self, chosen: NDArray[np.bool_]) -> "Samples":
        """Take the chosen samples."""
        return Samples(self.time_ns[chosen], self.input[chosen], self.value[chosen], self.flag[chosen])

    def sorted_by_input(self, chosen: NDArray[np.bool_]) -> "Samples":
        """Take the chosen samples input by input, each in the order of the bus."""
        at = chosen.nonzero()[0]
        at = at.take(self.input.take(at).argsort(kind="stable"))
        return Samples(self.time_ns.take(at), self.input.take(at), self.value.take(at), self.flag.take(at))


_NOTHING = (
    Samples(np.empty(0, np.int64), np.empty(0, np.intp), np.empty(0), np.empty(0, np.uint8)),
    np.empty(0, np.bool_),
)


def identifies_cells(string: StringPlan) -> bool:
    """Whether the string's cells are told apart by their voltages."""
    return string.identify == "window" and string.model.cells > 1 and not string.model.effects


_NO_CURRENT = Means()


class Inputs:
    """All inputs of a plan: compiled, guarded, integrated.

    Parameters
    ----------
    plan : Plan
    database : Database
        Ours and the user's.

    Attributes
    ----------
    wires : list of Wire
        One per string.
    can_ids : ndarray of uint32
        Identifiers that carry an input, ascending: the kernel's filter and ours.
    rejected : dict of str to int
        Samples turned away so far, by reason.
    good : tuple of Samples and ndarray of bool
        Samples of the newest tick, and which of them the guard let pass.
    """

    def __init__(self, plan: Plan, database: Database) -> None:
        self._channels: list[Channel] = []
        self._spare: set[int] = set()
        self._names: list[tuple[str, int | None]] = []
        groups: list[int] = []
        index: dict[tuple[str, float, float], int] = {}
        self.wires: list[Wire] = []
        for string in plan.strings:
            self.wires.append(self._wire(string, index, groups))
        signals = [c.signal or "" for c in self._channels]
        self._table = database.compile(signals)
        self.can_ids = self._table.can_ids
        self._scale = np.array([c.scale for c in self._channels])
        self._offset = np.array([c.offset for c in self._channels])
        self._guard = Guard(
            [
                default_rule(c.quantity, database.resolve(signal), c.scale, c.offset, group)
                for c, signal, group in zip(self._channels, signals, groups, strict=True)
            ]
        )
        self._counters = CounterGuard(self._table)
        self._quality = np.full(len(signals), Quality.NEVER, np.uint8)
        self._told = self._quality.copy()
        self._heard = np.zeros(len(signals), np.bool_)
        self._currents = {(w.current, w.voltage): Current() for w in self.wires if w.current >= 0}
        self._meters = {
            (i, u): Ammeter(abs(self._channels[u].scale) * database.resolve(signals[u]).resolution)
            for i, u in self._currents
            if u >= 0
        }
        self._reversed: set[int] = set()
        self._inlets = {w.coolant_inlet: Line() for w in self.wires if w.coolant_inlet >= 0}
        self._followed = np.zeros(len(signals), np.bool_)
        self._cells = CellVoltages([(w.current, w.cell_voltage) for w in self.wires])
        self._followed[self._cells.inputs] = True
        self._followed[[i for pair in self._currents for i in pair if i >= 0] + list(self._inlets)] = True
        self._number = np.arange(len(signals) + 1)
        # the surfaces of all strings in one row, and which of them are each string's
        self._surface = np.concatenate([w.surface for w in self.wires])
        self._sensed = self._surface >= 0
        names, cells = [s.name for s in plan.strings], [s.model.cells for s in plan.strings]
        self._parts = Layout.of(names, cells).parts
        # where each string's quantities stand, and what stands for them where the bus does not carry them
        self._current_of = np.array([w.current for w in self.wires], np.intp)
        pairs = list(self._currents)
        self._means_of = np.array([pairs.index((w.current, w.voltage)) if w.current >= 0 else -1 for w in self.wires])
        self._inlet_of = np.array([w.coolant_inlet for w in self.wires], np.intp)
        self._flow_of = np.array([w.coolant_flow for w in self.wires], np.intp)
        self._soc_of = np.array([w.soc for w in self.wires], np.intp)
        self._inlet_else, self._flow_else = (
            np.array([w.constants.get(name, nan) for w in self.wires]) for name in ("coolant_inlet", "coolant_flow")
        )
        self._active = False
        self.good = _NOTHING
        self.rejected: dict[str, int] = {}
        # stamps of frames of ticks to come that give no sample, by reason
        self._passed_over = {UNKNOWN_MUX: np.empty(0, np.int64), REPEATED: np.empty(0, np.int64)}

    def _wire(self, string: StringPlan, index: dict[tuple[str, float, float], int], groups: list[int]) -> Wire:
        at: dict[str, int] = {}
        surface, cell_voltage = np.full((2, string.model.cells), -1, np.intp)
        constants: dict[str, float] = {}
        used = USED_BY_EFFECTS if string.model.effects else USED_BY_CELLS if identifies_cells(string) else USED
        for c in string.channels:
            if c.signal is None:
                constants[c.quantity] = nan if c.constant is None else c.constant
                continue
            if c.quantity not in used | RECORDED:
                continue
            known = len(index)
            i = index.setdefault((c.signal, c.scale, c.offset), known)
            (self._spare.discard if c.quantity in used else self._spare.add)(i)
            if i == known:
                self._channels.append(c)
                self._names.append((string.name, c.cell))
                groups.append(string.number)
            if c.quantity == "surface" and c.cell is not None:
                surface[c.cell - 1] = i
            elif c.quantity == "cell_voltage" and c.cell is not None:
                cell_voltage[c.cell - 1] = i
            elif c.cell is None:
                at[c.quantity] = i
        return Wire(
            current=at.get("current", -1),
            voltage=at.get("voltage", -1),
            coolant_inlet=at.get("coolant_inlet", -1),
            coolant_flow=at.get("coolant_flow", -1),
            soc=at.get("soc", -1),
            surface=surface,
            cell_voltage=cell_voltage,
            constants=constants,
        )

    def wanted(self, frames: FrameBatch) -> FrameBatch:
        """Keep the frames that carry an input; nothing else counts as life on the bus."""
        at = self.can_ids.searchsorted(frames.can_id)
        keep = (self.can_ids.take(at, mode="clip") == frames.can_id).nonzero()[0]
        if len(keep) == len(frames):
            return frames
        return FrameBatch(
            frames.time_ns.take(keep),
            frames.can_id.take(keep),
            frames.length.take(keep),
            frames.data.take(keep, axis=0),
        )

    def decode(self, frames: FrameBatch) -> Samples:
        """Decode all inputs of the next frames; alive counters are followed, so each frame must come once, in order."""
        s = decode(self._table, frames)
        flag, repeated = self._counters.follow(s)
        for reason, which in ((UNKNOWN_MUX, s.unknown), (REPEATED, repeated)):
            if len(which):
                self._passed_over[reason] = np.concatenate([self._passed_over[reason], frames.time_ns[which]])
        value = s.value * self._scale[s.signal] + self._offset[s.signal]
        samples = Samples(frames.time_ns[s.frame], s.signal, value, flag)
        return samples if not len(repeated) else samples.where(~np.isin(s.frame, repeated))

    def update(self, samples: Samples, t0: int, t1: int) -> Readings:
        """Take the samples of one tick [t0, t1); what they say of the strings, in the order of the plan."""
        self._heard[samples.input] = True
        g = self._guard.update(samples.time_ns, samples.input, samples.value, samples.flag, t1, self._active)
        rejected = g.rejected.sum(axis=0)
        for code in rejected.nonzero()[0].tolist():
            reason = Quality(code).name.lower()
            self.rejected[reason] = self.rejected.get(reason, 0) + int(rejected[code])
        for reason, stamps in self._passed_over.items():
            if count := int(np.searchsorted(stamps, t1)):
                self.rejected[reason] = self.rejected.get(reason, 0) + count
                self._passed_over[reason] = stamps[count:]
        self._quality = g.channel_quality
        self.good = samples, g.quality == GOOD
        means, cells = self._integrate(*self.good, t0, t1)
        seen = g.time_ns.take(self._surface)
        y = np.where(self._sensed & (seen >= t0), g.value.take(self._surface), nan)
        # one more at the end, for index −1: a channel that does not exist
        quality = np.append(g.channel_quality, np.uint8(ESTIMATED))
        known = np.append(np.where(g.channel_quality == GOOD, g.value, nan), nan)
        inlet = np.full(len(known), nan)
        for i, line in self._inlets.items():
            if quality[i] == GOOD:
                inlet[i] = line.at(t1)
        flow = known.take(self._flow_of)
        return Readings(
            np.array([(m.I, m.I2, m.V, m.IV, m.I_abs) for m in (*means, _NO_CURRENT)]).T.take(self._means_of, axis=1),
            quality.take(self._current_of),
            np.where(self._inlet_of < 0, self._inlet_else, inlet.take(self._inlet_of)),
            np.where(np.isnan(flow), self._flow_else, flow),
            known.take(self._soc_of),
            y,
            np.where(np.isfinite(y), (t1 - seen) * 1e-9, 0.0),
            quality.take(self._surface),
            self._parts,
            cells,
        )

    def _integrate(
        self, samples: Samples, good: NDArray[np.bool_], t0: int, t1: int
    ) -> tuple[list[Means], list[PairMeans | None]]:
        """Take the good samples of currents, voltages and inlets; a current that strings share is integrated once."""
        s = samples.sorted_by_input(good & self._followed.take(samples.input))
        edges = s.input.searchsorted(self._number)
        edge = edges.tolist()

        def of(i: int) -> tuple[NDArray[np.int64], Floats]:
            run = slice(edge[i], edge[i + 1]) if i >= 0 else slice(0)
            return s.time_ns[run], s.value[run]

        currents = {i: of(i) for i, _ in self._currents}
        volts = {u: of(u) for _, u in self._currents}
        for (i, u), meter in self._meters.items():
            meter.update(currents[i][1], volts[u][1])
            currents[i] = self._credible(i, meter, currents[i])
            if meter.reversed:
                volts[u] = of(-1)  # heat from I²R_e has no sign, that from the voltage has
        means = [line.update(*currents[i], *volts[u], t0, t1) for (i, u), line in self._currents.items()]
        for i, inlet in self._inlets.items():
            inlet.update(*of(i))
        self._active = any(m.I2 > ACTIVE_A**2 for m in means)
        cells = self._cells.update(s.time_ns, s.value, edges, currents)
        return means, cells

    def _credible(self, i: int, meter: Ammeter, run: Run) -> Run:
        """Turn away the value at which a current stands though the voltage moves."""
        time_ns, value = run
        if not meter.stands_at or not len(value):
            return run
        # what is between its ends is still read, but the sensor counts as failed until it has shown that it is not
        self._quality[i] = Quality.STUCK
        keep = ~np.isin(value, meter.stands_at)
        reason = Quality.STUCK.name.lower()
        self.rejected[reason] = self.rejected.get(reason, 0) + int(np.count_nonzero(~keep))
        return time_ns[keep], value[keep]

    def changes(self, t1: int) -> list[Notice]:
        """Tell which inputs have begun or ceased to be good since the last call."""
        notices = []
        for i in np.flatnonzero(self._quality != self._told).tolist():
            if i in self._spare:
                continue
            now, before = Quality(int(self._quality[i])), Quality(int(self._told[i]))
            first = before == Quality.NEVER
            if (first or Quality.GOOD in (now, before)) and not (first and now == Quality.GOOD):
                notices.append(self._notice(t1, i, now))
        self._told = self._quality.copy()
        return notices + self._signs(t1)

    def _signs(self, t1: int) -> list[Notice]:
        """Tell which currents have begun or ceased to have the wrong sign."""
        now = {i for (i, _), meter in self._meters.items() if meter.reversed}
        notices = [
            Notice(
                t1,
                Level.WARNING if i in now else Level.NOTICE,
                "current_sign",
                f"{WRONG_SIGN if i in now else RIGHT_SIGN} ({self._channels[i].signal})",
                self._names[i][0],
            )
            for i in sorted(now ^ self._reversed)
        ]
        self._reversed = now
        return notices

    def _notice(self, t1: int, i: int, now: Quality) -> Notice:
        c, (string, cell) = self._channels[i], self._names[i]
        what = c.quantity.replace("_", " ") + (f" of cell {cell}" if cell is not None else "")
        if now == Quality.GOOD:
            return Notice(t1, Level.NOTICE, "sensor", f"{what} is good again ({c.signal})", string, cell)
        why = REASONS[now]
        if c.quantity == "current" and now == Quality.STUCK:
            stands = next(m.stands_at for (current, _), m in self._meters.items() if current == i)
            why = CURRENT_STANDS.format(" and ".join(f"{amps:g}" for amps in stands))
        return Notice(t1, Level.WARNING, "sensor", f"{what} is not used: {why} ({c.signal})", string, cell)

    def faults(self) -> list[tuple[str, Channel, Quality]]:
        """List inputs once received and not good now: the string that first names each, its channel, its quality."""
        bad = set(np.flatnonzero((self._quality != GOOD) & (self._quality != Quality.NEVER)).tolist()) - self._spare
        return [(self._names[i][0], self._channels[i], Quality(int(self._quality[i]))) for i in sorted(bad)]

    def unheard(self) -> dict[str, str]:
        """Tell of which inputs no sample ever came, by string, as text."""
        missing: dict[str, list[str]] = {}
        for i in np.flatnonzero(~self._heard).tolist():
            if self._channels[i].quantity == "cell_voltage" or i in self._spare:
                continue  # our own DBC always has them; few buses carry them
            missing.setdefault(self._names[i][0], []).append(self._channels[i].signal or "")
        return {name: ", ".join(signals) for name, signals in missing.items()}

    def forget(self) -> None:
        """Drop what a gap has made worthless: the current held, the slope of the inlet."""
        for current in self._currents.values():
            current.forget()
        for meter in self._meters.values():
            meter.forget()
        self._cells.forget()
        for inlet in self._inlets.values():
            inlet.forget()
