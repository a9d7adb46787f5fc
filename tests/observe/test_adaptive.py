"""The adaptive observer: finds cores it does not see, keeps its word about how far off it is, outlives faults."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bms_gateway.errors import StateError
from bms_gateway.observe import PARAMETERS, AdaptiveObserver, Disturbance, stack
from bms_gateway.observe.open_loop import predicted_surface
from tests.observe.rig import Drive, follow, model, stacked, truth, wander
from tests.truth.string import lsoda

NAN = np.nan


def settling(error, limit):
    late = np.flatnonzero(error > limit)
    return 0 if not len(late) else late[-1] + 1


@pytest.mark.parametrize("gap", [0.0, 6.0])
def test_five_strings_of_twelve_cells_are_found_in_two_minutes_from_two_sensors_each(gap):
    """True starts of 31 … 43 °C, cores over surfaces by `gap`, nothing of it told to the observer."""
    string = truth(12, batch=(5,))
    level = np.array([31.0, 34.0, 37.0, 40.0, 43.0])[:, None]
    drive = Drive.of(string, 15, (level + gap, level), (1, 12))
    estimates = follow(AdaptiveObserver([model()] * 5, 1.0), drive)
    error = np.abs(stacked(estimates, "core") - drive.core).max(axis=(1, 2))
    assert settling(error, 1.0) < 120
    assert (error[-600:] < 0.7).all()


def test_band_holds_for_disturbances_and_parameters_as_wide_as_stated():
    """Forty strings drawn from the priors, with lasting heat and inlet errors: ±2 sd covers, and is not absurd."""
    S, n, minutes = 40, 5, 30
    rng = np.random.default_rng(11)
    sd = {"R_e": 0.10, "R_c": 0.05, "R_u": 0.10, "C_c": 0.05, "C_s": 0.05}
    drawn = {k: model().priors[k].value * np.exp(rng.normal(0, s, (S, 1))) for k, s in sd.items()}
    K = minutes * 60
    heat_error = wander(rng, K, 0.5, S, 1) + wander(rng, K, 0.15, S, n)
    drive = Drive.of(
        truth(n, batch=(S,), **drawn),
        minutes,
        (rng.uniform(15, 45, (S, 1)) + rng.normal(0, 5, (S, 1)), rng.uniform(15, 45, (S, 1))),
        (1, n),
        heat_error=heat_error,
        inlet_error=wander(rng, K + 1, 0.5, S),
    )
    observer = AdaptiveObserver([model(n, (1, n), rel_sd=sd)] * S, 1.0)
    estimates = follow(observer, drive)
    z = (stacked(estimates, "core") - drive.core) / stacked(estimates, "core_sd")
    part = slice(300, None, 20)
    inside = np.abs(z[part]) < 2
    assert 0.90 < inside.mean() < 0.995
    assert inside.mean(axis=(0, 1)).min() > 0.88  # no cell alone is worse
    assert np.median(stacked(estimates, "core_sd")[part]) < 2.0
    z_surface = (stacked(estimates, "surface") - drive.surface) / stacked(estimates, "surface_sd")
    assert np.mean(np.abs(z_surface[part]) < 2) > 0.90
    normal = stacked(estimates, "innovation")[part] / stacked(estimates, "innovation_sd")[part]
    assert 0.5 < np.nanstd(normal) < 1.2


def test_band_holds_for_cells_that_differ_as_the_tolerances_allow():
    S, n, minutes = 40, 5, 40
    rng = np.random.default_rng(12)
    table = model().priors
    share = {"R_e": 0.02, "R_u": 0.02, "R_c": 0.03}
    unlike = {k: table[k].value * np.exp(rng.normal(0, s, (S, n))) for k, s in share.items()}
    K = minutes * 60
    drive = Drive.of(
        truth(n, batch=(S,), **unlike),
        minutes,
        25.0,
        (1, n),
        heat_error=wander(rng, K, 0.5, S, 1) + wander(rng, K, 0.15, S, n),
        inlet_error=wander(rng, K + 1, 0.5, S),
    )
    estimates = follow(AdaptiveObserver([model(n, (1, n))] * S, 1.0), drive)
    z = (stacked(estimates, "core") - drive.core) / stacked(estimates, "core_sd")
    inside = np.abs(z[600::20]) < 2
    assert 0.90 < inside.mean() < 0.995
    assert inside.mean(axis=(0, 1)).min() > 0.88
    assert np.median(stacked(estimates, "core_sd")[600::20]) < 1.2


def test_wide_priors_leave_a_wide_core_however_small_the_surface_residual():
    """R_e, R_c wrong by a half, surface residuals of 0.1 K: the core's band still holds the truth."""
    wide = {"R_e": 0.6, "R_c": 0.6, "R_u": 0.6, "C_c": 0.05, "C_s": 0.05}
    drive = Drive.of(truth(1, batch=(1,), R_e=5.5e-3, R_c=1.9), 40, 25.0, (1,))
    last = follow(AdaptiveObserver([model(1, (1,), "single", rel_sd=wide)], 1.0), drive)[-600:]
    z = (stacked(last, "core") - drive.core[-600:]) / stacked(last, "core_sd")
    assert (np.abs(z) < 2).mean() > 0.9
    assert np.median(stacked(last, "core_sd")) > 5.0


