"""Priors of C_c, C_s, R_e, R_c, R_u, R_cc from known facts of a cell, each with its sd, formula and source.

A standard deviation states how much cells of the same description differ, not how exactly a formula is evaluated. If a
formula omits something important, the standard deviation includes it. All are sd of the logarithm (`rel_sd`), about a
median.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, NamedTuple

from bms_gateway.thermal.cells.facts import CellFacts
from bms_gateway.thermal.parameters import DEFAULT_TOLERANCES, KINDS, Prior

SPECIFIC_HEAT: Final[Mapping[str | None, float]] = MappingProxyType(
    {"LFP": 1050.0, "NMC": 950.0, "NCA": 950.0, "LMO": 1000.0, "LCO": 950.0, None: 1000.0}
)
"""J/(kg K) of whole cells: calorimeters give 800 to 1150, LFP at the upper end."""
DENSITY: Final[Mapping[tuple[str, bool], float]] = MappingProxyType(
    {
        ("cylinder", True): 2150.0,
        ("cylinder", False): 2800.0,
        ("pouch", True): 1900.0,
        ("pouch", False): 2150.0,
        ("prismatic", True): 2050.0,
        ("prismatic", False): 2250.0,
    }
)
"""kg/m³ of cells on the market by shape and whether LFP, for a cell without a stated mass."""
AREA_RESISTANCE_OHM_L: Final = 7e-4
"""Resistance over minutes times volume, Ω l, for a cell without a known resistance.

A layer of electrodes has an area and a thickness, so resistance times volume differs less from cell to cell than
resistance times capacity: for 21 published cells from 2.3 to 280 Ah, the sd of the logarithm is 0.44 (median 7.1e-4 Ω
l) against 0.68 (median 0.078 Ω Ah). Cells of 18650 and 21700 have about 200 Ah/l.
"""
AREA_RESISTANCE_SD: Final = 0.55
"""Wider than the sd of the published cells, because other cells may differ more."""
SLOW_SHARE: Final = 1.3
"""Heat over minutes comes from the ohmic drop and from diffusion; a pulse of seconds shows the first and half of the
second."""
FROM_AC: Final = 1.9
"""The same for a resistance at 1 kHz, which shows almost only the ohmic drop."""
K_RADIAL: Final = 0.35
K_STACK: Final = 0.6
"""W/(m K) across the layers, including the contacts between them: wound rolls 0.15 to 0.9, stacks 0.3 to 1.1."""
PROBED: Final = math.sqrt(2.0)
"""Ratio to the roll's mean: the core is between mean (1/(8πkL) above the surface) and hottest point (1/(4πkL))."""
CAN_M: Final[Mapping[str, float]] = MappingProxyType({"cylinder": 0.27e-3, "prismatic": 0.8e-3, "pouch": 0.15e-3})
CAN_J_M3K: Final[Mapping[str, float]] = MappingProxyType({"cylinder": 3.6e6, "prismatic": 2.4e6, "pouch": 2.2e6})
"""Wall of the casing and its heat capacity by volume: steel, aluminium, laminate."""
K_ALONG: Final = 25.0
"""W/(m K) along the layers: path of the heat to a plate at the base of a can."""
EMISSIVITY: Final = 0.85
SIGMA: Final = 5.670e-8
WARM_K: Final = 8.0
AIR_K: Final = 298.0
"""Temperature of the surface over air, and of the air, for still air; h changes by ± 20 % from 3 to 20 K."""
FORCED_H: Final = 40.0
"""W/(m² K) of air moved by a fan at 1 to 5 m/s over cells: 15 in a slow chamber to 80 in a fast bank of tubes."""
PLATE_H: Final = 450.0
"""W/(m² K) through 1–2 mm of gap filler (1.5–3 W/m/K), its contacts and a plate with coolant."""
RIBBON_H: Final = 150.0
"""W/(m² K) over the whole side of a cell of which a third touches a ribbon through its pad; more if immersed."""
NARROW_M: Final = 6e-3
"""Gaps narrower than the boundary layers of both walls reduce the convection."""
K_AIR: Final = 0.026
BUSBAR_W_K: Final = 0.012
"""Two welded strips of nickel, 0.2 × 8 mm over 20 mm, per cell of 21 mm; larger cells have more metal."""
PAD_M: Final = 1.0e-3
PAD_W_MK: Final = 0.15
"""Foam between flat cells if no gap is stated."""

_HEAT = "Steinhardt et al. 2022 (review of measured heat capacities and conductivities)"
_ROLL = "Drake et al. 2014, Forgez et al. 2010, Lin et al. 2014 (26650: 1.9 to 3.4 K/W), Steinhardt et al. 2022"

