"""The observer of strings with effects: the string's own balances, honest bands, memories that outlive a restart."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bms_gateway.errors import StateError
from bms_gateway.observe import AdaptiveObserver, Measured
from bms_gateway.observe.effect_observer import EffectObserver
from bms_gateway.thermal import AddedEffect
from bms_gateway.thermal.effects import catalogue
from tests.observe.rig import Drive, follow, model, stacked, truth, wander
from tests.truth.cycle import repeated
from tests.truth.string import lsoda, rk4

NAN = np.nan
B = 3000.0


def effect(name, sd=0.0, **values):
    """An effect of the catalogue at its probe values, on cell 1 if it sits on one; `sd` as a share of the prior's."""
    kind = catalogue()[name]
    return AddedEffect(
        name,
        None if kind.place == "string" else 1,
        {p.name: values.get(p.name, p.probe) for p in kind.parameters},
        {p.name: sd * p.sd for p in kind.parameters},
    )


def with_effects(m, *effects):
    return replace(m, effects=effects)


def run(observer, current, inlet, y, **more):
    """Step through instants 0…K: current (K,), inlet (K + 1,), y (K + 1, n)."""
    now = np.zeros(y.shape[1])
    amps = np.concatenate([[NAN], current])
    return [observer.step(Measured(a, a * a, abs(a), inlet[k], **more), y[k], now) for k, a in enumerate(amps)]


def readings(surface, sensors, noise, rng):
    y = np.full(surface.shape, NAN)
    at = np.array(sensors) - 1
    y[:, at] = surface[:, at] + rng.normal(0, noise, (len(surface), len(at)))
    return y


@pytest.mark.parametrize("amps", [40.0, -25.0, 0.0])
def test_the_heat_that_is_identified_is_that_of_the_current_as_the_effect_says(amps):
    """An offset of the current sensor is in the mean square that the identifier is fed, not left to R_e."""
    b = 5.5
    m = with_effects(model(3, (1, 3)), effect("current_offset", b=b))
    observer = EffectObserver(m, 1.0)
    y = np.full(3, NAN)
    for _ in range(3):  # a second of two currents, 30 A apart
        observer.step(Measured(amps, amps**2 + 225.0, abs(amps) + 1.0, 25.0), y, np.zeros(3))
    assert observer.effective[0] == pytest.approx((amps - b) ** 2 + 225.0, rel=1e-9)
    assert observer.effective[1] == 0.0


def test_an_effect_of_no_strength_leaves_what_the_observer_without_effects_says():
    m = model(5, (1, 5))
    drive = Drive.of(truth(5, batch=(1,)), 15, (34.0, 30.0), (1, 5), inlet=20.0)
    plain = follow(AdaptiveObserver([m], 1.0), drive)
    none = with_effects(m, AddedEffect("resistance_temperature", None, {"B": 0.0}, {"B": 0.0}))
    mine = run(EffectObserver(none, 1.0), np.sqrt(drive.I2[1:, 0]), drive.inlet[:, 0], drive.y[:, 0])
    for name, tolerance in (("core", 0.02), ("core_sd", 0.02), ("surface", 0.02), ("innovation_sd", 0.005)):
        a, b = stacked(plain, name)[1:], stacked(mine, name)[1:]
        assert np.nanmax(np.abs(a - b)) < tolerance, name


@pytest.mark.parametrize("name", ["thermocouple_lag", "thermocouple_offset", "surface_joule"])
def test_a_string_of_which_every_number_is_known_exactly_is_followed(name):
    """Nothing is uncertain then, a reading's slopes by it are none, and the band is that of the readings alone."""
    exactly = with_effects(model(1, (1,)), effect(name))
    found = run(EffectObserver(exactly, 1.0), np.full(60, 20.0), np.full(61, 25.0), np.full((61, 1), 25.0))
    assert all(np.isfinite(e.core).all() and np.isfinite(e.core_sd).all() for e in found[1:])


def test_left_alone_it_runs_as_the_true_string_whose_resistance_falls():
    n, minutes = 4, 20
    current, inlet = repeated(minutes, 2), 10.0 + 4.0 * np.sin(np.arange(minutes * 60 + 1) / 150)
    core, surface = lsoda(truth(n, B=B), current, inlet, 10.0)
    m = with_effects(model(n, (1, n)), AddedEffect("resistance_temperature", None, {"B": B}, {"B": 0.0}))
    y = np.full(surface.shape, NAN)
    y[0] = 10.0
    e = run(EffectObserver(m, 1.0), current, inlet, y)
    assert np.abs(stacked(e, "core")[60:, 0] - core[60:]).max() < 0.05
    assert np.abs(stacked(e, "surface")[60:, 0] - surface[60:]).max() < 0.05
    linear = run(EffectObserver(with_effects(m, replace(m.effects[0], values={"B": 0.0})), 1.0), current, inlet, y)
    assert np.abs(stacked(linear, "core")[-1, 0] - core[-1]).max() > 1.0  # the test has something to see


