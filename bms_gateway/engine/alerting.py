"""The alerts of an engine: at every tick it determines what is wrong, and reports what has changed.

Alerts belong to the engine and not to the service, so that logged traffic gives the same alerts as the live bus.
Conditions that only a live service can know (the interface, the disk, its own parts) belong to the service.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.conditions import of_inputs, of_strings
from bms_gateway.engine.estimators import Estimators
from bms_gateway.engine.events import Alerted, Event, Level, Notice
from bms_gateway.engine.inputs import Inputs
from bms_gateway.engine.readings import Readings
from bms_gateway.frames.quality import Quality
from bms_gateway.health.alerts import Alerts, AlertSettings, Condition
from bms_gateway.health.confirm import Confirm, Surfaces
from bms_gateway.health.endings import Endings
from bms_gateway.health.limits import Limits, Points, Sensed
from bms_gateway.health.nearing import Nearing
from bms_gateway.health.runaway import Runaway
from bms_gateway.thermal import StringModel

QUIET_S: Final = (
    2.5  # without a wanted frame for longer than this the bus is quiet: stale values are then no fault of the sensors
)
PAUSE_S: Final = 10.0  # after a pause of this length the senders start one by one
GOOD, STALE, ESTIMATED, DOUBTFUL, NEVER, JUMPY = (
    np.uint8(q)
    for q in (Quality.GOOD, Quality.STALE, Quality.ESTIMATED, Quality.DOUBTFUL, Quality.NEVER, Quality.JUMPY)
)
ABOVE = (Quality.OUT_OF_RANGE, Quality.OPEN)


class Alerting:
    """Conditions and alerts of the strings of one engine.

    Attributes
    ----------
    alerts : Alerts
        The present alerts.
    limits : Limits
    runaway : Runaway
    """

    def __init__(self, settings: AlertSettings, inputs: Inputs, estimators: Estimators) -> None:
        self._inputs, self._estimators = inputs, estimators
        hold_s, clear_s = settings.hold_s, settings.clear_s
        self.alerts = Alerts(grace_s=settings.grace_s, hold_s=hold_s, clear_s=clear_s, ended=self._ended)
        self._endings = Endings()
        names, self._parts = [s.plan.name for s in estimators.strings], [s.mine for s in estimators.strings]
        stale_s = inputs.stale_s()
        self.limits = Limits(names, self._parts, settings.core_max_C, settings.surface_limit_C, stale_s)
        models = [s.plan.model for s in estimators.strings]
        rise, cools_s = np.array([_least_rise(m) for m in models]), np.array([_longest_s(m) for m in models])
        self._confirm = Confirm(self._parts, rise, cools_s)
        self.runaway = Runaway(names, self._parts)
        self._nearing = {name: Nearing(name, settings.core_max_C) for name in names}
        self._sizes = [p.stop - p.start for p in self._parts]
        self._paused = False

    def wake(self, start_ns: int) -> None:
        """Start the grace time: at the first tick, and after each silence of the bus."""
        self.alerts.begin(start_ns / 1e9)
        for n in self._nearing.values():
            n.forget()

    def sense(self, readings: Readings, t1: int, heard: int) -> list[Event]:
        """Take the readings and estimates of a tick before they are sent; new runaways are reported at once.

        Parameters
        ----------
        readings : Readings
            Readings that the guard has accepted.
        t1 : int
            End of the tick, ns.
        heard : int
            Stamp of the newest wanted frame, ns.
        """
        newest, raw = self._estimators.newest, self._inputs.raw()
        quality = readings.quality
        failed = (quality != GOOD) & (quality != ESTIMATED) & (quality != NEVER)
        beyond = raw.value >= self.limits.surface.limit
        beyond |= (quality == ABOVE[0]) & (raw.value > 0.0) | (quality == ABOVE[1])
        square, hot = readings.means[1], self.limits.surface
        surfaces = Surfaces(readings.y, hot.fallen, hot.over, hot.rate)
        confirmed = self._confirm.step(t1 / 1e9, square, readings.inlet, surfaces)
        jumpy = np.where(quality == JUMPY, raw.value, np.nan)
        wrong = self._wrong()
        sensed = Sensed(readings.y, failed, beyond, jumpy, confirmed, failed & (quality != STALE), wrong)
        seen = np.repeat(readings.seen(GOOD), self._sizes)
        watched = ((quality == GOOD) | (quality == ESTIMATED)) & seen
        known = (newest.quality == GOOD) | (newest.quality == ESTIMATED) | (newest.quality == DOUBTFUL)
        trusted = watched & known & ~wrong
        quiet = t1 - heard >= QUIET_S * 1e9
        core, centre, centre_sd = newest.with_withheld()
        self.limits.step(t1 / 1e9, Points(centre, centre_sd, core, trusted, watched), sensed, quiet)
        told: list[Event] = []
        current = np.repeat(readings.means[4], self._sizes)
        if self.runaway.step(raw.value, raw.time_s, raw.invalid, raw.volt, current):
            new = self.runaway.told
            told = [Notice(t1, Level.WARNING, "runaway", c.text, c.string, c.cell) for c in new]
        for s in self._estimators.strings:
            s.hot = self.limits.over(s.mine)
            s.fire = tuple(np.flatnonzero(self.runaway.latched[s.mine]).tolist())
            s.burning = s.runaway or self.limits.measured_over(s.mine)
        return told

    def step(self, t1: int, heard: int, *, silent: bool) -> list[Alerted]:
        """Update the alerts at the end of a tick.

        Parameters
        ----------
        t1 : int
            End of the tick, ns.
        heard : int
            Stamp of the newest wanted frame, ns.
        silent : bool
            Whether the bus falls asleep now: the next update then comes only when it wakes.

        Returns
        -------
        list of Alerted
        """
        pause_s, now_s = (t1 - heard) / 1e9, t1 / 1e9
        if self._paused and pause_s < QUIET_S:
            self.alerts.begin(now_s)
        self._paused = pause_s >= PAUSE_S
        for nearing, s in zip(self._nearing.values(), self._estimators.strings, strict=True):
            if silent or pause_s >= PAUSE_S:  # forecasts go on for a while, of a load that nobody measures
                nearing.silent(pause_s)
            elif s.forecast is not None and s.forecast.time_ns == t1:
                nearing.take(s.forecast.approach(), s.forecast.peak, s.forecast.unknown)
        now = list(self._conditions(quiet=pause_s >= QUIET_S))
        self._endings.see(now, quiet=pause_s >= QUIET_S)
        changes = self.alerts.update(now_s, now, last=silent)
        return [Alerted(t1, change) for change in changes]

    def hear(self, events: Iterable[Event]) -> None:
        """Take the events since the last `step`: a notice that a fault has ended gives the reason to its alert."""
        for e in events:
            if isinstance(e, Notice) and e.level is Level.NOTICE:
                code = "ageing" if e.code == "baseline" else e.code
                self._endings.take(code, e.string or "", e.part, e.cell, e.text)

    def _ended(self, last: Condition) -> Condition:
        """Return the condition of an alert that ends now with the sentence that says why."""
        nearing = self._nearing.get(last.string or "") if last.name == "forecast" else None
        return self._endings.of(last, self.limits.why_over(last) if nearing is None else nearing.why_over)

    def _wrong(self) -> NDArray[np.bool_]:
        """Which cells (N,) have a thermocouple that is reported to be wrong: alone, it ends no alarm."""
        wrong = np.zeros(len(self._estimators.newest.core), np.bool_)
        for s in self._estimators.strings:
            wrong[[s.mine.start + k for k in s.wrong]] = True
        return wrong

    def _conditions(self, *, quiet: bool) -> Iterator[Condition]:
        """List what is wrong now: runaways first, then causes before their consequences."""
        strings = self._estimators.strings
        yield from self.runaway.conditions()
        yield from self.limits.conditions()
        if not quiet:
            yield from of_inputs(self._inputs, strings)
        yield from of_strings(strings)
        yield from (n.condition for n in self._nearing.values() if n.condition is not None)

    def acknowledge(self, string: str | None) -> bool:
        """End the alarms that only a person may end; return whether there were any.

        Parameters
        ----------
        string : str or None
            None for all.
        """
        found = False
        latched = (*self.runaway.conditions(), *self.limits.conditions())
        self._endings.acknowledge(c for c in latched if string in (None, c.string))
        for s in self._estimators.strings:
            if string in (None, s.plan.name):
                found |= self.runaway.acknowledge(s.mine)
                found |= self.limits.acknowledge(s.mine)
        return found

    def snapshot(self) -> dict[str, Any]:
        """State of the strings that have alarms, as JSON-able values: a restart must not end an alarm."""
        return {
            s.plan.name: {"limits": self.limits.snapshot(s.mine), "runaway": self.runaway.snapshot(s.mine)}
            for s in self._estimators.strings
            if s.hot or s.runaway
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a stored state for the strings that still exist with the same number of cells."""
        for s in self._estimators.strings:
            if (stored := state.get(s.plan.name)) is not None and len(stored["limits"]["lost"]) == len(s.core):
                self.limits.restore(s.mine, stored["limits"])
                self.runaway.restore(s.mine, stored["runaway"])


def _least_rise(model: StringModel) -> float:
    """Least rise of a surface above its coolant per square of the current, within the model file's sd, K/A²."""
    least = [float(np.min(p.value)) / (1.0 + p.rel_sd) for p in (model.priors["R_e"], model.priors["R_u"])]
    return least[0] * least[1]


def _longest_s(model: StringModel) -> float:
    """Longest time constant with which a cell cools, within the model file's sd, s."""
    most = {name: float(np.max(p.value)) * (1.0 + p.rel_sd) for name, p in model.priors.items()}
    return (most["C_c"] + most["C_s"]) * (most["R_c"] + most["R_u"])
