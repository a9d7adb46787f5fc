"""The thin shell around the engine: an event loop, a clock, signals, systemd. It decides nothing about batteries.

How it spends its time: asleep until the first frame comes (or, on ports that cannot be waited for, polling); then it
lets frames gather, as long as the port has room for, and drains it, while traffic flows. A full bus costs some ten
wake-ups a second, a silent one none. One timer serves the engine's next deadline: it drains the port too, and the last
drain before it comes shortly before it, so that how long frames gather adds nothing to the time from a deadline to what
is sent for it.

Why a deadline waits a little: a frame stamped just before the deadline may reach the socket just after it. So the
timer is handled only once bus time is `SETTLE_NS` past the deadline, and after a drain that began then and left
nothing; thus no frame stamped before the deadline is ever behind the timer, and the same traffic read from a log gives
the same output.
"""

import asyncio
import logging
import signal
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, Final

from bms_gateway.bus.port import Link, Port
from bms_gateway.engine.events import Alerted, Estimated, Event, Job, Notice, SendFrames, StartJob
from bms_gateway.errors import GatewayError
from bms_gateway.health.alerts import Change
from bms_gateway.service import lines
from bms_gateway.service.boot import noted
from bms_gateway.service.engine import LiveEngine
from bms_gateway.service.fits import Fits, run_here
from bms_gateway.service.notify import notify, reloading, watchdog_s
from bms_gateway.service.saves import Saves
from bms_gateway.service.signals import ENDING, Signals
from bms_gateway.service.tally import Tally

log = logging.getLogger(__name__)
ANSWER: Final = {"code": "reload", "asked": True}

DRAIN_S: Final = 0.01  # what is read at a deadline gathered no longer; nor do others beside the first after a silence
SETTLE_NS: Final = 2_000_000  # from the kernel's stamp to the socket it takes some µs, on a loaded machine up to 1 ms
OVERDUE_NS: Final = 2_000_000_000  # two ticks: a deadline older than this means that the engine does not move
SAVE_S: Final = 60.0  # what a power cut may cost; an estimate moves little in a minute
FEEDS: Final = 3  # per watchdog interval: one may be late
STATUS_S: Final = 10.0  # what `systemctl status` shows may be so old
LOOK_S: Final = 0.5  # while the bus is not there at a start
PATIENCE_S: Final = 30  # by which systemd's time limit for a start is then put off, again and again
SAVE_LAST_S: Final = 2.0  # a disk that has not answered by then costs the last minute, and not the end
END_S: Final = 1.0  # what runs beside gets so long to say goodbye
HASTE: Final = 0.25  # for a person at a terminal, who wants the end within a second, so much of both
ROUNDING_S: Final = 0.0002  # two clocks are in play: rather a little later than once too early


def pause(gather_s: float, left_s: float | None) -> float:
    """How long frames gather from now, s.

    Parameters
    ----------
    gather_s : float
        As long as the port has room for.
    left_s : float or None
        Until the next deadline: a drain falls `DRAIN_S` before it, if that is sooner.

    Examples
    --------
    >>> pause(0.1, None), pause(0.1, 0.5), round(pause(0.1, 0.07), 3), pause(0.1, 0.009)
    (0.1, 0.1, 0.06, 0.1)
    """
    return gather_s if left_s is None or left_s <= DRAIN_S else min(gather_s, left_s - DRAIN_S)


