"""From decoded samples to the inputs of the estimators at a tick: guarded, scaled, at the same instant."""

from math import nan

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.both_ways import BothWays
from bms_gateway.engine.current import Means
from bms_gateway.engine.events import Notice
from bms_gateway.engine.input_news import Fault, InputNews
from bms_gateway.engine.integrals import Integrals
from bms_gateway.engine.places import Places
from bms_gateway.engine.plan import Channel, Plan
from bms_gateway.engine.readings import Assigned, Readings
from bms_gateway.engine.reasons import REPEATED, UNKNOWN_MUX
from bms_gateway.engine.samples import Raw, Samples
from bms_gateway.engine.wiring import Wire, Wiring
from bms_gateway.frames.ammeter import Ammeter
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.counter import CounterGuard
from bms_gateway.frames.database import Database
from bms_gateway.frames.decode import decode
from bms_gateway.frames.freshness import ROUNDS
from bms_gateway.frames.guard import QUALITIES, Guard, GuardResult
from bms_gateway.frames.j1939 import Senders
from bms_gateway.frames.own_dbc import OWN_DBC
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.rules import default_rule
from bms_gateway.frames.signal_info import Switch
from bms_gateway.thermal import Floats

# plain integers: comparing with a member of an enumeration takes numpy many times longer
GOOD, ESTIMATED, OUT_OF_RANGE = int(Quality.GOOD), int(Quality.ESTIMATED), int(Quality.OUT_OF_RANGE)
NOT_AVAILABLE, ERROR = int(Quality.NOT_AVAILABLE), int(Quality.ERROR)
_NOTHING = (
    Samples(np.empty(0, np.int64), np.empty(0, np.intp), np.empty(0), np.empty(0, np.uint8)),
    np.empty(0, np.bool_),
)


_NO_CURRENT = Means()


