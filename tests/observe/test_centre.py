"""The hottest point that observers tell: in order with core and surface, as unsure as its parts, kept by restarts."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.observe import AdaptiveObserver
from bms_gateway.observe.cell_scatter import between_cells, of_centre, weights
from bms_gateway.observe.effect_observer import EffectObserver
from bms_gateway.observe.measured import Measured
from bms_gateway.thermal import AddedEffect, Share
from tests.observe.rig import Drive, follow, model, stacked, truth
from tests.thermal.cylinder import cylinder

EXACT = Share(0.5, 0.0)


def drive(minutes=15, sensors=(1, 4)):
    return Drive.of(truth(4, batch=(1,)), minutes, 30.0, sensors)


def followed(share, d, rel_sd=None, tolerances=None):
    m = replace(model(4, (1, 4), rel_sd=rel_sd), centre_share=share)
    return follow(AdaptiveObserver([m if tolerances is None else replace(m, tolerances=tolerances)], 1.0), d)


def with_effect(share=None, **more):
    effect = AddedEffect("resistance_temperature", None, {"B": 300.0}, {"B": 100.0})
    return replace(model(4, (1, 4), rel_sd={"R_c": 0.3, "R_e": 0.1}, **more), effects=(effect,), centre_share=share)


def run_effects(observer, d, stop=None):
    at = [np.sqrt(i) for i in d.I2[:, 0]]
    return [
        observer.step(Measured(at[k], d.I2[k, 0], at[k], inlet=d.inlet[k, 0]), d.y[k, 0], np.zeros(4))
        for k in range(1, len(d) if stop is None else stop)
    ]


def variances(seed, n=3):
    """Covariance of core and surface of `n` cells, by numbers drawn at random, and samples of them."""
    rng = np.random.default_rng(seed)
    factors = rng.normal(size=(n, 2, 2)) * [[1.5], [0.5]]
    both = factors @ factors.swapaxes(1, 2)
    sampled = np.einsum("nij,nkj->nki", factors, rng.normal(size=(n, 40_000, 2)))
    return both, sampled, rng


@pytest.mark.parametrize("seed", range(5))
def test_the_variance_of_the_centre_is_that_of_samples(seed) -> None:
    """Core, surface and share drawn at random about a mean difference of 6 K."""
    both, sampled, rng = variances(seed)
    phi, phi_sd, gap = 0.6, 0.2, 6.0
    core, surface = sampled[..., 0] + gap, sampled[..., 1]
    centre = core + (phi + phi_sd * rng.normal(size=core.shape)) * (core - surface)
    said = of_centre(both[:, 0, 0], both[:, 1, 1], both[:, 0, 1], phi, phi_sd) + (phi_sd * gap) ** 2
    np.testing.assert_allclose(np.sqrt(said), centre.std(axis=1), rtol=0.03)


def test_what_cells_differ_by_reaches_core_surface_and_centre_as_samples_of_their_numbers_say() -> None:
    rng = np.random.default_rng(1)
    tolerated, phi, phi_sd = np.array([0.02, 0.05, 0.03]) ** 2, 0.6, 0.2
    over, gap = rng.uniform(1.0, 9.0, (2, 1, 4))
    levers = np.stack([gap + over, over, gap, 0.7 * gap])
    e, p = rng.normal(size=(100_000, 3)) * np.sqrt(tolerated), phi + phi_sd * rng.normal(size=100_000)
    surface = np.outer(e[:, 0] + e[:, 1], over)
    moved = np.outer(e[:, 0] + e[:, 2], gap)
    centre = surface + moved + p[:, None] * (0.7 * gap[0] + moved)
    truth = [surface + moved, surface, centre]
    own = np.broadcast_to(np.diag(tolerated), (1, 4, 3, 3))
    share = np.array([[phi]]), np.array([[phi_sd]])
    plain = np.einsum("ksn,sok->osn", levers**2, weights(tolerated[:, None], share[0][0], share[1][0]))
    for said in (plain, between_cells(levers, own, *share)):
        np.testing.assert_allclose(np.sqrt(said[:, 0]), [x.std(axis=0) for x in truth], rtol=0.02)


@settings(max_examples=6, deadline=None)
@given(st.floats(0.0, 1.0), st.floats(0.0, 0.5), st.floats(0.01, 0.5))
def test_surface_core_and_centre_are_in_order_and_an_unsure_share_widens_the_centre_alone(phi, sd, more) -> None:
    d = drive(2)
    one, two = followed(Share(phi, sd), d, {"R_c": 0.3}), followed(Share(phi, sd + more), d, {"R_c": 0.3})
    for a, b in zip(one, two, strict=True):
        assert (a.centre >= np.maximum(a.core, a.surface)).all()
        for name in ("core", "core_sd", "surface", "surface_sd", "centre"):
            assert np.array_equal(getattr(a, name), getattr(b, name))
        assert (b.centre_sd >= a.centre_sd).all()


@pytest.mark.parametrize(
    "told",
    [lambda s: followed(s, drive(), {"R_c": 0.3}), lambda s: run_effects(EffectObserver(with_effect(s), 1.0), drive())],
)
def test_a_roll_whose_resistance_is_all_contact_is_as_hot_as_its_mean(told) -> None:
    for e in told(Share(0.0, 0.0)):
        warmer = e.core >= e.surface
        np.testing.assert_array_equal(e.centre[warmer], e.core[warmer])
        np.testing.assert_allclose(e.centre_sd[warmer], e.core_sd[warmer], rtol=1e-12)


def test_both_observers_tell_the_same_of_the_same_string() -> None:
    """An effect that changes nothing: the full physics beside the stacked filters."""
    d, sd = drive(), {"R_c": 0.3, "R_u": 0.1}
    m = model(4, (1, 4), rel_sd=sd)
    none = replace(m, effects=(AddedEffect("resistance_temperature", None, {"B": 0.0}, {"B": 0.0}),))
    plain, full = follow(AdaptiveObserver([m], 1.0), d, start=1), run_effects(EffectObserver(none, 1.0), d)
    late = slice(300, None)
    off = np.abs(stacked(full, "centre") - stacked(plain, "centre"))[late]
    assert (off < 0.2 * stacked(plain, "centre_sd")[late]).all()


def test_nothing_is_told_before_anything_is_known() -> None:
    observer = AdaptiveObserver([model(4, (1, 4))] * 2, 1.0)
    y = np.full((2, 4), np.nan)
    y[1, 0] = 25.0
    e = observer.step(np.zeros(2), None, np.array([np.nan, 25.0]), y, np.zeros((2, 4)))
    assert np.isnan(e.centre[0]).all()
    assert np.isinf(e.centre_sd[0]).all()
    assert np.isfinite(e.centre[1]).all()
    assert np.isfinite(e.centre_sd[1]).all()


def test_the_hottest_point_of_a_real_roll_is_inside_its_band() -> None:
    """A roll of eighty shells, φ of 0.3 and of 0.7, seen by its casing alone, under load, rest and a cold jump."""
    heat = 12.6 * (np.arange(2400) // 300 % 3 > 0)
    coolant = np.where(np.arange(2400) > 1500, 10.0, 25.0)
    for share in (0.3, 0.7):
        true = cylinder(share, heat, coolant, start=25.0)
        m = model(1, (1,), "single", rel_sd={"R_c": 0.1, "R_e": 0.05})
        observer = AdaptiveObserver([m], 1.0)
        rng = np.random.default_rng(0)
        seen = true.surface + rng.normal(0.0, 0.05, 2400)
        told = [
            observer.step(heat[k : k + 1] / 3.5e-3, None, coolant[k : k + 1], seen[k].reshape(1, 1), np.zeros((1, 1)))
            for k in range(2400)
        ]
        point, sd = stacked(told, "centre")[:, 0, 0], stacked(told, "centre_sd")[:, 0, 0]
        inside = np.abs(point - true.hottest) < 2.0 * sd + 0.1
        assert inside[60:].mean() > 0.95
        assert sd[300:].max() < 8.0


def test_states_of_before_there_were_centres_begin_with_a_settled_profile() -> None:
    d = drive()
    for make, run in (
        (lambda: AdaptiveObserver([model(4, (1, 4))], 1.0), lambda o, n: follow(o, d, stop=n)),
        (lambda: EffectObserver(with_effect(), 1.0), lambda o, n: run_effects(o, d, n)),
    ):
        old = make()
        run(old, 600)
        state = json.loads(json.dumps(old.snapshot(), allow_nan=False))
        for place in (state["own"], state.get("block")):
            if isinstance(place, dict):
                place.pop("lag", None)
        new = make()
        new.restore(state)
        e = new.estimate()
        np.testing.assert_allclose(e.centre, e.core + 0.5 * (e.core - e.surface), rtol=1e-12)


def test_a_long_rest_brings_surface_core_and_centre_together() -> None:
    d = drive()
    observer = AdaptiveObserver([model(4, (1, 4))], 1.0)
    follow(observer, d, stop=600)
    e = observer.propagate(6 * 3600.0)
    np.testing.assert_allclose(e.centre, e.surface, atol=0.05)
    again = EffectObserver(with_effect(), 1.0)
    run_effects(again, d, 600)
    e = again.propagate(6 * 3600.0)
    np.testing.assert_allclose(e.centre, e.surface, atol=0.05)


def test_what_an_identification_moves_moves_the_profile_too() -> None:
    """As if it had always run with the new number: no minute of a centre that is behind its core."""
    d, names = drive(), ("R_c",)
    observer = AdaptiveObserver([replace(model(4, (1, 4), rel_sd={"R_c": 0.3}), centre_share=EXACT)], 1.0)
    before = follow(observer, d, stop=700)[-1]
    observer.set_parameters(0, {"R_c": 1.5}, names, np.array([[0.01]]))
    after = observer.estimate()
    rise = after.core - before.core
    assert (rise > 0.5).all()
    np.testing.assert_allclose(
        after.centre - before.centre, 1.5 * rise - 0.5 * (after.surface - before.surface), atol=1e-9
    )
