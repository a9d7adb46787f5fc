"""The engine: frames and bus time in, estimates, frames and notices out. No I/O, no clock, no threads.

**Ticks.** Estimation takes place at the multiples of `plan.tick_ns` of bus time. Frames are only collected until a
frame stamped at or after the deadline arrives (or a timer says that the deadline has passed and nothing more comes).
Then the whole interval [t0, t1) is decoded, guarded, integrated and estimated at once. Therefore the result cannot
depend on how frames were cut into batches, and a full bus costs one numpy pass a second.

**Silence.** If no wanted frame came for `plan.silent_after_ns`, the bus counts as asleep: the last estimates are sent,
then nothing, and no timer is armed. The next frame wakes the engine, which carries its state over the gap in one step.
A start from a stored state is treated alike: as a gap between the snapshot and the first frame.

**Jobs.** Identification of a window takes tenths of a second. The engine hands it out as a job and applies its result
at a fixed later bus time, so a live service and an inline replay change parameters at the same tick. The engine
waits for a late result. It does not compute such a result itself: the result is late because the machine is busy, and
a full bus would then lose frames in the kernel. The engine computes only a job that nobody has taken, because one long
batch may span both the start of the job and its due time.
"""

from collections import deque
from collections.abc import Mapping
from itertools import islice
from typing import Any

import numpy as np

from bms_gateway.engine.alerting import Alerting
from bms_gateway.engine.broadcast import Broadcast, Counts, State
from bms_gateway.engine.estimators import Estimators
from bms_gateway.engine.events import Decoded, Event, Level, Notice, SendFrames, StartJob
from bms_gateway.engine.input_news import Fault
from bms_gateway.engine.inputs import Inputs
from bms_gateway.engine.jobs import Jobs
from bms_gateway.engine.judgement import judged
from bms_gateway.engine.plan import Plan
from bms_gateway.engine.plausible import fitting
from bms_gateway.engine.readings import Readings
from bms_gateway.engine.samples import Samples
from bms_gateway.engine.stamps import Clock
from bms_gateway.engine.string_estimator import StringEstimator
from bms_gateway.engine.wiring import Wire
from bms_gateway.errors import ConfigError, StateError, did_you_mean
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.database import Database
from bms_gateway.frames.quality import Quality
from bms_gateway.health.alerts import Alerts

JOB_DUE_TICKS = 30  # far longer than the fit of a window takes on a slow core, far shorter than a window
GRACE_TICKS = 10  # after a start or a pause: a sensor that has sent nothing yet is not faulty; a fault lasts longer
AT_ONCE_NS = 2_000_000_000  # a reload takes less, a restart more: a shorter stop cannot hide a change
CLOCK_SET_NS = 1_577_836_800_000_000_000  # 2020: an older stamp belongs to a clock that started in 1970 and was not set
SNAPSHOT_VERSION = 1
GOOD = np.uint8(Quality.GOOD)  # numpy's own type, because numpy compares it faster
LATEST_NS = 9_000_000_000_000_000_000  # the year 2255: stamps and periods added to them fit into 64 bits


