"""Once a second: what is wrong with bus, sensors, strings and state, and whom to tell when that changes.

Conditions are read off the present state, not collected from notices: so a flag that was raised before a restart is
raised again after it. Where one cause explains others, it is told alone: with the bus down or silent no sensor is.
"""

import asyncio
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from bms_gateway.bus.port import Link
from bms_gateway.engine.inputs import REASONS
from bms_gateway.engine.plan import Channel
from bms_gateway.frames.quality import Quality
from bms_gateway.health import StringHealth
from bms_gateway.service.alerts import Alerts, Change, Condition, Severity
from bms_gateway.service.journal import NOTICE
from bms_gateway.service.live import Gateway

log = logging.getLogger(__name__)

PERIOD_S: Final = 1.0
QUIET_S: Final = 2.5  # without a wanted frame for longer the bus is quiet: what is then stale is not the sensors' fault
EVENT_S: Final = 60.0  # how long something that happens in a moment, such as a loss of frames, stays an alert
COOLER_K: Final = 2.0  # below its limit before a core is no longer too hot
NAMED: Final = 6  # cells that a sentence names; more are counted

REMEDIES: Final = {
    Quality.STALE: "check its sender and the wiring of the bus",
    Quality.OUT_OF_RANGE: "check the sensor, and scale and offset in the config",
    Quality.NOT_AVAILABLE: "check the sensor at its sender",
    Quality.ERROR: "check the sensor at its sender",
    Quality.STUCK: "check that the sensor sits on its cell, and its amplifier",
    Quality.OPEN: "check its wire and plug",
    Quality.SHORT: "check its wire and insulation",
    Quality.JUMPY: "check its contact and shielding",
    Quality.COUNTER: "look for a second sender of the same identifier",
    Quality.CRC: "look for a second sender of the same identifier, or a DBC of another version",
}
BUS: Final = {
    Link.DOWN: "the interface is switched off: set it up (ip link set {channel} up)",
    Link.ABSENT: "there is no such interface: check the adapter and its driver",
    Link.BUS_OFF: "the controller is bus-off: check bit rate, termination and wiring",
}
WATCH: Final = ("ageing",)
"""Flags whose levels are watch, warning, alarm; those of the others are warning (suspected), alarm (confirmed)."""


class WatchedPlan(Protocol):
    """What is looked at of a string's plan."""

    @property
    def name(self) -> str:
        """Name of the string."""
        ...


class WatchedString(Protocol):
    """What is looked at of a string; `engine.string.StringEstimator` has it."""

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
    def quality(self) -> NDArray[np.uint8]:
        """`Quality` of both."""
        ...

    health: StringHealth


class WatchedEngine(Protocol):
    """What is looked at of the engine."""

    frames: int

    def next_deadline(self) -> int | None:
        """Bus time of the next tick; None while the bus sleeps."""
        ...

    @property
    def strings(self) -> Sequence[WatchedString]:
        """Estimators."""
        ...

    @property
    def faults(self) -> Sequence[tuple[str, Channel, Quality]]:
        """Inputs that are not good."""
        ...

    @property
    def unheard(self) -> dict[str, str]:
        """Inputs never received, by string."""
        ...


