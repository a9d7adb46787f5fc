"""From decoded samples to what the estimators take at a tick: guarded, scaled, aligned in time.

An *input* is one signal of the bus with its scale and offset; strings share inputs (one pack current for all). The
wiring from strings to inputs is worked out once, so that a tick is a few numpy passes however many cells there are.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.current import Current, Means
from bms_gateway.engine.events import Level, Notice
from bms_gateway.engine.line import Line
from bms_gateway.engine.plan import Channel, Plan, StringPlan
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.counter import CounterGuard
from bms_gateway.frames.database import Database
from bms_gateway.frames.decode import decode
from bms_gateway.frames.guard import Guard
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.rules import default_rule
from bms_gateway.thermal import Floats

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


@dataclass(frozen=True, slots=True)
class Wire:
    """Where one string's quantities come from: indices of inputs, −1 where there is none.

    Attributes
    ----------
    surface : ndarray of intp (n,)
    constants : mapping
        Quantities that the bus does not carry, by name.
    """

    current: int
    voltage: int
    coolant_inlet: int
    coolant_flow: int
    surface: NDArray[np.intp]
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

    def of(self, index: int) -> tuple[NDArray[np.int64], Floats]:
        """Pick times and values of one input."""
        mine = self.input == index
        return self.time_ns[mine], self.value[mine]


@dataclass(frozen=True, slots=True)
class Reading:
    """One string at one tick.

    Attributes
    ----------
    means : Means
        Of current and voltage over the tick.
    current_quality : int
    inlet : float
        Coolant inlet at the tick, °C; NaN where unknown.
    flow : float
        m³/s; NaN where unknown.
    y, age : ndarray (n,)
        Surface readings, °C, NaN where none is new and good; seconds between reading and tick.
    quality : ndarray of uint8 (n,)
        Of the surface sensors; `Quality.ESTIMATED` for cells without one.
    """

    means: Means
    current_quality: int
    inlet: float
    flow: float
    y: Floats
    age: Floats
    quality: NDArray[np.uint8]


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
    """

    def __init__(self, plan: Plan, database: Database) -> None:
        self._channels: list[Channel] = []
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
        self._currents = {(w.current, w.voltage): Current() for w in self.wires if w.current >= 0}
        self._inlets = {w.coolant_inlet: Line() for w in self.wires if w.coolant_inlet >= 0}
        self._active = False
        self.rejected: dict[str, int] = {}

    def _wire(self, string: StringPlan, index: dict[tuple[str, float, float], int], groups: list[int]) -> Wire:
        at: dict[str, int] = {}
        surface = np.full(string.model.cells, -1, np.intp)
        constants: dict[str, float] = {}
        for c in string.channels:
            if c.signal is None:
                constants[c.quantity] = nan if c.constant is None else c.constant
                continue
            known = len(index)
            i = index.setdefault((c.signal, c.scale, c.offset), known)
            if i == known:
                self._channels.append(c)
                self._names.append((string.name, c.cell))
                groups.append(string.number)
            if c.quantity == "surface" and c.cell is not None:
                surface[c.cell - 1] = i
            elif c.cell is None:
                at[c.quantity] = i
        return Wire(
            current=at.get("current", -1),
            voltage=at.get("voltage", -1),
            coolant_inlet=at.get("coolant_inlet", -1),
            coolant_flow=at.get("coolant_flow", -1),
            surface=surface,
            constants=constants,
        )

    def wanted(self, frames: FrameBatch) -> FrameBatch:
        """Keep the frames that carry an input; nothing else counts as life on the bus."""
        keep = np.isin(frames.can_id, self.can_ids)
        if keep.all():
            return frames
        return FrameBatch(frames.time_ns[keep], frames.can_id[keep], frames.length[keep], frames.data[keep])

    def decode(self, frames: FrameBatch) -> Samples:
        """Decode all inputs of the next frames; alive counters are followed, so each frame must come once, in order."""
        s = decode(self._table, frames)
        flag = self._counters.update(s)
        value = s.value * self._scale[s.signal] + self._offset[s.signal]
        return Samples(frames.time_ns[s.frame], s.signal, value, flag)

    def update(self, samples: Samples, t0: int, t1: int) -> list[Reading]:
        """Take the samples of one tick [t0, t1).

        Returns
        -------
        list of Reading
            One per string of the plan, in its order.
        """
        g = self._guard.update(samples.time_ns, samples.input, samples.value, samples.flag, t1, self._active)
        for code in np.flatnonzero(g.rejected.any(axis=0)).tolist():
            reason = Quality(code).name.lower()
            self.rejected[reason] = self.rejected.get(reason, 0) + int(g.rejected[:, code].sum())
        good = g.quality == Quality.GOOD
        kept = Samples(samples.time_ns[good], samples.input[good], samples.value[good], samples.flag[good])
        means = {}
        for (current, voltage), line in self._currents.items():
            time, I = kept.of(current)  # noqa: E741
            V_time, V = kept.of(voltage)
            means[current, voltage] = line.update(time, I, V_time, V, t0, t1)
        self._active = any(m.I2 > ACTIVE_A**2 for m in means.values())
        for i, inlet in self._inlets.items():
            inlet.update(*kept.of(i))
        self._quality = g.channel_quality
        age = (t1 - g.time_ns) * 1e-9
        fresh = (g.time_ns >= t0) & (g.time_ns > 0)
        # one row more, for index −1: a channel that does not exist
        value = np.append(np.where(fresh, g.value, nan), nan)
        flow = np.append(np.where(g.channel_quality == Quality.GOOD, g.value, nan), nan)
        age, quality = np.append(age, 0.0), np.append(g.channel_quality, np.uint8(Quality.ESTIMATED))
        readings = []
        for w in self.wires:
            y = value[w.surface]
            readings.append(
                Reading(
                    means.get((w.current, w.voltage), Means()),
                    int(quality[w.current]),
                    self._inlet(w, quality, t1),
                    w.constants.get("coolant_flow", float(flow[w.coolant_flow])),
                    y,
                    np.where(np.isfinite(y), age[w.surface], 0.0),
                    quality[w.surface],
                )
            )
        return readings

    def _inlet(self, w: Wire, quality: NDArray[np.uint8], t1: int) -> float:
        if w.coolant_inlet < 0:
            return w.constants.get("coolant_inlet", nan)
        return self._inlets[w.coolant_inlet].at(t1) if quality[w.coolant_inlet] == Quality.GOOD else nan

    def changes(self, t1: int) -> list[Notice]:
        """Tell which inputs have begun or ceased to be good since the last call."""
        notices = []
        for i in np.flatnonzero(self._quality != self._told).tolist():
            now, before = Quality(int(self._quality[i])), Quality(int(self._told[i]))
            first = before == Quality.NEVER
            if (first or Quality.GOOD in (now, before)) and not (first and now == Quality.GOOD):
                notices.append(self._notice(t1, i, now))
        self._told = self._quality.copy()
        return notices

    def _notice(self, t1: int, i: int, now: Quality) -> Notice:
        c, (string, cell) = self._channels[i], self._names[i]
        what = c.quantity.replace("_", " ") + (f" of cell {cell}" if cell is not None else "")
        if now == Quality.GOOD:
            return Notice(t1, Level.NOTICE, "sensor", f"{what} is good again ({c.signal})", string, cell)
        return Notice(t1, Level.WARNING, "sensor", f"{what} is not used: {REASONS[now]} ({c.signal})", string, cell)

    def forget(self) -> None:
        """Drop what a gap has made worthless: the current held, the slope of the inlet."""
        for current in self._currents.values():
            current.forget()
        for inlet in self._inlets.values():
            inlet.forget()
