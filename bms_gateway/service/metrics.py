"""The metrics of the gateway for Prometheus, read from the present state when a client asks for the page.

Labels are few and bounded: strings by the config; reasons, classes, codes and flags by the program. Cells have no
label; the number of the hottest cell is a value. A value that is not known (a core without estimate, a growth without
baseline) is left out, so that no rule takes it for zero.
"""

import os
import platform
import resource
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from bms_gateway import __version__
from bms_gateway.bus.canframe import ERROR_CLASSES
from bms_gateway.bus.port import Link
from bms_gateway.engine.forecast_result import FOR_S, TOLD_S
from bms_gateway.frames.quality import Quality
from bms_gateway.health.alerts import Severity
from bms_gateway.service.exposition import Family, Sample, page
from bms_gateway.service.live import Gateway
from bms_gateway.service.watch import Watch, WatchedEngine, WatchedString
from bms_gateway.thermal.centre import hottest_of

PREFIX: Final = "bms_gateway_"
UNREFUSED: Final = (Quality.GOOD, Quality.ESTIMATED, Quality.DOUBTFUL, Quality.NEVER)
REASONS: Final = [q.name.lower() for q in Quality if q not in UNREFUSED]
FLAGS: Final = (
    *("ageing", "cooling", "current", "inlet", "mismatch", "missing_heat", "self_discharge", "thermocouple"),
    "unexplained_heat",
)
"""Flags of a string, named as in `StringHealth.conditions`."""


class MeasuredEngine(WatchedEngine, Protocol):
    """What the page needs of the engine in addition to `WatchedEngine`."""

    frames: int

    @property
    def rejected(self) -> dict[str, int]:
        """Samples refused, by reason."""
        ...


class Page:
    """The page of one gateway.

    Parameters
    ----------
    gateway : Gateway
    engine : callable
        Returns the present engine.
    watch : Watch
    more : callables, optional
        Families of metrics of other parts.
    """

    def __init__(
        self,
        gateway: Gateway,
        engine: Callable[[], MeasuredEngine],
        watch: Watch,
        more: Sequence[Callable[[], Iterator[Family]]] = (),
    ) -> None:
        self._gateway, self._engine, self._watch = gateway, engine, watch
        self._more = more
        self._started_s = time.time()

    def __call__(self) -> bytes:
        """Make the page as text."""
        return page(self.families())

    def families(self) -> Iterator[Family]:
        """Yield all metrics, in the order of the page."""
        engine = self._engine()
        yield from self._process()
        yield from self._bus()
        yield from self._shell(engine)
        yield from _strings(engine)
        yield from self._alerts()
        for part in self._more:
            yield from part()

    def _process(self) -> Iterator[Family]:
        usage = resource.getrusage(resource.RUSAGE_SELF)
        version = {"version": __version__, "python": platform.python_version()}
        yield Family(f"{PREFIX}build_info", "gauge", "Version that runs; always 1.", (("", version, 1.0),))
        yield _gauge("uptime_seconds", "Time since the start.", time.time() - self._started_s)
        yield Family("process_start_time_seconds", "gauge", "Start, seconds since 1970.", (("", {}, self._started_s),))
        cpu = usage.ru_utime + usage.ru_stime
        yield Family("process_cpu_seconds_total", "counter", "Processor time used.", (("", {}, cpu),))
        resident = Family("process_resident_memory_bytes", "gauge", "Memory held.", (("", {}, resident_bytes()),))
        yield resident

    def _bus(self) -> Iterator[Family]:
        c, link = self._gateway.port.counters, self._gateway.port.link
        yield _counter("frames_received_total", "Frames taken from the bus.", c.received)
        yield _counter("frames_sent_total", "Frames put on the bus.", c.sent)
        yield _counter("frames_lost_total", "Frames lost in the kernel, read too late.", c.dropped)
        unsent = {"stale": c.stale, "overflow": c.overflow, "limited": c.limited}
        yield _counter("frames_unsent_total", "Own frames not sent, by reason.", unsent, "reason")
        ignored = {"remote": c.remote, "malformed": c.malformed}
        yield _counter("frames_ignored_total", "Frames that carry no data, by reason.", ignored, "reason")
        yield _counter("impostors_total", "Frames with identifiers of this node from another sender.", c.impostors)
        errors = dict.fromkeys(ERROR_CLASSES.values(), 0) | c.errors
        yield _counter("bus_errors_total", "Error frames by class.", errors, "class")
        yield _gauge("bus_up", "1 while the bus can be read and written.", float(link is Link.UP))
        states = {state.value: float(link is state) for state in Link}
        yield _gauge("bus_state", "1 for the state in which the link is.", states, "state")
        yield _counter("bus_outages_total", "Times the interface went down, away, or bus-off.", c.outages)
        yield _counter("clock_steps_total", "Times the wall clock was set.", c.clock_steps)
        yield _counter("frames_misdated_total", "Frames whose stamp could not be true.", c.misdated)

    def _shell(self, engine: MeasuredEngine) -> Iterator[Family]:
        t = self._gateway.tally
        yield _counter("frames_used_total", "Frames that carried an input.", engine.frames)
        rejected = dict.fromkeys(REASONS, 0) | engine.rejected
        yield _counter("samples_rejected_total", "Samples refused, by reason.", rejected, "reason")
        awake = engine.next_deadline() is not None
        yield _gauge("awake", "1 while the bus talks and the estimators tick.", float(awake))
        yield _counter("wakes_total", "Pauses of the bus that ended.", t.wakes)
        yield _counter("ticks_total", "Ticks of the estimators.", t.ticks)
        bounds = [*map(str, t.lateness.bounds), "+Inf"]
        counts = t.lateness.cumulative()
        samples: list[Sample] = [("_bucket", {"le": b}, n) for b, n in zip(bounds, counts, strict=True)]
        samples += [("_sum", {}, t.lateness.total), ("_count", {}, counts[-1])]
        late = "From the end of a tick in bus time to its output."
        yield Family(f"{PREFIX}tick_lateness_seconds", "histogram", late, tuple(samples))
        yield _counter("jobs_total", "Identifications handed to the worker.", t.jobs)
        yield _counter("jobs_late_total", "Identifications that came after their time.", t.jobs_late)
        yield _counter(
            "jobs_failed_total", "Tries of an identification that hung, died or could not start.", t.jobs_failed
        )
        age_s = float("nan") if t.saved_s is None else time.monotonic() - t.saved_s  # left out where nothing is kept
        yield _gauge("state_age_seconds", "Age of the newest state on disk, while awake.", age_s)
        yield _counter("state_saves_total", "Snapshots saved.", t.saves)
        yield _counter("state_save_failures_total", "Snapshots that could not be saved.", t.saves_failed)
        reloads = {"taken": t.reloads, "refused": t.reloads_refused}
        yield _counter("reloads_total", "Configurations read again, by result.", reloads, "result")
        yield _counter("notices_total", "Notices, by code.", t.notices, "code")

    def _alerts(self) -> Iterator[Family]:
        raised = self._watch.alerts.raised
        state = self._watch.alerts.severity
        yield _gauge("state", "0 OK, 1 warning, 2 alarm.", float(state))
        severities = [s for s in Severity if s]
        numbers = {s.name.lower(): float(sum(c.severity is s for c in raised)) for s in severities}
        yield _gauge("alerts", "Alerts now, by severity.", numbers, "severity")
        places: dict[tuple[str, str], Severity] = {}
        for c in raised:
            key = (c.name, c.string or "")
            places[key] = max(places.get(key, c.severity), c.severity)
        samples = tuple(("", {"alert": n, "string": s}, float(level)) for (n, s), level in places.items())
        yield Family(f"{PREFIX}alert", "gauge", "Alert now: 1 warning, 2 alarm; absent when over.", samples)


