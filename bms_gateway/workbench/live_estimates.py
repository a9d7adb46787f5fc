"""Estimates of a pack, tick by tick, for any number of tabs, each of which shows its own moment.

A live bus and a played log work in the same way. The engine runs as fast as it gets frames, every tick is kept, and a
tab shows one tick. Going back, pausing and playing at another speed therefore do not change the estimates.
"""

import json
import secrets
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine import Alerted, Decoded, Engine, Estimated, Event, Judged, Notice
from bms_gateway.engine.forecast_result import TOLD_S, Forecast
from bms_gateway.engine.reasons import REASONS, unused
from bms_gateway.errors import UsageError
from bms_gateway.frames.quality import AVAILABLE_SD_K, Quality
from bms_gateway.health.limit_words import BAND_SD
from bms_gateway.thermal.centre import hottest_of
from bms_gateway.workbench.history import SET_NS, driven_by, history, past_of, table
from bms_gateway.workbench.incidents import Events, alerts_now
from bms_gateway.workbench.kept_ticks import KeptTicks, Tick
from bms_gateway.workbench.signal_ring import Signals
from bms_gateway.workbench.stretch import Ends, of_ends

PERIOD_S: Final = 0.4
"""Time between two pictures: two and a half a second. Cells change more slowly; more pictures would only cost time."""
TREND: Final = 48
"""Points of the trend of R_e: as many as its small figure has room for."""
MOST_VIEWS: Final = 16
FARTHEST_S: Final = 1e10  # no time of a log is beyond; an integer of a thousand digits cannot become a float
SPEEDS: Final = (1, 2, 5, 10, 20, 50, 100)
BEHIND_NS: Final = 3_000_000_000
"""A tab that is nearer to the newest tick than this follows it."""
STALE_S: Final = 3.0
"""Age above which shown values are marked as outdated."""
HEAT_SDS: Final = 2.0
"""Distance from zero, in sd, of unexplained heat; below, it may be zero."""
WORDS: Final = {int(q): q.name.lower().replace("_", " ") for q in Quality}
WHY: Final = {int(q): text for q, text in REASONS.items()} | {
    int(Quality.GOOD): "measured and used",
    int(Quality.ESTIMATED): "no sensor of its own: estimated from the model and its neighbours",
    int(Quality.DOUBTFUL): "core not proven: the model file or the drive speaks against it",
}


@dataclass(slots=True)
class _View:
    """Position of a tab in time: `at_ns` is None while it follows the newest tick."""

    at_ns: float | None
    playing: bool = True
    speed: float = 1.0
    moved: float = field(default_factory=time.monotonic)