class Watch:
    """Conditions and alerts of a gateway whose engine is a `WatchedEngine`.

    Parameters
    ----------
    gateway : Gateway
    engine : callable
        Gives the engine of now: a reload brings another one.
    channel : str
        Name of the bus, for sentences.
    alerts : Alerts, optional
    core_max_C : float, optional
        Core temperature above which there is an alarm, °C.
    """

    def __init__(
        self,
        gateway: Gateway,
        engine: Callable[[], WatchedEngine],
        *,
        channel: str,
        alerts: Alerts | None = None,
        core_max_C: float | None = None,
    ) -> None:
        self.gateway, self.engine, self.channel = gateway, engine, channel
        self.alerts = alerts or Alerts()
        self.core_max_C = core_max_C
        self.listeners: list[Callable[[Change], None]] = []
        self._frames, self._moved_s = -1, float("-inf")
        self._lost, self._impostors = _Recent(), _Recent()
        self._hot: set[str] = set()
        self._wakes, self._link = 0, Link.UP
        self._asleep_s = _asleep_s()

    async def run(self) -> None:
        """Look once a second until cancelled."""
        self.alerts.begin(time.monotonic())
        while True:
            self.look(time.monotonic())
            await asyncio.sleep(PERIOD_S)

    def look(self, now_s: float) -> None:
        """Work out what is wrong now and tell what has changed."""
        link, wakes, asleep_s = self.gateway.port.link, self.gateway.tally.wakes, _asleep_s()
        back = link is Link.UP and self._link is not Link.UP
        if back or wakes != self._wakes or asleep_s - self._asleep_s > PERIOD_S:
            self.alerts.begin(now_s)
        self._link, self._wakes, self._asleep_s = link, wakes, asleep_s
        for change in self.alerts.update(now_s, list(self.conditions(now_s))):
            self._tell(change)

    def conditions(self, now_s: float) -> Iterator[Condition]:
        """List what is wrong now, the causes first."""
        engine, link = self.engine(), self.gateway.port.link
        if engine.frames != self._frames:
            self._frames, self._moved_s = engine.frames, now_s
        if link is not Link.UP:
            yield Condition("bus", Severity.ALARM, f"{self.channel}: {BUS[link].format(channel=self.channel)}")
        elif engine.next_deadline() is not None and now_s - self._moved_s < QUIET_S:
            yield from _sensors(engine)
            yield from _unknown(engine)
        yield from self._events(now_s)
        for name, why in self.gateway.tally.failed_parts.items():
            yield Condition("part", Severity.WARNING, f"{name} has failed ({why}): restart the service", part=name)
        if problem := self.gateway.tally.save_problem:
            text = f"{problem}; mend that, or what is learnt is lost at the next stop"
            yield Condition("state", Severity.WARNING, text)
        yield from self._strings(engine)

    def _events(self, now_s: float) -> Iterator[Condition]:
        counters = self.gateway.port.counters
        if lost := self._lost.update(counters.dropped, now_s):
            text = f"{lost} frames lost in the kernel: the computer was too busy, or net.core.rmem_max is too small"
            yield Condition("loss", Severity.WARNING, text, settled=True)
        if others := self._impostors.update(counters.impostors, now_s):
            text = f"{others} frames with identifiers of this node came from somebody else: find the second sender"
            yield Condition("impostor", Severity.ALARM, text, settled=True)

    def _strings(self, engine: WatchedEngine) -> Iterator[Condition]:
        for s in engine.strings:
            name = s.plan.name
            for flag in s.health.conditions():
                grave = flag.level >= (3 if flag.code in WATCH else 2)
                severity = Severity.ALARM if grave else Severity.WARNING
                yield Condition(flag.code, severity, flag.text, name, flag.cell, settled=True)
            if self.core_max_C is not None:
                yield from self._too_hot(name, s, self.core_max_C)

    def _too_hot(self, name: str, s: WatchedString, limit: float) -> Iterator[Condition]:
        if np.isnan(s.core).all():
            self._hot.discard(name)
            return
        k = int(np.nanargmax(s.core))
        core = float(s.core[k])
        (self._hot.add if core >= limit - COOLER_K * (name in self._hot) else self._hot.discard)(name)
        if name in self._hot:
            text = (
                f"core of cell {k + 1} is {core:.1f} ± {float(s.core_sd[k]):.1f} °C, the limit is {limit:g} °C: "
                "lower the current or cool the string"
            )
            yield Condition("core", Severity.ALARM, text, name)

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


@dataclass(slots=True)
class _Recent:
    """What has been added to a counter lately, without a pause of `EVENT_S`."""

    count: int = 0
    added: int = 0
    last_s: float = float("-inf")

    def update(self, count: int, now_s: float) -> int:
        """Take the counter; 0 when it has stood still for `EVENT_S`."""
        if now_s - self.last_s >= EVENT_S:
            self.added = 0
        if count != self.count:
            self.added, self.count, self.last_s = self.added + count - self.count, count, now_s
        return self.added


def _sensors(engine: WatchedEngine) -> Iterator[Condition]:
    """One condition per string and quantity, however many cells and faults it is of: a fault may change its face."""
    found: dict[tuple[str, str], dict[Quality, list[Channel]]] = {}
    for string, channel, quality in engine.faults:
        found.setdefault((string, channel.quantity), {}).setdefault(quality, []).append(channel)
    for (string, quantity), faults in found.items():
        clauses = [_fault(quantity, quality, channels) for quality, channels in faults.items()]
        cells = [c.cell for channels in faults.values() for c in channels]
        severity = Severity.ALARM if quantity == "current" else Severity.WARNING
        one = cells[0] if len(cells) == 1 else None
        yield Condition("sensor", severity, "; ".join(clauses), string, one, part=quantity)


def _fault(quantity: str, quality: Quality, channels: Sequence[Channel]) -> str:
    cells = [c.cell for c in channels if c.cell is not None]
    what = quantity.replace("_", " ") + (f" of {_cells(cells)}" if cells else "")
    return f"{what} not used: {REASONS[quality]} ({channels[0].signal}): {REMEDIES[quality]}"


def _unknown(engine: WatchedEngine) -> Iterator[Condition]:
    for string, missing in engine.unheard.items():
        text = f"never received: {missing}: check the names in the config, the DBC, and the sender"
        yield Condition("unheard", Severity.WARNING, text, string)
    for s in engine.strings:
        if np.isnan(s.core).all():
            text = "no core temperature is known to 12 K: see the string's other alerts and its model file"
            yield Condition("estimate", Severity.WARNING, text, s.plan.name)


def _cells(cells: Sequence[int]) -> str:
    """Name cells: ``cell 3``, ``cells 1, 2``, and from the seventh on how many more."""
    named = ", ".join(map(str, cells[:NAMED]))
    more = f" and {len(cells) - NAMED} more" if len(cells) > NAMED else ""
    return f"cell{'s' if len(cells) > 1 else ''} {named}{more}"


def _asleep_s() -> float:
    """How long the computer has been suspended since its boot, s."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.clock_gettime(time.CLOCK_MONOTONIC)
