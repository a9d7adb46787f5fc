"""Reports alerts, and checks once a second for those that only a running service can know: bus, frames, fits, state.

Alerts of sensors and strings belong to the engine (`engine.alerting`), which reports them at its ticks, the same ones
for a log.
"""

import asyncio
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from bms_gateway.bus.port import Link
from bms_gateway.engine.forecast_result import Forecast
from bms_gateway.engine.input_news import Fault
from bms_gateway.errors import counted
from bms_gateway.health import StringHealth
from bms_gateway.health.alerts import Alerts, AlertSettings, Change, Condition, Severity, no_longer
from bms_gateway.service.journal import NOTICE
from bms_gateway.service.live import Gateway

log = logging.getLogger(__name__)

PERIOD_S: Final = 1.0
EVENT_S: Final = 60.0  # time for which a momentary event, such as a loss of frames, stays an alert
OLD_S: Final = 150.0  # a save is made every minute: two were left out

BUS: Final = {
    Link.DOWN: "the interface is switched off: set it up (ip link set {channel} up)",
    Link.ABSENT: "there is no such interface: check the adapter and its driver",
    Link.BUS_OFF: "the controller is bus-off: check bit rate, termination and wiring",
}
ENDED: Final = {
    "bus": "the bus can be read again",
    "loss": f"no frame was lost for {EVENT_S:.0f} s",
    "impostor": f"no frame of this node's identifiers came from another sender for {EVENT_S:.0f} s",
    "fit": "the fits have results again",
    "state": "the learnt state is saved again",
}
"""Why an alert of the service has ended."""


class WatchedPlan(Protocol):
    """What is needed of a string's plan."""

    @property
    def name(self) -> str:
        """Name of the string."""
        ...


