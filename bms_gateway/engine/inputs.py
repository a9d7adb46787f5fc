"""From decoded samples to the inputs of the estimators at a tick: guarded, scaled, aligned in time.

An *input* is one signal of the bus with its scale and offset. Strings share inputs (one pack current for all). The
wiring from strings to inputs is computed once, so that a tick takes a few numpy passes for any number of cells.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.cell_voltage import CellVoltages, Run
from bms_gateway.engine.current import Current, Means
from bms_gateway.engine.events import Level, Notice
from bms_gateway.engine.line import Line
from bms_gateway.engine.plan import Channel, Plan, StringPlan
from bms_gateway.engine.readings import Layout, Readings
from bms_gateway.engine.reasons import CURRENT_STANDS, REASONS, REPEATED, RIGHT_SIGN, UNKNOWN_MUX, WRONG_SIGN
from bms_gateway.engine.statistics import OneOfSeveral
from bms_gateway.frames.ammeter import Ammeter
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.counter import CounterGuard
from bms_gateway.frames.database import Database
from bms_gateway.frames.decode import decode
from bms_gateway.frames.guard import QUALITIES, Guard
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.rules import default_rule
from bms_gateway.frames.vocabulary import CELL, INPUTS, SLOW, WHOLE, Quantity
from bms_gateway.identify import PairMeans
from bms_gateway.thermal import Floats

# plain integers: numpy takes many times longer to compare with a member of an enumeration
GOOD, ESTIMATED, OUT_OF_RANGE = int(Quality.GOOD), int(Quality.ESTIMATED), int(Quality.OUT_OF_RANGE)
NOT_AVAILABLE, ERROR = int(Quality.NOT_AVAILABLE), int(Quality.ERROR)
ACTIVE_A = 1.0  # mean current of a tick from which on a sensor that never moves is suspicious


@dataclass(frozen=True, slots=True)
class Wire:
    """Where one string's quantities come from: indices of inputs, −1 where there is none.

    Attributes
    ----------
    whole : mapping of Quantity to int
        Inputs of the whole string.
    cells : mapping of Quantity to ndarray of intp (n,)
        Inputs of its cells.
    constants : mapping
        Quantities that the bus does not carry, by name.
    statistics : mapping
        Inputs that are the greatest, least or mean surface of several cells, by which of these.
    """

    whole: Mapping[Quantity, int]
    cells: Mapping[Quantity, NDArray[np.intp]]
    constants: Mapping[Quantity, float] = field(default_factory=dict)
    statistics: Mapping[str, int] = field(default_factory=dict)

    @property
    def current(self) -> int:
        """Input of the current."""
        return self.whole["current"]

    @property
    def voltage(self) -> int:
        """Input of the string's voltage."""
        return self.whole["voltage"]

    @property
    def surface(self) -> NDArray[np.intp]:
        """Inputs of the surfaces."""
        return self.cells["surface"]

    @property
    def cell_voltage(self) -> NDArray[np.intp]:
        """Inputs of the cells' voltages."""
        return self.cells["cell_voltage"]

    def of(self, c: Channel) -> int:
        """Index of the input of a channel; −1 where it is not taken in."""
        return self.input(c.quantity, c.cell) if c.statistic is None else self.statistics.get(c.statistic, -1)

    def input(self, quantity: Quantity, cell: int | None) -> int:
        """Index of the input of a quantity, of a cell where it belongs to one; −1 where there is none."""
        if cell is None:
            return self.whole.get(quantity, -1)
        return int(self.cells[quantity][cell - 1]) if quantity in self.cells else -1


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


@dataclass(frozen=True, slots=True)
class Raw:
    """Everything received of all N cells in a tick, before any guard.

    Attributes
    ----------
    value, time_s : ndarray (N,)
        Newest surface as decoded, °C, and its stamp, s; NaN where none came.
    invalid : ndarray of bool (N,)
        Where a sample came whose sender says "not available" or "error".
    volt : ndarray (N,)
        Newest voltage of the cell, V; NaN where none came.
    """

    value: Floats
    time_s: Floats
    invalid: NDArray[np.bool_]
    volt: Floats


