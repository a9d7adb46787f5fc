"""Voltage of rested lithium-ion cells over their state of charge, by chemistry: prior knowledge without data."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from bms_gateway.thermal.cells.facts import Chemistry
from bms_gateway.thermal.parameters import Floats

CHARGE: Final = np.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
"""State of charge of the columns below."""
REST_V: Final[Mapping[Chemistry, Floats]] = MappingProxyType(
    {
        "LFP": np.array([2.60, 3.10, 3.20, 3.24, 3.275, 3.287, 3.291, 3.297, 3.32, 3.33, 3.335, 3.45]),
        "NMC": np.array([2.95, 3.28, 3.40, 3.52, 3.59, 3.64, 3.70, 3.80, 3.91, 4.01, 4.09, 4.18]),
        "NCA": np.array([2.90, 3.22, 3.35, 3.50, 3.59, 3.64, 3.71, 3.82, 3.93, 4.03, 4.09, 4.18]),
        "LMO": np.array([3.00, 3.45, 3.57, 3.70, 3.80, 3.87, 3.92, 3.96, 4.00, 4.04, 4.09, 4.17]),
        "LCO": np.array([3.20, 3.55, 3.67, 3.73, 3.77, 3.79, 3.82, 3.87, 3.93, 4.00, 4.08, 4.18]),
    }
)
"""V at 25 °C against graphite, between the branches of charge and discharge; rounded from published curves.

NMC: half-way between nickel-rich cells (LG M50, Chen et al. 2020) and NMC111, which differ by 0.1 V when nearly empty.
NCA: Kollmeyer 2018 (18650PF). LMO: cells blended with a layered oxide, as in the Leaf.
LFP and LCO: data sheets and text books (Plett, Battery Management Systems I).
"""
REST_SD_V: Final[Mapping[Chemistry, float]] = MappingProxyType(
    {"LFP": 0.02, "NMC": 0.05, "NCA": 0.04, "LMO": 0.05, "LCO": 0.04}
)
"""V: sd of the differences between cells of one chemistry, with hysteresis."""


def rest_voltage(chemistry: Chemistry, soc: Floats) -> Floats:
    """Voltage of a rested cell, V; `soc` 0…1, any shape.

    Examples
    --------
    >>> float(rest_voltage("NMC", np.array(0.85)))
    4.05
    """
    return np.asarray(np.interp(soc, CHARGE, REST_V[chemistry]))
