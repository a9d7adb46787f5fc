"""Innovations of signals that belong to one of several cells: judged per signal, not per cell.

A signal that is the greatest, least or mean surface of several cells changes from cell to cell. Its noise and its steps
are those of one signal, and so is the average of its innovations. Judged per cell, it would look like a thermocouple
that is read for seconds only and whose steps are not known. A coarse constant reading would then look like heat within
the cell while the model moves on. Odd innovations of a signal belong to the core of the cell assigned at the time.

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
        White noise of a reading, as in the filter.
    """

    def __init__(self, parameters: Sequence[StringParameters], sensors: Ints, dt: float, noise: float) -> None:
        self._sensors, self._m = sensors, sensors.shape[1]
        # after the cells' own thermocouples come the readings whose cell is assigned in each step
        self._of = Surprise(parameters, np.pad(sensors, ((0, 0), (0, READINGS))), dt, noise)
        self._at = np.full((len(sensors), READINGS), -1)
        self._said = np.full(self._at.shape, np.nan)

    @property
    def own(self) -> Floats:
        """Rates (S, m), K/s, of `Surprise.own` by the cells' own thermocouples."""
        return self._of.own[:, : self._m]

    def set_parameters(self, parameters: Sequence[StringParameters]) -> None:
        """Take other numbers of the strings into use."""
        self._of.set_parameters(parameters)

    def settle(self, s: int) -> None:
        """Give string `s` time to find the state that fits new numbers."""
        self._of.settle(s)

    def assign(self, source: NDArray[np.int8], said: Floats) -> None:
        """Set, before a step, which reading each of the n cells has (S, n), and its value (S, n), °C."""
        source = np.take_along_axis(source, self._sensors, axis=1)
        said = np.take_along_axis(said, self._sensors, axis=1)
        for r in range(READINGS):
            mine = source == r + 1
            at = mine.argmax(axis=1)
            there = mine.any(axis=1)
            self._at[:, r] = np.where(there, at, -1)
            self._said[:, r] = np.where(there, said[np.arange(len(at)), at], np.nan)

    def step(self, y: Floats, value: Floats, sd: Floats, known: Floats, inputs: Bools, inlet: Floats) -> Floats | None:
        """Use the innovations of a step; see `Surprise.step`."""
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
        """Widen standard deviations `sd` (S, m) of innovations by the steps of readings that noise does not blur."""
        wide = self._of.rounded(self._parted(sd))
        out = wide[:, : self._m].copy()
        row, r = (self._at >= 0).nonzero()
        out[row, self._at[row, r]] = wide[row, self._m + r]
        return out

    def _parted(self, values: Floats) -> Floats:
        """Move values (S, m) from the cells to the readings assigned to them; NaN elsewhere."""
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
        """Create an object like this from a snapshot; None, or a snapshot by cell, starts without knowledge.

        Raises
        ------
        KeyError, TypeError, ValueError
            `snapshot` is not a snapshot of as many cells.
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
    """Create the check of an observer; `several`: readings may belong to one of several cells."""
    return (StatisticSurprise if several else Surprise)(parameters, sensors, dt, noise)