def _strings(engine: MeasuredEngine) -> Iterator[Family]:
    strings = engine.strings
    points = [(s, k) for s in strings if (k := hottest_of(s.centre)) is not None]
    yield _of_strings(
        "hottest_point_celsius", "Hottest point of a cell.", {s.plan.name: float(s.centre[k]) for s, k in points}
    )
    sd = {s.plan.name: float(s.centre_sd[k]) for s, k in points}
    yield _of_strings("hottest_point_sd_kelvin", "Standard deviation of the hottest point.", sd)
    cells = {s.plan.name: k + 1.0 for s, k in points}
    yield _of_strings("hottest_point_cell", "Cell with the hottest point, from 1.", cells)
    hottest = [(s, k) for s in strings if (k := hottest_of(s.core)) is not None]
    yield _of_strings("core_max_celsius", "Hottest core.", {s.plan.name: float(s.core[k]) for s, k in hottest})
    sd = {s.plan.name: float(s.core_sd[k]) for s, k in hottest}
    yield _of_strings("core_max_sd_kelvin", "Standard deviation of the hottest core.", sd)
    yield _of_strings(
        "core_max_cell", "Cell with the hottest core, from 1.", {s.plan.name: k + 1.0 for s, k in hottest}
    )
    coldest = {s.plan.name: float(np.nanmin(s.core)) for s, _ in hottest}
    yield _of_strings("core_min_celsius", "Coldest core.", coldest)
    qualities = [
        ("", {"string": s.plan.name, "quality": q.name.lower()}, float((s.quality == q).sum()))
        for s in strings
        for q in Quality
    ]
    yield Family(f"{PREFIX}cells", "gauge", "Cells by the quality of their estimate.", tuple(qualities))
    heating = [(s, int(np.nanargmax(s.own_heat))) for s in strings if not np.isnan(s.own_heat).all()]
    yield _of_strings(
        "unexplained_heat_watts",
        "Greatest heat of a cell that no current makes.",
        {s.plan.name: float(s.own_heat[k]) for s, k in heating},
    )
    heat_sd = {s.plan.name: float(s.own_heat_sd[k]) for s, k in heating}
    yield _of_strings("unexplained_heat_sd_watts", "Standard deviation of that heat.", heat_sd)
    cells = {s.plan.name: k + 1.0 for s, k in heating}
    yield _of_strings("unexplained_heat_cell", "Cell with the greatest unexplained heat, from 1.", cells)
    yield from _ahead(strings)
    faults = {s.plan.name: 0.0 for s in strings}
    for name, *_ in engine.faults:
        faults[name] += 1.0
    yield _of_strings("inputs_faulty", "Inputs received but not usable now.", faults)
    health = {s.plan.name: s.health for s in strings}
    growth = {name: h.ageing.growth for name, h in health.items()}
    yield _of_strings("resistance_growth_ratio", "Growth of R_e since commissioning, 0.1 is +10 %.", growth)
    growth_sd = {name: h.ageing.growth_sd for name, h in health.items()}
    yield _of_strings("resistance_growth_sd_ratio", "Standard deviation of the growth.", growth_sd)
    cooling = {name: h.cooling.growth for name, h in health.items()}
    yield _of_strings("cooling_growth_ratio", "Growth of R_u since commissioning: cooling that got worse.", cooling)
    excess = {name: h.mismatch.excess**0.5 for name, h in health.items()}
    yield _of_strings("innovation_ratio", "Innovations over their band, rms of ten minutes; 1 is right.", excess)
    levels: dict[tuple[str, str], int] = {(name, flag): 0 for name in health for flag in FLAGS}
    for name, h in health.items():
        for raised in h.conditions():
            levels[name, raised.code] = max(levels.get((name, raised.code), 0), raised.level)
    flags = [("", {"string": name, "flag": flag}, float(level)) for (name, flag), level in levels.items()]
    text = "Level of a flag, 0 none; ageing 1 watch, 2 warning, 3 alarm; others 1 suspected, 2 confirmed."
    yield Family(f"{PREFIX}flag_level", "gauge", text, tuple(flags))


