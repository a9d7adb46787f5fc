"""From the channels of a plan to numbered inputs: the signals that are used, and the inputs of each string.

An *input* is one signal of the bus with its scale and offset. Strings share inputs (one pack current for all). The
wiring from strings to inputs is computed once, so that a tick takes a few numpy passes for any number of cells.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.plan import Channel, Plan, StringPlan
from bms_gateway.engine.statistics import OneOfSeveral
from bms_gateway.frames.vocabulary import CELL, INPUTS, WHOLE, Quantity

Half = tuple[str | None, float, float]
"""Signal, scale and offset of one direction of an input; most inputs have one."""


@dataclass(frozen=True, slots=True)
class Wire:
    """Inputs of one string's quantities, by index; −1 if there is none.

    Attributes
    ----------
    whole : mapping of Quantity to int
        Inputs of the whole string.
    cells : mapping of Quantity to ndarray of intp (n,)
        Inputs of its cells.
    constants : mapping
        Quantities that the bus does not carry, by name.
    statistics : mapping
        Inputs that are the greatest, least or mean surface of several cells, by kind.
    """

    whole: Mapping[Quantity, int]
    cells: Mapping[Quantity, NDArray[np.intp]]
    constants: Mapping[Quantity, float] = field(default_factory=dict)
    statistics: Mapping[str, int] = field(default_factory=dict)

    @property
    def current(self) -> int:
        """Input of the current."""
        return self.whole["current"]

    @property
    def voltage(self) -> int:
        """Input of the string's voltage."""
        return self.whole["voltage"]

    @property
    def surface(self) -> NDArray[np.intp]:
        """Inputs of the surfaces."""
        return self.cells["surface"]

    @property
    def cell_voltage(self) -> NDArray[np.intp]:
        """Inputs of the cells' voltages."""
        return self.cells["cell_voltage"]

    def of(self, c: Channel) -> int:
        """Index of the input of a channel; −1 if it is not used."""
        return self.input(c.quantity, c.cell) if c.statistic is None else self.statistics.get(c.statistic, -1)

    def input(self, quantity: Quantity, cell: int | None) -> int:
        """Index of the input of a quantity, of a cell if it belongs to one; −1 if there is none."""
        if cell is None:
            return self.whole.get(quantity, -1)
        return int(self.cells[quantity][cell - 1]) if quantity in self.cells else -1


def used_inputs(string: StringPlan) -> frozenset[Quantity]:
    """List the inputs that the estimators of a string use."""
    special = "effects" if string.model.effects else "cells" if identifies_cells(string) else "all"
    return frozenset(q for q, i in INPUTS.items() if i.used_by in ("all", special))


def identifies_cells(string: StringPlan) -> bool:
    """Whether the string's cells are identified singly by their voltages."""
    return string.identify == "window" and string.model.cells > 1 and not string.model.effects


@dataclass(slots=True)
class Wiring:
    """All inputs of a plan.

    Attributes
    ----------
    wires : list of Wire
        One per string.
    channels : list of Channel
        First channel of each input.
    names : list of (str, int or None)
        The first string with each input, and the cell.
    groups : list of int
        Index of this string, per input.
    spare : set of int
        Inputs that are used only for a record.
    several : list of OneOfSeveral
    """

    wires: list[Wire] = field(default_factory=list)
    channels: list[Channel] = field(default_factory=list)
    names: list[tuple[str, int | None]] = field(default_factory=list)
    groups: list[int] = field(default_factory=list)
    spare: set[int] = field(default_factory=set)
    several: list[OneOfSeveral] = field(default_factory=list)

    @classmethod
    def of(cls, plan: Plan, *, everything: bool = False) -> "Wiring":
        """Give numbers to the inputs of a plan; with `everything` also those that no estimator uses."""
        made = cls()
        index: dict[tuple[Half, ...], int] = {}
        before = 0
        for string in plan.strings:
            made.wires.append(made._wire(string, index, before, everything))
            before += string.model.cells
        return made

    @property
    def decoded(self) -> list[tuple[Channel, int]]:
        """Channel and input of each decoded signal: one per input, then the charge of each current with two signals."""
        charges = [(c.charge, i) for i, c in enumerate(self.channels) if c.charge is not None]
        return [*((c, i) for i, c in enumerate(self.channels)), *charges]

    def _wire(self, string: StringPlan, index: dict[tuple[Half, ...], int], before: int, everything: bool) -> Wire:
        """Find the inputs of a string; `before` is the number of cells of the strings before it."""
        whole: dict[Quantity, int] = dict.fromkeys(WHOLE, -1)
        cells: dict[Quantity, NDArray[np.intp]] = {q: np.full(string.model.cells, -1, np.intp) for q in CELL}
        constants: dict[Quantity, float] = {}
        statistics: dict[str, int] = {}
        used = used_inputs(string)
        for c in string.channels:
            if c.signal is None:
                constants[c.quantity] = nan if c.constant is None else c.constant
                continue
            if not everything and c.quantity not in used and not INPUTS[c.quantity].recorded:
                continue
            known = len(index)
            i = index.setdefault(tuple((h.signal, h.scale, h.offset) for h in c.halves), known)
            (self.spare.discard if c.quantity in used else self.spare.add)(i)
            if i == known:
                self.channels.append(c)
                self.names.append((string.name, c.cell))
                self.groups.append(string.number)
            if c.statistic is not None:
                statistics[c.statistic] = i
                self.several.append(OneOfSeveral(i, c.statistic, before + np.array(c.among, np.intp) - 1))
            elif c.cell is None:
                whole[c.quantity] = i
            elif c.quantity in cells:
                cells[c.quantity][c.cell - 1] = i
        return Wire(whole, cells, constants, statistics)