COOLED_APART: Final = 0.1
"""Relative sd of R_u from cell to cell in air or on pads: streams of a fan, neighbours and gaps differ by more than the
2 % of a liquid along the sides. A fit with 2 % takes such cells for a missing effect and finds no number."""


@dataclass(frozen=True, slots=True)
class Stated:
    """One parameter of a cell, with its source.

    Attributes
    ----------
    value : float
        SI: J/K, Ω, K/W.
    rel_sd : float
        Standard deviation of the logarithm.
    formula : str
        With the numbers used.
    source : str
        Physics, data sheet, published measurement: named.
    """

    value: float
    rel_sd: float
    formula: str
    source: str


class _Film(NamedTuple):
    """Heat from one cell's surface to what cools it."""

    conductance: float
    rel_sd: float
    formula: str
    source: str


def stated_parameters(cell: CellFacts) -> dict[str, Stated]:
    """Compute the parameters of one cell of the model.

    Parameters
    ----------
    cell : CellFacts
        With `parallel` = n > 1, the n cells count as one. It carries the current I of all and their heat: each cell
        heats by (I/n)² R_e, all by I² R_e/n. Through each cell flows 1/n of the heat, so that a temperature difference
        is the same with n times the capacities and 1/n of all resistances, R_c too. This holds where each cell gives
        off its heat through its own faces. Flat cells that touch (`spacing` 0) give it off through the outer faces of
        their stack, which is computed as one cell of n times the thickness.

    Returns
    -------
    dict of symbol to Stated
        C_c, C_s, R_e, R_c, R_u, R_cc; SI. Deterministic: the same facts give the same numbers.

    Notes
    -----
    Compared with the measured cells of a test: see `tests/thermal/test_cell_priors.py`. A mean-to-surface value
    1/(8πkL) with 20 or 30 % is *not* safe for R_c: two cells with a thermocouple inside have twice that value.

    References
    ----------
    Lin et al., Table 1; Churchill and Chu 1975 (natural convection); Drake et al. 2014, Steinhardt et al. 2022.

    Examples
    --------
    >>> from bms_gateway.thermal.cells import PUBLISHED
    >>> p = stated_parameters(PUBLISHED["a123_26650"])
    >>> round(p["R_c"].value, 2), p["R_c"].rel_sd
    (2.45, 0.5)
    """
    total, total_sd, heat, heat_source = _heat_capacity(cell)
    C_s = cell.area * CAN_M[cell.shape] * CAN_J_M3K[cell.shape]
    stacked = _stack(cell)
    film = _film(stacked)
    found = {
        "C_c": Stated(total - C_s, total_sd, f"{heat} − C_s", heat_source),
        "C_s": Stated(
            C_s,
            0.6,
            f"casing: {1e4 * cell.area:.4g} cm² × {1e3 * CAN_M[cell.shape]:g} mm × "
            f"{1e-6 * CAN_J_M3K[cell.shape]:g} MJ/m³/K",
            "geometry; held against two-node fits of measured cells (26650: 2.7 to 4.5, 32157: 18.8 J/K)",
        ),
        "R_e": _resistance(cell),
        "R_c": _core(stacked),
        "R_u": Stated(1.0 / film.conductance, film.rel_sd, film.formula, film.source),
        "R_cc": _neighbours(stacked),
    }
    if cell.parallel == 1:
        return found
    if stacked is not cell:
        text = f"{cell.parallel} cells that touch, as one of {cell.parallel} times the thickness: "
        whole = {k: replace(found[k], formula=text + found[k].formula) for k in ("R_c", "R_u", "R_cc")}
        return {k: whole.get(k) or _side_by_side(k, s, cell.parallel) for k, s in found.items()}
    return {symbol: _side_by_side(symbol, s, cell.parallel) for symbol, s in found.items()}


def _stack(cell: CellFacts) -> CellFacts:
    """Replace parallel flat cells whose faces touch by one of their thickness: heat leaves through its outer faces."""
    if cell.parallel == 1 or cell.shape == "cylinder" or cell.spacing != 0.0:
        return cell
    length, width, thickness = cell.size
    return replace(cell, size=(length, width, cell.parallel * thickness), parallel=1)


def cell_priors(cell: CellFacts, *, conduction: bool) -> dict[str, Prior]:
    """Return the parameters as priors of a string model; without R_cc if its cells do not conduct.

    A value of many parallel cells may be outside the bounds of a model file; it is then set to the bound.
    """
    return {
        symbol: Prior(min(max(s.value, KINDS[symbol].lower), KINDS[symbol].upper), s.rel_sd)
        for symbol, s in stated_parameters(cell).items()
        if conduction or symbol != "R_cc"
    }


