"""Known facts of a cell before any measurement: format, mass, data sheet, surroundings; and its geometry."""

import math
from dataclasses import dataclass
from typing import Literal

Shape = Literal["cylinder", "pouch", "prismatic"]
Cooling = Literal["still", "forced", "plate", "liquid"]
"""Air at rest (natural convection and radiation), air moved by a fan, one face on a cold plate, liquid along the sides
(in a ribbon or by immersion)."""
Chemistry = Literal["LFP", "NMC", "NCA", "LMO", "LCO"]


@dataclass(frozen=True, slots=True)
class CellFacts:
    """One kind of cell, and its position in its pack.

    Attributes
    ----------
    name : str
    shape : {"cylinder", "pouch", "prismatic"}
    size : tuple of float, m
        Diameter and height of a cylinder; length, width and thickness otherwise (the thickness is across the layers).
    chemistry : Chemistry or None
    mass : float or None, kg
    capacity_Ah : float or None
        Of one cell.
    resistance : float or None, Ω
        Of one cell at 25 °C.
    resistance_kind : {"dc", "ac"}
        From a direct-current pulse of 1 to 30 s, or at 1 kHz.
    parallel : int
        Cells in parallel that are one cell of the model.
    orientation : {"standing", "lying"}
        Of a cylinder's axis, or of a flat cell's large face.
    cooling : Cooling
    spacing : float or None, m
        Gap to the neighbours.
    source : str
        Source of mass, capacity and resistance.
    """

    name: str
    shape: Shape
    size: tuple[float, ...]
    chemistry: Chemistry | None = None
    mass: float | None = None
    capacity_Ah: float | None = None
    resistance: float | None = None
    resistance_kind: Literal["dc", "ac"] = "dc"
    parallel: int = 1
    orientation: Literal["standing", "lying"] = "standing"
    cooling: Cooling = "still"
    spacing: float | None = None
    source: str = "as given"

    @property
    def volume(self) -> float:
        """m³."""
        if self.shape == "cylinder":
            d, h = self.size
            return math.pi / 4 * d**2 * h
        return math.prod(self.size)

    @property
    def side_area(self) -> float:
        """Area that gives heat to the surroundings through the sides, m²: a cylinder's mantle, a flat cell's faces."""
        if self.shape == "cylinder":
            d, h = self.size
            return math.pi * d * h
        length, width, _ = self.size
        return 2 * length * width

    @property
    def area(self) -> float:
        """Whole outer area, m²."""
        if self.shape == "cylinder":
            return self.side_area + math.pi / 2 * self.size[0] ** 2
        length, width, t = self.size
        return self.side_area + 2 * t * (length + width)

    @property
    def base_area(self) -> float:
        """Area that stands on a cold plate, m²: the base of a can, one large face of a pouch."""
        if self.shape == "cylinder":
            return math.pi / 4 * self.size[0] ** 2
        length, width, t = self.size
        return length * width if self.shape == "pouch" else length * t

    @property
    def upright(self) -> float:
        """Length along which air rises at the sides, m."""
        if self.shape == "cylinder":
            return self.size[1] if self.orientation == "standing" else self.size[0]
        return self.size[1] if self.orientation == "standing" else min(self.size[:2]) / 2
