"""What `cells` says before any measurement, held against published values and against cells that were measured."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.errors import UsageError
from bms_gateway.thermal import KINDS
from bms_gateway.thermal.cells import FORMATS, PUBLISHED, cell_of, cell_priors, stated_parameters
from tests.thermal.prior_errors import known_errors


def test_priors_hold_what_was_published_and_measured() -> None:
    errors = known_errors()
    print("\n".join(f"{what}: {e:+.2f} sd" for what, e in errors.items()))
    inside = np.abs(list(errors.values())) <= 2.0
    assert len(errors) >= 30
    assert inside.mean() >= 0.95
    # honest, not merely wide: a prior of twice the error everywhere would be useless
    assert np.sqrt(np.mean(np.square(list(errors.values())))) > 0.5


def test_a_cell_without_a_resistance_gets_one_that_published_cells_have() -> None:
    """Half of them above, half below, and inside two sd: with the size alone, and with the capacity too."""
    for forgotten in ({"resistance": None}, {"resistance": None, "capacity_Ah": None}):
        z = []
        for cell in (c for c in PUBLISHED.values() if c.resistance is not None):
            assert cell.resistance_kind == "dc"
            found = stated_parameters(replace(cell, **forgotten))["R_e"]
            z.append(math.log(1.3 * cell.resistance / found.value) / found.rel_sd)  # 1.3: minutes against a pulse
        assert len(z) >= 20
        assert abs(np.median(z)) < 0.3
        assert np.mean(np.abs(z) <= 2.0) >= 0.95
        assert np.sqrt(np.mean(np.square(z))) > 0.5  # not merely wide


def test_a_conductivity_of_thirty_per_cent_is_not_claimed() -> None:
    for cell in (*PUBLISHED.values(), *FORMATS.values()):
        assert stated_parameters(cell)["R_c"].rel_sd >= 0.45


@pytest.mark.parametrize("name", [*PUBLISHED, *FORMATS])
def test_every_cell_states_formula_source_and_what_a_model_file_takes(name: str) -> None:
    cell = cell_of(name)
    for symbol, stated in stated_parameters(cell).items():
        assert stated.formula
        assert stated.source
        assert KINDS[symbol].lower <= stated.value <= KINDS[symbol].upper
        assert 0.05 <= stated.rel_sd <= 1.5


def test_cells_in_parallel_are_one_that_gives_the_same_temperatures() -> None:
    one, four = (stated_parameters(cell_of(f"lg_m50 {p}p")) for p in (1, 4))
    for symbol in ("C_c", "C_s"):
        assert four[symbol].value == pytest.approx(4 * one[symbol].value)
    for symbol in ("R_e", "R_c", "R_u", "R_cc"):
        assert four[symbol].value == pytest.approx(one[symbol].value / 4)


def test_a_very_large_lump_still_makes_a_model() -> None:
    for symbol, prior in cell_priors(cell_of("leaf_pouch 40p"), conduction=True).items():
        assert KINDS[symbol].lower <= prior.value <= KINDS[symbol].upper


def test_what_is_told_counts() -> None:
    told = cell_of("21700, 4.9Ah, 68g, 24mOhm ac, liquid, lying, NCA, 3p, 1.5mm")
    assert (told.capacity_Ah, told.mass, told.resistance, told.resistance_kind) == (4.9, 0.068, 0.024, "ac")
    assert (told.cooling, told.orientation, told.chemistry, told.parallel, told.spacing) == (
        "liquid", "lying", "NCA", 3, 0.0015,
    )  # fmt: skip
    known, unknown = stated_parameters(cell_of("21700 4.9Ah 68g 24mOhm")), stated_parameters(cell_of("21700"))
    for symbol in ("C_c", "R_e"):
        assert known[symbol].rel_sd < unknown[symbol].rel_sd
    still, forced, plate = (stated_parameters(cell_of(f"21700 {c}"))["R_u"].value for c in ("still", "forced", "plate"))
    assert still > forced
    assert still > plate


def test_the_thickness_is_the_least_measure() -> None:
    assert cell_of("pouch 7.1x290x216mm").size == pytest.approx(cell_of("pouch 290x216x7.1mm").size)


@pytest.mark.parametrize(
    ("model", "name", "capacity"),
    [
        ("INR21700-50E", "samsung_50e", 4.9),
        ("US18650VTC6", "sony_vtc6", 3.0),
        ("INR18650-26X", "INR18650-26X", 2.6),
        ("NCR18650B", "panasonic_ncr18650b", 3.25),
        ("INR18650Q", "INR18650Q", None),
    ],
)
def test_a_makers_model_is_the_published_cell_or_its_format(model: str, name: str, capacity: float | None) -> None:
    cell = cell_of(model)
    assert (cell.name, cell.capacity_Ah) == (name, capacity)
    assert cell_of(f"{cell.name} 2p").size == cell.size


@pytest.mark.parametrize(
    "text", ["prismatic 174 x 207 x 72 mm 280 Ah 0.3 mOhm", "prismatic 174×207×72mm 280Ah 0.3mOhm"]
)
def test_numbers_may_stand_apart_from_their_units(text: str) -> None:
    cell = cell_of(text)
    assert (cell.size, cell.capacity_Ah, cell.resistance) == (pytest.approx((0.207, 0.174, 0.072)), 280.0, 0.3e-3)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "says nothing"),
        ("lg_m5", "did you mean 'lg_m50'"),
        ("21700 5A", "'5A' is not known"),
        ("lg_m50 air", "cooling: still, forced, plate, liquid"),
        ("lg_m50 upright", "orientation: standing, lying"),
        ("lg_m50 LTO", "chemistry: LFP, NMC, NCA, LMO, LCO"),
        ("21700 forsed", "did you mean 'forced'"),
        ("pouch 33Ah", "size of a pouch cell is needed"),
        ("pouch 290x216mm", "has 3 measures"),
        ("cylinder 32x113x5mm", "has 2 measures"),
        ("21700 0p", "1p to 500p"),
        ("21700 1.5p", "whole number"),
        ("21700 5000Ah", "0.01 to 1000 Ah"),
        ("21700 900g", "g/cm³"),
        ("21700 500Ah", "valid: up to 10 Ah"),
        ("21700 g", "is not known"),
        ("21700 25Ohm", "0.01 mOhm to 1 Ohm"),
    ],
)
def test_what_is_wrong_is_told_in_a_line(text: str, part: str) -> None:
    with pytest.raises(UsageError) as told:
        cell_of(text)
    assert part in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(("gap", "stacks"), [("2mm", 1), ("0mm", 3)], ids=["apart", "touching"])
def test_r_c_of_parallel_pouches_is_between_mean_and_hottest_of_a_solved_stack(gap, stacks) -> None:
    """Truth: the heat equation of the layers by finite differences, heated uniformly, both outer faces at 0 K."""
    cells, thickness, k, area, heat = 3, 8e-3, 0.6, 0.2 * 0.1, 5.0
    total = stacks * thickness  # three cells apart are three such plates, each with a third of the heat
    share = heat * stacks / cells
    n = 400
    laplacian = (np.diag(np.full(n, -2.0)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)) * (n + 1) ** 2
    rise = np.linalg.solve(laplacian, np.full(n, -share / (area * total) * total**2 / k))
    told = stated_parameters(cell_of(f"pouch 200x100x8mm 3p {gap}"))
    assert rise.mean() < heat * told["R_c"].value < rise.max()
    one = stated_parameters(cell_of(f"pouch 200x100x8mm {gap}"))
    assert told["R_e"].value == pytest.approx(one["R_e"].value / cells)
    assert told["C_c"].value == pytest.approx(one["C_c"].value * cells)
