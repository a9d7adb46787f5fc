"""Known facts of a cell (format, mass, data sheet, kind of cooling), and the parameters that follow from them."""

from bms_gateway.thermal.cells.cell_in_words import cell_of
from bms_gateway.thermal.cells.facts import CellFacts, Chemistry, Cooling, Shape
from bms_gateway.thermal.cells.priors import Stated, cell_priors, cell_tolerances, stated_parameters
from bms_gateway.thermal.cells.published import FORMATS, PUBLISHED

__all__ = [
    "FORMATS",
    "PUBLISHED",
    "CellFacts",
    "Chemistry",
    "Cooling",
    "Shape",
    "Stated",
    "cell_of",
    "cell_priors",
    "cell_tolerances",
    "stated_parameters",
]
