"""Temperature limits. An alarm ends only when good readings show that the cell is cool; missing readings do not end it.

A cell is *over* when its temperature reaches the limit. An estimate whose sd is greater than that of an available core
makes a cell over only where it reaches the limit also with its sd subtracted. A cell stays over until a credible value
is below the limit. A value is credible if it comes from good sensors, is `COOLER_K` below the limit, is below the limit
also with its sd added, and has not fallen faster than a cell can cool. The lowest temperature to which the cell can
have cooled is computed from its last high value, so that many small falls are judged like one large fall. A
thermocouple that has fallen faster may have come off. It ends no alarm, even when the cell could have cooled to its
reading in the meantime, until another reading confirms it. A cell whose temperature becomes unknown stays over; the
alarm then reports the last known value and the rate at which it rose.

A thermocouple that fails may be damaged by the heat of its cell. It is *lost in heat* if it fails while its cell heats
towards the limit, or if it reads beyond its range while a cell of its string heats near the limit, and if this lasts
for `LOST_S`. This alarm stays until a person acknowledges it, or until the sensor soon continues where it was.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.quality import AVAILABLE_SD_K
from bms_gateway.health.alerts import Condition, Severity
from bms_gateway.health.limit_words import banded, beside, clock, trend
from bms_gateway.thermal import Floats

Bools = NDArray[np.bool_]

COOLER_K: Final = 2.0  # so far below its limit a cell is no longer over
FALL_K_S: Final = 0.3  # greatest rate at which a cell cools: 60 K above its coolant, time constant three minutes
TREND_S: Final = 30.0  # time constant of the rate: 0.05 K of noise then give 0.1 K/min
FORGET_S: Final = 60.0  # a cell without a reading for longer has no rate
RISING_K_S: Final = 0.03  # 0.3 K in 10 s: faster than the drift of a sensor, and than a cell at rest
NEAR_K: Final = 10.0  # below the limit: a sensor that fails there while its cell rises may be destroyed by heat
AROUND_K: Final = 20.0  # the same for a sensor that reads beyond its range
SOON_S: Final = 60.0  # time within which the cell would have reached the limit
BACK_K: Final = 2.0  # a sensor that reads so close to its former course works again
LOST_S: Final = 5.0  # a short disturbance, and the time for which the guard then refuses the sensor, are shorter
FOUND_S: Final = 30.0  # a sensor that continues its course within this time was not lost
REBOUND_K: Final = 5.0  # a sensor that fell, and then rises by so much, touches its cell again
UNSEEN_S: Final = 10.0  # a cell without a reading for longer counts as unseen: one or two readings may be missing
SEEN_S: Final = 60.0  # a cell that was unseen counts as seen after so long: a loose contact makes one report, not ten
OLDER: Final = {"_high": "last", "_high_s": "last_s"}  # names that states of older versions have instead
MOST: Final = {
    "over": 1.0, "last": 1e4, "last_s": 1e10, "_slow": 1e4, "_high": 1e4, "_high_s": 1e10, "fallen": 1.0, "_low": 1e4,
}  # fmt: skip
"""Greatest magnitude that each value of a stored state may have, °C and s since 1970."""
UNKNOWN_SD_K: Final = 2.0 * AVAILABLE_SD_K
"""Sd of an estimate above which no value is told unless it is over the limit with this sd subtracted."""


@dataclass(frozen=True, slots=True)
class Sensed:
    """Surfaces of all N cells at one tick.

    Attributes
    ----------
    good : ndarray (N,)
        Reading of this tick, °C; NaN where there is no new good one.
    failed : ndarray of bool (N,)
        The sensor sends, and its readings are not good.
    beyond : ndarray of bool (N,)
        The sensor reads above the limit or above its range, with any quality.
    raw : ndarray (N,), optional
        Reading that the guard refuses because it jumped, °C; NaN for all other sensors.
    confirmed : ndarray of bool (N,), optional
        `Confirm` accepts the reading; None: nothing was confirmed or refused.
    broken : ndarray of bool (N,), optional
        The sensor itself is at fault and not only silent; None: all that failed are.
    wrong : ndarray of bool (N,), optional
        The sensor reads, but is reported to be wrong: it ends no alarm.
    """

    good: Floats
    failed: Bools
    beyond: Bools
    raw: Floats | None = None
    confirmed: Bools | None = None
    broken: Bools | None = None
    wrong: Bools | None = None


class Points(NamedTuple):
    """Hottest points of all N cells as estimated at one tick.

    Attributes
    ----------
    value, sd : ndarray (N,)
        °C, and its sd, K; NaN where unknown.
    core : ndarray (N,)
        Core, °C, for the text of the alarm.
    trusted : ndarray of bool (N,)
        The estimate may end an alarm: it is known, and uses good sensors, the cell's own one, or, for a cell without
        a sensor, some of its string.
    watched : ndarray of bool (N,), optional
        These sensors are read, whatever is known of the hottest point; None: where the estimate is trusted.
    """

    value: Floats
    sd: Floats
    core: Floats
    trusted: Bools
    watched: Bools | None = None


class Limit:
    """One limit for all N cells.

    Parameters
    ----------
    cells : int
    limit : float
        °C.

    Attributes
    ----------
    over : ndarray of bool (N,)
        See the module's text.
    last, last_s : ndarray (N,)
        Newest credible value, °C, and its time, s; NaN and −inf before the first one.
    fallen : ndarray of bool (N,)
        The value has fallen faster than a cell cools, or while its sensor was broken, and has not been confirmed since.
    """

    _STATE = ("over", "last", "last_s", "_slow", "_high", "_high_s", "fallen", "_low")

    def __init__(self, cells: int, limit: float) -> None:
        self.limit = limit
        self.over = np.zeros(cells, np.bool_)
        self.fallen = np.zeros(cells, np.bool_)
        self.last, self._slow = np.full((2, cells), np.nan)
        self.last_s = np.full(cells, -np.inf)
        # a value and its time, from which the cell can have cooled since; least value since the reading fell too fast
        self._high, self._high_s, self._low = np.full(cells, np.nan), np.full(cells, -np.inf), np.full(cells, np.nan)

    @property
    def rate(self) -> Floats:
        """Rate of the values when they were last known (N,), K/s; NaN where they never were."""
        rate: Floats = (self.last - self._slow) / TREND_S
        return rate

    def update(
        self,
        now_s: float,
        value: Floats,
        good: Bools,
        sd: Floats | float = 0.0,
        confirmed: Bools | None = None,
        broke: Bools | bool = False,
    ) -> None:
        """Take the values of a tick.

        Parameters
        ----------
        now_s : float
        value : ndarray (N,)
            °C; NaN where unknown.
        good : ndarray of bool (N,)
            The value may end an alarm.
        sd : ndarray (N,) or float
            Of the value, K.
        confirmed : ndarray of bool (N,), optional
            See `Sensed`.
        broke : ndarray of bool (N,), optional
            Where the sensor was broken since its last good reading.
        """
        above = (value >= self.limit) & ((sd <= AVAILABLE_SD_K) | (value - sd >= self.limit))  # NaN is not
        known = (good & np.isfinite(value)) | above
        self.over |= above
        heard = known & good
        lowest = self._high - FALL_K_S * (now_s - self._high_s)
        credible = ~(value < lowest - COOLER_K)  # NaN is
        fell = heard & ~(credible & ~(broke & (value < self._high - COOLER_K))) & ~self.fallen
        if fell.any() or self.fallen.any():
            self._low = np.where(fell, value, np.fmin(self._low, value))
            self.fallen |= fell
            held = True if confirmed is None else confirmed
            self.fallen &= ~(heard & credible & (held | (value >= self._low + REBOUND_K)))
            credible &= ~self.fallen
        if self.over.any():
            known &= above | ~self.over | credible
            ends = known & good if confirmed is None else known & good & confirmed
            self.over &= ~(ends & (value <= self.limit - COOLER_K) & (value + sd <= self.limit))
        higher = known & ~(value < lowest)
        self._high, self._high_s = np.where(higher, value, self._high), np.where(higher, now_s, self._high_s)
        since = now_s - self.last_s
        fresh = since > FORGET_S
        step = np.where(fresh, 1.0, 1.0 - np.exp(-np.minimum(since, FORGET_S) / TREND_S))
        start = np.where(fresh, value, self._slow)
        self._slow = np.where(known, start + step * (value - start), self._slow)
        self.last = np.where(known, value, self.last)
        self.last_s = np.where(known, now_s, self.last_s)

    def snapshot(self, part: slice) -> dict[str, list[float | None]]:
        """State of some cells as JSON-able values."""
        return {
            name.lstrip("_"): [x if np.isfinite(x) else None for x in getattr(self, name)[part].astype(float).tolist()]
            for name in self._STATE
        }

    def restore(self, part: slice, state: Mapping[str, Sequence[float | None]]) -> None:
        """Take up a stored state of as many cells."""
        for name in self._STATE:
            mine, unknown = getattr(self, name), -np.inf if name.endswith("_s") else np.nan
            if (stored := state.get(name.lstrip("_"))) is None:  # a state of an older version
                stored = state[OLDER[name]] if name in OLDER else [0.0 if name == "fallen" else None] * len(mine[part])
            values = np.array([unknown if x is None else float(x) for x in stored])
            if not (np.abs(values[np.isfinite(values)]) <= MOST[name]).all():
                raise ValueError(f"{name.lstrip('_')} of a limit's state is out of all bounds")
            mine[part] = values.astype(mine.dtype)

    def forget(self, part: slice) -> bool:
        """Forget the state of some cells; return whether any of them was over."""
        was = bool(self.over[part].any())
        self.over[part], self.last[part], self.last_s[part] = False, np.nan, -np.inf
        self.fallen[part], self._high[part], self._high_s[part] = False, np.nan, -np.inf
        return was


class Limits:
    """Limits of cores and surfaces of all strings, and their conditions.

    Parameters
    ----------
    names : sequence of str
        Strings.
    parts : sequence of slice
        The cells of each string among the N cells.
    core_max, surface_max : float
        °C.
    stale_s : ndarray (N,), optional
        Time without a reading after which each cell's sensor is stale, s.
    """

    def __init__(
        self,
        names: Sequence[str],
        parts: Sequence[slice],
        core_max: float,
        surface_max: float,
        stale_s: Floats | None = None,
    ) -> None:
        self._names, self._parts = tuple(names), tuple(parts)
        cells = parts[-1].stop if parts else 0
        self._string = np.repeat(np.arange(len(parts)), [p.stop - p.start for p in parts])
        self.core, self.surface = Limit(cells, core_max), Limit(cells, surface_max)
        self.lost, self._failing, self._broke = np.zeros((3, cells), np.bool_)
        self._loss = np.full((4, cells), np.nan)  # last reading, °C, its time, s, its rate, K/s, time of the failure, s
        self._unseen_s = np.full(cells, UNSEEN_S) if stale_s is None else np.maximum(stale_s, UNSEEN_S)
        self._now_s = 0.0
        unknown, no = np.full(cells, np.nan), np.zeros(cells, np.bool_)
        self._points = Points(unknown, unknown, unknown, no)
        # last reading of each surface, °C, believed or not, and its time, s; whether its sensor is reported to be wrong
        self._read, self._read_s, self._wrong = unknown.copy(), np.full(cells, -np.inf), no
        self._blind_s = {(what, name): -np.inf for what in ("core", "surface") for name in names}

    def step(self, now_s: float, points: Points, sensed: Sensed, quiet: bool) -> None:
        """Take a tick.

        Parameters
        ----------
        now_s : float
        points : Points
        sensed : Sensed
        quiet : bool
            The bus is silent: then no sensor counts as failed.
        """
        self._now_s, self._points = now_s, points
        if not quiet and sensed.failed.any():
            self._fail(now_s, sensed)
        if self._failing.any() or self.lost.any():
            self._lose(now_s, sensed, quiet)
        surface, read = self.surface, np.isfinite(sensed.good)
        self._read, self._read_s = np.where(read, sensed.good, self._read), np.where(read, now_s, self._read_s)
        self._wrong = np.zeros_like(read) if sensed.wrong is None else sensed.wrong
        if not quiet and surface.over.any():
            self._broke |= surface.over & (sensed.failed if sensed.broken is None else sensed.broken)
        ends = read & ~self.lost  # a sensor that failed in heat ends no alarm before a person has looked
        if sensed.wrong is not None:
            ends &= ~sensed.wrong
        surface.update(now_s, sensed.good, ends, confirmed=sensed.confirmed, broke=self._broke)
        self._broke &= surface.over & ~read
        trusted = points.trusted & ~surface.over & ~surface.fallen & ~self.lost
        self.core.update(now_s, points.value, trusted, points.sd)
        self._look()

    def _look(self) -> None:
        """Note at which strings with an alarm no hot cell is seen now."""
        for what, limit in (("core", self.core), ("surface", self.surface)):
            if limit.over.any():
                unseen = limit.over & ~self._seen(limit)
                for name, part in zip(self._names, self._parts, strict=True):
                    if unseen[part].any() and not (limit.over & ~unseen)[part].any():
                        self._blind_s[what, name] = self._now_s

    def _seen(self, limit: Limit) -> Bools:
        """Return for which cells (N,) a present value is believed enough to be told as that of the cell."""
        seen = self._now_s - limit.last_s <= self._unseen_s
        if limit is self.surface:
            return np.asarray(seen & ~self._wrong & ~self.lost & ~limit.fallen)
        # an estimate or a surface that fell too fast is still there, though it ends no alarm
        p = self._points
        watched = p.trusted if p.watched is None else p.watched
        return np.asarray(seen | (((watched & ~self.lost) | self.surface.fallen) & np.isfinite(p.value)))

    def _fail(self, now_s: float, sensed: Sensed) -> None:
        """Find thermocouples that fail while their cells heat."""
        s = self.surface
        recent = now_s - s.last_s <= FORGET_S
        rising = recent & (s.rate >= RISING_K_S)
        due = rising & (s.last >= s.limit - NEAR_K) & (s.last + SOON_S * s.rate >= s.limit)
        heats = rising & (s.last >= s.limit - AROUND_K)
        around = np.bincount(self._string, heats, len(self._parts))[self._string] > 0
        found = sensed.failed & np.isfinite(s.last) & (due | (sensed.beyond & around & recent))
        new = found & ~self._failing & ~self.lost
        if new.any():
            self._loss = np.where(new, np.stack([s.last, s.last_s, s.rate, np.full(len(new), now_s)]), self._loss)
            self._failing |= new

    def _lose(self, now_s: float, sensed: Sensed, quiet: bool) -> None:
        """Call the sensors lost that have failed for `LOST_S`; release those that continue their former course."""
        last, last_s, rate, since_s = self._loss
        on = last + rate * np.minimum(now_s - last_s, FOUND_S)
        soon, least, most = now_s - last_s <= FOUND_S, np.fmin(last, on) - BACK_K, np.fmax(last, on) + BACK_K
        found = soon & (sensed.good >= least)  # a hotter reading is accepted: the sensor shows that its cell heats
        self.lost &= ~found
        if sensed.raw is not None:  # the guard does not accept the reading yet
            found |= soon & (sensed.raw >= least) & (sensed.raw <= most) & ~sensed.beyond
        self._failing &= ~found
        if not quiet:
            # a sensor that reads again, but away from its former course, may have come off
            self.lost |= self._failing & (now_s - since_s >= LOST_S)
        self._failing &= ~self.lost

    def over(self, part: slice) -> bool:
        """Tell whether any of some cells is over a limit or lost in heat."""
        return bool((self.core.over[part] | self.surface.over[part] | self.lost[part]).any())

    def measured_over(self, part: slice) -> bool:
        """Tell whether any of some cells has a surface that was read over its limit, or is lost in heat."""
        return bool((self.surface.over[part] | self.lost[part]).any())

    def acknowledge(self, part: slice) -> bool:
        """End the alarms of some cells; a cell that is still too hot raises a new one. Return whether one ended."""
        was = bool(self.lost[part].any())
        self.lost[part] = self._failing[part] = False
        return bool(was | self.core.forget(part) | self.surface.forget(part))

    def why_over(self, last: Condition) -> str:
        """Say why the alarm with this last condition has ended, if it is one of a limit; else return "".

        An acknowledgement ends alarms too, and is not known here.
        """
        if last.name not in ("core", "surface", "lost_in_heat") or last.string not in self._names or not last.cell:
            return ""
        cell, at = last.cell, self._parts[self._names.index(last.string)].start + last.cell - 1
        if last.name == "lost_in_heat":
            return f"thermocouple of cell {cell} reads again, and goes on from where it was"
        if last.name == "surface":
            of, end = self.surface, f"no surface is over the limit of {self.surface.limit:g} °C any more"
            if self._now_s - of.last_s[at] <= self._unseen_s[at]:
                return f"surface of cell {cell} reads {of.last[at]:.1f} °C: {end}"
            return f"surface of cell {cell}: {self._last(of, at)}: {end}"
        end = f"no hottest point is over the limit of {self.core.limit:g} °C any more"
        value, sd, core = (float(x[at]) for x in self._points[:3])
        if sd <= AVAILABLE_SD_K:
            return f"hottest point of cell {cell} is {banded(value, sd, core)}: {end}"
        return f"hottest point of cell {cell} was seen below it and is not known to {AVAILABLE_SD_K:g} K now: {end}"

    def conditions(self) -> Iterator[Condition]:
        """List the strings with cells over a limit."""
        for what, limit in (("hottest point", self.core), ("surface", self.surface)):
            if limit.over.any():
                for name, part in zip(self._names, self._parts, strict=True):
                    if limit.over[part].any():
                        yield self._over(what, limit, name, part)
        if self.lost.any():
            for name, part in zip(self._names, self._parts, strict=True):
                for k in np.flatnonzero(self.lost[part]).tolist():
                    yield self._lost(name, k + 1, part.start + k)

    def _over(self, what: str, limit: Limit, name: str, part: slice) -> Condition:
        over = np.flatnonzero(limit.over[part]) + part.start
        read = self._now_s - self._read_s <= self._unseen_s
        seen = over[self._seen(limit)[over]]
        doubted = over[read[over]] if limit is self.surface else over[:0]
        among = seen if len(seen) else doubted if len(doubted) else over
        at = int(among[np.argmax(np.where(np.isfinite(limit.last[among]), limit.last[among], -np.inf))])
        cell = at - part.start + 1
        if among is over:
            now = f": {self._last(limit, at)}"
        elif limit is self.surface:
            now = f" reads {self._read[at] if read[at] else limit.last[at]:.1f} °C{self._against(at)}"
        elif np.isfinite(self._points.value[at]):
            p = self._points
            value, sd, core = (float(x[at]) for x in p[:3])
            now = f" is {banded(value, sd, core)}"
            if sd > UNKNOWN_SD_K and value - sd < limit.limit:  # a number would say nothing
                now = f": not known now, {self._last(limit, at)}"
            elif sd > AVAILABLE_SD_K:  # a symmetric band would reach below all that is possible
                now = f" is about {value:.0f} °C and not known to {AVAILABLE_SD_K:g} K (core about {core:.0f} °C)"
            if value < limit.limit and sd <= UNKNOWN_SD_K:
                now += ", was above the limit and is not known to be below it again"
        else:
            now = f" was {limit.last[at]:.1f} °C"
        others = over[over != at]
        known = np.isfinite(self._points.value) & (limit is self.core)
        hot = np.where(known, self._points.value, limit.last)[others] >= limit.limit
        more = beside(*((others[x] - part.start + 1).tolist() for x in (hot, ~hot)))
        text = (
            f"{what} of cell {cell}{now}, the limit is {limit.limit:g} °C{more}: lower the current or cool the string"
        )
        blind_s = self._blind_s["core" if limit is self.core else "surface", name]
        phase = "unseen" if self._now_s - blind_s < SEEN_S else ""
        if limit is self.core:
            return Condition("core", Severity.ALARM, text, name, cell, wanders=True, phase=phase)
        return Condition("surface", Severity.ALARM, text, name, cell, wanders=True, phase=phase, urgent=True)

    def _lost(self, name: str, cell: int, at: int) -> Condition:
        last, last_s, rate, _ = self._loss[:, at].tolist()
        text = (
            f"thermocouple of cell {cell} failed while its cell heated: last {last:.0f} °C{trend(rate)} at "
            f"{clock(last_s)}: take it for hot; stop, cool the string, look at it, then acknowledge"
        )
        return Condition("lost_in_heat", Severity.ALARM, text, name, cell, settled=True, urgent=True)

    def _against(self, at: int) -> str:
        """Say why a reading that is below the limit of surfaces does not end the alarm of its cell."""
        limit = self.surface
        if self._now_s - self._read_s[at] <= self._unseen_s[at] and self._read[at] < limit.limit:
            why = ""
            if self.lost[at]:
                why = "its thermocouple failed while its cell heated"
            elif self._wrong[at]:
                why = "its thermocouple is reported to be wrong"
            elif limit.fallen[at]:
                why = "it has fallen faster than a cell cools"
            if why:
                since_s = self._now_s - limit.last_s[at]
                before = f"{limit.last[at]:.0f} °C{trend(float(limit.rate[at]))}, {since_s:.0f} s ago"
                return f", which is not believed, because {why} (last believed: {before})"
        if limit.last[at] < limit.limit:
            return f", was above the limit and is not known to be {COOLER_K:g} K below it"
        return ""

    def _last(self, limit: Limit, at: int) -> str:
        since_s = self._now_s - limit.last_s[at]
        told = f"last {limit.last[at]:.0f} °C{trend(float(limit.rate[at]))}"
        if limit is self.core:
            return f"{told}, not known since {since_s:.0f} s"
        unread_s = self._now_s - max(float(self._read_s[at]), float(limit.last_s[at]))
        ago = f", {since_s:.0f} s ago" if since_s > unread_s else ""
        return f"{told}{ago}, not read since {unread_s:.0f} s"

    def snapshot(self, part: slice) -> dict[str, Any]:
        """State of some cells as JSON-able values."""
        return {
            "core": self.core.snapshot(part),
            "surface": self.surface.snapshot(part),
            "lost": self.lost[part].tolist(),
            "loss": [[x if np.isfinite(x) else None for x in row] for row in self._loss[:, part].tolist()],
        }

    def restore(self, part: slice, state: Mapping[str, Any]) -> None:
        """Take up a stored state of as many cells."""
        self.core.restore(part, state["core"])
        self.surface.restore(part, state["surface"])
        self.lost[part] = state["lost"]
        if (loss := state.get("loss")) is None:  # a state of an older version
            s = self.surface
            self._loss[:, part] = s.last[part], s.last_s[part], s.rate[part], s.last_s[part]
            return
        values = np.array([[np.nan if x is None else float(x) for x in row] for row in loss])
        if not (np.abs(values[np.isfinite(values)]) <= MOST["last_s"]).all():
            raise ValueError("loss of a limit's state is out of all bounds")
        self._loss[:, part] = values