CAPACITY_AH = 8.0
U = {"entropic": 0.2, "entropic_slope": -0.7}
"""mV/K: coefficients of reversible heat."""


def test_sensitivities_are_those_of_the_observer_with_its_gain():
    """Two runs with one parameter scaled, both corrected by the gains of the nominal one."""
    n, seconds = 3, 400
    rng = np.random.default_rng(4)
    drive = Drive.of(
        truth(n, batch=(1,)), seconds / 60, 32.0, (1, 3), inlet=25 + wander(rng, seconds + 1, 2.0)[:, None]
    )
    given = np.full((seconds + 1, 1, n), NAN)
    given[:, :, 1] = rng.uniform(5, 15, (seconds + 1, 1))
    observer = AdaptiveObserver([model(n, (1, 3))], 1.0)
    observer.set_parameters(0, U | {"charge": -0.1}, (), np.zeros((0, 0)))
    p = observer.parameters[0]
    now, gains = np.full((1, n), 0.4), []
    drive.I2[0] = drive.I2[1]
    current = np.sqrt(drive.I2) * np.where(np.arange(seconds + 1) < 250, 0.8, -0.9)[:, None]
    moved = -0.1 + np.cumsum(current, axis=0) / 3600 / CAPACITY_AH - current / 7200 / CAPACITY_AH  # in mid-step
    for k in range(seconds + 1):
        observer.reversible.flow(current[k])
        observer.step(drive.I2[k], given[k], drive.inlet[k], drive.y[k], now)
        gains.append(observer.snapshot()["state"]["K"])
    J = np.array(observer.snapshot()["own"]["J"])[0]

    def run(name, factor):
        q = replace(p, **{name: getattr(p, name) * factor}) if hasattr(p, name) else p
        u = U | ({name: U[name] + np.log(factor)} if name in U else {})
        m = stack([q], 1.0, Disturbance())
        x = np.append(np.full(2 * n, np.nanmean(drive.y[0])), [0.0, 0.0])[None]
        for k in range(seconds + 1):
            made = drive.I2[k][:, None] * q.R_e
            if name == "warmth":
                over = 1000.0 / (x[:, 0 : 2 * n : 2] + 273.15) - 1000.0 / 298.15
                made = made * np.exp(np.log(factor) * over)
            heat = np.where(np.isfinite(given[k]), given[k] * (factor if name == "heat" else 1.0), made)
            coefficient = (u["entropic"] + u["entropic_slope"] * moved[k]) * 1e-3
            heat = heat - current[k] * coefficient * (x[:, 0 : 2 * n : 2] + 273.15)
            before, x = x, m.advance(x, heat, drive.inlet[max(k - 1, 0)], drive.inlet[k])
            at = np.array([[0, 2]])
            r = drive.y[k][:, [0, 2]] - predicted_surface(x, before, at, np.full((1, 2), 0.4))
            x = x + (np.array(gains[k]) @ r[:, :, None])[:, :, 0]
        return x[0]

    for j, name in enumerate(PARAMETERS):
        slope = (run(name, np.exp(1e-4)) - run(name, np.exp(-1e-4))) / 2e-4
        if name == "R_e":
            assert np.abs(slope).max() > 1.0  # the test has something to see
        np.testing.assert_allclose(J[:, j], slope, atol=0.01 + 0.01 * np.abs(slope).max(), err_msg=name)


