"""Computes the paper's figures and tables with the code that runs in the vehicle, and compares them with the print.

No method is implemented here: identification comes from `identify`, observers from `observe`, ranks and placement
from `sensors`. This room sets up the paper's cases, compares the results, and says where the print is wrong.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from bms_gateway.reproduce import (
    adaptive,
    cells,
    errata,
    excited,
    identification,
    noise,
    observability,
    placement,
    string_runs,
)
from bms_gateway.reproduce.result import VERDICTS, Curve, Figure, Panel, Row, Section, Verdict
from bms_gateway.reproduce.setting import Size

SECTIONS: Mapping[str, Callable[[Size], Section]] = MappingProxyType(
    {
        "identification": identification.section,
        "noise": noise.section,
        "excitation": excited.section,
        "adaptive": adaptive.section,
        "string": string_runs.section,
        "cells": cells.section,
        "observability": observability.section,
        "placement": placement.section,
        "errata": errata.section,
    }
)
"""Sections in the order in which a newcomer should read them."""

WEIGHTS: Mapping[str, float] = MappingProxyType(
    {"noise": 50.0, "cells": 16.0, "adaptive": 8.0, "identification": 6.0, "string": 2.0, "observability": 1.0}
)
"""Approximate duration of sections, s, for the progress bar and to begin with the longest; the others are short."""

__all__ = ["SECTIONS", "VERDICTS", "WEIGHTS", "Curve", "Figure", "Panel", "Row", "Section", "Size", "Verdict"]