class Gateway:
    """Engine and port, joined by an event loop.

    Parameters
    ----------
    engine : LiveEngine
    port : Port
    save : callable, optional
        Gets a snapshot every `SAVE_S` and, last of all, at the end, in a thread of its own; one that hangs holds up
        nothing but itself. What it raises as `GatewayError` or `OSError` is told and does no harm.
    reload : coroutine function, optional
        Called on SIGHUP; gives the engine to go on with, while the present one goes on. A `GatewayError` is told and
        keeps the present one.
    watch : callable, optional
        Gets every event in order, jobs left out: for a record of what is sent, or a live table.
    run_job : callable
        Called in a thread of its own; gives a job's result, or `NotDone`: then the job is tried again later.
        `aside.Aside.run` keeps its calculation out of this process.
    end_jobs : callable
        Called at the end: what `run_job` is at need not be finished.
    signals : Signals, optional
        Of whoever limits how long ending may take.

    Attributes
    ----------
    tally : Tally
    beside : dict of str to callable
        What runs in the same loop until the end, by name: coroutine functions, added before `run`. One that fails is
        told, counted and left off: estimates do not depend on who looks at them.
    save_every_s : float
    unread : callable
        What of a stored state could not be read, and is kept until a person sees to it; empty for nothing.
    on_alert : callable
        Told of every change of the engine's alerts.
    summary : callable
        One line for systemd's status, before the counts of frames.
    ended_by : int or None
        The signal that has ended it.

    Notes
    -----
    READY is told once the bus is open; until then systemd sees what is waited for.

    The watchdog is fed only when all three move: the receiving side (drained since the last time, or asleep on a
    silent bus), the estimator (no deadline is overdue) and the sender (nothing waits, or it was its turn in time).
    """

    def __init__(
        self,
        engine: LiveEngine,
        port: Port,
        *,
        save: Callable[[Mapping[str, object]], None] | None = None,
        reload: Callable[[], Awaitable[LiveEngine]] | None = None,
        watch: Callable[[Event], None] | None = None,
        run_job: Callable[[Job], object] = run_here,
        end_jobs: Callable[[], None] = lambda: None,
        signals: Signals | None = None,
    ) -> None:
        self.engine = engine
        self.port = port
        self._reload, self._watch = reload, watch
        self._signals = signals
        self.tally = Tally()
        self.beside: dict[str, Callable[[], Coroutine[Any, Any, None]]] = {}
        self.summary: Callable[[], str] = lambda: ""
        self.unread: Callable[[], str] = lambda: ""
        self.on_alert: Callable[[Change], None] = lambda _: None
        self.ended_by: int | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self._ready = False
        self._told_ns = 0
        self._fits = Fits(self, run_job, end_jobs)
        self._saves = None if save is None else Saves(save, self._snapshot, self.tally)
        self.save_every_s = SAVE_S
        self._drained = False
        self._asleep = False
        self._deadline: int | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._pump_timer: asyncio.TimerHandle | None = None
        self._failure: BaseException | None = None
        self._reloading: asyncio.Task[None] | None = None
        self._reload_again = False

    def serve(self, *, seconds: float | None = None) -> None:
        """Run in an event loop of its own, as a command does.

        Parameters
        ----------
        seconds : float, optional
            As of `run`, and so is what is raised besides.

        Raises
        ------
        KeyboardInterrupt
            SIGINT has ended it, cleanly.
        """
        asyncio.run(self.run(seconds=seconds))
        if self.ended_by == signal.SIGINT:
            raise KeyboardInterrupt

    async def run(self, *, seconds: float | None = None) -> None:
        """Work until SIGTERM, SIGINT or the time is over; then save the state.

        Parameters
        ----------
        seconds : float, optional
            End by itself after so long.

        Raises
        ------
        Exception
            Whatever escapes the engine or a job: a bug, to be seen; the state is not saved, systemd restarts us.
        """
        self._loop = asyncio.get_running_loop()
        self._stop = asyncio.Event()
        self._loop.set_exception_handler(self._on_bug)
        actions: dict[int, Callable[[], object]] = {n: partial(self._on_end, n) for n in ENDING}
        if self._reload is not None:
            actions[signal.SIGHUP] = partial(self._on_reload, self._reload)
        signals = self._signals or Signals()
        signals.take(self._loop, actions)
        try:
            await self._live(seconds)
        finally:
            signals.drop()
            if signals is not self._signals:
                signals.close()

    async def _live(self, seconds: float | None) -> None:
        self._pump()
        self._on_drain()
        if (watchdog := watchdog_s()) is not None:
            self._every(watchdog / FEEDS, self._feed)
        if self._saves is not None:
            self.tally.saved_s = self._loop.time()
            self._every(self.save_every_s, self._saves.begin)
        self._tell_ready()
        self._every(STATUS_S, self.tell_status)
        self._start_beside()
        with suppress(TimeoutError):
            await asyncio.wait_for(self._stop.wait(), seconds)
        self._stop.set()  # the time may be over: a drain that is still due must find it so
        notify("STOPPING=1", "STATUS=saving state")
        self._let_go()
        if self._failure is not None:
            raise self._failure
        if self._saves is not None:
            await self._saves.last(self._at_end(SAVE_LAST_S))
        await self._end_beside()

    @property
    def stopping(self) -> bool:
        """Whether `run` ends: nothing new is begun then."""
        return self._stop.is_set()

    def stop(self) -> None:
        """End `run` as a signal does; to be called in its loop."""
        self._stop.set()

    def _on_end(self, number: int) -> None:
        self.ended_by = number
        self.stop()

    def _at_end(self, seconds: float) -> float:
        return seconds * HASTE if self.ended_by == signal.SIGINT else seconds

    # frames in, deadlines

    def _on_readable(self) -> None:
        """First frame after a pause: let some gather."""
        self._loop.remove_reader(self.port.fileno())
        self._asleep = False
        self._loop.call_later(DRAIN_S, self._on_drain)

    def _on_drain(self) -> None:
        fileno = self.port.fileno()
        if self._stop.is_set():
            return
        if self._step() or fileno < 0:
            due = self.engine.next_deadline()
            left_s = None if due is None else (due - self.port.now_ns()) / 1e9
            self._loop.call_later(pause(self.port.gather_s, left_s), self._on_drain)
        else:
            self._asleep = True
            self._loop.add_reader(fileno, self._on_readable)

    def _on_deadline(self) -> None:
        self._deadline = None
        self._step()

    def _step(self) -> int:
        """Drain, give to the engine, do what is due, carry out what it says; returns the number of frames."""
        before_ns = self.port.now_ns()
        frames = self.port.drain()
        self.engine.dropped = self.port.counters.dropped
        self._drained = True
        if len(frames):
            self.engine.receive(frames, now_ns=self.port.now_ns())
        due = self.engine.next_deadline()
        if due is not None and due + SETTLE_NS <= before_ns and self.port.emptied:
            self.engine.handle_timer(now_ns=before_ns - SETTLE_NS)
        self.put_out()
        self._arm()
        if self.port.link is not Link.UP and self._pump_timer is None:
            self._pump()
        return len(frames)

    def _arm(self) -> None:
        due = self.engine.next_deadline()
        if due == self._deadline:
            return
        self._deadline = due
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if due is not None:
            wait_ns = due + SETTLE_NS - self.port.now_ns()
            self._timer = self._loop.call_later(max(0.0, wait_ns / 1e9) + ROUNDING_S, self._on_deadline)

    # events out

    def put_out(self) -> None:
        """Carry out what the engine says: send, tell, start jobs."""
        sent = False
        while (event := self.engine.next_output()) is not None:
            if isinstance(event, StartJob):
                self.start_job(event)
                continue
            if isinstance(event, SendFrames):
                self.port.send(event.batch)
                sent = True
            elif isinstance(event, Notice):
                self.tally.notices[event.code] = self.tally.notices.get(event.code, 0) + 1
                self.tally.wakes += event.code == "awake"
                lines.write(log, event)
            elif isinstance(event, Alerted):
                self.on_alert(event.change)
            if isinstance(event, SendFrames | Estimated) and event.time_ns > self._told_ns:
                self._told_ns = event.time_ns
                self.tally.ticks += 1
                self.tally.lateness.note(max(0, self.port.now_ns() - event.time_ns) * 1e-9)
            if self._watch is not None:
                self._watch(event)
        if sent and self._pump_timer is None:
            self._pump()

    def _pump(self) -> None:
        wait = self.port.pump()
        self._pump_timer = None if wait is None else self._loop.call_later(wait, self._pump)

    def start_job(self, event: StartJob) -> None:
        """Have a job done beside the loop; its result goes to the engine of now."""
        self._fits.start(self.engine, event)

    # systemd, state, end

    def _every(self, seconds: float, task: Callable[[], object]) -> None:
        def again() -> None:
            if not self._stop.is_set():
                self._loop.call_later(seconds, again)
                task()

        self._loop.call_later(seconds, again)

    def _feed(self) -> None:
        due = self.engine.next_deadline()
        receiving = self._drained or self._asleep
        estimating = due is None or self.port.now_ns() - due < OVERDUE_NS
        sending = self._pump_timer is None or self._loop.time() - self._pump_timer.when() < OVERDUE_NS / 1e9
        if receiving and estimating and sending:
            notify("WATCHDOG=1")
        else:
            log.error("stalled: receiving %s, estimating %s, sending %s", receiving, estimating, sending)
        self._drained = False

    def _tell_ready(self) -> None:
        """READY once the bus is open; before that ask for patience and say what is missing, and look again."""
        if self._ready or self._stop.is_set():
            return
        if self.port.link in (Link.DOWN, Link.ABSENT):
            notify(f"EXTEND_TIMEOUT_USEC={PATIENCE_S * 1_000_000}", f"STATUS=waiting: bus {self.port.link.value}")
            self._loop.call_later(LOOK_S, self._tell_ready)
            return
        self._ready = True
        notify("READY=1", self._status())

    def tell_status(self) -> None:
        """Give systemd the line of now: who looks at it when something happens should see it."""
        if self._ready:
            notify(self._status())

    def _status(self) -> str:
        c = self.port.counters
        summary = f"{text}; " if (text := self.summary()) else ""
        return f"STATUS={summary}bus {self.port.link.value}; {c.received} frames in, {c.sent} out, {c.dropped} lost"

    # what runs beside

    def _start_beside(self) -> None:
        for name, part in self.beside.items():
            task = self._loop.create_task(part(), name=name)
            task.add_done_callback(self._on_part_ended)
            self._tasks.append(task)

    async def _end_beside(self) -> None:
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=self._at_end(END_S))

    def _on_part_ended(self, task: "asyncio.Task[None]") -> None:
        if not task.cancelled() and (error := task.exception()) is not None:
            name = task.get_name()
            self.tally.failed_parts[name] = f"{type(error).__name__}: {error}"
            log.error("%s has failed and is off until a restart; estimates go on", name, exc_info=error)

    def _snapshot(self) -> Mapping[str, object]:
        return {**self.engine.snapshot(), "clock": noted(self.port.now_ns())}

    def _on_reload(self, reload: Callable[[], Awaitable[LiveEngine]]) -> None:
        """Begin to read the config again, or, where that goes on already, do so once more when it ends."""
        if self._reloading is not None:
            self._reload_again = True
            return
        reloading()
        self._reloading = self._loop.create_task(self._take_engine(reload))
        self._reloading.add_done_callback(partial(self._on_reloaded, reload))
        self._tasks.append(self._reloading)

    async def _take_engine(self, reload: Callable[[], Awaitable[LiveEngine]]) -> None:
        try:
            self.engine = await reload()
        except GatewayError as error:
            self.tally.reloads_refused += 1
            log.error("not reloaded, going on as before: %s", error, extra=ANSWER)  # noqa: TRY400 (as above)
        else:
            self.tally.reloads += 1
            self.tally.fit_problems.clear()  # what the engine before has left undone is of no use to this one
            log.info("reloaded", extra=ANSWER)
            self._arm()

    def _on_reloaded(self, reload: Callable[[], Awaitable[LiveEngine]], done: "asyncio.Task[None]") -> None:
        self._tasks.remove(done)
        self._reloading = None
        if done.cancelled() or self._stop.is_set():
            return
        if (error := done.exception()) is not None:
            raise error  # a bug
        if self._reload_again:
            self._reload_again = False
            self._on_reload(reload)
        elif self._ready:
            notify("READY=1", self._status())

    def _on_bug(self, _: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """End the service on any exception in the loop: better restarted than half alive."""
        self._failure = self._failure or context.get("exception") or RuntimeError(context["message"])
        self._stop.set()

    def _let_go(self) -> None:
        if self._asleep:
            self._loop.remove_reader(self.port.fileno())
        for timer in (self._timer, self._pump_timer):
            if timer is not None:
                timer.cancel()
        if self._reloading is not None:
            self._reloading.cancel()  # the engine of now is the one that is saved
        self._fits.close()
