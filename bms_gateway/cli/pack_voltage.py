"""A table's voltage of a whole pack, for a string of fewer cells: its share, and the line that asks for it."""

from dataclasses import replace

import numpy as np

from bms_gateway.engine.plan import StringPlan
from bms_gateway.errors import UsageError
from bms_gateway.records.signal_use import OF_A_CELL_V, USUAL_V
from bms_gateway.report.table import Table
from bms_gateway.thermal import Floats

MOST_CELLS = 10_000
WHOLE_PACK = 0.999
"""Share of a signal below which the config takes the voltage of a string's cells from that of a pack."""


def share_of_string(table: Table, string: StringPlan, series: int | None) -> Table:
    """Replace the voltage of `series` cells in series by the share of the string's cells.

    Parameters
    ----------
    table : Table
    string : StringPlan
    series : int or None
        None: the voltage is that of the string.

    Raises
    ------
    UsageError
        The number is not plausible.
    """
    if series is None:
        return table
    if not string.model.cells <= series <= MOST_CELLS:
        raise UsageError(
            f"encode: --series {series}: valid: {string.model.cells} (the cells of {string.name}) to {MOST_CELLS}"
        )
    if table.voltage_V is None:
        raise UsageError(f"encode: --series {series}: {table.source} has no column voltage_V")
    return replace(table, voltage_V=table.voltage_V * (string.model.cells / series))


def of_cells(string: StringPlan, low: float, high: float) -> tuple[float, float]:
    """Bound a plausible range of a string's voltage by what its cells can have."""
    least, most = (string.model.cells * end for end in OF_A_CELL_V)
    return max(low, least), min(high, most)


def of_a_pack(string: StringPlan, volts: Floats) -> str | None:
    """Write what to do with a voltage that is too high for the cells of the string; None if it is not.

    Parameters
    ----------
    string : StringPlan
    volts : ndarray
        Known values of the table.
    """
    cells = string.model.cells
    middle = float(np.median(volts)) if len(volts) else 0.0
    if middle <= cells * OF_A_CELL_V[1]:
        return None
    scale = next((c.scale for c in string.carried if c.quantity == "voltage"), 1.0)
    stated = round(cells / scale) if 0.0 < scale < WHOLE_PACK else 0
    fits = stated > cells and OF_A_CELL_V[0] <= middle / stated <= OF_A_CELL_V[1]
    count = str(stated) if fits else f"N, about {max(round(middle / USUAL_V), cells + 1)}"
    return (
        f"{middle / cells:.3g} V for each of the {cells} cells of {string.name}: if it is the voltage of more cells in "
        f"series, give their number: --series {count}"
    )
