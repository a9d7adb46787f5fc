r"""States of the heat filter for a string of n cells with m thermocouples, and their order.

.. math::
    z = [T_{c1}, T_{s1}, \dots, T_{sn} \,|\, a, u, b_f, \varepsilon, a', w \,|\, b_1 \dots b_m \,|\,
         p_1 \dots \,|\, a_1 \dots \,|\, u_1 \dots]

Six states are common to all cells: a and a' are the shares by which the heat exceeds that of the current, over hours
and over minutes; u is the lost share of the films' conductance; b_f [K] is the offset of the inlet's sensor; ε [V/K] is
the entropic coefficient; w is the share by which the coolant warms more along the string, as it does when less of
it flows. b_j [K] is the offset of a thermocouple. The last three blocks belong to the observed cells,
which are those with a thermocouple and their neighbours: unexplained heat p [W], and the cell's own factors on heat and
R_u. The common states are well known from all sensors together. Heat of a single cell can therefore be told from them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import Floats, StringModel

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
COMMON = 6  # a, u, b_f, ε, a', w


@dataclass(frozen=True)
class Layout:
    """Indices of the states of S strings; a string with fewer sensors than the others has unused states.

    Attributes
    ----------
    strings, cells, sensed, near : int
        S, n, m and the number of observed cells a.
    sensors : ndarray of int (S, m)
        0-based cells with a thermocouple; `fitted` (S, m) is False for unused entries.
    told : ndarray of int (S, a)
        0-based observed cells; `seen` (S, a) is False for unused entries.
    told_of : ndarray (S, n, a)
        1 where a cell is that observed cell, else 0.
    """

    strings: int
    cells: int
    sensed: int
    near: int
    sensors: Ints
    fitted: Bools
    told: Ints
    seen: Bools
    told_of: Floats

    @classmethod
    def of(cls, models: Sequence[StringModel]) -> "Layout":
        """Order the states of strings of equal length."""
        n = models[0].cells
        near = [sorted({k + d for k in m.sensors for d in (-1, 0, 1)} & set(range(1, n + 1))) for m in models]
        m, a = max(len(x.sensors) for x in models), max(len(x) for x in near)
        sensors, fitted = np.zeros((len(models), m), np.int64), np.zeros((len(models), m), np.bool_)
        told, seen = np.zeros((len(models), a), np.int64), np.zeros((len(models), a), np.bool_)
        for s, (model, cells) in enumerate(zip(models, near, strict=True)):
            sensors[s, : len(model.sensors)] = np.array(model.sensors, np.int64) - 1
            fitted[s, : len(model.sensors)] = True
            told[s, : len(cells)] = np.array(cells, np.int64) - 1
            seen[s, : len(cells)] = True
        told_of = np.where(seen[:, None, :], np.arange(n)[:, None] == told[:, None, :], False).astype(np.float64)
        return cls(len(models), n, m, a, sensors, fitted, told, seen, told_of)

    @cached_property
    def nodes(self) -> int:
        """Number of temperatures, 2n."""
        return 2 * self.cells

    @cached_property
    def states(self) -> int:
        """Number of states of a string."""
        return self.nodes + COMMON + self.sensed + 3 * self.near

    @cached_property
    def load(self) -> int:
        """Place of a."""
        return self.nodes

    @cached_property
    def flow(self) -> int:
        """Place of u."""
        return self.nodes + 1

    @cached_property
    def inlet(self) -> int:
        """Place of b_f."""
        return self.nodes + 2

    @cached_property
    def entropy(self) -> int:
        """Place of ε."""
        return self.nodes + 3

    @cached_property
    def brisk(self) -> int:
        """Place of a'."""
        return self.nodes + 4

    @cached_property
    def stream(self) -> int:
        """Place of w."""
        return self.nodes + 5

    @cached_property
    def common(self) -> slice:
        """Places of the states common to all cells."""
        return slice(self.nodes, self.nodes + COMMON)

    @cached_property
    def bias(self) -> slice:
        """Places of b_j."""
        return slice(self.common.stop, self.common.stop + self.sensed)

    @cached_property
    def heat(self) -> slice:
        """Places of p."""
        return slice(self.bias.stop, self.bias.stop + self.near)

    @cached_property
    def own_load(self) -> slice:
        """Places of the cells' own a."""
        return slice(self.heat.stop, self.heat.stop + self.near)

    @cached_property
    def own_flow(self) -> slice:
        """Places of the cells' own u."""
        return slice(self.own_load.stop, self.own_load.stop + self.near)

    def apart(self, s: int, place: int, used: Bools | bool = True) -> Ints:
        """Cells between observed cell `place` of string `s` and each thermocouple (m,); all where one is not used."""
        return np.where(self.fitted[s] & used, np.abs(self.sensors[s] - self.told[s, place]), self.cells)

    def nearest(self) -> Ints:
        """For each cell (S, n) the cell with the nearest thermocouple, 0-based."""
        apart = np.abs(np.arange(self.cells)[:, None] - self.sensors[:, None, :])
        apart = np.where(self.fitted[:, None, :], apart, self.cells)
        return np.take_along_axis(self.sensors, apart.argmin(axis=2), axis=1)
