"""Voltage as a witness against the current: a current that flows makes the voltage sag."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bms_gateway.health.heat.layout import Bools
from bms_gateway.thermal import Floats

MEMORY_S = 45.0
"""Time constant of the compared means: longer than an acceleration, shorter than the two minutes for a report."""
DENIES = 0.35
"""Largest heat by the voltage, as a share of I²R_e, at which the voltage denies the current."""


@dataclass(slots=True)
class VoltageWitness:
    """Compares heat from the voltage with the heat of the current, in S strings.

    Attributes
    ----------
    least : ndarray (S,), W
        Heat of a cell below which its current is not judged.
    shown, witnessed : ndarray (S,), W
        Recent means of I²R_e and of the heat from the voltage, per cell.
    """

    least: Floats
    shown: Floats
    witnessed: Floats

    @classmethod
    def of(cls, least: Floats) -> "VoltageWitness":
        """Start without knowledge."""
        return cls(least, np.zeros_like(least), np.full_like(least, np.nan))

    @property
    def denies(self) -> Bools:
        """Which strings (S,) have a voltage that denies the current."""
        return np.asarray((self.shown > self.least) & (self.witnessed < DENIES * self.shown), dtype=np.bool_)

    def take(self, shown: Floats, by_voltage: Sequence[Floats | None], dt: float) -> None:
        """Include a step of `dt` seconds.

        Parameters
        ----------
        shown : ndarray (S,), W
            Mean of the step.
        by_voltage : sequence of ndarray (S,) or None
            Heat of each tick; None or NaN where no voltage was read.
        """
        heard = [x for x in by_voltage if x is not None]
        witnessed = np.mean(heard, axis=0) if heard else np.full_like(shown, np.nan)
        share = min(1.0, dt / MEMORY_S)
        self.shown = self.shown + (shown - self.shown) * share
        before = np.where(np.isfinite(self.witnessed), self.witnessed, witnessed)
        self.witnessed = before + (witnessed - before) * share
