"""Indices of the inputs of all strings, with which one numpy pass per quantity and tick collects the readings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.plan import Plan
from bms_gateway.engine.readings import Layout
from bms_gateway.engine.wiring import Wire
from bms_gateway.frames.vocabulary import INPUTS, SLOW, Quantity
from bms_gateway.thermal import Floats


@dataclass(frozen=True, slots=True)
class Places:
    """Inputs of S strings with N cells, −1 where there is none.

    Attributes
    ----------
    surface, volts : ndarray of intp (N,)
        Input of each cell. A cell without a voltage input uses that of its string if the string has one cell only.
    sensed : ndarray of bool (N,)
        Which cells have a surface.
    parts : tuple of slice
        The cells of each string among the N cells.
    current : ndarray of intp (S,)
    means : ndarray of intp (S,)
        Number of each string's pair of current and voltage.
    """

    surface: NDArray[np.intp]
    sensed: NDArray[np.bool_]
    volts: NDArray[np.intp]
    parts: tuple[slice, ...]
    current: NDArray[np.intp]
    means: NDArray[np.intp]
    _slow: NDArray[np.intp]
    _constant: Floats
    _unheard: NDArray[np.bool_]

    @classmethod
    def of(cls, plan: Plan, wires: Sequence[Wire], pairs: Sequence[tuple[int, int]]) -> "Places":
        """Collect the indices from the wires of a plan."""
        surface = np.concatenate([w.surface for w in wires])
        volts = [w.cell_voltage if len(w.surface) > 1 else np.maximum(w.cell_voltage, w.voltage) for w in wires]
        layout = Layout.of([s.name for s in plan.strings], [s.model.cells for s in plan.strings])
        constant = [[nan if INPUTS[q].stands_in == "start" else w.constants.get(q, nan) for w in wires] for q in SLOW]
        return cls(
            surface,
            surface >= 0,
            np.concatenate(volts),
            layout.parts,
            np.array([w.current for w in wires], np.intp),
            np.array([pairs.index((w.current, w.voltage)) if w.current >= 0 else -1 for w in wires]),
            np.array([[w.whole[q] for w in wires] for q in SLOW], np.intp),
            np.array(constant),
            np.array([[INPUTS[q].stands_in == "unheard"] for q in SLOW]),
        )

    def slow(self, known: Floats) -> Mapping[Quantity, Floats]:
        """Return the slow inputs (S,) from the value of each input; NaN if not good, and at the end."""
        value = known.take(self._slow)
        value = np.where((self._slow < 0) | (self._unheard & np.isnan(value)), self._constant, value)
        return dict(zip(SLOW, value, strict=True))