@pytest.mark.slow
def test_band_holds_for_numbers_as_uncertain_as_stated_and_the_effect_pays():
    """Strings drawn from what the model states, R_e falling with temperature, inlet read wrongly."""
    S, n, minutes = 6, 4, 20
    rng = np.random.default_rng(4)
    sd = {"R_e": 0.08, "R_c": 0.05, "R_u": 0.08, "C_c": 0.05, "C_s": 0.05}
    drawn = {k: model().priors[k].value * np.exp(rng.normal(0, s, (S, 1))) for k, s in sd.items()}
    K = minutes * 60
    current, inlet = repeated(minutes), np.full((K + 1, S), 10.0)
    string = truth(n, batch=(S,), B=B, **drawn)
    wrong = wander(rng, K + 1, 0.5, S)
    core, surface = rk4(string, np.repeat(current[:, None], S, 1), inlet + wrong, 10.0 + rng.normal(0, 2, (S, 1)))
    m = model(n, (1, n), rel_sd=sd)
    stated = with_effects(m, AddedEffect("resistance_temperature", None, {"B": B + 250.0}, {"B": 300.0}))
    y = [readings(surface[:, s], (1, n), 0.1, rng) for s in range(S)]
    part = slice(300, None, 20)
    z, error, plain_error = [], [], []
    for s in range(S):
        e = run(EffectObserver(stated, 1.0), current, inlet[:, s], y[s])
        error.append((stacked(e, "core")[:, 0] - core[:, s])[part])
        z.append(error[-1] / stacked(e, "core_sd")[part, 0])
        normal = stacked(e, "innovation")[part] / stacked(e, "innovation_sd")[part]
        assert 0.5 < np.nanstd(normal) < 1.5
    plain = AdaptiveObserver([m] * S, 1.0)
    none, now = np.full((S, n), NAN), np.zeros((S, n))
    for k in range(K + 1):
        I2 = np.full(S, current[k - 1] ** 2 if k else NAN)
        got = plain.step(I2, none, inlet[k], np.stack([x[k] for x in y]), now)
        if k >= 300 and k % 20 == 0:
            plain_error.append(got.core - core[k])
    inside = np.abs(np.array(z)) < 2
    assert 0.90 < inside.mean() <= 1.0
    rms, rms_plain = np.sqrt(np.mean(np.square(error))), np.sqrt(np.mean(np.square(plain_error)))
    print(f"core: {rms_plain:.2f} K without the effect, {rms:.2f} K with it, {inside.mean():.3f} in the band")
    assert rms < 0.75 * rms_plain


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("resistance_temperature", {"B": B}),
        pytest.param("polarization", {}, marks=pytest.mark.slow),
        ("hysteresis", {"V": 0.03}),
        pytest.param("coolant_delay", {"tau": 20.0}, marks=pytest.mark.slow),
        ("thermocouple_lag", {"tau": 6.0}),
        pytest.param("radial_gradient", {"phi": 0.5}, marks=pytest.mark.slow),
        pytest.param("natural_convection", {"n": 0.2}, marks=pytest.mark.slow),
    ],
)
@pytest.mark.plain_cases(1)
def test_sensitivities_are_the_slopes_of_the_whole_run(name, values):
    """J against observers that always had other numbers, with nothing read but the start; memories included."""
    n, seconds = 2, 300
    rng = np.random.default_rng(1)
    rel = dict.fromkeys(("R_e", "R_c", "R_u", "C_f"), 0.05)
    m = with_effects(model(n, (1, 2), rel_sd=rel), effect(name, 0.1, **values))
    current = 60.0 * np.repeat(rng.normal(size=seconds // 20), 20)
    inlet = 20.0 + 5.0 * (np.arange(seconds + 1) > 100)
    y = np.full((seconds + 1, n), NAN)
    y[0] = 22.0

    def end(m, moved=0.0, of=None):
        observer = EffectObserver(m, 1.0)
        if of is not None:
            observer._of.now = replace(of, step=moved).moved(observer._of.now)
        run(observer, current, inlet, y)
        return observer

    here = end(m)
    for j, number in enumerate(here.uncertain):
        h = 0.1 * abs(number.step) / 0.01
        slope = (end(m, h, number).belief.z - end(m, -h, number).belief.z) / (2 * h)
        scale = np.abs(slope).max()
        # they feel the inputs ten steps late, which hardly counts but for what is small and fast
        assert np.abs(here.belief.J[:, j] - slope).max() < 0.1 * scale + 0.06, number.name


@cache
def driven():
    n = 4
    rng = np.random.default_rng(0)
    current = repeated(10, 5)
    inlet = 20.0 + 3.0 * np.sin(np.arange(601) / 60)
    _, surface = rk4(truth(n), current, inlet, 25.0)
    return current, inlet, readings(surface, (1, n), 0.1, rng)


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_every_effect_is_observed_and_restored_bit_for_bit(name):
    """Also in the middle of the steps that are gathered for the sensitivities."""
    current, inlet, y = (x[:160] for x in driven())
    current = current[:-1]
    m = with_effects(model(4, (1, 4), rel_sd={"R_e": 0.1}), effect(name, 0.2))
    m = replace(m, capacity_Ah=8.0)
    more = {"V": 3.3, "IV": 30.0} if name == "voltage_heat" else {}
    a, b = (EffectObserver(m, 1.0) for _ in range(2))
    first = run(a, current[:126], inlet, y[:127], **more)
    assert np.isfinite(stacked(first, "core")).all()
    b.restore(json.loads(json.dumps(a.snapshot(), allow_nan=False)))
    for p, q in zip(*(run(o, current[127:], inlet[127:], y[127:], **more) for o in (a, b)), strict=True):
        for field in ("core", "core_sd", "surface", "surface_sd", "centre", "centre_sd", "innovation", "innovation_sd"):
            np.testing.assert_array_equal(getattr(p, field), getattr(q, field))
        assert np.isfinite(p.core).all()
        assert (p.core_sd < 30).all()


def test_a_gap_is_carried_as_by_steps_and_as_by_the_truth():
    current, inlet, y = driven()
    m = with_effects(
        model(4, (1, 4), rel_sd={"R_u": 0.1, "C_c": 0.1}),
        effect("natural_convection", 0.2, n=0.0),
        effect("polarization"),
    )
    one, many = (EffectObserver(m, 1.0) for _ in range(2))
    for o in (one, many):
        run(o, current, inlet, y)
    start = one.estimate()
    still = np.full(601, inlet[-1])
    for _ in range(600):
        stepped = many.step(Measured(0.0, 0.0, 0.0, inlet[-1]), np.full(4, NAN), np.zeros(4))
    carried = one.propagate(600.0)
    core, _ = lsoda(truth(4), np.zeros(1), still[:2], (start.core[0], start.surface[0]), dt=600.0)
    assert np.abs(carried.core - stepped.core).max() < 0.1
    assert np.abs(carried.core - core[-1]).max() < 0.5  # but for the offsets of inlet and heat, which decay
    assert (carried.core_sd > stepped.core_sd - 0.05).all()  # nobody saw the inlet
    for j, number in enumerate(one.uncertain):
        a, b = one.belief.J[:, j], many.belief.J[:, j]
        assert np.abs(a - b).max() < 0.05 * np.abs(b).max() + 0.02, number.name
    night = one.propagate(8 * 3600.0)
    assert np.abs(night.core - inlet[-1]).max() < 0.5


def test_new_parameters_put_the_estimate_where_it_would_always_have_been():
    current, inlet, y = driven()
    added = effect("resistance_temperature", 0.1)
    rel = {"R_e": 0.1, "R_u": 0.1}
    old, new = (
        EffectObserver(with_effects(model(4, (1, 4), rel_sd=rel, **v), added), 1.0) for v in ({}, {"R_e": 3.7e-3})
    )
    for o in (old, new):
        run(o, current, inlet, y)
    apart = np.abs(old.estimate().core - new.estimate().core).max()
    old.set_parameters(0, {"R_e": 3.7e-3}, ("R_e", "C_c"), np.diag([1e-4, 0.0]))
    assert np.abs(old.estimate().core - new.estimate().core).max() < 0.1 * apart + 0.01
    assert old.parameters[0].R_e == pytest.approx(3.7e-3)
    assert (old.estimate().core_sd < new.estimate().core_sd).all()


def test_numbers_that_hang_together_make_another_band_than_independent_ones():
    current, inlet, y = driven()
    m = with_effects(model(4, (1, 4), rel_sd={"R_e": 0.2, "R_c": 0.2}), effect("polarization"))
    names = ("R_e", "R_c")
    bands = []
    for rho in (-0.95, 0.0, 0.95):
        observer = EffectObserver(replace(m, correlation=(names, np.array([[1.0, rho], [rho, 1.0]]))), 1.0)
        bands.append(run(observer, current, inlet, y)[-1].core_sd.mean())
    assert bands[0] < 0.8 * bands[1] < 0.9 * bands[2]


def test_before_anything_is_heard_nothing_is_claimed():
    observer = EffectObserver(with_effects(model(3, (1,)), effect("radial_gradient")), 1.0)
    nothing = np.full(3, NAN)
    e = observer.step(Measured(), nothing, np.zeros(3))
    assert not e.available.any()
    assert np.isnan(e.core).all()
    assert np.isposinf(e.core_sd).all()
    assert np.isnan(observer.propagate(3600.0).core).all()
    e = observer.step(Measured(inlet=20.0), nothing, np.zeros(3))
    assert e.core == pytest.approx(20.0, abs=0.5)
    assert (e.core_sd > 15).all()


def test_lost_current_and_inlet_widen_the_band_which_comes_back():
    current, inlet, y = driven()
    m = with_effects(model(4, (1, 4)), effect("resistance_temperature"))
    whole, holed = (EffectObserver(m, 1.0) for _ in range(2))
    amps, gone = current.copy(), inlet.copy()
    amps[200:320], gone[200:320] = NAN, NAN
    a, b = run(whole, current, inlet, y), run(holed, amps, gone, y)
    assert (b[315].core_sd > 1.1 * a[315].core_sd).all()
    np.testing.assert_allclose(b[-1].core_sd, a[-1].core_sd, rtol=0.15)
    assert np.abs(b[-1].core - a[-1].core).max() < 1.0


def test_charge_is_counted_from_the_last_that_was_told():
    m = replace(with_effects(model(2, (1,)), effect("resistance_soc")), capacity_Ah=8.0)
    observer = EffectObserver(m, 1.0, soc=0.9)
    y, now = np.array([25.0, NAN]), np.zeros(2)
    for _ in range(360):
        observer.step(Measured(80.0, 6400.0, 80.0, 25.0), y, now)
    assert observer.soc == 0.0  # a whole charge was drawn of 0.9
    observer.step(Measured(80.0, 6400.0, 80.0, 25.0, soc=0.7), y, now)
    for _ in range(36):
        observer.step(Measured(80.0, 6400.0, 80.0, 25.0), y, now)
    assert observer.soc == pytest.approx(0.7 - 0.1)


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_no_reading_however_odd_makes_a_number_that_is_none(name):
    rng = np.random.default_rng(3)
    n = 3
    observer = EffectObserver(with_effects(model(n, (1, 3), rel_sd={"R_u": 0.2}), effect(name, 0.5)), 1.0)

    def maybe(p, x):
        return x if rng.random() < p else NAN

    for _ in range(60):
        amps = maybe(0.7, rng.uniform(-3000, 3000))
        m = Measured(
            amps, amps**2, abs(amps), maybe(0.7, rng.uniform(-40, 120)), maybe(0.3, rng.uniform(0, 3)),
            maybe(0.3, rng.uniform(-0.05, 1.05)), maybe(0.5, rng.uniform(0, 6)), maybe(0.5, rng.uniform(-9000, 9000)),
        )  # fmt: skip
        y = np.where(rng.random(n) < 0.5, rng.uniform(-40, 150, n), NAN)
        e = observer.step(m, y, rng.uniform(0, 5, n))
        if e.available[0]:
            assert np.isfinite(e.core).all()
            assert np.isfinite(e.core_sd).all()
        json.dumps(observer.snapshot(), allow_nan=False)


def test_a_state_that_is_foreign_or_damaged_is_refused_and_changes_nothing():
    def observer(n, name="polarization"):
        return EffectObserver(with_effects(model(n, (1, n)), effect(name)), 1.0)

    driven_one = observer(4)
    run(driven_one, *(x[:40] for x in (driven()[0][:39], driven()[1], driven()[2])))
    good = driven_one.snapshot()
    blank = json.loads(json.dumps(good))
    blank["belief"]["z"][0] = None
    holed = {k: v for k, v in good.items() if k != "memories"}
    for own, foreign in (
        (observer(5), good),
        (observer(4, "radial_gradient"), good),
        (observer(4), blank),
        (observer(4), holed),
    ):
        before = own.snapshot()
        with pytest.raises(StateError, match="observer state"):
            own.restore(foreign)
        assert own.snapshot() == before
