"""The inputs: every quantity that a string may measure, and everything that depends on its name.

The keys of `[string.signals]`, the channels of the engine, the ranges of the guard, the columns of tables and records,
the signals of the project's own DBC and the roles that `init` gives are all read from `INPUTS`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

__all__ = ["CELL", "CELL_COLUMNS", "INPUTS", "OPTIONAL", "SLOW", "WHOLE", "Input", "Kind", "Quantity"]

Quantity = Literal["current", "coolant_inlet", "voltage", "soc", "coolant_flow", "surface", "cell_voltage"]
"""Quantity of a channel: the keys of `INPUTS`."""

Kind = Literal["current", "voltage", "temperature", "soc", "flow"]
"""Quantities of one kind have the same units, also in DBC files."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Input:
    """One quantity of a string.

    Attributes
    ----------
    kind : Kind
    unit : str
        SI, °C for a temperature; empty for a share.
    plausible : (float, float)
        Plausible range for the guard.
    column : str
        Column of a table, and of `Columns` without the number; `{}` is the number of the cell, from 1.
    needed : bool
        Whether a string cannot be estimated without it.
    electrical : bool
        Whether the bus carries it several times per tick, in one message with the current.
    used_by : {"all", "effects", "cells"}
        Strings whose estimators use it: all; those whose models have effects; those whose single cells are identified.
    recorded : bool
        Whether every string decodes it, for the record of recent signals, also without an estimator that uses it.
    constant : (float, float) or None
        Range of a constant that may replace it; None if it must be measured.
    stands_in : {"unmeasured", "unheard", "start"}
        When the constant is the value at a tick: if the string has no signal for it; also while the signal has no good
        value; never, because it is only the start of a count.
    own : str or None
        Signal in the project's own DBC, of string `k` and cell `c`; None if this DBC has none.
    said : str
        Addition to the column in help texts.
    """

    kind: Kind
    unit: str
    plausible: tuple[float, float]
    column: str
    needed: bool = False
    electrical: bool = False
    used_by: Literal["all", "effects", "cells"] = "all"
    recorded: bool = False
    constant: tuple[float, float] | None = None
    stands_in: Literal["unmeasured", "unheard", "start"] = "unmeasured"
    own: str | None = None
    said: str = ""

    @property
    def of_cells(self) -> bool:
        """Whether each cell has its own value."""
        return "{}" in self.column

    @property
    def field(self) -> str:
        """Attribute of `Columns`: the column without the number of the cell."""
        return self.column.replace("_{}", "")


INPUTS: Final[Mapping[Quantity, Input]] = MappingProxyType(
    {
        "current": Input(
            kind="current",
            unit="A",
            plausible=(-3000.0, 3000.0),  # start-up transients of Hall sensors show 5 kA and more
            column="current_A",
            needed=True,
            electrical=True,
            own="string_{k}_electrical.current",
            said="discharge positive",
        ),
        "coolant_inlet": Input(
            kind="temperature",
            unit="°C",
            plausible=(-38.5, 120.0),
            column="coolant_inlet_C",
            needed=True,
            constant=(-60.0, 150.0),
            own="string_{k}_coolant.coolant_inlet",
        ),
        "voltage": Input(
            kind="voltage",
            unit="V",
            plausible=(0.0, 1500.0),  # end of the low-voltage directive
            column="voltage_V",
            electrical=True,
            own="string_{k}_electrical.voltage",
        ),
        "soc": Input(
            kind="soc",
            unit="",
            plausible=(-0.05, 1.05),  # counters overshoot a little
            column="soc",
            used_by="effects",
            recorded=True,
            constant=(0.0, 1.0),
            stands_in="start",
            own="string_{k}_coolant.soc",
            said="0 to 1",
        ),
        "coolant_flow": Input(
            kind="flow",
            unit="m3/s",
            plausible=(0.0, 1.0),
            column="coolant_flow_m3_s",
            constant=(1e-9, 10.0),
            stands_in="unheard",
            own="string_{k}_coolant.coolant_flow",
        ),
        "surface": Input(
            kind="temperature",
            unit="°C",
            # 8-bit signals show −39 and −40 °C for a broken wire; above 150 no cell exists
            plausible=(-38.5, 150.0),
            column="surface_{}_C",
            needed=True,
            own="string_{k}_surface.surface_{c:02d}",
        ),
        "cell_voltage": Input(
            kind="voltage",
            unit="V",
            plausible=(0.0, 6.0),
            column="cell_voltage_{}_V",
            used_by="cells",
            own="string_{k}_cell_voltage.cell_voltage_{c:02d}",
        ),
    }
)
WHOLE: Final = tuple(name for name, i in INPUTS.items() if not i.of_cells)
"""Inputs of the whole string."""
CELL: Final = tuple(name for name, i in INPUTS.items() if i.of_cells)
"""Inputs of single cells."""
SLOW: Final = tuple(name for name in WHOLE if not INPUTS[name].electrical)
"""Inputs of the whole string that have one value per tick."""
OPTIONAL: Final = tuple(name for name, i in INPUTS.items() if not i.needed)
CELL_COLUMNS: Final[Mapping[str, str]] = MappingProxyType(
    {**{name: INPUTS[name].column for name in CELL}, "core": "core_{}_C"}
)
"""Columns of single cells. A measured core is a reference for comparison, not an input."""
