"""Warns before a string reaches its limit at the present load.

A forecast is made every ten seconds. The warning begins when two forecasts in a row reach the limit within ten minutes.
It ends when the forecasts of two minutes stay `BACK_K` below the limit, or when the limit is reached: then the alarm
of the limit takes over. It does not end while the hottest point of its cell is not known.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from math import inf, isfinite

from bms_gateway.health.alerts import Condition, Fact, Severity

EVERY_S = 10.0
HOLD = 2
"""Number of forecasts in a row that must agree: a load of a few seconds does not heat a cell to its limit."""
BACK_K, BACK_HOLD = 1.0, 12
"""K below the limit at which the warning ends, and for how many forecasts: a load that swings makes one warning."""
PHASES_S = (60.0, 120.0, 300.0)
"""The warning is reported again when the time to the limit falls below one of these."""


@dataclass(frozen=True, slots=True)
class Approach:
    """Forecast of the cell that is the first of its string to reach the limit.

    Attributes
    ----------
    cell : int
        1-based.
    now_C, in_s : float
        Its hottest point now, and time to the limit, s.
    soonest_s, latest_s : float
        One standard deviation sooner and later; infinite where that is not within ten minutes.
    load_A : float
        RMS of the current that the forecast assumes; negative on charge.
    permitted_A : float
        Greatest constant current for ten minutes in that direction.
    doubtful : bool
        The core of the cell is not proven.
    """

    cell: int
    now_C: float
    in_s: float
    soonest_s: float
    latest_s: float
    load_A: float
    permitted_A: float
    doubtful: bool = False


class Nearing:
    """The warning of one string.

    Attributes
    ----------
    condition : Condition or None
        The present warning.
    why_over : str
        Why the last warning has ended.
    """

    def __init__(self, string: str, limit_C: float) -> None:
        self._string, self._limit = string, limit_C
        self._for = self._against = 0
        self._since = 0  # forecasts after the last one that reaches the limit
        self._last: Approach | None = None
        self.condition: Condition | None = None
        self.why_over = ""

    def forget(self, why: str = "no forecast: the bus was silent") -> None:
        """End the warning, as `why` says."""
        self.why_over = why
        self._for = self._against = 0
        self.condition = None

    def take(self, approach: Approach | None, hottest_C: float, unknown: Collection[int] = ()) -> None:
        """Take in a forecast.

        Parameters
        ----------
        approach : Approach or None
            None: no cell that is below the limit reaches it within ten minutes.
        hottest_C : float
            Greatest temperature of any hottest point within ten minutes; NaN where unknown.
        unknown : collection of int
            Cells, from 1, whose hottest points are not known.
        """
        if approach is not None and approach.in_s <= 0.0:  # the limit is reached: its own alarm takes over
            self.forget(f"hottest point of cell {approach.cell} has reached {self._limit:g} °C")
            return
        if approach is None:
            self._for = 0
            known = isfinite(hottest_C) and (self._last is None or self._last.cell not in unknown)
            self._against = self._against + 1 if known and hottest_C <= self._limit - BACK_K else 0
            self._since += 1
            if self._against >= BACK_HOLD:
                self.forget(
                    f"the load does not lead to {self._limit:g} °C any more: at most {hottest_C:.1f} °C within 10 min"
                )
            if self.condition is not None and self._last is not None:
                text = self._past(self._last, hottest_C) if known else self._unknown(self._last)
                self.condition = replace(self.condition, text=text)
            return
        self._for, self._against, self._since, self._last = self._for + 1, 0, 0, approach
        if self._for >= HOLD or self.condition is not None:
            self.condition = self._told(approach)

    def silent(self, pause_s: float) -> None:
        """Say of a warning that nothing has been heard for `pause_s`: the load of before may go on, or not."""
        if self.condition is not None and self._last is not None:
            a = self._last
            text = (
                f"hottest point of cell {a.cell} was to reach {self._limit:g} °C at the load of before the bus fell "
                f"silent ({_load(a.load_A)}, {duration(pause_s)} ago)"
            )
            self.condition = replace(self.condition, text=text)

    def _past(self, a: Approach, hottest_C: float) -> str:
        """Say that the present load does not lead to the limit, but the load of a moment ago did."""
        return (
            f"{self._was(a)}; the present load does not lead to it (at most {hottest_C:.1f} °C within 10 min); if the "
            f"load comes back: {_held(a.permitted_A)}"
        )

    def _unknown(self, a: Approach) -> str:
        """Say that the cell which was to reach the limit is not known any more."""
        return f"{self._was(a)}; it is not known any more: treat the cell as hot, lower the current or cool the string"

    def _was(self, a: Approach) -> str:
        return (
            f"hottest point of cell {a.cell} was to reach {self._limit:g} °C at the load of "
            f"{duration(EVERY_S * self._since)} ago ({_load(a.load_A)})"
        )

    def _told(self, a: Approach) -> Condition:
        early = duration(a.soonest_s) if duration(a.soonest_s) != duration(a.in_s) else ""
        late = "or later" if not isfinite(a.latest_s) else f"to {duration(a.latest_s)}"
        band = f" ({early} {late})" if early else " (or later)" if not isfinite(a.latest_s) else ""
        doubt = "; its core is not proven" if a.doubtful else ""
        text = (
            f"hottest point of cell {a.cell} reaches {self._limit:g} °C in {duration(a.in_s)}{band} at this load "
            f"({_load(a.load_A)}; now {a.now_C:.1f} °C){doubt}: lower the "
            f"current or cool the string; {_held(a.permitted_A)}"
        )
        phase = next((f"{p:g}" for p in PHASES_S if a.in_s <= p), "")
        facts: Mapping[str, Fact] = {"in_s": round(a.in_s, 1), "load_A": round(a.load_A, 1), "limit_C": self._limit}
        return Condition(
            "forecast",
            Severity.WARNING,
            text,
            self._string,
            a.cell,
            settled=True,
            wanders=True,
            phase=phase,
            facts=facts,
        )


def _held(permitted_A: float) -> str:
    """Say which constant current keeps every hottest point, with its band, below the limit."""
    return f"{permitted_A:.0f} A can be held for 10 min" if permitted_A >= 0.5 else "no current can be held for 10 min"


def _load(load_A: float) -> str:
    return f"{abs(load_A):.0f} A{' charging' if load_A < 0.0 else ''}"


def duration(seconds: float) -> str:
    """Say a time as people do: whole minutes from two on, else tens of seconds.

    Examples
    --------
    >>> duration(243.0), duration(95.0), duration(8.0), duration(inf)
    ('4 min', '100 s', '10 s', 'more than 10 min')
    """
    if seconds == inf:
        return "more than 10 min"
    if seconds >= 115.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{max(10.0, 10.0 * round(seconds / 10.0)):.0f} s"