_NOTHING = (
    Samples(np.empty(0, np.int64), np.empty(0, np.intp), np.empty(0), np.empty(0, np.uint8)),
    np.empty(0, np.bool_),
)


def used_inputs(string: StringPlan) -> frozenset[Quantity]:
    """Name the inputs that the estimators of a string take in."""
    special = "effects" if string.model.effects else "cells" if identifies_cells(string) else "all"
    return frozenset(q for q, i in INPUTS.items() if i.used_by in ("all", special))


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
    whole : bool
        Whether to take in all channels of the plan, for a record: also those of which no estimator makes anything.

    Attributes
    ----------
    wires : list of Wire
        One per string.
    can_ids : ndarray of uint32
        Identifiers that carry an input, ascending: the kernel's filter and ours.
    rejected : dict of str to int
        Samples turned away so far, by reason.
    good : tuple of Samples and ndarray of bool
        Samples of the newest tick, and which of them are believed.
    counts : ndarray of int64 (C, 16)
        Samples of each input so far, by `Quality`.
    extremes : ndarray (2, C)
        Least and greatest value of each input so far, believed or not, in the DBC's unit; ±inf before the first.
    """

    def __init__(self, plan: Plan, database: Database, *, whole: bool = False) -> None:
        self._channels: list[Channel] = []
        self._spare: set[int] = set()
        self._names: list[tuple[str, int | None]] = []
        groups: list[int] = []
        index: dict[tuple[str, float, float], int] = {}
        self.wires: list[Wire] = []
        self._several: list[OneOfSeveral] = []
        self._cells_before = 0  # of the strings wired so far
        for string in plan.strings:
            self.wires.append(self._wire(string, index, groups, whole))
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
        inlets = [w.whole["coolant_inlet"] for w in self.wires]
        self._inlets = {i: Line() for i in inlets if i >= 0}
        self._followed = np.zeros(len(signals), np.bool_)
        self._cells = CellVoltages([(w.current, w.cell_voltage) for w in self.wires])
        self._followed[self._cells.inputs] = True
        self._followed[[i for pair in self._currents for i in pair if i >= 0] + list(self._inlets)] = True
        self._number = np.arange(len(signals) + 1)
        # the surfaces of all strings in one row, and which of them are each string's
        self._surface = np.concatenate([w.surface for w in self.wires])
        self._sensed = self._surface >= 0
        # the voltage of a cell; of a string of one cell its own where the cell has none
        self._volts = np.concatenate(
            [w.cell_voltage if len(w.surface) > 1 else np.maximum(w.cell_voltage, w.voltage) for w in self.wires]
        )
        names, cells = [s.name for s in plan.strings], [s.model.cells for s in plan.strings]
        self._parts = Layout.of(names, cells).parts
        # where each string's quantities stand, and what stands for them where the bus does not carry them
        self._current_of = np.array([w.current for w in self.wires], np.intp)
        pairs = list(self._currents)
        self._means_of = np.array([pairs.index((w.current, w.voltage)) if w.current >= 0 else -1 for w in self.wires])
        self._slow = np.array([[w.whole[q] for w in self.wires] for q in SLOW], np.intp)
        self._slow_else = np.array(
            [[nan if INPUTS[q].stands_in == "start" else w.constants.get(q, nan) for w in self.wires] for q in SLOW]
        )
        self._unheard = np.array([[INPUTS[q].stands_in == "unheard"] for q in SLOW])
        self._active = False
        self.good = _NOTHING
        self.counts = np.zeros((len(signals), QUALITIES), np.int64)
        self.extremes = np.array([[np.inf], [-np.inf]]).repeat(len(signals), axis=1)
        self.rejected: dict[str, int] = {}
        # stamps of frames of ticks to come that give no sample, by reason
        self._passed_over = {UNKNOWN_MUX: np.empty(0, np.int64), REPEATED: np.empty(0, np.int64)}

    def _wire(
        self, string: StringPlan, index: dict[tuple[str, float, float], int], groups: list[int], everything: bool
    ) -> Wire:
        whole: dict[Quantity, int] = dict.fromkeys(WHOLE, -1)
        cells: dict[Quantity, NDArray[np.intp]] = {q: np.full(string.model.cells, -1, np.intp) for q in CELL}
        constants: dict[Quantity, float] = {}
        statistics: dict[str, int] = {}
        used = used_inputs(string)
        for c in string.channels:
            if c.signal is None:
                constants[c.quantity] = nan if c.constant is None else c.constant
                continue
            if not everything and c.quantity not in used and not INPUTS[c.quantity].recorded:
                continue
            known = len(index)
            i = index.setdefault((c.signal, c.scale, c.offset), known)
            (self._spare.discard if c.quantity in used else self._spare.add)(i)
            if i == known:
                self._channels.append(c)
                self._names.append((string.name, c.cell))
                groups.append(string.number)
            if c.statistic is not None:
                statistics[c.statistic] = i
                self._several.append(OneOfSeveral(i, c.statistic, self._cells_before + np.array(c.among, np.intp) - 1))
            elif c.cell is None:
                whole[c.quantity] = i
            elif c.quantity in cells:
                cells[c.quantity][c.cell - 1] = i
        self._cells_before += string.model.cells
        return Wire(whole, cells, constants, statistics)

    def wanted(self, frames: FrameBatch) -> FrameBatch:
        """Keep the frames that carry an input; other frames do not count as activity of the battery."""
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
        for extreme, of in zip(self.extremes, (np.fmin, np.fmax), strict=True):
            of.at(extreme, s.signal, s.value)
        for reason, which in ((UNKNOWN_MUX, s.unknown), (REPEATED, repeated)):
            if len(which):
                self._passed_over[reason] = np.concatenate([self._passed_over[reason], frames.time_ns[which]])
        value = s.value * self._scale[s.signal] + self._offset[s.signal]
        samples = Samples(frames.time_ns[s.frame], s.signal, value, flag)
        return samples if not len(repeated) else samples.where(~np.isin(s.frame, repeated))

    def update(self, samples: Samples, t0: int, t1: int, expected: Floats | None = None) -> Readings:
        """Take the samples of one tick [t0, t1); return the readings of the strings, in the order of the plan.

        Parameters
        ----------
        samples : Samples
        t0, t1 : int
        expected : ndarray (N,), optional
            Surfaces that the model last had, °C: which of several cells a reading belongs to.
        """
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
        means, cells = self._integrate(samples, g.quality, t0, t1)
        self.good = samples, g.quality == GOOD
        np.add.at(self.counts, (samples.input, g.quality), 1)
        seen = g.time_ns.take(self._surface)
        y = np.where(self._sensed & (seen >= t0), g.value.take(self._surface), nan)
        age = np.where(np.isfinite(y), (t1 - seen) * 1e-9, 0.0)
        own = np.append(g.channel_quality, np.uint8(ESTIMATED)).take(self._surface)
        for one in self._several:
            at = int(g.time_ns[one.input])
            if at >= t0:
                cell, reading = one.place(float(g.value[one.input]), y, expected)
                if cell >= 0:
                    y[cell], age[cell], own[cell] = reading, (t1 - at) * 1e-9, g.channel_quality[one.input]
        # one more at the end, for index −1: a channel that does not exist
        quality = np.append(g.channel_quality, np.uint8(ESTIMATED))
        known = np.append(np.where(g.channel_quality == GOOD, g.value, nan), nan)
        for i, line in self._inlets.items():
            if quality[i] == GOOD:
                known[i] = line.at(t1)
        slow = known.take(self._slow)
        slow = np.where((self._slow < 0) | (self._unheard & np.isnan(slow)), self._slow_else, slow)
        return Readings(
            np.array([(m.I, m.I2, m.V, m.IV, m.I_abs) for m in (*means, _NO_CURRENT)]).T.take(self._means_of, axis=1),
            quality.take(self._current_of),
            dict(zip(SLOW, slow, strict=True)),
            y,
            age,
            own,
            self._parts,
            cells,
        )

    def raw(self) -> Raw:
        """Give the newest tick's surfaces and cells' voltages as they were decoded."""
        s, n = self.good[0], len(self._channels)
        value, time_s = np.full((2, n + 1), nan)  # one more at the end, for index −1: a channel that does not exist
        told = (s.flag == GOOD) | (s.flag == OUT_OF_RANGE)
        value[s.input[told]], time_s[s.input[told]] = s.value[told], s.time_ns[told] / 1e9
        invalid = np.zeros(n + 1, np.bool_)
        invalid[s.input[(s.flag == NOT_AVAILABLE) | (s.flag == ERROR)]] = True
        at = self._surface
        return Raw(
            value.take(at), time_s.take(at), invalid.take(at) & np.isnan(value.take(at)), value.take(self._volts)
        )

    def stale_s(self) -> Floats:
        """Return the age at which each cell's surface is stale, s; without a sensor the longest of its string."""
        stale = np.array([r.stale_after_ns / 1e9 for r in self._guard.rules] + [0.0])
        own = np.where(self._sensed, stale.take(self._surface), 0.0)
        for part in self._parts:
            own[part] = np.where(self._sensed[part], own[part], own[part].max())
        return own

    def _integrate(
        self, samples: Samples, quality: NDArray[np.uint8], t0: int, t1: int
    ) -> tuple[list[Means], list[PairMeans | None]]:
        """Take the good samples of currents, voltages and inlets; a current that strings share is integrated once.

        What a voltage says against a current is written into `quality`.
        """
        s = samples.sorted_by_input((quality == GOOD) & self._followed.take(samples.input))
        edges = s.input.searchsorted(self._number)
        edge = edges.tolist()

        def of(i: int) -> tuple[NDArray[np.int64], Floats]:
            run = slice(edge[i], edge[i + 1]) if i >= 0 else slice(0)
            return s.time_ns[run], s.value[run]

        currents = {i: of(i) for i, _ in self._currents}
        volts = {u: of(u) for _, u in self._currents}
        for (i, u), meter in self._meters.items():
            meter.update(currents[i][1], volts[u][1])
            if meter.stands_at and len(currents[i][1]):
                currents[i] = self._credible(i, meter, currents[i])
                stands = (samples.input == i) & np.isin(samples.value, meter.stands_at)
                quality[stands & (quality == GOOD)] = Quality.STUCK
            if meter.reversed:
                volts[u] = of(
                    -1
                )  # heat from I²R_e does not depend on the sign of the current, heat from the voltage does
        means = [line.update(*currents[i], *volts[u], t0, t1) for (i, u), line in self._currents.items()]
        for i, inlet in self._inlets.items():
            inlet.update(*of(i))
        self._active = any(m.I2 > ACTIVE_A**2 for m in means)
        cells = self._cells.update(s.time_ns, s.value, edges, currents)
        return means, cells

    def _credible(self, i: int, meter: Ammeter, run: Run) -> Run:
        """Refuse the value at which a current stands while the voltage moves."""
        time_ns, value = run
        # readings between the refused values are still used, but the sensor counts as failed until it has proven
        # otherwise
        self._quality[i] = Quality.STUCK
        keep = ~np.isin(value, meter.stands_at)
        reason = Quality.STUCK.name.lower()
        self.rejected[reason] = self.rejected.get(reason, 0) + int(np.count_nonzero(~keep))
        return time_ns[keep], value[keep]

    def changes(self, t1: int) -> list[Notice]:
        """Report which inputs have become good, or are no longer good, since the last call."""
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
        """Report which currents have the wrong sign, or no longer have it, since the last call."""
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
        """Forget what does not hold after a gap: the last current, the slope of the inlet."""
        for current in self._currents.values():
            current.forget()
        for meter in self._meters.values():
            meter.forget()
        self._cells.forget()
        for inlet in self._inlets.values():
            inlet.forget()