class WatchedString(Protocol):
    """What is needed of a string; `engine.string_estimator.StringEstimator` has it."""

    @property
    def plan(self) -> WatchedPlan:
        """The plan, for its name."""
        ...

    @property
    def core(self) -> NDArray[np.float64]:
        """Newest estimate, °C."""
        ...

    @property
    def core_sd(self) -> NDArray[np.float64]:
        """Its standard deviation, K."""
        ...

    @property
    def centre(self) -> NDArray[np.float64]:
        """Newest estimate of each cell's hottest point, °C."""
        ...

    @property
    def centre_sd(self) -> NDArray[np.float64]:
        """Its standard deviation, K."""
        ...

    @property
    def quality(self) -> NDArray[np.uint8]:
        """`Quality` of all."""
        ...

    @property
    def own_heat(self) -> NDArray[np.float64]:
        """Heat of the cells that no current makes, W."""
        ...

    @property
    def own_heat_sd(self) -> NDArray[np.float64]:
        """Its standard deviation, W."""
        ...

    @property
    def forecast(self) -> Forecast | None:
        """The forecast; None before anything is known."""
        ...

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons against the cores, a sentence each."""
        ...

    health: StringHealth


class WatchedEngine(Protocol):
    """What is needed of the engine."""

    def next_deadline(self) -> int | None:
        """Bus time of the next tick; None while the bus sleeps."""
        ...

    @property
    def strings(self) -> Sequence[WatchedString]:
        """Estimators."""
        ...

    @property
    def faults(self) -> Sequence[Fault]:
        """Inputs that are not good."""
        ...

    @property
    def alerts(self) -> Alerts:
        """Alerts of its inputs and strings."""
        ...


class Watch:
    """Alerts of a gateway whose engine is a `WatchedEngine`: the engine's and the service's own.

    Parameters
    ----------
    gateway : Gateway
    engine : callable
        Returns the present engine: a reload replaces it.
    channel : str
        Name of the bus, for sentences.
    settings : AlertSettings, optional

    Attributes
    ----------
    alerts : Alerts
        The service's own alerts; its line and severity include those of the engine.
    listeners : list of callable
        Called with every change.
    asleep_s : float
        Time for which the computer had slept since its start, at the last check.
    """

    def __init__(
        self,
        gateway: Gateway,
        engine: Callable[[], WatchedEngine],
        *,
        channel: str,
        settings: AlertSettings | None = None,
    ) -> None:
        self.gateway, self.engine, self.channel = gateway, engine, channel
        s = settings or AlertSettings()
        self.alerts = Alerts(
            grace_s=s.grace_s,
            hold_s=s.hold_s,
            clear_s=s.clear_s,
            also=lambda: self.engine().alerts.raised,
            ended=_ended,
        )
        gateway.on_alert = self._tell
        self.listeners: list[Callable[[Change], None]] = []
        self._lost, self._impostors = _Recent(), _Recent()
        self._wakes, self._link = 0, Link.UP
        self.asleep_s = slept_s()

    async def run(self) -> None:
        """Check once a second until cancelled."""
        self.alerts.begin(time.monotonic())
        while True:
            self.look(time.monotonic())
            await asyncio.sleep(PERIOD_S)

    def look(self, now_s: float) -> None:
        """Determine what is wrong now and report what has changed."""
        link, wakes, asleep_s = self.gateway.port.link, self.gateway.tally.wakes, slept_s()
        back = link is Link.UP and self._link is not Link.UP
        if back or wakes != self._wakes or asleep_s - self.asleep_s > PERIOD_S:
            self.alerts.begin(now_s)
        self._link, self._wakes, self.asleep_s = link, wakes, asleep_s
        for change in self.alerts.update(now_s, list(self.conditions(now_s))):
            self._tell(change)

    def conditions(self, now_s: float) -> Iterator[Condition]:
        """List what is wrong now, the causes first."""
        link = self.gateway.port.link
        if link is not Link.UP:
            yield Condition("bus", Severity.ALARM, f"{self.channel}: {BUS[link].format(channel=self.channel)}")
        yield from self._events(now_s)
        for name, why in self.gateway.tally.failed_parts.items():
            yield Condition("part", Severity.WARNING, f"{name} has failed ({why}): restart the service", part=name)
        yield from self._kept(now_s)

    def _kept(self, now_s: float) -> Iterator[Condition]:
        """Yield faults of learning: fits without a result, and a state on disk that is older than some minutes."""
        tally = self.gateway.tally
        if why := next(iter(tally.fit_problems.values()), ""):
            others = f" ({len(tally.fit_problems)} fits wait)" if len(tally.fit_problems) > 1 else ""
            text = f"parameters are not identified further, estimates go on with those known: a fit was not made: {why}"
            yield Condition("fit", Severity.WARNING, f"{text}{others}; it is tried again")
        if unread := self.gateway.unread():
            yield Condition("state", Severity.WARNING, unread, part="unread", settled=True)
        age_s = 0.0 if tally.saved_s is None else now_s - tally.saved_s
        if problem := tally.save_problem or ("nothing has been saved" if age_s > OLD_S else ""):
            since = f" (the state on disk is {age_s / 60.0:.0f} min old)" if age_s > OLD_S else ""
            text = f"{problem}{since}; repair this, or the learnt state is lost at the next stop"
            yield Condition("state", Severity.WARNING, text)

    def _events(self, now_s: float) -> Iterator[Condition]:
        counters = self.gateway.port.counters
        if lost := self._lost.update(counters.dropped, now_s):
            why = "the computer was too busy, or net.core.rmem_max is too small"
            text = f"{counted(lost, 'frame')} lost in the kernel: {why}"
            yield Condition("loss", Severity.WARNING, text, settled=True)
        if others := self._impostors.update(counters.impostors, now_s):
            text = f"{counted(others, 'frame')} with identifiers of this node came from another sender: find it"
            yield Condition("impostor", Severity.ALARM, text, settled=True)

    def _tell(self, change: Change) -> None:
        c = change.condition
        level = {Severity.WARNING: logging.WARNING, Severity.ALARM: logging.CRITICAL}[c.severity]
        code = f"alert-{c.name}"
        extra = {"code": code, "kind": f"{code} {c.string}", "string": c.string, "cell": c.cell}
        where = "" if c.string is None else f" [{c.string}]"
        if change.raised:
            log.log(level, "%s: %s%s", c.severity.name, c.text, where, extra=extra)
        else:
            log.log(NOTICE, "over: %s%s", c.text, where, extra=extra)
        for listener in self.listeners:
            listener(change)


def _ended(last: Condition) -> Condition:
    """Return the condition of an alert that ends now with the sentence that says why."""
    if (why := ENDED.get(last.name)) is None or last.part == "unread":
        return no_longer(last)
    return replace(last, text=why)


@dataclass(slots=True)
class _Recent:
    """Increase of a counter in the latest run of events, which ends after a pause of `EVENT_S`."""

    count: int = 0
    added: int = 0
    last_s: float = float("-inf")

    def update(self, count: int, now_s: float) -> int:
        """Update from the counter; return 0 if it has not changed for `EVENT_S`."""
        if now_s - self.last_s >= EVENT_S:
            self.added = 0
        if count != self.count:
            self.added, self.count, self.last_s = self.added + count - self.count, count, now_s
        return self.added


def slept_s() -> float:
    """Time for which the computer has been suspended since its boot, s."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.clock_gettime(time.CLOCK_MONOTONIC)