class Engine:
    """See the module's text.

    Parameters
    ----------
    plan : Plan
    database : Database
        Ours and the user's, loaded.
    whole : bool
        Whether to use all channels of the plan, also those without an estimator; for a record.

    Attributes
    ----------
    frames : int
        Wanted frames so far.
    dropped : int
        Frames lost before they reached the engine; the reader of the bus sets this number.
    recording : bool
        Whether each tick's samples are wanted as `Decoded` events, for a record of recent signals.
    judging : bool
        Whether each tick's errors of the models are wanted as `Judged` events.
    started_ns, woken_ns : int
        Start of the first tick, and of the first one since the bus was last silent.
    inputs, estimators, alerting, broadcast : Inputs, Estimators, Alerting, Broadcast or None
        The parts of a tick, in this order; without `broadcast` nothing is sent.

    Raises
    ------
    ConfigError
        A signal of the plan is not in the database.
    """

    def __init__(self, plan: Plan, database: Database, *, whole: bool = False) -> None:
        self._plan = plan
        self.inputs = Inputs(plan, database, whole=whole)
        self.estimators = Estimators(plan, self.inputs.wires)
        self.broadcast = Broadcast(plan, database) if plan.transmit else None
        self.alerting = Alerting(plan.alerts, self.inputs, self.estimators)
        self._clock = Clock()
        self._queue: deque[Event] = deque()
        self._pending: list[FrameBatch] = []
        self._deadline: int | None = None
        self._tick_end: int | None = None  # newest instant that is estimated; None before the first
        self._heard = 0  # newest wanted frame, bus time
        self._jobs = Jobs()
        self.started_ns = 0
        self.woken_ns = 0
        self._told = Counts(0, 0, 0, 0.0)
        self.frames = 0
        self.dropped = 0
        self.recording = False
        # From a restore to the first frame: whether the time since the snapshot is known, whatever the clock shows.
        self._restored: bool | None = None
        self.judging = False

    def foresee(self) -> None:
        """Yield forecasts, with the states they start from, as `Foreseen` events from now on."""
        self.estimators.forecasts.wanted = True

    @property
    def plan(self) -> Plan:
        """The plan of the engine."""
        return self._plan

    @property
    def wires(self) -> list[Wire]:
        """Inputs of each string, in the order of the plan; `Decoded` refers to them by their index."""
        return self.inputs.wires

    @property
    def can_ids(self) -> np.ndarray[tuple[int], np.dtype[np.uint32]]:
        """Identifiers that the engine listens to."""
        return self.inputs.can_ids

    @property
    def any_sender(self) -> list[int]:
        """Identifiers that are parameter groups of J1939; their frames may also come from another source address."""
        return self.inputs.senders.can_ids

    @property
    def senders(self) -> dict[int, int]:
        """Source address by identifier, where frames of a parameter group come from another one than the DBC's."""
        return self.inputs.senders.heard

    @property
    def sends(self) -> dict[int, int]:
        """Identifiers that the engine sends and their cycles, ns; empty when it only listens."""
        return {} if self.broadcast is None else dict(self.broadcast.cycles)

    @property
    def strings(self) -> list[StringEstimator]:
        """Present results of each string, in the order of the plan; read-only."""
        return self.estimators.strings

    @property
    def duration_s(self) -> float:
        """Bus time from the first wanted frame to the newest one."""
        return 0.0 if self._clock.last_ns is None else (self._clock.last_ns - self._clock.first_ns) * 1e-9

    @property
    def clock_faults(self) -> str:
        """Faults of the time stamps so far, in words; empty if there were none."""
        return self._clock.faults()

    @property
    def clock_counts(self) -> dict[str, int]:
        """Counts of the faults of the time stamps so far: reordered frames, clocks set back, absurd stamps."""
        return {"reordered": self._clock.reordered, "set_back": self._clock.set_back, "absurd": self._clock.absurd}

    @property
    def unheard(self) -> dict[str, str]:
        """Inputs never received, by string, for people."""
        return self.inputs.unheard()

    @property
    def faults(self) -> list[Fault]:
        """Inputs that came and are not good now."""
        return self.inputs.faults()

    @property
    def alerts(self) -> Alerts:
        """Alerts on inputs and strings; read-only."""
        return self.alerting.alerts

    @property
    def rejected(self) -> dict[str, int]:
        """Refused samples so far, by reason."""
        return self.inputs.rejected

    @property
    def counts(self) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
        """Samples (C, 16) of each input so far, by `Quality`; inputs are numbered as in `wires`."""
        return self.inputs.counts

    @property
    def extremes(self) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        """Least and greatest value (2, C) of each input so far, used or refused, in the DBC's unit."""
        return self.inputs.extremes

    def receive(self, frames: FrameBatch, *, now_ns: int) -> None:
        """Use the next frames of the bus; no content of a frame raises an exception.

        Parameters
        ----------
        frames : FrameBatch
            In the order of the bus.
        now_ns : int
            Bus time at which they were read; a later stamp is replaced by it.
        """
        frames = self.inputs.wanted(frames)
        if len(frames) and frames.time_ns.max() > now_ns:
            frames = FrameBatch(np.minimum(frames.time_ns, now_ns), frames.can_id, frames.length, frames.data)
        frames = self._clock.straighten(frames)
        if not len(frames):
            return
        if self._deadline is None:
            self._wake(int(frames.time_ns[0]))
        elif self._tick_end is not None and int(frames.time_ns[0]) < self._tick_end:
            # the stamp lies before a timer that has already fired: the frame counts for the open tick
            time = np.maximum(frames.time_ns, self._tick_end)
            frames = FrameBatch(time, frames.can_id, frames.length, frames.data)
        self._pending.append(frames)
        if self._deadline is not None and int(frames.time_ns[-1]) >= self._deadline:
            self._work_off()

    def next_deadline(self) -> int | None:
        """Bus time of the next timer, ns; None while the bus is silent."""
        return self._deadline

    def handle_timer(self, *, now_ns: int) -> None:
        """Let time pass with no more frames: all ticks due by `now_ns` happen, stamped with their deadlines."""
        while self._deadline is not None and self._deadline <= now_ns:
            batch = FrameBatch.concat(self._pending)
            self._pending = []
            if len(batch):
                self._heard = int(batch.time_ns[-1])
                self.frames += len(batch)
            self._tick(self.inputs.decode(batch), self._deadline)

    def next_output(self) -> Event | None:
        """Next event of the one ordered queue; None if the queue is empty."""
        event = self._queue.popleft() if self._queue else None
        if isinstance(event, StartJob):
            self._jobs.take(event.job_id)
        return event

    def awaits(self, job_id: int) -> bool:
        """Whether a job still needs a result: none has been applied."""
        return self._jobs.awaits(job_id)

    def finish(self, job_id: int, result: object) -> None:
        """Return the result of a job; it takes effect at the job's due time, or at the next tick if that has passed.

        None returns the job without a result: it will not be computed.
        """
        self._jobs.finish(job_id, result)

    def _work_off(self) -> None:
        """Run every tick whose frames are complete; keep the frames of the open tick."""
        batch, tick = FrameBatch.concat(self._pending), self._plan.tick_ns
        open_start = int(batch.time_ns[-1]) // tick * tick
        closed = int(np.searchsorted(batch.time_ns, open_start))
        samples = self.inputs.decode(batch[:closed])
        frame = sample = 0
        while self._deadline is not None and self._deadline <= open_start:
            frame_end = int(np.searchsorted(batch.time_ns, self._deadline))
            sample_end = int(np.searchsorted(samples.time_ns, self._deadline))
            if frame_end > frame:
                self._heard = int(batch.time_ns[frame_end - 1])
                self.frames += frame_end - frame
            self._tick(samples.between(sample, sample_end), self._deadline)
            frame, sample = frame_end, sample_end
            if self._deadline is None:
                self._wake(int(batch.time_ns[frame]))
        self._pending = [batch[closed:]]

    def _wake(self, first_ns: int) -> None:
        """Arm the timer for the tick of the first frame, and carry the state over the time since the last tick."""
        tick = self._plan.tick_ns
        start = first_ns // tick * tick
        heard, self._heard, self._deadline = self._heard, first_ns, start + tick
        self.started_ns = self.started_ns or start
        self.alerting.wake(start)
        self.woken_ns = start
        if self._tick_end is not None and start != self._tick_end:
            gap_ns: int | None = start - self._tick_end
            unseen = self._restored is not None and not 0 <= start - self._tick_end <= AT_ONCE_NS
            if start < self._tick_end or (unseen and not self._restored and min(start, self._tick_end) < CLOCK_SET_NS):
                gap_ns = None
            silent_ns = first_ns - heard if heard else start - self._tick_end  # a stored state has ticks, no frames
            how_long = "a time that the clock does not tell" if gap_ns is None else f"{silent_ns * 1e-9:.0f} s"
            self._queue.append(
                Notice(start, Level.INFO, "awake", f"frames again after {how_long}: state carried over the gap")
            )
            self.inputs.forget()
            self.estimators.pass_time(None if gap_ns is None else gap_ns * 1e-9, unseen=unseen)
        self._restored = None
        self._tick_end = start

    def _tick(self, samples: Samples, t1: int) -> None:
        """Estimate at the deadline `t1` from the samples of the interval that it closes; arm the next one."""
        t0, before = t1 - self._plan.tick_ns, len(self._queue)
        self._take_results(t1)
        readings = self.inputs.update(samples, t0, t1, self.estimators.newest.surface)
        if self.recording:
            taken, good = self.inputs.good
            self._queue.append(Decoded(t1, taken.time_ns[good], taken.input[good], taken.value[good]))
        if t1 - self.woken_ns >= GRACE_TICKS * self._plan.tick_ns:
            self._queue.extend(self.inputs.changes(t1))
        if faults := self._clock.news(t1):
            self._queue.append(Notice(t1, Level.WARNING, "clock", f"time stamps: {faults}"))
        for name, missing in self.inputs.newly_missed().items():
            self._queue.append(Notice(t1, Level.WARNING, "unheard", f"not received so far: {missing}", name))
        tick = self.estimators.step(readings, t1)
        self._queue.extend(tick.events)
        self._queue.extend(self.alerting.sense(readings, t1, self._heard))
        if self.judging:
            self._queue.append(judged(t1, self.frames, self.rejected, self.estimators, readings))
        for string, job in tick.jobs:
            self._queue.append(self._jobs.hand_out(string, job, t1, t1 + JOB_DUE_TICKS * self._plan.tick_ns))
        silent = t1 - self._heard >= self._plan.silent_after_ns
        self.alerting.hear(islice(self._queue, before, None))
        self._queue.extend(self.alerting.step(t1, self._heard, silent=silent))
        if self.broadcast is not None:
            state = State.SILENT if silent else self._state(readings)
            self._queue.append(SendFrames(t1, self.broadcast.encode(t1, self.estimators, state, self._counts(t1))))
        self._tick_end = t1
        if silent:
            quiet = f"no wanted frame for {self._plan.silent_after_ns / 1e9:g} s: waiting for the bus, sending nothing"
            self._queue.append(Notice(t1, Level.NOTICE, "silent", quiet))
        self._deadline = None if silent else t1 + self._plan.tick_ns

    def _take_results(self, now: int) -> None:
        """Apply the results that are due, in the order of their jobs."""
        for string, result in self._jobs.results(now):
            self._queue.extend(self.estimators.accept(string, result, now))

    def _state(self, readings: Readings) -> State:
        """Give the state for the status frame: degraded while a string lacks its current or all of its surfaces."""
        if not np.isfinite(self.estimators.newest.core).any():
            return State.STARTING
        sound = (readings.current_quality == GOOD).all() and readings.seen(GOOD).all()
        return State.RUNNING if sound else State.DEGRADED

    def _counts(self, t1: int) -> Counts:
        rejected = sum(self.inputs.rejected.values())
        counts = Counts(
            self.frames - self._told.frames,
            rejected - self._told.rejected,
            self.dropped,
            (t1 - self.started_ns) * 1e-9,
        )
        self._told = Counts(self.frames, rejected, self.dropped, 0.0)
        return counts

    def reset_baseline(self, string: str, cell: int | None, reason: str, *, time_ns: int) -> bool:
        """Find a new baseline for the growth of R_e from now on: cells were replaced.

        Parameters
        ----------
        string : str
        cell : int or None
            1-based; None for the whole string.
        reason : str
            Kept in the history.
        time_ns : int
            Wall clock at the request.

        Returns
        -------
        bool
            False if this request has been carried out before.

        Raises
        ------
        ConfigError
            There is no such string or cell.
        """
        found = next((s for s in self.estimators.strings if s.plan.name == string), None)
        if found is None:
            names = [s.plan.name for s in self.estimators.strings]
            raise ConfigError(f"there is no string '{string}'{did_you_mean(string, names)}")
        if cell is not None and not 1 <= cell <= found.plan.model.cells:
            raise ConfigError(f"there is no cell {cell} in {string}; valid: 1 to {found.plan.model.cells}")
        done = found.health.reset(cell, reason, time_ns)
        if done:
            self._queue.append(Notice(self._tick_end or time_ns, Level.NOTICE, "baseline", done, string, cell))
            self.alerting.hear([self._queue[-1]])
        return bool(done)

    def acknowledge(self, string: str | None, reason: str) -> bool:
        """End the alarms that only a person can end; a condition that still holds raises its alarm again.

        Parameters
        ----------
        string : str or None
            None for all strings.
        reason : str
            Reported with the end of the alarms.

        Returns
        -------
        bool
            False if there were no such alarms.
        """
        done = self.alerting.acknowledge(string)
        if done:
            self._queue.append(Notice(self._tick_end or 0, Level.NOTICE, "acknowledged", reason, string))
        return done

    def snapshot(self) -> dict[str, Any]:
        """State as JSON-able values, from which `restore` continues after a stop of any length."""
        return {
            "version": SNAPSHOT_VERSION,
            "tick_end_ns": self._tick_end,
            "estimators": self.estimators.snapshot(),
            "alarms": self.alerting.snapshot(),
        }

    def restore(self, state: Mapping[str, Any], *, sure: bool = False) -> None:
        """Restore a stored state before the first frame; the time until then counts as parked.

        Parameters
        ----------
        state : mapping
            From `snapshot`.
        sure : bool
            Whether its time is of the same clock as the coming frames, even if this clock starts in 1970.

        Raises
        ------
        StateError
            The state cannot be used. The engine may be partly restored: discard it and build a new one.
        """
        if state.get("version") != SNAPSHOT_VERSION:
            raise StateError(f"stored state has version {state.get('version')}, this program writes {SNAPSHOT_VERSION}")
        with fitting():
            left = self.estimators.restore(state["estimators"])
            self.alerting.restore(state.get("alarms", {}))  # states of older versions have no alarms
            self._tick_end = None if state["tick_end_ns"] is None else int(state["tick_end_ns"])
        if self._tick_end is not None and not 0 <= self._tick_end < LATEST_NS:
            seconds = max(-(1 << 99), min(self._tick_end, 1 << 99)) * 1e-9  # an integer may be too large for a float
            raise StateError(f"stored state: its time, {seconds:.4g} s since 1970, is not the time of any clock")
        self._restored = None if self._tick_end is None else sure
        for text in left:
            self._queue.append(Notice(self._tick_end or 0, Level.NOTICE, "state", text))
