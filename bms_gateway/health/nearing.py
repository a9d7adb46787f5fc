"""Whether a string heats into its limit at the load of now: told before it is there, and over when it is not to be.

A forecast is renewed every ten seconds. It is told when two in a row reach the limit within ten minutes, and it is over
when two in a row stay `BACK_K` below it, or when the limit is reached: from then on the alarm of the limit speaks.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite

from bms_gateway.health.alerts import Condition, Fact, Severity

HOLD = 2
"""Forecasts in a row that must agree: a load of some seconds heats no cell."""
BACK_K = 1.0
"""Below the limit; a forecast that comes near to it again and again is one alert."""
PHASES_S = (60.0, 120.0, 300.0)
"""Shorter times to the limit than these are told again."""


@dataclass(frozen=True, slots=True)
class Approach:
    """What a forecast says of the cell of a string that is the first to reach the limit.

    Attributes
    ----------
    cell : int
        1-based.
    now_C, in_s : float
        Its hottest point now, and time to the limit, s.
    soonest_s, latest_s : float
        One standard deviation sooner and later; infinite where that is not within ten minutes.
    load_A : float
        Root of the mean square of the current that is taken for what comes; negative on charge.
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
    """Judge of one string.

    Attributes
    ----------
    condition : Condition or None
        What is told now.
    """

    def __init__(self, string: str, limit_C: float) -> None:
        self._string, self._limit = string, limit_C
        self._for = self._against = 0
        self.condition: Condition | None = None

    def forget(self) -> None:
        """Begin anew: nothing is known of what comes."""
        self._for = self._against = 0
        self.condition = None

    def take(self, approach: Approach | None, hottest_C: float) -> None:
        """Take in a forecast.

        Parameters
        ----------
        approach : Approach or None
            None where no cell that is below the limit reaches it within ten minutes.
        hottest_C : float
            The hottest of all points within ten minutes; NaN where nothing is known.
        """
        if approach is not None and approach.in_s <= 0.0:  # it is there: the limit's own alarm speaks
            self.forget()
            return
        if approach is None:
            self._for = 0
            self._against = self._against + 1 if not hottest_C > self._limit - BACK_K else 0
            if self._against >= HOLD:
                self.condition = None
            return
        self._for, self._against = self._for + 1, 0
        if self._for >= HOLD or self.condition is not None:
            self.condition = self._told(approach)

    def _told(self, a: Approach) -> Condition:
        early = duration(a.soonest_s) if duration(a.soonest_s) != duration(a.in_s) else ""
        late = "or later" if not isfinite(a.latest_s) else f"to {duration(a.latest_s)}"
        band = f" ({early} {late})" if early else " (or later)" if not isfinite(a.latest_s) else ""
        doubt = "; its core is not proven" if a.doubtful else ""
        text = (
            f"hottest point of cell {a.cell} reaches {self._limit:g} °C in {duration(a.in_s)}{band} at this load "
            f"({abs(a.load_A):.0f} A{' charging' if a.load_A < 0.0 else ''}; now {a.now_C:.1f} °C){doubt}: lower the "
            f"current or cool the string; {a.permitted_A:.0f} A can be held for 10 min"
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
