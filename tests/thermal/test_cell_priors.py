"""What `cells` says before any measurement, held against published values and against cells that were measured.

The measured values are found here, by a plain least-squares fit of two nodes to surface and core, by the decay of the
surface in rests, and by regression of the voltage: by none of the product's own code.
"""

import gzip
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import curve_fit, least_squares

from bms_gateway.errors import UsageError
from bms_gateway.thermal import KINDS
from bms_gateway.thermal.cells import FORMATS, PUBLISHED, CellFacts, cell_of, cell_priors, stated_parameters
from tests.data import need

# Published: X. Lin et al. Table 1 (32157); Lin et al. 2014, J. Power Sources 257 (26650, two states); Richardson
# (26650: sum of the capacities, centre to surface, surface to air; 32113: half as much again as its mean to surface).
LITERATURE = [
    ("a123_32157", {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79}),
    ("a123_26650", {"C_c": 62.7, "C_s": 4.5, "R_c": 1.94, "R_u": 3.19}),
    ("a123_26650", {"C": 84.5, "R_c": 3.0, "R_u": 4.8}),
    ("a123_32113", {"R_c": 1.76}),
]


def log_sd(cell: CellFacts, symbol: str) -> tuple[float, float]:
    """Logarithm of the prior's median, and its sd; `C` is the sum of the capacities, `tau` what a rest shows."""
    p = stated_parameters(cell)
    if symbol in p:
        return math.log(p[symbol].value), p[symbol].rel_sd
    C = p["C_c"].value + p["C_s"].value
    sd_C = math.hypot(p["C_c"].value * p["C_c"].rel_sd, p["C_s"].value * p["C_s"].rel_sd) / C
    if symbol == "C":
        return math.log(C), sd_C
    R = p["R_u"].value + p["R_c"].value
    sd_R = math.hypot(p["R_u"].value * p["R_u"].rel_sd, p["R_c"].value * p["R_c"].rel_sd) / R
    return math.log(C * R), math.hypot(sd_C, sd_R)


def off(cell: CellFacts, found: dict[str, float]) -> dict[str, float]:
    """Errors in sd."""
    errors = {}
    for symbol, truth in found.items():
        middle, sd = log_sd(cell, symbol)
        errors[f"{cell.name} {symbol}"] = (math.log(truth) - middle) / sd
    return errors


def two_nodes(p, heat, air, start, dt):
    C_c, C_s, R_c, R_u = np.exp(p)
    M = np.zeros((4, 4))
    M[:2] = dt * np.array(
        [
            [-1 / (C_c * R_c), 1 / (C_c * R_c), 1 / C_c, 0],
            [1 / (C_s * R_c), -(1 / R_c + 1 / R_u) / C_s, 0, 1 / C_s / R_u],
        ]
    )
    E = expm(M)
    x, out = np.array(start), np.empty((len(heat), 2))
    for k, u in enumerate(zip(heat, air, strict=True)):
        out[k] = x
        x = E[:2, :2] @ x + E[:2, 2:] @ np.array(u)
    return out


def fitted(name: str, guess: tuple[float, ...]) -> dict[str, float]:
    """Two nodes fitted to core and surface of a record, with the heat I (U − V)."""
    d = np.genfromtxt(need("core_surface", f"{name}.csv"), delimiter=",", names=True)
    step = 10
    n = len(d) // step * step
    mean = {c: d[c][:n].reshape(-1, step).mean(axis=1) for c in d.dtype.names}
    current, V = -d["I_A"], d["V_V"]  # the record counts charge positive
    charge = np.cumsum(current) / 3600
    U0, slope, R_e = np.linalg.lstsq(np.stack([np.ones(len(V)), charge, -current], 1), V, rcond=None)[0]

    def residual(p):
        heat = (current * (U0 + p[4] + slope * charge - V))[:n].reshape(-1, step).mean(axis=1)
        T = two_nodes(p[:4], heat, mean["T_amb_C"], [mean["T_core_C"][0], mean["T_surf_C"][0]], float(step))
        return np.concatenate([T[:, 0] - mean["T_core_C"], T[:, 1] - mean["T_surf_C"], [p[4] / 0.02]])

    p = least_squares(residual, [*np.log(guess), 0.0]).x
    C_c, C_s, R_c, R_u = np.exp(p[:4])
    assert np.sqrt(np.mean(residual(p) ** 2)) < 1.0  # K: these numbers do describe the record
    return {"C_c": C_c, "C_s": C_s, "R_c": R_c, "R_u": R_u, "R_e": R_e}


def rested(name: str, at_rest_A: float) -> float:
    """Time constant with which the surface falls in the longest rest after a load, s."""
    with gzip.open(need("bench", f"{name}.csv.gz"), "rt") as f:
        d = np.genfromtxt(f, delimiter=",", names=True)
    d = d[np.isfinite(d["surface_1_C"])]
    T = d["surface_2_C"] if "surface_2_C" in d.dtype.names else d["surface_1_C"]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.abs(d["current_A"]) < at_rest_A, [0]]).astype(int)))
    best = None
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        t, y = d["time_s"][a:b] - d["time_s"][a], T[a:b]
        keep = (t > 60) & (t < 5400)
        if keep.sum() > 8 and (fall := y[keep][0] - y[keep][-1]) > 1.5 and (best is None or fall > best[0]):
            shape = curve_fit(lambda u, a, b, tau: a + b * np.exp(-u / tau), t[keep], y[keep], p0=[y[-1], fall, 800.0])
            best = fall, float(shape[0][2])
    assert best is not None
    return best[1]


CHAMBER = {"lg_m50": "forced", "leaf_pouch": "still", "melasta_5Ah5": "still"}


@cache
def known_errors() -> dict[str, float]:
    """Errors in sd of all that was published, of the records with a core, and of long rests."""
    errors: dict[str, float] = {}
    for k, (name, values) in enumerate(LITERATURE):
        errors |= {f"published {k} {what}": e for what, e in off(PUBLISHED[name], values).items()}
    for record, name, guess in (
        ("a123_26650_hev2", "a123_26650", (75.0, 5.0, 2.5, 4.0)),
        ("lfp_32113_insulated_1", "a123_32113", (190.0, 15.0, 1.5, 3.0)),
        ("lfp_32113_uninsulated_2", "a123_32113", (190.0, 15.0, 1.5, 2.0)),
    ):
        errors |= {f"{record} {what}": e for what, e in off(PUBLISHED[name], fitted(record, guess)).items()}
    for record, name, amps in (
        ("lgm50_rate_2C_T25", "lg_m50", 0.05),
        ("lgm50_rate_0p5C_T0", "lg_m50", 0.05),
        ("lgm50_2C_25C_cell796", "lg_m50", 0.05),
        ("leaf_cell_pouch_1c", "leaf_pouch", 0.5),
        ("leaf_cell_pouch_3c", "leaf_pouch", 0.5),
        ("melasta_5Ah5_pouch_still", "melasta_5Ah5", 0.1),
    ):
        cell = cell_of(f"{name} {CHAMBER[name]}")
        errors |= {f"{record} {what}": e for what, e in off(cell, {"tau": rested(record, amps)}).items()}
    return errors


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
