"""Parts of an engine made by hand: wires to inputs, and slow inputs of a tick."""

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.wiring import Wire
from bms_gateway.frames.vocabulary import CELL, SLOW, WHOLE, Quantity


def wire(
    whole: dict[Quantity, int], cells: int, *, surface: NDArray | None = None, cell_voltage: NDArray | None = None
) -> Wire:
    """Wire a string of so many cells; what is not given is not on the bus."""
    given = {"surface": surface, "cell_voltage": cell_voltage}
    nowhere = np.full(cells, -1, np.intp)
    return Wire(
        {q: whole.get(q, -1) for q in WHOLE},
        {q: nowhere if given.get(q) is None else given[q] for q in CELL},
    )


def slow(inlet, flow, soc):
    """Slow inputs of a tick, of one string or of several."""
    given = {"coolant_inlet": inlet, "coolant_flow": flow, "soc": soc}
    return {q: given.get(q, np.nan * np.asarray(inlet)) for q in SLOW}
