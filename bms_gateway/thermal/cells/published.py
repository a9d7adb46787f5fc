"""Cells with published mass, capacity and resistance: examples, and the names that `--cell NAME` accepts.

Numbers are typical ones of data sheets; for an upper bound of a data sheet, a slightly lower value is used. Cooling is
that of the published measurement, otherwise still air: state your own.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from bms_gateway.thermal.cells.facts import CellFacts, Chemistry, Cooling

CYLINDERS: Final[Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "18650": (18.4e-3, 65.0e-3),
        "21700": (21.3e-3, 70.2e-3),
        "26650": (26.0e-3, 65.5e-3),
        "26700": (26.2e-3, 70.5e-3),
        "32113": (32.0e-3, 113.0e-3),
        "32157": (32.0e-3, 157.0e-3),
        "32700": (32.2e-3, 70.5e-3),
        "38120": (38.0e-3, 120.0e-3),
        "4680": (46.0e-3, 80.0e-3),
        "4695": (46.0e-3, 95.0e-3),
        "46120": (46.0e-3, 120.0e-3),
    }
)
"""Diameter and height of cylinder formats, m."""
FORMATS: Final[Mapping[str, CellFacts]] = MappingProxyType(
    {name: CellFacts(name, "cylinder", size) for name, size in CYLINDERS.items()}
)
"""A format alone: everything else at its usual value."""


def _round(
    name: str,
    form: str,
    chemistry: Chemistry,
    numbers: tuple[float, float, float],
    source: str,
    cooling: Cooling = "still",
) -> CellFacts:
    """Facts of a cylinder; `numbers` are mass [g], capacity [Ah] and resistance [mΩ]."""
    mass_g, capacity_Ah, mOhm = numbers
    return CellFacts(
        name,
        "cylinder",
        CYLINDERS[form],
        chemistry,
        1e-3 * mass_g,
        capacity_Ah,
        1e-3 * mOhm,
        cooling=cooling,
        source=source,
    )


def _flat(
    name: str,
    shape: str,
    size_mm: tuple[float, float, float],
    chemistry: Chemistry,
    numbers: tuple[float, float, float],
    source: str,
) -> CellFacts:
    """Facts of a flat cell; `numbers` as of `_round`."""
    mass_g, capacity_Ah, mOhm = numbers
    kind = CellFacts(name, "pouch" if shape == "pouch" else "prismatic", tuple(1e-3 * x for x in size_mm), chemistry)
    return CellFacts(name, kind.shape, kind.size, chemistry, 1e-3 * mass_g, capacity_Ah, 1e-3 * mOhm, source=source)


_ALL = (
    _round("a123_26650", "26650", "LFP", (72, 2.3, 10.0), "data sheet ANR26650M1; in a chamber with a fan", "forced"),
    _round(
        "a123_32113", "32113", "LFP", (205, 4.4, 3.2), "data sheet AHR32113M1Ultra; in a chamber with a fan", "forced"
    ),
    _round("a123_32157", "32157", "LFP", (285, 8.0, 2.6), "Lin et al., Table 1 (format, capacity)", "forced"),
    _round("k2_26650", "26650", "LFP", (82, 2.6, 14.0), "data sheet LFP26650P"),
    _round("lg_m50", "21700", "NMC", (69, 4.85, 27.0), "data sheet INR21700-M50; Chen et al. 2020"),
    _round("lg_mj1", "18650", "NMC", (49, 3.4, 35.0), "data sheet INR18650-MJ1"),
    _round("samsung_30q", "18650", "NCA", (46, 2.95, 22.0), "data sheet INR18650-30Q"),
    _round("samsung_40t", "21700", "NCA", (67, 3.95, 15.0), "data sheet INR21700-40T"),
    _round("samsung_50e", "21700", "NCA", (68, 4.9, 30.0), "data sheet INR21700-50E"),
    _round("molicel_p42a", "21700", "NCA", (67, 4.0, 16.0), "data sheet INR-21700-P42A"),
    _round("molicel_p45b", "21700", "NCA", (68, 4.4, 13.0), "data sheet INR-21700-P45B"),
    _round("sony_vtc6", "18650", "NCA", (46.5, 3.0, 20.0), "data sheet US18650VTC6"),
    _round("panasonic_18650pf", "18650", "NCA", (47, 2.8, 33.0), "data sheet NCR18650PF; Kollmeyer 2018"),
    _round("panasonic_ncr18650b", "18650", "NCA", (47.5, 3.25, 45.0), "data sheet NCR18650B"),
    _round("tesla_4680", "4680", "NMC", (355, 22.5, 5.0), "Ank et al. 2023 (teardown)"),
    _flat("leaf_pouch", "pouch", (290, 216, 7.1), "LMO", (787, 32.5, 1.6), "Nissan/AESC E5 data; ORNL 2019"),
    _flat("melasta_5Ah5", "pouch", (127, 43, 9.5), "LCO", (110, 5.5, 3.2), "data sheet of Melasta SLPB cells, 15C"),
    _flat("kokam_40Ah", "pouch", (226, 227, 10.7), "NMC", (1030, 40.0, 1.0), "data sheet SLPB100216216H"),
    _flat("catl_lf280", "prismatic", (205, 174, 72), "LFP", (5400, 280.0, 0.35), "data sheet LF280K"),
    _flat("sdi_60ah", "prismatic", (173, 125, 45), "NMC", (1800, 60.0, 0.9), "data sheet Samsung SDI 60 Ah (BMW i3)"),
    _flat("sdi_94ah", "prismatic", (173, 125, 45), "NMC", (2060, 94.0, 0.9), "data sheet Samsung SDI 94 Ah (BMW i3)"),
)
PUBLISHED: Final[Mapping[str, CellFacts]] = MappingProxyType({c.name: c for c in _ALL})
