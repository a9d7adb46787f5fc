"""The virtual pack obeys the physics of the independent truth, and its traffic says what it measured."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.bus.traffic import Series, Traffic, lines, steps, voltage_steps
from bms_gateway.bus.virtual import VirtualPack
from bms_gateway.config import load_config
from bms_gateway.thermal.cycles import US06_S
from tests.config.files import OWN, write
from tests.truth.string import TruthString, rk4

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    two = OWN + '[[string]]\nname = "string_2"\nmodel = "string_1.toml"\n'
    return load_config(write(tmp_path_factory.mktemp("pack"), two))


def test_the_pack_follows_the_independent_truth(loaded):
    pack = VirtualPack(loaded.plan, 5, common=0.1)
    parts = [segments[1] for segments in pack.segments(900)]
    assert len(parts) == 2
    core = np.vstack([parts[0].core_C, parts[1].core_C[1:]])
    surface = np.vstack([parts[0].surface_C, parts[1].surface_C[1:]])
    p = pack.parameters[1]
    truth = TruthString.of(5, C_c=p.C_c, C_s=p.C_s, R_e=p.R_e, R_c=p.R_c, R_u=p.R_u, R_cc=p.R_cc, C_f=p.C_f)
    seconds = np.arange(901.0)
    series = [{k: s.series[k] for k in (("current", None), ("coolant_inlet", None))} for s in parts]
    current = np.concatenate(
        [series[0]["current", None].at(seconds[:600]), series[1]["current", None].at(seconds[600:900])]
    )
    inlet = np.concatenate(
        [series[0]["coolant_inlet", None].at(seconds[:601]), series[1]["coolant_inlet", None].at(seconds[601:])]
    )
    expected_core, expected_surface = rk4(truth, current, inlet, (core[0], surface[0]))
    assert np.abs(core - expected_core).max() < 1e-4
    assert np.abs(surface - expected_surface).max() < 1e-4
    assert current.std() > 10
    assert np.ptp(inlet) > 4


def test_the_same_seed_is_the_same_pack_and_another_is_not(loaded):
    first, again, other = (next(VirtualPack(loaded.plan, seed).segments(60))[0].core_C for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.allclose(first, other)


def test_scatter_and_common_are_what_makes_it_differ_from_the_model_file(loaded):
    nominal = loaded.plan.strings[0].model.nominal
    assert np.array_equal(VirtualPack(loaded.plan, 0, scatter=0.0).parameters[0].R_e, nominal.R_e)
    many = np.log([VirtualPack(loaded.plan, seed).parameters[0].R_e / nominal.R_e for seed in range(60)])
    assert np.std(many) == pytest.approx(0.02, rel=0.2)
    shifted = np.log([VirtualPack(loaded.plan, s, scatter=0.0, common=0.3).parameters[0].R_c for s in range(60)])
    assert np.std(shifted[:, 0]) == pytest.approx(0.3, rel=0.3)
    assert np.allclose(shifted, shifted[:, :1])


def test_a_constant_inlet_of_the_plan_stays_constant(loaded):
    s = loaded.plan.strings[0]
    channels = tuple(replace(c, signal=None, constant=22.0) if c.quantity == "coolant_inlet" else c for c in s.channels)
    pack = VirtualPack(replace(loaded.plan, strings=(replace(s, channels=channels),)), 0)
    segment = next(pack.segments(10))[0]
    assert np.array_equal(segment.series["coolant_inlet", None].value, np.full(11, 22.0))


def test_frames_come_at_their_cycle_times_evenly_spread_and_cuts_do_not_matter(loaded):
    segments = next(VirtualPack(loaded.plan, 1).segments(20))
    feeds = [s.series for s in segments]
    whole = Traffic(loaded.plan, loaded.database).between(feeds, 0, 20_000_000_000)
    cut = Traffic(loaded.plan, loaded.database)
    parts = [cut.between(feeds, a, b) for a, b in ((0, 7_300_000_001), (7_300_000_001, 20_000_000_000))]
    assert np.array_equal(np.concatenate([p.time_ns for p in parts]), whole.time_ns)
    assert np.array_equal(np.concatenate([p.data for p in parts]), whole.data)
    assert np.all(np.diff(whole.time_ns) > 0)
    # two strings: current every 0.1 s; coolant, surfaces (2 multiplexer values) and voltages (2) every second
    assert len(whole) == 20 * 2 * (10 + 1 + 2 + 2)
    for can_id in np.unique(whole.can_id):
        gaps = np.diff(whole.time_ns[whole.can_id == can_id])
        assert gaps.max() <= 1_000_000_000


def test_noise_is_white_per_frame_and_only_on_temperatures(loaded):
    segments = next(VirtualPack(loaded.plan, 1).segments(600))
    feeds = [s.series for s in segments]
    quiet = Traffic(loaded.plan, loaded.database).between(feeds, 0, 600_000_000_000)
    noisy = Traffic(loaded.plan, loaded.database, noise_K=0.1, seed=3).between(feeds, 0, 600_000_000_000)
    first = quiet.can_id == quiet.can_id[0]  # string 1's current and voltage
    assert np.array_equal(quiet.data[first], noisy.data[first])
    surface = loaded.database.message("string_1_surface")
    pick = (quiet.can_id == surface.can_id) & (quiet.data[:, 1] >> 4 == 0)
    difference = 0.01 * (
        noisy.data[pick, 2:4].copy().view("<u2").astype(float) - quiet.data[pick, 2:4].copy().view("<u2")
    )
    assert difference.std() == pytest.approx(0.1, rel=0.1)


def test_a_step_series_holds_and_a_line_series_goes_straight():
    t = np.array([0.0, 1.0, 2.0])
    v = np.array([1.0, 3.0, 5.0])
    at = np.array([0.0, 0.5, 0.999, 1.0, 1.5, 2.0])
    assert steps(t, v).at(at).tolist() == [1.0, 1.0, 1.0, 3.0, 3.0, 5.0]
    assert lines(t, v).at(at) == pytest.approx([1.0, 2.0, 2.998, 3.0, 4.0, 5.0])


def test_the_mean_square_of_a_stepped_current_is_exact():
    rng = np.random.default_rng(0)
    t, i = np.arange(200.0), rng.normal(0, 50, 200)
    fine = steps(t, i).at(np.arange(0.005, 199.0, 0.01))
    assert np.mean(fine**2) == pytest.approx(np.mean(i[:-1] ** 2), rel=1e-9)


def test_a_voltage_steps_with_the_current_and_creeps_between():
    t = np.array([0.0, 1.0, 2.0, 3.0])
    current = np.array([0.0, 10.0, 10.0, 0.0])
    voltage = np.array([3.3, 3.2, 3.1, 3.25])
    got = voltage_steps(t, voltage, current).at(np.array([0.5, 1.0, 1.5, 2.5, 3.0]))
    assert got == pytest.approx([3.3, 3.2, 3.15, 3.1, 3.25])


def test_blanks_are_bridged_but_holes_are_not():
    t = np.arange(60.0)
    v = np.sin(t)
    v[3:6] = np.nan
    v[20:45] = np.nan
    s = lines(t, v)
    got = s.at(np.array([4.0, 19.0, 30.0, 45.0, 59.0, 65.0, 80.0]))
    assert np.isfinite(got).tolist() == [True, True, False, True, True, True, False]
    assert np.isnan(Series(np.empty(0), np.empty(0)).at(np.array([1.0]))).all()
    assert np.isnan(lines(t, np.full(60, np.nan)).at(t)).all()


def test_a_pack_drives_the_cycle_that_it_is_told_over_and_over(loaded):
    (early, _), (late, _), *_ = VirtualPack(loaded.plan, 5, cycle="us06").segments(1200)
    first, second = (s.series["current", None] for s in (early, late))
    t = np.arange(US06_S + 10.5, 1190.0)
    assert np.array_equal(second.at(t), first.at(t - US06_S))
    assert np.abs(first.value).max() > 50