class Watch:
    """See the module's text.

    Parameters
    ----------
    engine : Engine
        An engine that only listens.
    kind : {"live", "log"}
    title : str
        Name of the bus or the log.
    bitrate : float
        Of the bus, bit/s.
    bus : callable
        Returns received, dropped, bits and the state of the link so far.

    Attributes
    ----------
    ticks : KeptTicks
    events : Events
    kept_s : float
        Arrival of the newest tick, by the monotonic clock.
    """

    def __init__(
        self,
        engine: Engine,
        kind: Literal["live", "log"],
        title: str,
        bitrate: float,
        bus: Callable[[], dict[str, Any]],
    ) -> None:
        self.kind, self.title, self.bitrate = kind, title, bitrate
        self._engine, self._bus = engine, bus
        self._alerts = engine.plan.alerts
        self._parked_s = engine.plan.silent_after_ns * 1e-9
        self._parts = list(_parts([s.plan.model.cells for s in engine.strings]))
        self._read = np.full((2, self._parts[-1].stop if self._parts else 0), np.nan)  # °C; s, as the bus counts
        self._lock = threading.Lock()
        self.ticks = KeptTicks(thinned=kind == "log")
        self.events = Events()
        self.signals = Signals(engine)
        engine.judging = True  # the inputs of the strings are a part of their past
        self._trend: dict[str, list[tuple[int, float, float]]] = {s.plan.name: [] for s in engine.strings}
        self._views: OrderedDict[str, _View] = OrderedDict()
        self._before: tuple[int, int, int] | None = None
        self._heard = (0, 0)  # wanted frames so far, and the end of the tick in which the newest came
        self.kept_s = time.monotonic()
        self.problem = ""
        """Why there will be no more ticks, as one line; empty while there may be."""
        self.whole = False
        """Whether a log has been read to its end."""

    def about(self) -> dict[str, Any]:
        """Return what does not change."""
        return {
            "kind": self.kind,
            "title": self.title,
            "bitrate": self.bitrate,
            "speeds": list(SPEEDS),
            "view": secrets.token_urlsafe(9),
            "words": {str(k): w for k, w in WORDS.items()},
            "why": {str(k): w for k, w in WHY.items()},
            "limits": {"core_C": self._alerts.core_max_C, "surface_C": self._alerts.surface_limit_C},
            "available": {"K": AVAILABLE_SD_K, "unknown_95": BAND_SD * AVAILABLE_SD_K},
            "strings": [
                {
                    "name": s.plan.name,
                    "cells": s.plan.model.cells,
                    "sensors": list(s.plan.model.sensors),
                    "nominal_m3_s": s.plan.model.flow,
                }
                for s in self._engine.strings
            ],
        }

    # written by whoever drives the engine

    def take(self, event: Event) -> None:
        """Use the engine's next event."""
        if isinstance(event, Notice | Alerted):
            with self._lock:
                self.events.take(event)
        elif isinstance(event, Decoded):
            self.signals.take(event)
        elif isinstance(event, Estimated):
            self._keep(event)
        if isinstance(event, Judged):
            self._hear(event)
        if isinstance(event, Judged) and self.ticks and self.ticks.last_ns == event.time_ns:
            tick = self.ticks.at(event.time_ns)
            driven_by(tick.past, event)
            tick.read[:] = self._read[0], event.time_ns * 1e-9 - self._read[1]
            if event.frames != self._heard[0]:
                self._heard = event.frames, event.time_ns
            tick.bus["silent_s"] = (event.time_ns - self._heard[1]) * 1e-9

    def _hear(self, told: Judged) -> None:
        """Keep the newest reading of each surface, and its time, s; what is left out between two ticks too."""
        for part, s in zip(self._parts, told.strings, strict=True):
            new = np.isfinite(s.surface)
            value, time_s = self._read[:, part]
            value[new] = s.surface[new]
            time_s[new] = told.time_ns * 1e-9 - s.age[new]

    def _keep(self, told: Estimated) -> None:
        time_ns = told.time_ns
        numbers = (told.core, told.core_sd, told.surface, told.centre, told.centre_sd, told.heat, told.heat_sd)
        cells = np.stack(numbers).astype(np.float32)
        raised = alerts_now(self._engine.alerts.raised)
        past = past_of(cells, self._parts, [s.plan.name for s in self._engine.strings], raised)
        strings = []
        for s in self._engine.strings:
            R_e = next((e for e in s.estimates if e.name == "R_e"), None)
            strings.append(
                {
                    "R_e": None if R_e is None else [_n(1e3 * R_e.value, 4), _n(1.96e3 * R_e.sd, 4), R_e.status],
                    "growth": _n(100.0 * s.ageing.growth, 2),
                    "mismatch": _n(s.mismatch.excess**0.5, 3) if s.mismatch.excess >= 0.0 else None,
                    "flags": list(s.flags),
                    "ahead": _ahead(s.forecast),
                }
            )
            trend = self._trend[s.plan.name]
            if R_e is not None and (not trend or trend[-1][1:] != (R_e.value, R_e.sd)):
                trend.append((time_ns, R_e.value, R_e.sd))
        read = np.full((2, len(told.core)), np.nan, np.float32)
        tick = Tick(time_ns, cells, read, told.quality, past, tuple(strings), raised, self._traffic(time_ns))
        with self._lock:
            self.kept_s = time.monotonic()
            self.ticks.add(tick)

    def _traffic(self, time_ns: int) -> dict[str, Any]:
        now = self._bus()
        received, bits = int(now["received"]), int(now["bits"])
        found = {"received": received, "dropped": now["dropped"], "link": now["link"], "per_s": None, "load": None}
        if self._before is not None and time_ns > self._before[0]:
            seconds = (time_ns - self._before[0]) * 1e-9
            found["per_s"] = round((received - self._before[1]) / seconds, 1)
            found["load"] = round(100.0 * (bits - self._before[2]) / seconds / self.bitrate, 2)
        self._before = (time_ns, received, bits)
        found["refused"] = unused(self._engine.rejected)
        return found

    # read by tabs

    def steer(self, name: str, wish: Mapping[str, Any]) -> None:
        """Move a tab: `seek` to a time in s since the first tick, `play`, `speed`, `follow` the newest.

        Raises
        ------
        UsageError
        """
        with self._lock:
            view = self._view(name)
            self._move(view)
            if "speed" in wish:
                if wish["speed"] not in SPEEDS:
                    raise UsageError(f"speed: valid are {', '.join(map(str, SPEEDS))}")
                view.speed = float(wish["speed"])
            if "play" in wish:
                view.playing = bool(wish["play"])
                if view.at_ns is None and self.ticks:
                    view.at_ns = float(self.ticks.last_ns)
            if "seek" in wish:
                to = wish["seek"]
                if isinstance(to, bool) or not isinstance(to, int | float) or not abs(to) < FARTHEST_S:
                    raise UsageError("seek: a time in s is needed")
                if self.ticks:
                    first, last = self.ticks.first_ns, self.ticks.last_ns
                    view.at_ns = float(np.clip(first + to * 1e9, first, last))
            if wish.get("follow"):
                view.at_ns, view.playing = None, True

    def stream(self, name: str) -> Iterator[str]:
        """Yield pictures as JSON, `PERIOD_S` apart; an empty text if nothing has changed."""
        last: dict[str, Any] | None = None
        while True:
            with self._lock:
                view = self._view(name)
                self._move(view)
                picture = self._picture(view)
            yield json.dumps(picture, separators=(",", ":"), allow_nan=False) if picture != last else ""
            last = picture
            time.sleep(PERIOD_S)

    def _view(self, name: str) -> _View:
        if name not in self._views:
            self._views[name] = _View(float(self.ticks.first_ns) if self.kind == "log" else None)
            if len(self._views) > MOST_VIEWS:
                self._views.popitem(last=False)
        self._views.move_to_end(name)
        return self._views[name]

    def _move(self, view: _View) -> None:
        """Advance a tab's moment with the wall clock, at its speed."""
        now = time.monotonic()
        passed, view.moved = now - view.moved, now
        if view.at_ns is None or not self.ticks:
            return
        view.at_ns = max(view.at_ns, float(self.ticks.first_ns))
        if view.playing:
            view.at_ns = min(view.at_ns + passed * view.speed * 1e9, float(self.ticks.last_ns))
            if self.kind == "live" and view.speed >= 1 and self.ticks.last_ns - view.at_ns < BEHIND_NS and passed > 0:
                view.at_ns = None if view.speed > 1 else view.at_ns

    def _picture(self, view: _View) -> dict[str, Any]:
        if not self.ticks:
            return {"ticks": 0, "problem": self.problem, "link": self._bus()["link"]}
        at = self.ticks.last_ns if view.at_ns is None else int(view.at_ns)
        tick, first = self.ticks.at(at), self.ticks.first_ns
        age = (at - tick.time_ns) * 1e-9 + (self._age_s() if view.at_ns is None else 0.0)
        silent = age + tick.bus.get("silent_s", 0.0)  # the engine continues for a while without frames
        return {
            "ticks": len(self.ticks),
            "problem": self.problem,
            "at": round((at - first) * 1e-9 + (self._age_s() if view.at_ns is None else 0.0), 2),
            "last": round((self.ticks.last_ns - first) * 1e-9, 3),
            "first_s": first / 1e9,
            "wall_ms": tick.time_ns // 1_000_000 if tick.time_ns >= SET_NS else None,
            "age": round(age, 1),
            "silent": round(silent, 1),
            "state": "now" if silent <= STALE_S else "stale" if silent < self._parked_s else "parked",
            "alerts": tick.alerts,
            "whole": self.whole,
            "following": view.at_ns is None,
            "playing": view.playing,
            "speed": view.speed,
            "strings": self._strings(tick, age),
            "bus": tick.bus,
            "events": self.events.grouped(tick.time_ns, first),
        }

    def history(self, name: str, string: int, span_s: float, ends: Ends | None = None) -> dict[str, Any]:
        """Return the past of one string (from 0): between `ends`, or `span_s` back from the tab's moment; 0: all.

        Raises
        ------
        UsageError
        """
        if not 0 <= string < len(self._parts):
            raise UsageError(f"history: string: valid are 0 to {len(self._parts) - 1}")
        with self._lock:
            ticks = self.ticks.back(*self._stretch(name, span_s, ends))
            if not ticks:
                return {"t": [], "marks": []}
            ends, first = (ticks[0].time_ns, ticks[-1].time_ns), self.ticks.first_ns
            of = self._engine.strings[string].plan.name
            marks = self.events.marks(of, *ends, first)
        return {**history(ticks, string, self._parts[string], of, first), "marks": marks, "first_s": first / 1e9}

    def table(self, name: str, span_s: float, ends: Ends | None = None) -> Iterator[bytes]:
        """Write the estimates as CSV; the stretch is that of `history`, the clock that of the frames."""
        with self._lock:
            ticks = self.ticks.back(*self._stretch(name, span_s, ends))
        return table(ticks, [s.plan.name for s in self._engine.strings], self._parts, WORDS)

    def acknowledge(self, name: str, wish: Mapping[str, Any]) -> None:
        """Mark the events of one group as seen, until the tab's moment; the next one is new again.

        Raises
        ------
        UsageError
        """
        given = [wish.get(k, "") for k in ("code", "part", "string", "reason")]
        if not all(isinstance(x, str) for x in given):
            raise UsageError("acknowledge: code, part, string and reason must be texts")
        code, part, string, reason = map(str, given)
        with self._lock:
            view = self._view(name)
            until = self.ticks.last_ns if view.at_ns is None else int(view.at_ns)
            group = code, part, string, bool(wish.get("alert"))
            self.events.acknowledge(group, " ".join(reason.split())[:200], until)

    def events_table(self) -> bytes:
        """Write all events as CSV, oldest first, with acknowledgements; on the clock of the frames."""
        with self._lock:
            return self.events.table()

    def stretch_ns(self, name: str, span_s: float, ends: Ends | None) -> tuple[int, int]:
        """Return the first and the last moment, ns, of the signals in a stretch, which is that of `history`.

        They are those of its first and its last estimate. The very first estimate stands at the end of the tick whose
        signals it is made of: the stretch then begins with this tick, or where it was asked to begin within it.

        Raises
        ------
        UsageError
            There are no estimates.
        """
        with self._lock:
            until_ns, length_s = self._stretch(name, span_s, ends)
            ticks = self.ticks.back(until_ns, length_s)
        if not ticks:
            raise UsageError("window: there are no estimates in this stretch")
        first_ns = ticks[0].time_ns
        if first_ns == self.ticks.first_ns:
            began_ns = first_ns - self._engine.plan.tick_ns
            asked_ns = until_ns - int(length_s * 1e9) if length_s > 0.0 else began_ns
            first_ns = min(max(began_ns, asked_ns), first_ns)
        return first_ns, ticks[-1].time_ns

    def refused(self, string: int, first_ns: int, last_ns: int) -> dict[int, str]:
        """Return the cells of a string (from 0) whose thermocouple is not to be used in a stretch, and why."""
        with self._lock:
            return self.events.refused(self._engine.strings[string].plan.name, first_ns, last_ns)

    def _stretch(self, name: str, span_s: float, ends: Ends | None) -> tuple[int, float]:
        if ends is not None:
            return of_ends(ends)
        at = self._view(name).at_ns
        return self.ticks.last_ns if at is None else max(int(at), self.ticks.first_ns), span_s

    def _age_s(self) -> float:
        """Time since the newest tick, s; it grows while a live bus is silent."""
        return 0.0 if self.whole else time.monotonic() - self.kept_s

    def _strings(self, tick: Tick, age_s: float) -> list[dict[str, Any]]:
        found = []
        dark = np.flatnonzero(np.isnan(tick.cells[0]) & np.isfinite(tick.read[0])).tolist()
        for s, part, known in zip(self._engine.strings, self._parts, tick.strings, strict=True):
            core, sd, surface, centre, centre_sd, heat, heat_sd = tick.cells[:, part]
            quality = tick.quality[part]
            trend = [
                [round(t * 1e-9, 1), _n(1e3 * R, 4), _n(1.96e3 * e, 4)]
                for t, R, e in self._trend[s.plan.name]
                if t <= tick.time_ns
            ]
            words = [a["text"] for a in tick.alerts if a["string"] == s.plan.name]
            found.append(
                {
                    **known,
                    "core": [_n(x, 2) for x in core.tolist()],
                    "half": [_n(1.96 * x, 2) for x in sd.tolist()],
                    "surface": [_n(x, 2) for x in surface.tolist()],
                    "quality": quality.tolist(),
                    "centre": [_n(x, 2) for x in centre.tolist()],
                    "centre_half": [_n(1.96 * x, 2) for x in centre_sd.tolist()],
                    "hottest": hottest_of(centre),
                    "trend": trend[-TREND:],
                    "words": words,
                    # of cells whose core is not known: what was read at their surface, and how long ago
                    "read": {
                        k - part.start: [_n(x, 2), _n(x_age + age_s, 1)]
                        for k in dark
                        if part.start <= k < part.stop
                        for x, x_age in [tick.read[:, k].tolist()]
                    },
                    "heat": _heat(heat, heat_sd),
                }
            )
        return found


