"""The thin shell around the engine: an event loop, a clock, signals, systemd. It makes no decision about batteries.

`service.turns` decides when it reads the port.

Why a deadline waits a little: a frame stamped just before the deadline may reach the socket just after it. So the timer
is handled only when bus time is `SETTLE_NS` past the deadline, and after a drain that began then and left nothing. Thus
no frame stamped before the deadline comes after the timer, and the same traffic from a log gives the same output.
"""

import asyncio
import logging
import signal
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from bms_gateway.bus.port import Link, Port
from bms_gateway.engine.events import Alerted, Estimated, Event, Job, Notice, SendFrames, StartJob
from bms_gateway.health.alerts import Change
from bms_gateway.service import lines
from bms_gateway.service.boot import noted
from bms_gateway.service.engine_protocol import LiveEngine
from bms_gateway.service.fits import Fits, run_here
from bms_gateway.service.notify import notify, watchdog_s
from bms_gateway.service.parts import Parts
from bms_gateway.service.reloads import Reloads
from bms_gateway.service.saves import Saves
from bms_gateway.service.signals import ENDING, Signals
from bms_gateway.service.tally import Tally
from bms_gateway.service.turns import SETTLE_NS, Turns

log = logging.getLogger(__name__)

OVERDUE_NS: Final = 2_000_000_000  # two ticks: a deadline older than this means that the engine does not move
SAVE_S: Final = 60.0  # greatest loss by a power cut; an estimate moves little in a minute
FEEDS: Final = 3  # per watchdog interval: one may be late
STATUS_S: Final = 10.0  # greatest age of the line that `systemctl status` shows
LOOK_S: Final = 0.5  # interval of checks while the bus is missing at a start
PATIENCE_S: Final = 30  # time by which systemd's time limit for a start is then extended, repeatedly
SAVE_LAST_S: Final = 2.0  # if the disk has not answered by then, the last minute is lost and the service ends
END_S: Final = 1.0  # time for the end of what runs beside the loop
HASTE: Final = 0.25  # share of both times for a person at a terminal, who wants the end within a second


@dataclass(frozen=True, slots=True)
class Jobs:
    """How the jobs of the engine are done.

    Attributes
    ----------
    run : callable
        Called in a thread of its own; returns a job's result, or `NotDone`: the job is then tried again later.
        `fit_process.Aside.run` keeps its computation out of this process.
    end : callable
        Called at the end: a running `run` need not be finished.
    """

    run: Callable[[Job], object] = run_here
    end: Callable[[], None] = lambda: None