def test_new_parameters_put_the_estimate_where_it_would_always_have_been():
    n = 3
    drive = Drive.of(truth(n, batch=(1,), R_e=3.6e-3, R_u=0.77), 14, 30.0, (1, 3))
    late, always = (AdaptiveObserver([m], 1.0) for m in (model(n, (1, 3)), model(n, (1, 3), R_e=3.6e-3, R_u=0.77)))
    without = AdaptiveObserver([model(n, (1, 3))], 1.0)
    for o in (late, always, without):
        follow(o, drive)
    late.set_parameters(0, {"R_e": 3.6e-3, "R_u": 0.77}, ("R_e", "R_u"), np.diag([1e-4, 1e-4]))
    a, b, c = (o.estimate().core for o in (late, always, without))
    assert np.abs(a - b).max() < 0.1 * np.abs(c - b).max() + 0.01
    assert late.parameters[0].R_e == pytest.approx(3.6e-3)
    assert late.parameters[0].R_c == pytest.approx(1.266)
    known = late.estimate().core_sd
    late.set_parameters(0, {}, ("R_e", "R_u"), np.diag([0.09, 0.09]))
    assert (late.estimate().core_sd > known + 0.3).all()


def test_heat_that_is_given_carries_its_own_error_and_not_that_of_R_e():
    wide = {"R_e": 0.5}
    drive = Drive.of(truth(1, batch=(1,)), 30, 25.0, (1,))
    heat = drive.I2[:, :, None] * 3.5e-3
    by_R_e = follow(AdaptiveObserver([model(1, (1,), "single", rel_sd=wide)], 1.0), drive)[-1]
    known = AdaptiveObserver([model(1, (1,), "single", rel_sd=wide)], 1.0, heat_rel_sd=0.03)
    by_heat = follow(known, drive, heat=heat)[-1]
    assert by_heat.core_sd[0, 0] < 0.3 * by_R_e.core_sd[0, 0]


def test_before_anything_is_heard_nothing_is_claimed():
    observer = AdaptiveObserver([model(3, (1,))] * 2, 1.0)
    none = np.full((2, 3), NAN)
    nothing = np.full(2, NAN)
    for _ in range(3):
        e = observer.step(nothing, none, nothing, none, np.zeros((2, 3)))
        assert not e.available.any()
        assert np.isnan(e.core).all()
        assert np.isposinf(e.core_sd).all()
    y = none.copy()
    y[1, 0] = 33.0
    e = observer.step(nothing, none, nothing, y, np.zeros((2, 3)))
    assert e.available.tolist() == [False, True]
    assert e.surface[1, 0] == pytest.approx(33.0, abs=0.05)
    assert 1.0 < e.core_sd[1].min() < 15.0


def test_inlet_alone_starts_a_string_with_a_band_of_tens():
    observer = AdaptiveObserver([model(2, (1,))], 1.0)
    e = observer.step(np.zeros(1), np.full((1, 2), NAN), np.array([20.0]), np.full((1, 2), NAN), np.zeros((1, 2)))
    assert e.core == pytest.approx(20.0, abs=0.5)
    assert (e.core_sd > 15).all()


