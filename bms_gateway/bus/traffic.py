"""Makes the frames that a battery management system would send for measured or simulated quantities.

Every message is sent at the cycle time of its DBC, a multiplexed one once per cycle and multiplexer value. All messages
are spread over the cycle as on a real bus. Each value is that at the frame's own time stamp.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.engine.plan import Channel, Plan, StringPlan
from bms_gateway.engine.statistics import statistic_of
from bms_gateway.errors import UsageError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.database import Database
from bms_gateway.frames.encode import LARGEST_BITS, Encoder, not_available
from bms_gateway.frames.signal_info import SignalInfo
from bms_gateway.frames.vocabulary import INPUTS
from bms_gateway.identify.sensor_noise import resolution
from bms_gateway.thermal import Floats

SECOND = 1_000_000_000
# Where a DBC states no cycle time. Current must be denser than the estimator's tick, its square is what heats.
ELECTRICAL_NS, OTHER_NS = SECOND // 10, SECOND
# A column without a value for this time, and for this number of its usual intervals, has a hole: no values are
# interpolated there.
HOLE_S, HOLE_INTERVALS = 10.0, 10.0
ASIDE = ("voltage", "soc", "flow")
"""Quantities that, in a hole of a table, do not suppress their frame if they can be sent out of range."""
HELD_INTERVALS, LONGEST_LINE_S = 2.5, 600.0
"""A current or voltage is held over blank rows for at most this number of its own intervals; a temperature is
interpolated over them for at most this number of seconds."""
EDGE_S = 1e-6  # width of a step in a series: below any time stamp that matters
SAME_CURRENT = 0.01  # share of the greatest current, up to which two readings are of one level
CHUNK_S = 600
COARSE_K, OFTEN_SAME, SAME_STEP, LEAST_ROWS = 0.05, 0.1, 1e-3, 30
"""A sensor counts in steps of the first number, K, and more, if the share of values equal to the one before exceeds the
second, and each value is a whole number of steps, to the third, from the first value; so many rows show it."""

Key = tuple[str, int | None]
"""A quantity of a string, and the cell (from 1) where it has one."""


@dataclass(frozen=True, slots=True)
class Series:
    """One quantity over time: straight lines between points, steps as two points that almost coincide.

    Attributes
    ----------
    time_s : ndarray (K,)
        Increasing.
    value : ndarray (K,)
        SI, °C; no NaN.
    hole_s : float
        Between points further apart than this the value is unknown.
    blanks : ndarray (H, 2), s
        Between these instants the value is unknown: rows say that it was not read.
    coarse : bool
        Values are those of the nearest point: lines would hide that the sensor counts in coarse steps.
    """

    time_s: Floats
    value: Floats
    hole_s: float = np.inf
    blanks: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    coarse: bool = False

    def at(self, t: Floats) -> Floats:
        """Value at the instants `t` (N,); NaN in holes and blanks, and outside the ends by more than a hole."""
        if not len(self.time_s):
            return np.full(len(t), np.nan)
        j = np.searchsorted(self.time_s, t, "right") - 1
        before = self.time_s[np.maximum(j, 0)]
        after = self.time_s[np.minimum(j + 1, len(self.time_s) - 1)]
        inside = (after - before <= self.hole_s) & (j >= 0) | (t == before)
        ends = ((j < 0) & (before - t <= self.hole_s)) | ((t >= self.time_s[-1]) & (t - before <= self.hole_s))
        there = inside & (t <= self.time_s[-1]) | ends
        for begin, end in self.blanks:
            there &= (t <= begin) | (t >= end)
        if self.coarse:
            x = self.value[np.searchsorted((self.time_s[1:] + self.time_s[:-1]) / 2.0, t, "right")]
        else:
            x = np.interp(t, self.time_s, self.value)
        return np.where(there, x, np.nan)


def lines(time_s: Floats, value: Floats) -> Series:
    """Series of a quantity that changes continuously, such as a temperature; NaN rows are skipped."""
    known = np.isfinite(value)
    t, v = time_s[known], value[known]
    return Series(t, v, _hole(t), _blanks(time_s, known, min(_hole(t), LONGEST_LINE_S)), _coarse(v))


def steps(time_s: Floats, value: Floats, moves: NDArray[np.bool_] | None = None) -> Series:
    """Series of a quantity that holds from row to row, as a current does.

    Parameters
    ----------
    time_s, value : ndarray (K,)
        NaN rows are skipped.
    moves : ndarray of bool (K,), optional
        Rows that begin with a step; between the others the value is linear. Default: all rows.
    """
    known = np.isfinite(value)
    t, v = time_s[known], value[known]
    blanks = _blanks(time_s, known, _hole(t, HELD_INTERVALS))
    if len(t) < 2:
        return Series(t, v, _hole(t), blanks)
    step = np.ones(len(t) - 1, np.bool_) if moves is None else moves[known][1:]
    at = np.flatnonzero(step) + 1
    edge = t[at] - np.minimum(EDGE_S, 0.5 * (t[at] - t[at - 1]))
    return Series(np.insert(t, at, edge), np.insert(v, at, v[at - 1]), _hole(t), blanks)


def voltage_steps(time_s: Floats, voltage: Floats, current: Floats) -> Series:
    """Series of a voltage: it steps with the current and is linear while the current is constant.

    Held from row to row, the voltage would lag its own slow change. Linear across steps, it would not belong to the
    current at the same instant. Both matter, because heat is their product.
    """
    known = np.isfinite(voltage)
    i = steps(time_s, current).at(time_s[known])
    level = SAME_CURRENT * float(np.nanmax(np.abs(current), initial=0.0))
    moves = np.zeros(len(time_s), np.bool_)
    moves[known] = np.abs(np.diff(i, prepend=i[:1])) > level
    return steps(time_s, voltage, moves)


def feed_of(rows: Columns, string: StringPlan) -> dict[Key, Series]:
    """Series of all measured quantities of a string, by the names of its channels.

    Parameters
    ----------
    rows : Columns
    string : StringPlan
        Its channels define which greatest, least and mean surfaces it reads.
    """
    t = rows.time_s
    feed: dict[Key, Series] = {}
    for quantity, cell, x in rows.given():
        kind = INPUTS[quantity].kind
        if kind == "current":
            feed[quantity, cell] = steps(t, x)
        elif kind == "voltage":
            feed[quantity, cell] = voltage_steps(t, x, rows.current_A)
        else:
            feed[quantity, cell] = lines(t, x)
    for c in string.channels:
        columns = [rows.surface_C[k] for k in c.among if k in rows.surface_C]
        if c.statistic is not None and columns:
            feed[c.key] = lines(t, statistic_of(c.statistic, columns))
    return feed


def _coarse(value: Floats) -> bool:
    """Return whether a sensor counts in coarse steps and often gives the same value twice."""
    step = resolution(value) if len(value) >= LEAST_ROWS else 0.0
    if step < COARSE_K or np.mean(np.diff(value) == 0.0) < OFTEN_SAME:
        return False
    off = (value - value[0]) / step
    return bool((np.abs(off - np.round(off)) < SAME_STEP).all())


def _hole(t: Floats, intervals: float = HOLE_INTERVALS) -> float:
    return max(HOLE_S, intervals * float(np.median(np.diff(t)))) if len(t) > 1 else HOLE_S


def _blanks(time_s: Floats, known: NDArray[np.bool_], limit_s: float) -> Floats:
    """Find the times (H, 2) of blank rows: before the first value, and where they last longer than `limit_s`.

    Shorter ones are normal in tables whose quantities have their own sample times.
    """
    at = np.flatnonzero(known)
    if not len(at):
        return np.zeros((0, 2))
    t, between = time_s[at], np.diff(at) > 1
    long = between & (np.diff(t) > limit_s)
    found = list(zip(t[:-1][long].tolist(), t[1:][long].tolist(), strict=True))
    if at[0] > 0:
        found.append((-np.inf, float(t[0])))
    if at[-1] < len(time_s) - 1 and float(time_s[-1] - t[-1]) > limit_s:
        found.append((float(t[-1]), np.inf))
    return np.array(found).reshape(-1, 2)


@dataclass(frozen=True, slots=True)
class _Slot:
    """One frame layout and its place in time: phase + k · cycle.

    Attributes
    ----------
    silent : bool
        Whether a frame without any valid value is not sent, as in J1939.
    cargo, mute : tuple of (column, feed, channel)
        All signals that it carries, and those that cannot be sent as not available.
    """

    row: int
    cycle_ns: int
    phase_ns: int
    silent: bool
    cargo: tuple[tuple[int, int, Channel], ...]
    mute: tuple[tuple[int, int, Channel], ...]


class Traffic:
    """Frames of the input messages of some strings; keeps the alive counters from call to call.

    Parameters
    ----------
    plan : Plan
    database : Database
        Of the plan's DBC files and ours.
    strings : sequence of int, optional
        Indices into `plan.strings` of the strings with a feed, in the order of the feeds; default all.
    noise_K : float
        White noise added to every temperature sent.
    seed : int
        Seed of the noise.

    Attributes
    ----------
    left_out : dict of str to int
        Number of frames of each message that have known values but were not sent because another value is blank.

    Raises
    ------
    UsageError
        None of these strings takes anything from the bus.
    """

    def __init__(
        self,
        plan: Plan,
        database: Database,
        strings: Sequence[int] | None = None,
        *,
        noise_K: float = 0.0,
        seed: int = 0,
    ) -> None:
        fed = range(len(plan.strings)) if strings is None else strings
        wanted = [(feed, c) for feed, index in enumerate(fed) for c in plan.strings[index].carried]
        if not wanted:
            raise UsageError("nothing to send: every quantity of these strings is a constant")
        messages = dict.fromkeys(database.resolve(c.signal or "").message for _, c in wanted)
        known = [c for string in plan.strings for c in string.carried]
        infos = {c.signal or "": (database.resolve(c.signal or ""), c) for c in known}
        infos = {signal: of for signal, of in infos.items() if of[0].message in messages}
        refused = {signal: _refused(*of) for signal, of in infos.items()}
        fed_signals = {c.signal for _, c in wanted}
        self._others = {
            (info.can_id, info.name): c
            for signal, (info, c) in infos.items()
            if signal not in fed_signals and not_available(info) is None and refused[signal] is None
        }
        self._mute = {s: (info.scale, info.offset) for s, (info, _) in infos.items() if not_available(info) is None}
        self._refused = {signal: raw for signal, raw in refused.items() if raw is not None}
        self._encoder = Encoder(database, tuple(messages), self._refused)
        self._slots = _spread(self._load(database, wanted))
        self._names = {info.can_id: info.message for info, _ in infos.values()}
        self.left_out: dict[str, int] = {}
        self._noise_K = noise_K
        self._rng = np.random.default_rng([seed, 0xCA])

    def _load(self, database: Database, wanted: Sequence[tuple[int, Channel]]) -> list[_Slot]:
        """Assign each channel to the first frame layout with its signal; a shared signal gets its first channel."""
        cargo: dict[int, dict[int, tuple[int, Channel]]] = {}
        cycles: dict[int, int] = {}
        silent: dict[int, bool] = {}
        mute: dict[int, set[int]] = {}
        for feed, c in wanted:
            info = database.resolve(c.signal or "")
            row = next(
                r
                for r in np.flatnonzero(self._encoder.can_id == info.can_id).tolist()
                if info.name in self._encoder.columns(r)
            )
            column = self._encoder.column(row, info.name)
            cargo.setdefault(row, {}).setdefault(column, (feed, c))
            aside = INPUTS[c.quantity].kind in ASIDE and c.signal in self._refused
            if not_available(info) is None and not aside:
                mute.setdefault(row, set()).add(column)
            cycle = _cycle(info, c)
            cycles[row] = min(cycles.get(row, cycle), cycle)
            silent[row] = silent.get(row, True) and not info.j1939
        return [
            _Slot(
                row,
                cycles[row],
                0,
                silent[row],
                tuple((column, *cargo[row][column]) for column in cargo[row]),
                tuple((column, *cargo[row][column]) for column in cargo[row] if column in mute.get(row, ())),
            )
            for row in cargo
        ]

    def made_up(self, feeds: Sequence[Mapping[Key, Series]]) -> list[Channel]:
        """List signals without values that would be sent as measurements, because their frames have other values.

        Signals of strings without a feed are included.
        """
        found = []
        for slot in self._slots:
            if any(_known(feeds[feed], channel) for _, feed, channel in slot.cargo):
                own = [c for _, feed, c in slot.mute if not _known(feeds[feed], c)]
                found += [c for c in own if c.signal not in self._refused]
                can_id = int(self._encoder.can_id[slot.row])
                names = self._encoder.columns(slot.row)
                found += [self._others[can_id, name] for name in names if (can_id, name) in self._others]
        return found

    def in_place(self, feeds: Sequence[Mapping[Key, Series]]) -> dict[str, float]:
        """Give what is sent, SI, for signals without values or a code for not available: their reader refuses it."""
        found: dict[str, float] = {}
        for slot in self._slots:
            if any(_known(feeds[feed], channel) for _, feed, channel in slot.cargo) or not slot.silent:
                for _, feed, c in slot.cargo:
                    raw = self._refused.get(c.signal or "")
                    if raw is not None and c.signal in self._mute and not _known(feeds[feed], c):
                        scale, offset = self._mute[c.signal]
                        found[c.signal] = c.scale * (raw * scale + offset) + c.offset
        return found

    def between(self, feeds: Sequence[Mapping[Key, Series]], start_ns: int, stop_ns: int) -> FrameBatch:
        """Frames of [start, stop), ns on the time axis of the series.

        Parameters
        ----------
        feeds : sequence of mapping
            One per string fed. A missing value is sent as not available. If its signal cannot express this, the frame
            is not sent; but a quantity without any values is sent as a value that its reader refuses, or, if the signal
            has no such value, as 0 or the start value (`made_up`).
        """
        times, rows, values = [], [], []
        for slot in self._slots:
            first = -((slot.phase_ns - start_ns) // slot.cycle_ns)
            t = np.arange(slot.phase_ns + first * slot.cycle_ns, stop_ns, slot.cycle_ns, dtype=np.int64)
            block = np.full((len(t), self._encoder.width), np.nan)
            for column, feed, channel in slot.cargo:
                block[:, column] = self._sample(feeds[feed], channel, t)
            says = np.isfinite(block).any(axis=1) | (not slot.silent)
            heard = says.copy()
            for column, feed, channel in slot.mute:
                if _known(feeds[feed], channel):
                    says &= np.isfinite(block[:, column])
            if lost := int((heard & ~says).sum()):
                name = self._names[int(self._encoder.can_id[slot.row])]
                self.left_out[name] = self.left_out.get(name, 0) + lost
            t, block = t[says], block[says]
            times.append(t)
            rows.append(np.full(len(t), slot.row, np.intp))
            values.append(block)
        time = np.concatenate(times)
        order = np.argsort(time, kind="stable")
        can_id, length, data = self._encoder.encode(np.concatenate(rows)[order], np.concatenate(values)[order])
        return FrameBatch(time[order], can_id, length, data)

    def stream(self, feeds: Sequence[Mapping[Key, Series]], start_ns: int, stop_ns: int) -> Iterator[FrameBatch]:
        """Frames of [start, stop), in blocks of some minutes."""
        for t in range(start_ns, stop_ns, CHUNK_S * SECOND):
            yield self.between(feeds, t, min(stop_ns, t + CHUNK_S * SECOND))

    def _sample(self, feed: Mapping[Key, Series], c: Channel, t_ns: NDArray[np.int64]) -> Floats:
        series = feed.get(c.key)
        if series is None:
            return np.full(len(t_ns), np.nan)
        t: Floats = t_ns.astype(np.float64) * 1e-9
        value = series.at(t)
        if self._noise_K and INPUTS[c.quantity].kind == "temperature":
            value = value + self._noise_K * self._rng.standard_normal(len(t))
        with np.errstate(over="ignore"):  # a value too large for a float is too large for a signal
            return (c.share(value) - c.offset) / c.scale


def _known(feed: Mapping[Key, Series], c: Channel) -> bool:
    """Whether a quantity has any value."""
    return c.key in feed and len(feed[c.key].time_s) > 0


def _refused(info: SignalInfo, c: Channel) -> float | None:
    """Give a raw value that no reader takes for a measurement; None if there is none.

    A temperature above its range counts as heat. So the lowest value is used for a temperature: a missing sensor has
    this reading.
    """
    if info.is_float or info.place.size > LARGEST_BITS:
        return None
    this = INPUTS[c.quantity]
    valid, (lower, upper) = info.raw_valid, this.plausible
    ends = sorted(info.raw_limits, key=lambda raw: c.scale * (raw * info.scale + info.offset))
    if this.kind == "temperature":
        return ends[0]
    for raw in ends:
        value = c.scale * (raw * info.scale + info.offset) + c.offset
        if not (valid[0] <= raw <= valid[1] and lower <= value <= upper):
            return raw
    return None


def _cycle(info: SignalInfo, c: Channel) -> int:
    """Cycle time of a signal's frames, ns."""
    if info.mux:
        # The cycle time of a DBC may apply to single frames: then each multiplexer value comes once a second.
        return max(info.cycle_ns or 0, OTHER_NS)
    return info.cycle_ns or (ELECTRICAL_NS if INPUTS[c.quantity].electrical else OTHER_NS)


def _spread(slots: Sequence[_Slot]) -> list[_Slot]:
    """Spread the slots of each cycle time evenly over it, the slower cycles between the faster ones."""
    out = []
    for rank, cycle in enumerate(sorted({s.cycle_ns for s in slots})):
        same = [s for s in slots if s.cycle_ns == cycle]
        for i, s in enumerate(same):
            phase = (cycle * i // len(same) + rank * 1_000_000) % cycle
            out.append(replace(s, phase_ns=phase))
    return out