def _ahead(strings: Sequence[WatchedString]) -> Iterator[Family]:
    """Yield the forecast of the cell that will be hottest in ten minutes; nothing for strings without a forecast."""
    known = [(s.plan.name, f, k) for s in strings if (f := s.forecast) is not None and (k := f.hottest) is not None]
    points, sd = [], []
    for name, f, k in known:
        for h, seconds in TOLD_S.items():
            labels = {"string": name, "ahead_s": seconds}
            points.append(("", labels, float(f.centre[h, k])))
            sd.append(("", labels, float(f.centre_sd[h, k])))
    about = "Hottest point so many seconds ahead at the load of now."
    yield Family(f"{PREFIX}forecast_point_celsius", "gauge", about, tuple(points))
    yield Family(f"{PREFIX}forecast_point_sd_kelvin", "gauge", "Standard deviation of that forecast.", tuple(sd))
    soon = {name: float(f.limit_s.min()) for name, f, _ in known if f.first is not None}
    yield _of_strings(
        "forecast_limit_seconds", "Time to the limit at the load of now; absent beyond ten minutes.", soon
    )
    currents = []
    for name, f, _ in known:
        for way, of in (("discharge", f.discharge), ("charge", f.charge)):
            for seconds, value in zip(FOR_S, of.tolist(), strict=True):
                currents.append(("", {"string": name, "direction": way, "for_s": seconds}, float(value)))
    about = "Greatest constant current for so many seconds that keeps every hottest point below its limit."
    yield Family(f"{PREFIX}permitted_current_amperes", "gauge", about, tuple(currents))


def _gauge(name: str, text: str, value: float | Mapping[str, float], label: str = "") -> Family:
    return Family(PREFIX + name, "gauge", text, _samples(value, label))


def _counter(name: str, text: str, value: float | Mapping[str, float], label: str = "") -> Family:
    return Family(PREFIX + name, "counter", text, _samples(value, label))


def _of_strings(name: str, text: str, values: Mapping[str, float]) -> Family:
    return Family(PREFIX + name, "gauge", text, _samples(values, "string"))


def _samples(value: float | Mapping[str, float], label: str) -> tuple[Sample, ...]:
    if isinstance(value, Mapping):
        return tuple(("", {label: key}, float(v)) for key, v in value.items())
    return (("", {}, float(value)),)


def resident_bytes() -> float:
    """Memory that the process holds; NaN if the kernel does not report it."""
    try:
        return float(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")
    except (OSError, IndexError, ValueError):
        return float("nan")  # left out of the page, as every unknown value