@pytest.mark.parametrize("lost", ["sensors", "inlet", "current"])
@pytest.mark.plain_cases(1)
def test_what_is_lost_widens_the_band_which_still_holds_and_narrows_when_it_is_back(lost):
    """Four strings lose it for ten minutes, four beside them do not."""
    n, K = 5, 1800
    rng = np.random.default_rng(7)
    inlet = 25 + wander(rng, K + 1, 2.0, 8)
    drive = Drive.of(truth(n, batch=(8,)), K / 60, 30.0, (1, n), inlet=inlet, inlet_error=wander(rng, K + 1, 0.5, 8))
    gone = slice(600, 1200), slice(0, 4)
    if lost == "sensors":
        drive.y[gone] = NAN
    elif lost == "inlet":
        drive.inlet[gone] = NAN
    else:
        drive.I2[gone] = NAN
    estimates = follow(AdaptiveObserver([model(n, (1, n), tolerances={})] * 8, 1.0), drive)
    sd, error = stacked(estimates, "core_sd"), stacked(estimates, "core") - drive.core
    assert np.isfinite(sd).all()
    wider = sd[1190, :4] / sd[1190, 4:]
    assert (wider > 1.0).all()
    assert (wider.max(axis=1) > 1.1).all()
    np.testing.assert_allclose(sd[-1, :4], sd[-1, 4:], rtol=0.1)
    assert (np.abs(error / sd)[500:] < 2).mean() > 0.9


def test_thermocouples_that_take_turns_do_not_make_the_band_flicker():
    drive = Drive.of(truth(5, batch=(1,)), 12, 30.0, (1, 5))
    turn = np.arange(len(drive)) % 4
    drive.y[turn != 0, :, 0] = NAN
    drive.y[turn != 2, :, 4] = NAN
    estimates = follow(AdaptiveObserver([model(5, (1, 5))], 1.0), drive)
    sd = stacked(estimates, "core_sd")[600:, 0]
    assert np.abs(np.diff(np.log(sd), axis=0)).max() < 0.1
    assert np.abs(stacked(estimates, "core") - drive.core)[300:].max() < 1.0


def test_one_sensor_of_two_may_fail_and_come_back():
    drive = Drive.of(truth(12, batch=(1,)), 18, 30.0, (1, 12))
    drive.y[400:800, :, 11] = NAN
    estimates = follow(AdaptiveObserver([model()], 1.0), drive)
    assert np.abs(stacked(estimates, "core") - drive.core)[200:].max() < 1.0
    assert stacked(estimates, "core_sd")[790, 0, 11] > stacked(estimates, "core_sd")[390, 0, 11]


@cache
def driven():
    """Five cells driven for half an hour."""
    return Drive.of(truth(5, batch=(1,)), 30, 25.0, (1, 5))


def rested(seconds):
    """The same cells after `seconds` of rest in air that still moves, and the two minutes after that."""
    core, surface = lsoda(truth(5), [0.0], [25.0, 25.0], (driven().core[-1, 0], driven().surface[-1, 0]), dt=seconds)
    return Drive.of(truth(5, batch=(1,)), None, (core[-1], surface[-1]), (1, 5), current=np.zeros(120))


@cache
def stored():
    """What an observer wrote down at the end of that drive, as it comes back from a disk."""
    observer = AdaptiveObserver([model(5, (1, 5), rel_sd={"R_u": 0.1})], 1.0)
    follow(observer, driven())
    return json.dumps(observer.snapshot(), allow_nan=False)


@pytest.mark.parametrize("parked", [600, 8 * 3600])
def test_restart_after_parking_goes_on_from_the_stored_state(parked):
    rest = rested(parked)
    fresh = AdaptiveObserver([model(5, (1, 5), rel_sd={"R_u": 0.1})], 1.0)
    fresh.restore(json.loads(stored()))
    e = fresh.propagate(float(parked), np.array([25.0]))
    assert np.abs(e.core - rest.core[0]).max() < 0.5
    if parked == 600:
        assert np.mean(e.core - e.surface) > 4.0  # the gap that "core = surface" would miss
    assert (e.core_sd > 0.5).all()
    assert (e.core_sd < 6.0).all()
    after = follow(fresh, rest, start=1)
    assert np.abs(stacked(after, "core") - rest.core[1:]).max() < 1.0
    assert (after[-1].core_sd < 1.5).all()


def test_gap_carries_the_sensitivities_as_the_steps_would():
    sd = {"R_e": 0.1, "R_c": 0.1, "R_u": 0.1, "C_c": 0.1, "C_s": 0.1, "R_cc": 0.2, "C_f": 0.1}
    one, many = (AdaptiveObserver([model(5, (1, 5), rel_sd=sd)], 1.0) for _ in range(2))
    for o in (one, many):
        follow(o, driven(), stop=901)
    none, now, still = np.full((1, 5), NAN), np.zeros((1, 5)), np.zeros(1)
    for _ in range(120):
        many.step(still, none, driven().inlet[0], none, now)
    one.propagate(120.0)
    a, b = (np.array(o.snapshot()["own"]["J"]) for o in (one, many))
    np.testing.assert_allclose(a, b, atol=0.01 * np.abs(b).max())


