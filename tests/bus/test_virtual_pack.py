"""The virtual pack number by number: what drives it, how it scatters, what breaks, and what can be measured of it."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from bms_gateway.bus import virtual
from bms_gateway.bus.virtual import PackFault, VirtualPack
from bms_gateway.config import load_config
from tests.config.files import OWN, write
from tests.truth.string import TruthString, rk4


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    two = OWN + '[[string]]\nname = "string_2"\nmodel = "string_1.toml"\n'
    return load_config(write(tmp_path_factory.mktemp("pack"), two)).plan


@pytest.fixture
def driven(monkeypatch):
    """Has packs driven by one current over and over, which takes no time to draw."""

    def by(current):
        monkeypatch.setattr(virtual, "CYCLES", {"urban-assault": lambda rng, capacity: np.array([current] * 7, float)})

    return by


def many(plan, count, model=None):
    """A plan of so many equal strings."""
    string = plan.strings[0]
    return replace(plan, strings=(replace(string, model=model or string.model),) * count)


def joined(pack, which, duration_s, **how):
    """One string over all segments: time, core, surface, and its series at the rows."""
    parts = [segments[which] for segments in pack.segments(duration_s, **how)]
    keep = [slice(None), *[slice(1, None)] * (len(parts) - 1)]
    time, core, surface = (
        np.concatenate([getattr(p, name)[k] for p, k in zip(parts, keep, strict=True)])
        for name in ("time_s", "core_C", "surface_C")
    )
    series = {
        key: np.concatenate([p.series[key].at(p.time_s)[k] for p, k in zip(parts, keep, strict=True)])
        for key in parts[0].series
    }
    return time, core, surface, series


def test_the_bounds():
    assert (virtual.SEGMENT_S, virtual.STEP_S, virtual.SENSOR_NOISE_K) == (600, 1.0, 0.1)
    assert (virtual.INLET_C, virtual.INLET_SWING_K, virtual.INLET_PERIOD_S) == (25.0, 3.0, 300.0)
    assert (virtual.OCV_EMPTY_V, virtual.OCV_SPAN_V, virtual.SOC_START) == (3.2, 0.15, 0.6)


def test_it_comes_in_segments_of_ten_minutes_that_join(plan):
    pack = VirtualPack(plan, 1)
    assert pack.plan is plan
    found = list(pack.segments(1300.4))
    assert [[(s.string.name, s.time_s[0], s.time_s[-1], len(s.time_s)) for s in x] for x in found] == [
        [(name, a, b, b - a + 1) for name in ("string_1", "string_2")] for a, b in ((0, 600), (600, 1200), (1200, 1300))
    ]
    for before, after in pairwise(found):
        for a, b in zip(before, after, strict=True):
            assert np.array_equal(a.core_C[-1], b.core_C[0])
            assert np.array_equal(a.surface_C[-1], b.surface_C[0])
            for key in a.series:
                ends = a.series[key].at(a.time_s[-1:]), b.series[key].at(b.time_s[:1])
                assert ends[0] == pytest.approx(ends[1])
    assert len(next(pack.segments(0.1))[0].time_s) == 2


def test_no_current_flows_at_rest(plan):
    *_, moving = joined(VirtualPack(plan, 2), 0, 120)
    *_, resting = joined(VirtualPack(plan, 2), 0, 120, rest_s=(30.0, 60.0))
    expected = moving["current", None].copy()
    assert np.abs(expected[[30, 59, 60]]).min() > 0
    expected[30:60] = 0.0
    assert np.array_equal(resting["current", None], expected)


def test_the_inlet_swings_by_two_waves_about_25_degrees(plan, driven):
    driven(0.0)
    pack = VirtualPack(plan, 4, inlet_swing_K=2.0)
    time, *_, series = joined(pack, 0, 1200)
    inlet = series["coolant_inlet", None]
    w = 2 * np.pi / 300.0
    basis = np.column_stack(
        [np.ones(1201), np.sin(w * time), np.cos(w * time), np.sin(2.7 * w * time), np.cos(2.7 * w * time)]
    )
    (mean, sine, cosine, fast, none), residual, *_ = np.linalg.lstsq(basis, inlet, rcond=None)
    assert residual == pytest.approx(0.0, abs=1e-9)
    assert (mean, np.hypot(sine, cosine), fast, none) == pytest.approx((25.0, 1.6, 0.4, 0.0), abs=1e-9)
    phases = []
    for seed in range(300):
        start = float(next(VirtualPack(plan, seed).segments(1))[0].series["coolant_inlet", None].value[0])
        phases.append((start - 25.0) / (3.0 * 0.8))
    # of a phase that may be anything, the sine is spread evenly to both sides
    assert np.mean(phases) == pytest.approx(0.0, abs=0.15)
    assert np.std(phases) == pytest.approx(0.5**0.5, abs=0.06)
    assert (min(phases), max(phases)) == pytest.approx((-1.0, 1.0), abs=0.02)
    parts = {VirtualPack(plan, seed).phase // (np.pi / 8) for seed in range(300)}
    assert parts == set(range(16))
    assert VirtualPack(plan).phase == VirtualPack(plan, 0).phase


def test_an_inlet_that_the_config_gives_as_a_number_is_that_number(plan, driven):
    driven(0.0)
    string = plan.strings[0]
    channels = tuple(replace(c, constant=11.0) if c.quantity == "coolant_inlet" else c for c in string.channels)
    *_, core, surface, _ = joined(
        VirtualPack(replace(plan, strings=(replace(string, channels=channels),)), 4), 0, 30_000
    )
    assert core[-1] == pytest.approx(np.full(5, 11.0), abs=1e-3)
    assert surface[-1] == pytest.approx(np.full(5, 11.0), abs=1e-3)


def test_a_start_is_up_to_eight_kelvin_above_the_coolant_and_cells_differ(plan, driven):
    driven(0.0)
    segments = next(VirtualPack(many(plan, 600), 1).segments(1))
    inlet = segments[0].series["coolant_inlet", None].value[0]
    surface, core = (np.array([getattr(s, name)[0] for s in segments]) for name in ("surface_C", "core_C"))
    for above in (surface - inlet, core - surface):
        found = above.mean(axis=1)
        assert found.mean() == pytest.approx(4.0, abs=0.3)
        assert found.std() == pytest.approx(8.0 / 12**0.5, abs=0.15)
        assert -0.9 < found.min() < 0.3
        assert 7.7 < found.max() < 8.9
        assert np.sqrt(above.var(axis=1, ddof=1).mean()) == pytest.approx(0.5, rel=0.06)


def test_cells_scatter_by_the_tolerances_and_strings_by_the_common_deviation(plan, driven):
    driven(0.0)
    model = plan.strings[0].model

    def logs(name, model=model, **how):
        pack = VirtualPack(many(plan, 400, model), 2, **how)
        return np.array([np.log(getattr(p, name) / getattr(model.nominal, name)) for p in pack.parameters])

    for name, sd in (("R_e", 0.02), ("R_c", 0.03), ("R_u", 0.02)):
        alone = logs(name)
        assert alone.std() == pytest.approx(sd, rel=0.1)
        assert alone.mean(axis=1).std() == pytest.approx(sd / 5**0.5, rel=0.15)
        assert logs(name, scatter=2.0).std() == pytest.approx(2 * sd, rel=0.1)
        together = logs(name, scatter=0.0, common=0.2)
        assert np.ptp(together, axis=1).max() < 1e-12
        assert together.std() == pytest.approx(0.2, rel=0.15)
    assert np.ptp(logs("C_c")) == 0
    priors = {**model.priors, "R_c": replace(model.priors["R_c"], rel_sd=0.0)}
    known = replace(model, priors=priors, tolerances={"cell_R_e": 0.02})
    assert np.all(logs("R_c", known, common=0.2) == 0)
    others = logs("R_u", known, common=0.2)
    assert np.ptp(others, axis=1).max() < 1e-12
    assert others.std() == pytest.approx(0.2, rel=0.15)


FAULT = PackFault((100.0, 250.0), heat_W={2: 6.0, 5: 1.5}, R_u=1.8, flow=0.5, current=1.3)


def expected(pack, which, current, inlet, start, fault):
    """The independent truth, in three parts: before, while, and after it is broken."""
    p = pack.parameters[which]
    values = {name: getattr(p, name) for name in ("C_c", "C_s", "R_e", "R_c", "R_u", "R_cc", "C_f")}
    sound = TruthString.of(5, **values)
    broken = TruthString.of(5, **values | {"R_u": p.R_u * fault.R_u, "C_f": p.C_f * fault.flow})
    core, surface = [start[0][None]], [start[1][None]]
    first, last = (int(x) for x in fault.during_s)
    for string, a, b in ((sound, 0, first), (broken, first, last), (sound, last, len(current) - 1)):
        share = fault.current if string is broken else 1.0
        heat = np.outer((share * current[a:b]) ** 2, p.R_e)
        for cell, watts in fault.heat_W.items():
            heat[:, cell - 1] += watts * (string is broken)
        x, y = rk4(string, current[a:b], inlet[a : b + 1], (core[-1][-1], surface[-1][-1]), heat=heat)
        core.append(x[1:])
        surface.append(y[1:])
    return np.concatenate(core), np.concatenate(surface)


@pytest.mark.parametrize("during", [(100, 250), (599, 640)])  # a step before a segment ends
def test_what_breaks_breaks_in_the_first_string_from_its_begin_to_its_end(plan, during):
    pack, fault, whole = VirtualPack(plan, 6), replace(FAULT, during_s=during), during[1] + 150
    sound = [joined(VirtualPack(plan, 6), k, whole) for k in (0, 1)]
    broken = [joined(pack, k, whole, fault=fault) for k in (0, 1)]
    for a, b in zip(sound[1], broken[1], strict=True):
        if isinstance(a, dict):
            assert all(np.array_equal(a[key], b[key]) for key in a)
        else:
            assert np.array_equal(a, b)
    _, core, surface, series = broken[0]
    current = sound[0][3]["current", None]
    assert np.array_equal(series["current", None], current)  # what is shown
    truth = expected(pack, 0, current, series["coolant_inlet", None], (core[0], surface[0]), fault)
    assert np.abs(core - truth[0]).max() < 1e-3
    assert np.abs(surface - truth[1]).max() < 1e-3
    assert np.abs(core - sound[0][1]).max() > 2.0
    inside = np.zeros(whole + 1, bool)
    inside[slice(*during)] = True
    assert series["coolant_flow", None] == pytest.approx(np.where(inside, 0.5, 1.0) * 0.0095)


def test_a_fault_that_changes_nothing_changes_nothing(plan):
    *_, sound = joined(VirtualPack(plan, 6), 0, 100)
    *_, same = joined(VirtualPack(plan, 6), 0, 100, fault=PackFault((10.0, 50.0)))
    assert all(sound[key] == pytest.approx(same[key]) for key in sound)


def test_what_can_be_measured_follows_from_current_charge_and_temperature(plan):
    string = plan.strings[0]
    model = replace(string.model, capacity_Ah=4.0)
    statistic = replace(string.channels[0], quantity="surface", cell=None, statistic="max", among=(2, 4))
    one = replace(plan, strings=(replace(string, model=model, channels=(*string.channels, statistic)),))
    pack = VirtualPack(one, 8)
    _, _, surface, series = joined(pack, 0, 700, fault=replace(FAULT, during_s=(600.0, 650.0)))
    current = series["current", None]
    real = np.where((np.arange(701) >= 600) & (np.arange(701) < 650), 1.3 * current, current)
    soc = 0.6 - np.concatenate([[0.0], np.cumsum(real[:-1])]) / (3600.0 * 4.0)
    assert series["soc", None] == pytest.approx(soc)
    assert np.abs(soc - 0.6).max() > 0.02
    cells = 3.2 + 0.15 * soc[:, None] - real[:, None] * pack.parameters[0].R_e
    assert series["voltage", None] == pytest.approx(cells.sum(axis=1))
    for k in range(5):
        assert series["cell_voltage", k + 1] == pytest.approx(cells[:, k])
        assert series["surface", k + 1] == pytest.approx(surface[:, k])
    assert series["max_surface", None] == pytest.approx(surface[:, [1, 3]].max(axis=1))
    assert series["coolant_flow", None][0] == pytest.approx(0.0095)
    assert set(series) == {
        (q, None) for q in ("current", "voltage", "coolant_inlet", "soc", "coolant_flow", "max_surface")
    } | {(q, k) for q in ("surface", "cell_voltage") for k in range(1, 6)}


@pytest.mark.parametrize(("current", "end"), [(1.0, 0.0), (-1.0, 1.0)])
def test_a_charge_has_its_ends_and_a_model_may_have_no_flow(plan, driven, current, end):
    driven(current)
    small = replace(plan.strings[0].model, capacity_Ah=0.1, flow=None)
    *_, series = joined(VirtualPack(many(plan, 1, small), 1), 0, 400)
    soc = series["soc", None]
    assert ("coolant_flow", None) not in series
    assert soc == pytest.approx(np.clip(0.6 - current * np.arange(401) / 360.0, 0.0, 1.0))
    assert soc[-1] == end


def test_a_model_without_a_capacity_has_that_of_the_papers_cell(plan):
    model = plan.strings[0].model
    both = [VirtualPack(many(plan, 1, replace(model, capacity_Ah=x)), 1) for x in (None, 8.0)]
    found = [joined(pack, 0, 60)[3] for pack in both]
    for key in (("soc", None), ("current", None)):
        assert np.array_equal(found[0][key], found[1][key])
    other = joined(VirtualPack(many(plan, 1, replace(model, capacity_Ah=4.0)), 1), 0, 60)[3]
    assert other["current", None] == pytest.approx(0.5 * found[0]["current", None])