def cell_tolerances(cell: CellFacts, cells: int) -> dict[str, float]:
    """How far the cells of a string differ, as `[tolerances]` of its model file.

    Examples
    --------
    >>> from bms_gateway.thermal.cells import cell_of
    >>> [cell_tolerances(cell_of(f"21700 {how}"), 12)["cell_R_u"] for how in ("forced", "liquid")]
    [0.1, 0.02]
    """
    apart = {"cell_R_u": COOLED_APART} if cells > 1 and cell.cooling != "liquid" else {}
    return {**DEFAULT_TOLERANCES, **apart}


def _side_by_side(symbol: str, one: Stated, cells: int) -> Stated:
    capacity = symbol in ("C_c", "C_s")
    value = one.value * cells if capacity else one.value / cells
    formula = f"({one.formula}) {'×' if capacity else '/'} {cells} in parallel"
    return Stated(value, one.rel_sd, formula, one.source)


def _heat_capacity(cell: CellFacts) -> tuple[float, float, str, str]:
    c = SPECIFIC_HEAT[cell.chemistry]
    sd = 0.10 if cell.chemistry else 0.12
    if cell.mass is not None:
        return cell.mass * c, sd, f"{1e3 * cell.mass:.4g} g × {c:g} J/kg/K", f"mass: {cell.source}; {_HEAT}"
    lfp = cell.chemistry == "LFP"
    density = DENSITY[cell.shape, lfp]
    mass = density * cell.volume
    text = f"{1e6 * cell.volume:.4g} cm³ × {density / 1e3:g} g/cm³ × {c:g} J/kg/K"
    return mass * c, math.hypot(sd, 0.15), text, f"usual density of a {cell.shape} cell; {_HEAT}"


def _resistance(cell: CellFacts) -> Stated:
    if cell.resistance is not None and cell.resistance_kind == "dc":
        text = f"{1e3 * cell.resistance:.4g} mΩ (pulse, 25 °C) × {SLOW_SHARE:g} for diffusion over minutes"
        return Stated(cell.resistance * SLOW_SHARE, 0.4, text, f"resistance: {cell.source}; 10 to 40 °C")
    if cell.resistance is not None:
        text = f"{1e3 * cell.resistance:.4g} mΩ (1 kHz) × {FROM_AC:g} for charge transfer and diffusion"
        return Stated(cell.resistance * FROM_AC, 0.5, text, f"resistance: {cell.source}; 10 to 40 °C")
    litres = 1e3 * cell.volume
    text = f"{1e3 * AREA_RESISTANCE_OHM_L:g} mΩ l / {litres:.3g} l"
    source = "usual product of resistance and volume (21 published cells); 10 to 40 °C"
    return Stated(AREA_RESISTANCE_OHM_L / litres, AREA_RESISTANCE_SD, text, source)


def _core(cell: CellFacts) -> Stated:
    if cell.shape == "cylinder":
        height = cell.size[1]
        mean = 1.0 / (8 * math.pi * K_RADIAL * height)
        text = f"√2/(8π k L), k = {K_RADIAL:g} W/m/K, L = {1e3 * height:g} mm (mean to hottest point: 1 to 2)"
        return Stated(PROBED * mean, 0.5, text, f"uniform heat in a cylinder; {_ROLL}")
    length, width, t = cell.size
    if cell.cooling == "plate" and cell.shape == "pouch":
        # heat leaves through one face: mean to surface t/(3 k A), hottest point t/(2 k A)
        value = t / (2.5 * K_STACK * length * width)
        text = f"t/(2.5 k A), t = {1e3 * t:g} mm, k = {K_STACK:g} W/m/K, A = {1e4 * length * width:.4g} cm²"
        return Stated(value, 0.6, text, "uniform heat in a plate cooled on one face; Steinhardt et al. 2022")
    # through both faces: mean to surface t/(12 k A), hottest point t/(8 k A), A one face
    value = t / (10 * K_STACK * length * width)
    text = f"t/(10 k A), t = {1e3 * t:g} mm, k = {K_STACK:g} W/m/K, A = {1e4 * length * width:.4g} cm²"
    return Stated(value, 0.6, text, "uniform heat in a plate cooled on both faces; Steinhardt et al. 2022")