class Gateway:
    """Engine and port, connected by an event loop.

    Parameters
    ----------
    engine : LiveEngine
    port : Port
    save : callable, optional
        Gets a snapshot every `SAVE_S` and at the end, in a thread of its own, so that a save that hangs delays nothing
        else. A `GatewayError` or `OSError` from it is reported and has no other effect.
    reload : coroutine function, optional
        Called on SIGHUP; returns the new engine, while the present one continues. A `GatewayError` is reported, and the
        present engine is kept.
    watch : callable, optional
        Gets every event except jobs, in order: for a record of what is sent, or a live table.
    jobs : Jobs
        Usually in another process: see `fit_process.Aside`.

    Attributes
    ----------
    tally : Tally
    beside : Parts
        What runs in the same loop until the end, by name; added before `run`.
    save_every_s : float
    unread : callable
        Returns which parts of a stored state could not be read and wait for a person; empty if none.
    on_alert : callable
        Gets every change of the engine's alerts.
    summary : callable
        Returns one line for systemd's status, before the counts of frames.
    ended_by : int or None
        The signal that ended it.
    turns : Turns
        Decides when port and engine are served.
    fits : Fits
        Jobs that run beside the loop.
    saves : Saves or None
    reloads : Reloads or None

    Notes
    -----
    READY is sent when the bus is open; until then systemd sees what is missing.

    The watchdog is fed only if all three work: the receiving side (drained since the last time, or asleep on a silent
    bus), the estimator (no deadline is overdue) and the sender (nothing waits, or it was served in time).
    """

    def __init__(
        self,
        engine: LiveEngine,
        port: Port,
        *,
        save: Callable[[Mapping[str, object]], None] | None = None,
        reload: Callable[[], Awaitable[LiveEngine]] | None = None,
        watch: Callable[[Event], None] | None = None,
        jobs: Jobs = Jobs(),
    ) -> None:
        self.engine = engine
        self.port = port
        self.tally = Tally()
        self.beside = Parts(self.tally)
        self.summary: Callable[[], str] = lambda: ""
        self.unread: Callable[[], str] = lambda: ""
        self.on_alert: Callable[[Change], None] = lambda _: None
        self.ended_by: int | None = None
        self.save_every_s = SAVE_S
        self._watch = watch
        self.turns = Turns(self)
        self.fits = Fits(self, jobs.run, jobs.end)
        self.saves = None if save is None else Saves(save, self._snapshot, self.tally)
        self.reloads = None if reload is None else Reloads(self, reload)
        self._ready = False
        self._pump_timer: asyncio.TimerHandle | None = None
        self._failure: BaseException | None = None

    def serve(self, *, seconds: float | None = None, signals: Signals | None = None) -> None:
        """Run in its own event loop, as a command does.

        Parameters
        ----------
        seconds, signals
            As for `run`, also for other exceptions.

        Raises
        ------
        KeyboardInterrupt
            SIGINT has ended it in an orderly way.
        """
        asyncio.run(self.run(seconds=seconds, signals=signals))
        if self.ended_by == signal.SIGINT:
            raise KeyboardInterrupt

    async def run(self, *, seconds: float | None = None, signals: Signals | None = None) -> None:
        """Work until SIGTERM, SIGINT or the end of the time; then save the state.

        Parameters
        ----------
        seconds : float, optional
            Time after which it ends by itself.
        signals : Signals, optional
            Given by a caller that limits the time of ending.

        Raises
        ------
        Exception
            Any exception of the engine or a job, which is a bug. The state is not saved, and systemd restarts the
            service.
        """
        self._loop = asyncio.get_running_loop()
        self._stop = asyncio.Event()
        self._loop.set_exception_handler(self._on_bug)
        actions: dict[int, Callable[[], object]] = {n: partial(self._on_end, n) for n in ENDING}
        if self.reloads is not None:
            actions[signal.SIGHUP] = self.reloads.begin
        taken = signals or Signals()
        taken.take(self._loop, actions)
        try:
            await self._live(seconds)
        finally:
            taken.drop()
            if signals is None:
                taken.close()

    async def _live(self, seconds: float | None) -> None:
        self._pump()
        self.turns.begin()
        if (watchdog := watchdog_s()) is not None:
            self._every(watchdog / FEEDS, self._feed)
        if self.saves is not None:
            self.tally.saved_s = self._loop.time()
            self._every(self.save_every_s, self.saves.begin)
        self._tell_ready()
        self._every(STATUS_S, self.tell_status)
        self.beside.start()
        with suppress(TimeoutError):
            await asyncio.wait_for(self._stop.wait(), seconds)
        self._stop.set()  # the loop may be ending: a drain that is still due must see it
        notify("STOPPING=1", "STATUS=saving state")
        self._let_go()
        if self._failure is not None:
            raise self._failure
        if self.saves is not None:
            await self.saves.last(self._at_end(SAVE_LAST_S))
        going = () if self.reloads is None or self.reloads.going is None else (self.reloads.going,)
        await self.beside.end(self._at_end(END_S), *going)

    @property
    def stopping(self) -> bool:
        """Whether `run` ends, so that nothing new begins."""
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

    def step(self) -> int:
        """Drain, give frames to the engine, do what is due, carry out its events; return the number of frames."""
        before_ns = self.port.now_ns()
        frames = self.port.drain()
        self.engine.dropped = self.port.counters.dropped
        if len(frames):
            self.engine.receive(frames, now_ns=self.port.now_ns())
        due = self.engine.next_deadline()
        if due is not None and due + SETTLE_NS <= before_ns and self.port.emptied:
            self.engine.handle_timer(now_ns=before_ns - SETTLE_NS)
        self.put_out()
        self.turns.drained()
        if self.port.link is not Link.UP and self._pump_timer is None:
            self._pump()
        return len(frames)

    def go_on_with(self, engine: LiveEngine) -> None:
        """Continue with another engine, as after a reload; call this in the loop."""
        self.engine = engine
        self.turns.arm()

    # events out

    def put_out(self) -> None:
        """Carry out the engine's events: send frames, report notices, start jobs."""
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
            if isinstance(event, SendFrames | Estimated):
                self.tally.told(event.time_ns, self.port.now_ns())
            if self._watch is not None:
                self._watch(event)
        if sent and self._pump_timer is None:
            self._pump()

    def _pump(self) -> None:
        wait = self.port.pump()
        self._pump_timer = None if wait is None else self._loop.call_later(wait, self._pump)

    def start_job(self, event: StartJob) -> None:
        """Run a job beside the loop; its result goes to the present engine."""
        self.fits.start(self.engine, event)

    # systemd, state, end

    def _every(self, seconds: float, task: Callable[[], object]) -> None:
        def again() -> None:
            if not self._stop.is_set():
                self._loop.call_later(seconds, again)
                task()

        self._loop.call_later(seconds, again)

    def _feed(self) -> None:
        due = self.engine.next_deadline()
        receiving = self.turns.move()
        estimating = due is None or self.port.now_ns() - due < OVERDUE_NS
        sending = self._pump_timer is None or self._loop.time() - self._pump_timer.when() < OVERDUE_NS / 1e9
        if receiving and estimating and sending:
            notify("WATCHDOG=1")
        else:
            log.error("stalled: receiving %s, estimating %s, sending %s", receiving, estimating, sending)

    def _tell_ready(self) -> None:
        """Send READY when the bus is open; before, extend the time limit, say what is missing, and check again."""
        if self._ready or self._stop.is_set():
            return
        if self.port.link in (Link.DOWN, Link.ABSENT):
            notify(f"EXTEND_TIMEOUT_USEC={PATIENCE_S * 1_000_000}", f"STATUS=waiting: bus {self.port.link.value}")
            self._loop.call_later(LOOK_S, self._tell_ready)
            return
        self._ready = True
        notify("READY=1", self._status())

    def tell_status(self, *before: str) -> None:
        """Send systemd the present status line, after other lines, so that it is seen when something happens."""
        if self._ready:
            notify(*before, self._status())

    def _status(self) -> str:
        c = self.port.counters
        summary = f"{text}; " if (text := self.summary()) else ""
        return f"STATUS={summary}bus {self.port.link.value}; {c.received} frames in, {c.sent} out, {c.dropped} lost"

    def _snapshot(self) -> Mapping[str, object]:
        return {**self.engine.snapshot(), "clock": noted(self.port.now_ns())}

    def _on_bug(self, _: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """End the service on any exception in the loop: a restart is better than a service that works partly."""
        self._failure = self._failure or context.get("exception") or RuntimeError(context["message"])
        self._stop.set()

    def _let_go(self) -> None:
        self.turns.end()
        if self._pump_timer is not None:
            self._pump_timer.cancel()
        if self.reloads is not None and self.reloads.going is not None:
            self.reloads.going.cancel()  # the present engine is the one that is saved
        self.fits.close()