class Inputs:
    """All inputs of a plan: compiled, guarded, integrated.

    Parameters
    ----------
    plan : Plan
    database : Database
        Ours and the user's.
    whole : bool
        Whether to use all channels of the plan, for a record: also those without an estimator.

    Attributes
    ----------
    wires : list of Wire
        One per string.
    can_ids : ndarray of uint32
        Identifiers that carry an input, ascending: the kernel's filter and ours.
    rejected : dict of str to int
        Refused samples so far, by reason.
    good : tuple of Samples and ndarray of bool
        Samples of the newest tick, and which of them the guard has accepted.
    counts : ndarray of int64 (C, 16)
        Samples of each input so far, by `Quality`.
    extremes : ndarray (2, C)
        Least and greatest value of each decoded signal so far, used or refused, in the DBC's unit, without values that
        mean "not available" or "error"; ±inf before the first. The first C are those of the inputs.
    both_ways : BothWays
        Currents that two signals carry.
    """

    def __init__(self, plan: Plan, database: Database, *, whole: bool = False) -> None:
        self._wiring = Wiring.of(plan, everything=whole)
        self.wires: list[Wire] = self._wiring.wires
        decoded = self._wiring.decoded
        signals = [c.signal or "" for c, _ in decoded]
        self._table = database.compile(signals)
        self.can_ids = self._table.can_ids
        groups = {m.can_id for m in database.messages.values() if m.any_sender and m.database != OWN_DBC}
        self.senders = Senders(groups.intersection(self.can_ids.tolist()), groups)
        self._scale = np.array([c.scale for c, _ in decoded])
        self._offset = np.array([c.offset for c, _ in decoded])
        rules = []
        turns: dict[tuple[str, tuple[Switch, ...]], int] = {}  # a message may have thousands of multiplexed signals
        for (c, i), path in zip(decoded, signals, strict=True):
            signal = database.resolve(path)
            if (part := (signal.message, signal.mux)) not in turns:
                message = database.message(signal.message)
                # by our own DBC all parts come in each cycle
                turns[part] = 1 if message.database == OWN_DBC else message.turns(signal)
            rules.append(default_rule(c.quantity, signal, c.scale, c.offset, self._wiring.groups[i], turns[part]))
        self.both_ways, rules = BothWays.of([i for _, i in decoded], rules)
        self._guard = Guard(rules)
        self._counters = CounterGuard(self._table)
        steps = [abs(c.scale) * database.resolve(c.signal or "").resolution for c in self._wiring.channels]
        self._integrals = Integrals(self.wires, steps)
        due_ns = [max(r.stale_after_ns, ROUNDS * r.round_ns) for r in rules]
        self._news = InputNews(self._wiring, self._integrals.meters, np.array(due_ns, np.int64))
        self._places = Places.of(plan, self.wires, self._integrals.pairs)
        self.good = _NOTHING
        self.counts = np.zeros((len(rules), QUALITIES), np.int64)
        self.extremes = np.array([[np.inf], [-np.inf]]).repeat(len(signals), axis=1)
        self.rejected: dict[str, int] = {}
        # stamps of the collected frames without a sample, by reason
        self._passed_over = {UNKNOWN_MUX: np.empty(0, np.int64), REPEATED: np.empty(0, np.int64)}

    def wanted(self, frames: FrameBatch) -> FrameBatch:
        """Keep the frames that carry an input; other frames are no activity of the battery."""
        frames = self.senders.named(frames)
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
        """Decode all inputs of the next frames; alive counters are checked, so each frame must come once, in order."""
        s = decode(self._table, frames)
        flag, repeated = self._counters.follow(s)
        measured = (flag != NOT_AVAILABLE) & (flag != ERROR)
        for extreme, of in zip(self.extremes, (np.fmin, np.fmax), strict=True):
            of.at(extreme, s.signal[measured], s.value[measured])
        for reason, which in ((UNKNOWN_MUX, s.unknown), (REPEATED, repeated)):
            if len(which):
                self._passed_over[reason] = np.concatenate([self._passed_over[reason], frames.time_ns[which]])
        value = s.value * self._scale[s.signal] + self._offset[s.signal]
        samples, frame = Samples(frames.time_ns[s.frame], s.signal, value, flag), s.frame
        if len(repeated):
            once = ~np.isin(frame, repeated)
            samples, frame = samples.where(once), frame[once]
        return self.both_ways.join(samples, frame) if self.both_ways.pairs else samples

    def update(self, samples: Samples, t0: int, t1: int, expected: Floats | None = None) -> Readings:
        """Use the samples of one tick [t0, t1); return the readings of the strings, in the order of the plan.

        Parameters
        ----------
        samples : Samples
        t0, t1 : int
        expected : ndarray (N,), optional
            Last surfaces of the model, °C; they decide to which of several cells a reading belongs.
        """
        self._news.heard[samples.input] = True
        self._news.waited_ns += t1 - t0
        g = self._guard.update(samples.time_ns, samples.input, samples.value, samples.flag, t1, self._integrals.active)
        rejected = g.rejected.sum(axis=0)
        for code in rejected.nonzero()[0].tolist():
            self._reject(Quality(code).name.lower(), int(rejected[code]))
        for reason, stamps in self._passed_over.items():
            if count := int(np.searchsorted(stamps, t1)):
                self._reject(reason, count)
                self._passed_over[reason] = stamps[count:]
        self._news.quality, self._news.held = g.channel_quality, g.held
        means, cells = self._integrals.update(samples, g.quality, g.channel_quality, t0, t1)
        if self._integrals.refused:
            self._reject(Quality.STUCK.name.lower(), self._integrals.refused)
        self.good = samples, g.quality == GOOD
        np.add.at(self.counts, (samples.input, g.quality), 1)
        at = self._places
        seen = g.time_ns.take(at.surface)
        y = np.where(at.sensed & (seen >= t0), g.value.take(at.surface), nan)
        age = np.where(np.isfinite(y), (t1 - seen) * 1e-9, 0.0)
        own = np.append(g.channel_quality, np.uint8(ESTIMATED)).take(at.surface)
        several = self._assign(g, (y, age, own), expected, t0, t1) if self._wiring.several else None
        # one more at the end, for index −1: a channel that does not exist
        quality = np.append(g.channel_quality, np.uint8(ESTIMATED))
        known = np.append(np.where(g.channel_quality == GOOD, g.value, nan), nan)
        for i, line in self._integrals.inlets.items():
            if quality[i] == GOOD:
                known[i] = line.at(t1)
        return Readings(
            np.array([(m.I, m.I2, m.V, m.IV, m.I_abs) for m in (*means, _NO_CURRENT)]).T.take(at.means, axis=1),
            quality.take(at.current),
            at.slow(known),
            y,
            age,
            own,
            at.parts,
            cells,
            several,
        )

    def _assign(
        self, g: GuardResult, into: tuple[Floats, Floats, NDArray[np.uint8]], expected: Floats | None, t0: int, t1: int
    ) -> Assigned:
        """Put readings of one of several cells `into` surfaces, ages and qualities (N,); return where."""
        y, age, own = into
        source, said = np.zeros(len(y), np.int8), np.full(len(y), nan)
        for one in self._wiring.several:
            stamp, value = int(g.time_ns[one.input]), float(g.value[one.input])
            if stamp >= t0:
                cell, reading = one.place(value, y, expected)
                if cell >= 0:
                    y[cell], age[cell], own[cell] = reading, (t1 - stamp) * 1e-9, g.channel_quality[one.input]
                    source[cell], said[cell] = one.number, value
        return source, said

    def raw(self) -> Raw:
        """Return the newest tick's surfaces and cell voltages as decoded."""
        s, n = self.good[0], len(self._wiring.channels)
        value, time_s = np.full((2, n + 1), nan)  # one more at the end, for index −1: a channel that does not exist
        told = (s.flag == GOOD) | (s.flag == OUT_OF_RANGE)
        value[s.input[told]], time_s[s.input[told]] = s.value[told], s.time_ns[told] / 1e9
        invalid = np.zeros(n + 1, np.bool_)
        invalid[s.input[(s.flag == NOT_AVAILABLE) | (s.flag == ERROR)]] = True
        at = self._places.surface
        return Raw(
            value.take(at), time_s.take(at), invalid.take(at) & np.isnan(value.take(at)), value.take(self._places.volts)
        )

    def stale_s(self) -> Floats:
        """Age, s, at which each cell's surface is stale; for a cell without a sensor, the longest of its string."""
        at = self._places
        stale = np.array([r.stale_after_ns / 1e9 for r in self._guard.rules] + [0.0])
        own = np.where(at.sensed, stale.take(at.surface), 0.0)
        for part in at.parts:
            own[part] = np.where(at.sensed[part], own[part], own[part].max())
        return own

    def _reject(self, reason: str, count: int) -> None:
        self.rejected[reason] = self.rejected.get(reason, 0) + count

    def changes(self, t1: int) -> list[Notice]:
        """Report which inputs have become good, or are no longer good, since the last call."""
        return self._news.changes(t1)

    def compared(self) -> list[tuple[str, Channel, Ammeter]]:
        """List the currents that a voltage checks: the first string with each, its channel, the comparison."""
        return self._news.compared()

    def ammeter(self, wire: Wire) -> Ammeter | None:
        """Return the comparison of a string's current with its voltage; None if it lacks one of them."""
        return self._integrals.meters.get((wire.current, wire.voltage))

    def faults(self) -> list[Fault]:
        """List inputs that came and are not good now."""
        return self._news.faults()

    def unheard(self) -> dict[str, str]:
        """List the inputs without any sample, by string, as text."""
        return self._news.unheard()

    def missed(self) -> dict[str, str]:
        """List the inputs that should have had a sample by now and had none, by string, as text."""
        return self._news.missed()

    def newly_missed(self) -> dict[str, str]:
        """List those of `missed` that are new since the last call."""
        return self._news.newly_missed()

    def forget(self) -> None:
        """Discard what is no longer valid after a gap: the last current and the slope of the inlet."""
        self._integrals.forget()