def test_restored_observer_goes_on_bit_for_bit():
    drive = Drive.of(truth(12, batch=(2,)), 12, 30.0, (1, 12))
    models = [model(rel_sd={"R_e": 0.3}), model(rel_sd={"R_u": 0.1})]
    a, b = (AdaptiveObserver(models, 1.0) for _ in range(2))
    follow(a, drive, stop=400)
    a.set_parameters(1, {"R_e": 3.4e-3}, ("R_e", "R_c"), np.array([[0.01, 0.005], [0.005, 0.02]]))
    b.restore(json.loads(json.dumps(a.snapshot(), allow_nan=False)))
    for x, y in zip(follow(a, drive, start=400), follow(b, drive, start=400), strict=True):
        for name in ("core", "core_sd", "surface", "surface_sd", "centre", "centre_sd"):
            assert (getattr(x, name) == getattr(y, name)).all()


def test_a_state_that_is_foreign_or_damaged_is_refused_and_changes_nothing():
    def observer(n, strings=2):
        return AdaptiveObserver([model(n, (1, n))] * strings, 1.0)

    good = observer(5).snapshot()
    holed = {**good, "state": {k: v for k, v in good["state"].items() if k != "P"}}
    blank = json.loads(json.dumps(good))
    blank["state"]["x"][0][0] = None
    for own, foreign in ((observer(12), good), (observer(5, 1), good), (observer(5), holed), (observer(5), blank)):
        before = own.snapshot()
        with pytest.raises(StateError, match="observer state"):
            own.restore(foreign)
        assert own.snapshot() == before


def test_flow_changes_cool_by_the_heat_that_the_stream_carries():
    ratio = 2.0
    p = model(3, (1, 3)).nominal.with_flow_ratio(ratio)
    drive = Drive.of(truth(3, batch=(1,), R_u=p.R_u, C_f=p.C_f), 30, 25.0, (1, 3))
    observer = AdaptiveObserver([model(3, (1, 3))], 1.0)
    none, now = np.full((1, 3), NAN), np.zeros((1, 3))
    jitter = 1 + 0.01 * np.sin(np.arange(len(drive)))
    cores = [
        observer.step(
            drive.I2[k], none, drive.inlet[k], none if k else drive.y[k], now, np.array([ratio]) * jitter[k]
        ).core
        for k in range(len(drive))
    ]
    assert np.abs(np.array(cores) - drive.core)[1200:].max() < 0.4
    slow = observer.step(drive.I2[-1], none, drive.inlet[-1], none, now, np.array([0.001]))
    assert np.isfinite(slow.core).all()


def test_no_reading_however_odd_makes_a_number_that_is_none():
    rng = np.random.default_rng(3)
    S, n = 3, 4
    observer = AdaptiveObserver([model(n, (1, 4)), model(n, (2,)), model(n, ())], 1.0)
    y = np.full((S, n), NAN)
    for _ in range(300):
        y = np.where(rng.random((S, n)) < 0.5, rng.uniform(-40, 120, (S, n)), NAN)
        I2 = np.where(rng.random(S) < 0.7, rng.uniform(0, 160**2, S), NAN)
        inlet = np.where(rng.random(S) < 0.7, rng.uniform(-40, 60, S), NAN)
        flow = np.where(rng.random(S) < 0.1, rng.uniform(0, 3, S), NAN)
        e = observer.step(I2, np.full((S, n), NAN), inlet, y, rng.uniform(0, 5, (S, n)), flow)
        assert np.isfinite(e.core[e.available]).all()
        assert np.isfinite(e.core_sd[e.available]).all()
    assert e.available.all()


def test_strings_of_unequal_length_are_refused():
    with pytest.raises(ValueError, match="equal numbers"):
        AdaptiveObserver([model(3, (1,)), model(4, (1,))], 1.0)