def _film(cell: CellFacts) -> _Film:
    if cell.cooling == "forced":
        text = f"1/(h A), h = {FORCED_H:g} W/m²/K, A = {1e4 * cell.area:.4g} cm²"
        return _Film(FORCED_H * cell.area, 0.6, text, "air at 1 to 5 m/s; fits of cells in chambers and wind tunnels")
    if cell.cooling == "plate":
        text = f"1/(U A), U = {PLATE_H:g} W/m²/K, A = {1e4 * cell.base_area:.4g} cm² on the plate"
        resistance = 1 / (PLATE_H * cell.base_area)
        if cell.shape != "pouch":  # mean of the height to the base
            height = cell.size[1]
            resistance += height / (3 * K_ALONG * cell.base_area)
            text += f", + L/(3 k A), L = {1e3 * height:g} mm, k = {K_ALONG:g} W/m/K along the layers"
        return _Film(1 / resistance, 0.7, text, "gap filler, contacts and film of the coolant in series")
    if cell.cooling == "liquid":
        text = f"1/(U A), U = {RIBBON_H:g} W/m²/K, A = {1e4 * cell.side_area:.4g} cm²"
        return _Film(
            RIBBON_H * cell.side_area, 1.0, text, "a third of the side on a ribbon with a pad; a rig had a sixth"
        )
    return _still_air(cell)


def _still_air(cell: CellFacts) -> _Film:
    convective, radiative = _convection(cell), 4 * EMISSIVITY * SIGMA * (AIR_K + WARM_K / 2) ** 3
    free, sd = 1.0, 0.4
    if cell.spacing is not None and cell.spacing < NARROW_M:
        free, sd = max(cell.spacing / NARROW_M, 0.15), 0.6
    h = free * (convective + radiative)
    text = (
        f"1/(h A), h = {convective:.3g} (air) + {radiative:.3g} (radiation)"
        f"{f', × {free:.2g} in gaps of {1e3 * (cell.spacing or 0):g} mm' if free < 1 else ''}"
        f" W/m²/K, A = {1e4 * cell.area:.4g} cm²"
    )
    return _Film(h * cell.area, sd, text, f"Churchill and Chu 1975 at {WARM_K:g} K; emissivity {EMISSIVITY:g}")


def _convection(cell: CellFacts) -> float:
    """Natural convection of air at a wall or a lying cylinder, W/(m² K).

    References
    ----------
    Churchill and Chu 1975, for laminar films; air at 30 °C.
    """
    length, viscosity, diffusivity, prandtl, k = cell.upright, 1.6e-5, 2.25e-5, 0.71, K_AIR
    rayleigh = 9.81 / AIR_K * WARM_K * length**3 / (viscosity * diffusivity)
    if cell.shape == "cylinder" and cell.orientation == "lying":
        nusselt = 0.36 + 0.518 * rayleigh**0.25 / (1 + (0.559 / prandtl) ** (9 / 16)) ** (4 / 9)
    else:
        nusselt = 0.68 + 0.670 * rayleigh**0.25 / (1 + (0.492 / prandtl) ** (9 / 16)) ** (4 / 9)
    return float(nusselt * k / length)


def _neighbours(cell: CellFacts) -> Stated:
    if cell.shape == "cylinder":
        d, height = cell.size
        gap = 2e-3 if cell.spacing is None else max(cell.spacing, 1e-4)
        shape_factor = 2 * math.pi * height / math.acosh(2 * ((d + gap) / d) ** 2 - 1)
        air = shape_factor * K_AIR
        radiation = 0.2 * cell.side_area * 4 * EMISSIVITY * SIGMA * AIR_K**3
        bars = BUSBAR_W_K * d / 0.021
        text = (
            f"1/(air {1e3 * air:.3g} + radiation {1e3 * radiation:.3g} + busbars {1e3 * bars:.3g} mW/K), "
            f"gap {1e3 * gap:g} mm"
        )
        return Stated(1 / (air + radiation + bars), 0.9, text, "conduction between parallel cylinders; joints assumed")
    face = cell.size[0] * cell.size[1]
    if cell.spacing is None:
        resistance, text = PAD_M / (PAD_W_MK * face), f"{1e3 * PAD_M:g} mm of foam, {PAD_W_MK:g} W/m/K"
    elif cell.spacing == 0.0:
        resistance, text = 1.0 / (300.0 * face), "faces that touch, 300 W/m²/K"
    else:
        radiation = 4 * EMISSIVITY / (2 - EMISSIVITY) * SIGMA * AIR_K**3
        resistance = 1.0 / ((K_AIR / cell.spacing + radiation) * face)
        text = f"{1e3 * cell.spacing:g} mm of air and radiation"
    return Stated(resistance, 0.9, f"{text} over {1e4 * face:.4g} cm²", "plate of the gap; joints left out")
