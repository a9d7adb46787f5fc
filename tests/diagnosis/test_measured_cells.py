"""Real cells, surface only: missing effects are named, the core gets better or is not claimed to, the band holds."""

from functools import cache

import numpy as np
import pytest

from bms_gateway.diagnosis.adding import cores_with_named
from bms_gateway.diagnosis.core_band import UNPROVEN, core_bands
from bms_gateway.diagnosis.diagnosis import diagnose
from bms_gateway.diagnosis.second_search import second_search
from tests.diagnosis.measured_cells import CELLS, bench, bench_record

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


def against(found, cores):
    """Core less thermocouple at the instants of each record, K, and the sd that is told of it."""
    parts = []
    for band, core, m in zip(core_bands(found.best, share=UNPROVEN), cores, found.records, strict=True):
        y = np.interp(band.time_s, m.drive.dt * np.arange(len(core)), core)
        parts.append((band.T_c[:, 0] - y, band.total_K[:, 0]))
    return parts


def error(found, core):
    ((off, _),) = against(found, [core])
    return float(np.sqrt(np.mean(off**2)))


@each
def test_effects_are_named_from_the_surface_alone(name):
    found, _ = searched(name)
    assert named(found) == NAMES[name]
    assert found.verdict == "missing_effect"
    assert found.unknown_remains


@pytest.mark.slow
@pytest.mark.parametrize("name", CELLS)
def test_band_covers_the_thermocouple_in_the_core(name):
    model, record, core = bench_record(name, every=2)
    asked = diagnose(model, [record])
    for known in cores_with_named(model, [record], asked):  # as it is, and with what is named
        (band,) = known.bands
        off = band.T_c[:, 0] - np.interp(band.time_s, record.instants, core)
        assert np.mean(np.abs(off) < 2.0 * band.total_K[:, 0]) >= 0.9


def test_core_of_the_26650_is_within_half_a_kelvin():
    found, core = searched("a123_26650_hev2")
    assert found.core_claimed
    assert error(found, core) <= 0.5


@pytest.mark.slow
def test_core_of_the_insulated_cell_falls_from_many_kelvins_to_one():
    found, core = searched("lfp_32113_insulated_1")
    before = found.baseline.prediction.X[0][:, 0]
    dt = found.baseline.problem.records[0].drive.dt
    before = np.interp(np.arange(len(core)), dt * np.arange(len(before)), before)
    assert found.core_claimed
    assert np.sqrt(np.mean((before - core) ** 2)) > 4.0
    assert error(found, core) <= 1.0


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
    for off, sd in against(found, cores):
        assert np.mean(np.abs(off) < 2.0 * sd) >= 0.9


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
        assert error(found, core) <= 1.2
