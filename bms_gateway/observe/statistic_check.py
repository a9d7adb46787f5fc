"""What readings of some cell among several say: judged by signal, not by the cell that a signal is taken for.

A signal that is the greatest, least or mean surface of several cells goes from cell to cell. Its noise and its steps
are those of one signal, and so is the average of its innovations. Judged by cell, it would be a thermocouple that is
read for seconds only, whose steps are not known. A coarse reading that stands still while the model moves on would then
look like heat within the cell. What is odd about a signal belongs to the core of the cell that it is then taken for.

Beyond Lin et al., who have a thermocouple for each sensed cell.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.observe.innovation_check import Surprise
from bms_gateway.observe.model import Bools, Ints
from bms_gateway.thermal import Floats, StringParameters

READINGS: Final = 3
"""Greatest, least and mean: numbers 1 to 3 of a `source`; 0 is a thermocouple of the cell's own."""


class StatisticSurprise:
    """`Surprise` of m cells of S strings, some of which are read by signals that belong to several cells.

    Parameters
    ----------
    parameters : sequence of StringParameters
    sensors : ndarray of int (S, m)
        0-based cells that can have a reading of either kind.
    dt : float, s
        Step.
    noise : float, K
        White noise of a reading, as the filter has it.
    """

    def __init__(self, parameters: Sequence[StringParameters], sensors: Ints, dt: float, noise: float) -> None:
        self._sensors, self._m = sensors, sensors.shape[1]
        # behind the cells' own thermocouples come the readings, whose cell is told in each step
        self._of = Surprise(parameters, np.pad(sensors, ((0, 0), (0, READINGS))), dt, noise)
        self._at = np.full((len(sensors), READINGS), -1)
        self._said = np.full(self._at.shape, np.nan)

    def set_parameters(self, parameters: Sequence[StringParameters]) -> None:
        """Take other numbers of the strings into use."""
        self._of.set_parameters(parameters)

    def settle(self, s: int) -> None:
        """Let string `s` find the state that fits other numbers."""
        self._of.settle(s)

    def assign(self, source: NDArray[np.int8], said: Floats) -> None:
        """Tell, before a step, which reading each of the n cells has (S, n), and what it said (S, n), °C."""
        source = np.take_along_axis(source, self._sensors, axis=1)
        said = np.take_along_axis(said, self._sensors, axis=1)
        for r in range(READINGS):
            mine = source == r + 1
            at = mine.argmax(axis=1)
            there = mine.any(axis=1)
            self._at[:, r] = np.where(there, at, -1)
            self._said[:, r] = np.where(there, said[np.arange(len(at)), at], np.nan)

    def step(self, y: Floats, value: Floats, sd: Floats, known: Floats, inputs: Bools, inlet: Floats) -> Floats | None:
        """Take in the innovations of a step; see `Surprise.step`."""
        cells = np.take_along_axis(self._sensors, np.maximum(self._at, 0), axis=1)
        self._of.move(np.concatenate((self._sensors, cells), axis=1))
        value, sd, known = (self._parted(a) for a in (value, sd, known))
        y = np.concatenate((self._parted(y)[:, : self._m], self._said), axis=1)
        grown = self._of.step(y, value, sd, known, inputs, inlet)
        if grown is None:
            return None
        whole = grown[:, : self._m].copy()
        row, r = (self._at >= 0).nonzero()
        np.add.at(whole, (row, self._at[row, r]), grown[row, self._m + r])
        return whole

    def rounded(self, sd: Floats) -> Floats:
        """Widen what innovations should be, `sd` (S, m), by the steps of readings that noise does not blur."""
        wide = self._of.rounded(self._parted(sd))
        out = wide[:, : self._m].copy()
        row, r = (self._at >= 0).nonzero()
        out[row, self._at[row, r]] = wide[row, self._m + r]
        return out

    def _parted(self, values: Floats) -> Floats:
        """Put values (S, m) of cells at the readings that these have; NaN elsewhere."""
        row, r = (self._at >= 0).nonzero()
        at = self._at[row, r]
        out = np.full((len(values), self._m + READINGS), np.nan)
        out[:, : self._m] = values
        out[row, self._m + r] = values[row, at]
        out[row, at] = np.nan
        return out

    def snapshot(self) -> dict[str, Any]:
        """Return it as numbers and lists."""
        return {"of_readings": self._of.snapshot()}

    def restored(self, snapshot: Mapping[str, Any] | None) -> "StatisticSurprise":
        """Make one like this from a snapshot; None, and one that was made by cell, know nothing yet.

        Raises
        ------
        KeyError, TypeError, ValueError
            It is none of as many cells.
        """
        new = copy(self)
        new._of = self._of.restored(None if snapshot is None else snapshot.get("of_readings"))
        new._at, new._said = np.full_like(self._at, -1), np.full_like(self._said, np.nan)
        return new


def surprise_of(
    parameters: Sequence[StringParameters],
    sensors: Ints,
    dt: float,
    noise: float,
    several: bool,
) -> Surprise | StatisticSurprise:
    """Build the check of an observer; `several` where readings may be of some cell among several."""
    return (StatisticSurprise if several else Surprise)(parameters, sensors, dt, noise)
