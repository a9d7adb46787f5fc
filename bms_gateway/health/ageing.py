"""Growth of the internal resistance against the baseline taken at commissioning.

The first windows in which R_e is identified make the baseline (their precision-weighted mean of ln R_e); it is kept for
the life of the string and stored with the state. Thresholds are 10, 20 and 30 %: with one window's sd of a few per cent
a 5 % threshold raises false alarms.
"""

from dataclasses import dataclass, field
from math import exp, log, nan, sqrt

from bms_gateway.health.flag import Flag, Thresholds

BASELINE_WINDOWS = 3
# Falls lie 3 or 4 points below the rises, so that window-to-window scatter does not toggle the flag.
GROWTH = Thresholds(rise=(0.10, 0.20, 0.30), fall=(0.07, 0.16, 0.26), hold=2)


@dataclass(slots=True)
class Ageing:
    """Resistance growth of one string.

    Attributes
    ----------
    flag : Flag
        0 none, 1 watch (10 %), 2 warning (20 %), 3 alarm (30 %).
    growth, growth_sd : float
        Share (0.1 is +10 %) and its sd; NaN before the baseline is complete.
    """

    flag: Flag = field(default_factory=lambda: Flag(GROWTH))
    growth: float = nan
    growth_sd: float = nan
    _weight: float = 0.0
    _weighted_ln: float = 0.0
    _windows: int = 0

    @property
    def commissioned(self) -> bool:
        """Whether the baseline is complete."""
        return self._windows >= BASELINE_WINDOWS

    @property
    def baseline(self) -> float:
        """R_e at commissioning, Ω; NaN before the first window."""
        return exp(self._weighted_ln / self._weight) if self._weight else nan

    def update(self, R_e: float, sd: float) -> bool:
        """Take one window's identified resistance.

        Parameters
        ----------
        R_e, sd : float
            Ω, both positive.

        Returns
        -------
        bool
            Whether the flag's level changed.
        """
        rel = sd / R_e
        if not self.commissioned:
            self._weight += 1.0 / rel**2
            self._weighted_ln += log(R_e) / rel**2
            self._windows += 1
            return False
        self.growth = R_e / self.baseline - 1.0
        self.growth_sd = (1.0 + self.growth) * sqrt(rel**2 + 1.0 / self._weight)
        return self.flag.update(self.growth)

    def sentence(self) -> str:
        """Say what the flag means and what to do."""
        of = f"resistance growth {100 * self.growth:+.0f} ± {100 * self.growth_sd:.0f} % since commissioning"
        what = (
            "below the limits again",
            "watch: plan an inspection",
            "warning: have the string inspected soon",
            "alarm: have the string inspected before the next drive",
        )
        return f"{of}: {what[self.flag.level]}"

    def snapshot(self) -> dict[str, float]:
        """State as plain numbers."""
        return {
            "weight": self._weight,
            "weighted_ln": self._weighted_ln,
            "windows": self._windows,
            "level": self.flag.level,
        }

    def restore(self, state: dict[str, float]) -> None:
        """Take up a stored state."""
        self._weight, self._weighted_ln = float(state["weight"]), float(state["weighted_ln"])
        self._windows, self.flag.level = int(state["windows"]), int(state["level"])
