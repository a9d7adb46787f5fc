"""Growth of R_e since commissioning: the flag, its sentence, and the history over the years.

The thresholds are 10, 20 and 30 %. A threshold of 5 % would raise false alarms, because the seasons of a year alone
move the result by a few per cent.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import nan
from typing import Any

from bms_gateway.errors import StateError, signed
from bms_gateway.health.flag import Flag, Thresholds
from bms_gateway.health.limit_words import BAND_SD

# Each `fall` is 3 or 4 points below its `rise`, so that the scatter of windows does not switch the flag on and off.
GROWTH = Thresholds(rise=(0.10, 0.20, 0.30), fall=(0.07, 0.16, 0.26), hold=3)
KNOWN_SD = 0.05  # a growth with a larger sd raises no flag: half of the first threshold
HISTORY = 500  # rows: more than a year with one row a day; of the time before, every second day, and so on
DAY_NS = 86_400_000_000_000

DO = (
    "below the limits again",
    "watch: plan an inspection",
    "warning: have the string inspected soon",
    "alarm: have the string inspected before the next drive",
)


@dataclass(slots=True)
class Ageing:
    """Resistance growth of a string or of one of its cells.

    Attributes
    ----------
    flag : Flag
        0 none, 1 watch (10 %), 2 warning (20 %), 3 alarm (30 %).
    growth, growth_sd : float
        Share (0.1 is +10 %) and its sd; NaN before anything is known.
    """

    flag: Flag = field(default_factory=lambda: Flag(GROWTH))
    growth: float = nan
    growth_sd: float = nan

    @property
    def commissioned(self) -> bool:
        """Whether growth is known well enough to be judged."""
        return self.growth_sd <= KNOWN_SD

    def update(self, growth: float, sd: float, *, judge: bool = True) -> bool:
        """Take the growth and its sd after one more window; `judge` False leaves the flag as it is.

        Returns
        -------
        bool
            Whether the flag's level changed.
        """
        self.growth, self.growth_sd = growth, sd
        return self.flag.update(growth if self.commissioned and judge else nan)

    def sentence(self, of: str = "", doubt: str = "") -> str:
        """Say what the flag means and what to do; `of` names the cell, `doubt` names another possible cause."""
        grown = f"{signed(100 * self.growth, 0)} ± {100 * BAND_SD * self.growth_sd:.0f} %"
        what = f"resistance growth{of} {grown} since commissioning"
        return f"{what}: {DO[self.flag.level]}{doubt if self.flag.level else ''}"

    def reset(self) -> None:
        """Start again without a known growth: cells were replaced."""
        self.flag, self.growth, self.growth_sd = Flag(GROWTH), nan, nan

    def snapshot(self) -> dict[str, Any]:
        """State as plain values."""
        known = self.growth == self.growth
        return {
            "level": self.flag.level,
            "growth": self.growth if known else None,
            "sd": self.growth_sd if known else None,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take up a stored state."""
        self.flag.level = stored_level(state["level"], 3)
        known = state["growth"] is not None
        self.growth, self.growth_sd = (float(state["growth"]), float(state["sd"])) if known else (nan, nan)


def stored_level(value: object, most: int) -> int:
    """Level of a flag from a stored state.

    Raises
    ------
    StateError
        The value is not a level.
    """
    if not isinstance(value, int) or not 0 <= value <= most:
        raise StateError(f"health: the stored state is damaged: {value!r} is no level of a flag")
    return value


@dataclass(slots=True)
class History:
    """R_e over the years, one row a day, and what was done to the string.

    When there are too many rows, every second row of the older half is removed.

    Attributes
    ----------
    rows : list of (int, float, float, float, float)
        Bus time ns, R_e at 25 °C Ω, growth, its sd, growth of R_u; the newest last.
    events : list of (int, str)
        Bus time ns, and one sentence: commissioning, or a reset of the baseline with its reason.
    """

    rows: list[tuple[int, float, float, float, float]] = field(default_factory=list)
    events: list[tuple[int, str]] = field(default_factory=list)

    def add(self, row: tuple[int, float, float, float, float]) -> None:
        """Add the newest row; it replaces a row of the same day."""
        if self.rows and self.rows[-1][0] // DAY_NS == row[0] // DAY_NS:
            self.rows.pop()
        self.rows.append(row)
        if len(self.rows) > HISTORY:
            half = len(self.rows) // 2
            self.rows = self.rows[:half:2] + self.rows[half:]

    def note(self, time_ns: int, text: str) -> None:
        """Add an event; the oldest events are removed when there are too many."""
        self.events = [*self.events, (time_ns, text)][-HISTORY // 5 :]

    def snapshot(self) -> dict[str, Any]:
        """State as plain values."""
        return {"rows": [list(row) for row in self.rows], "events": [list(e) for e in self.events]}

    def restore(self, state: Mapping[str, Sequence[Sequence[Any]]]) -> None:
        """Take up a stored state."""
        rows = [(int(t), float(R), float(g), float(s), float(u)) for t, R, g, s, u in state["rows"]]
        self.rows = rows[-HISTORY:]
        self.events = [(int(t), str(text)) for t, text in state["events"]][-HISTORY // 5 :]
