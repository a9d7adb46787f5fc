"""Real cells, surface only: missing effects are named, the core gets better or is not claimed to, the band holds."""

from functools import cache

import numpy as np
import pytest

from bms_gateway.diagnose.band import core_band
from bms_gateway.diagnose.second import second_search
from tests.diagnose.measured_cells import CELLS, bench

NAMES = {
    "a123_26650_hev2": {"resistance_temperature"},
    "lfp_32113_insulated_1": {"resistance_temperature", "entropic_heat"},
    "lfp_32113_uninsulated_2": {"resistance_temperature", "entropic_heat"},
}
BOTH = ("lfp_32113_insulated_1", "lfp_32113_uninsulated_2")
QUICK = "a123_26650_hev2"
each = pytest.mark.parametrize("name", [pytest.param(n, marks=() if n == QUICK else pytest.mark.slow) for n in CELLS])
PERTURBED = ({"every": 2}, {"share": 0.6}, {"noise": 0.05}, {"C_c": 0.8}, {"C_c": 1.2})


@cache
def searched(name, **how):
    model, m, core = bench(name, **how)
    return second_search(model, [m]), core


@cache
def together():
    model, *_ = bench(BOTH[0])
    parts = [bench(name, voltage=True) for name in BOTH]
    return second_search(model, [m for _, m, _ in parts]), [core for *_, core in parts]


def named(found):
    return {c.candidate.name for c in found.chosen}


def error(cores, core):
    return float(np.sqrt(np.mean((cores.mean[:, 0] - core) ** 2)))


@each
def test_effects_are_named_from_the_surface_alone(name):
    found, _ = searched(name)
    assert named(found) == NAMES[name]
    assert found.verdict == "missing_effect"
    assert found.unknown_remains


@each
def test_band_covers_the_thermocouple_in_the_core(name):
    found, core = searched(name)
    (cores,) = found.cores()
    assert np.mean(np.abs(cores.mean[:, 0] - core) < 2.0 * cores.sd[:, 0]) >= 0.9


def test_band_grows_where_a_witness_speaks_against_the_core():
    found, _ = searched("a123_26650_hev2")
    size = found.discrepancy[1]
    calm, alarmed = (
        core_band(found.best, size, found.hypotheses, found.records, alarmed=a)[0].sd for a in (False, True)
    )
    assert np.all(alarmed > calm)
    assert np.all(calm >= size)


def test_core_of_the_26650_is_within_half_a_kelvin():
    found, core = searched("a123_26650_hev2")
    assert found.core_claimed
    assert error(found.cores()[0], core) <= 0.5


@pytest.mark.slow
def test_core_of_the_insulated_cell_falls_from_many_kelvins_to_one():
    found, core = searched("lfp_32113_insulated_1")
    before = found.baseline.prediction.X[0][:, 0]
    dt = found.baseline.problem.records[0].drive.dt
    before = np.interp(np.arange(len(core)), dt * np.arange(len(before)), before)
    assert found.core_claimed
    assert np.sqrt(np.mean((before - core) ** 2)) > 4.0
    assert error(found.cores()[0], core) <= 1.0


@pytest.mark.slow
def test_core_of_the_cell_cooled_at_its_ends_is_not_claimed_though_its_surface_gets_better():
    found, _ = searched("lfp_32113_uninsulated_2")
    assert found.explained > 0.8
    assert not found.core_claimed
    assert any("B = " in said for said in found.alarms)
    assert any("All numbers together" in said for said in found.alarms)


@pytest.mark.slow
def test_records_of_one_cell_type_that_disagree_are_told():
    found, cores = together()
    assert named(found) == {"resistance_temperature", "entropic_heat"}
    assert not found.core_claimed
    assert any(s.startswith("Alone, lfp_32113_uninsulated_2 asks for other numbers") for s in found.alarms)
    assert not any(s.startswith("Alone, lfp_32113_insulated_1 asks for other") for s in found.alarms)
    for band, core in zip(found.cores(), cores, strict=True):
        assert np.mean(np.abs(band.mean[:, 0] - core) < 2.0 * band.sd[:, 0]) >= 0.9


@pytest.mark.slow
@pytest.mark.parametrize("name", CELLS)
def test_voltage_testifies_to_the_same_heat(name):
    found, _ = searched(name, voltage=True)
    said = {w.name: w for w in found.witnesses}
    assert said["voltage energy"].value < 0.2
    assert not said["voltage activation"].alarm
    assert "voltage heat" in said
    assert named(found) == NAMES[name]


@pytest.mark.slow
@pytest.mark.parametrize("name", CELLS)
@pytest.mark.parametrize("how", PERTURBED, ids=str)
def test_names_and_claims_hold_under_perturbation(name, how):
    found, core = searched(name, **how)
    assert named(found) == NAMES[name]
    assert found.core_claimed == (name != "lfp_32113_uninsulated_2")
    if found.core_claimed:
        assert error(found.cores()[0], core) <= 1.2