def _parts(cells: Sequence[int]) -> Iterator[slice]:
    first = 0
    for n in cells:
        yield slice(first, first + n)
        first += n


def _heat(heat: NDArray[np.float32], sd: NDArray[np.float32]) -> list[float | int | None] | None:
    """Return the cell with the surest unexplained heat, with this heat and its 95 % half width, W."""
    with np.errstate(invalid="ignore"):
        ratio = np.where(np.isfinite(heat) & (sd > 0.0), heat / sd, -np.inf)
    k = int(ratio.argmax())
    return [k + 1, _n(heat[k], 2), _n(1.96 * sd[k], 2)] if ratio[k] > HEAT_SDS else None


def _ahead(f: Forecast | None) -> dict[str, Any] | None:
    """Return the forecast of the cell that will be hottest; None if its temperature is not known to 12 K."""
    if f is None or (k := f.hottest) is None:
        return None
    first = f.first
    told = [h if f.centre_sd[h, k] <= AVAILABLE_SD_K else None for h in TOLD_S]
    if told[0] is None:
        return None
    return {
        "cell": k + 1,
        "load_A": _n(f.load, 1),
        "point": [None if h is None else _n(f.centre[h, k], 2) for h in told],
        "half": [None if h is None else _n(1.96 * f.centre_sd[h, k], 2) for h in told],
        "limit_s": None if first is None else [first + 1, _n(f.limit_s[first], 0)],
        "discharge": [_n(x, 0) for x in f.discharge.tolist()],
        "charge": [_n(x, 0) for x in f.charge.tolist()],
        "limiting": f.limiting + 1,
    }


def _n(x: float, digits: int) -> float | None:
    """Round for the page; None for NaN."""
    return round(float(x), digits) if isfinite(x) else None


def bits_on_wire(can_id: Sequence[int] | NDArray[np.uint32], length: NDArray[np.uint8], extended: int) -> int:
    """Count the bits of classic frames without stuff bits (up to a fifth more, depending on the data).

    Examples
    --------
    >>> bits_on_wire(np.array([0x100], np.uint32), np.array([8], np.uint8), 0x8000_0000)
    111
    """
    ids = np.asarray(can_id)
    frame = np.where((ids & extended) != 0, 67, 47)  # start to interframe space, without data
    return int(frame.sum() + 8 * length.astype(np.int64).sum())
