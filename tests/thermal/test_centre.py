"""The hottest point by two nodes and a share of R_c, against a cylinder of eighty shells."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_gateway.thermal import AddedEffect, Prior, Share, StringModel
from bms_gateway.thermal.centre import (
    CENTRE_SHARE,
    CORE_PROBE,
    centre_share,
    core_probe,
    hottest,
    hottest_of,
    hottest_point,
    lagged,
    time_constant,
)
from tests.thermal.cylinder import cylinder

R_C, C_C = np.array([1.266]), np.array([268.0])
NONE = np.zeros(1)


def load():
    """Twenty minutes of 12.6 W (60 A in 3.5 mΩ), a rest, pulses of half a minute, and cooling to the end."""
    heat = np.zeros(3600)
    heat[:1200] = 12.6
    heat[1800:2400] = 12.6 * (np.arange(600) // 30 % 2)
    return heat, np.zeros(3600)


def jump():
    """A steady 6 W and a coolant that jumps down by 10 K, then up by 20 K and down again."""
    coolant = np.zeros(4200)
    coolant[1800:2400], coolant[2400:3000] = -10.0, 10.0
    return np.full(4200, 6.0), coolant


def stated(run, phi):
    """Hottest point and what φ stands behind, as the product has them from mean and surface alone."""
    gap = (run.mean - run.surface)[:, None]
    lag = lagged(gap, np.ones(len(gap)), time_constant(phi, R_C, C_C))[:, 0]
    return hottest_point(run.mean, run.surface, lag, phi), lag


@pytest.mark.parametrize("share", [0.05, 0.3, 0.5, 0.8, 1.0])
def test_in_the_steady_state_the_centre_is_as_far_above_the_mean_as_the_mean_is_above_the_edge(share) -> None:
    q = 12.6
    run = cylinder(share, np.full(60, q), np.full(60, 25.0), dt=600.0, start=25.0)
    assert run.centre[-1] - run.mean[-1] == pytest.approx(share * 1.266 * q, rel=2e-3)
    gap = run.mean - run.surface
    assert gap[-1] == pytest.approx(1.266 * q, rel=2e-3)
    assert hottest_point(run.mean, run.surface, gap, share)[-1] == pytest.approx(run.hottest[-1], abs=0.02)


@pytest.mark.parametrize(("share", "part"), [(0.1, 0.01), (0.25, 0.02), (0.5, 0.02), (0.75, 0.06), (0.95, 0.12)])
@pytest.mark.parametrize("drive", [load, jump])
def test_with_its_own_share_it_follows_steps_pulses_and_cooling(drive, share, part) -> None:
    run = cylinder(share, *drive())
    point, _ = stated(run, share)
    settled = slice(0 if drive is load else 1500, None)
    assert np.abs(point - run.hottest)[settled].max() < part * np.abs(run.mean - run.surface).max()


def test_without_the_lag_a_jump_of_the_coolant_would_be_taken_for_heat() -> None:
    run = cylinder(0.5, *jump())
    off = (hottest_point(run.mean, run.surface, run.mean - run.surface, 0.5) - run.hottest)[1500:]
    assert off.max() > 2.0  # K, by the cold
    assert off.min() < -2.0  # by the warmth: the dangerous way
    assert np.abs(stated(run, 0.5)[0] - run.hottest)[1500:].max() < 0.3


@pytest.mark.parametrize("drive", [load, jump])
@pytest.mark.parametrize("share", [0.02, 0.2, 0.4, 0.6, 0.8])
def test_two_sd_of_the_default_share_hold_the_hottest_point_of_most_rolls(drive, share) -> None:
    run = cylinder(share, *drive())
    point, lag = stated(run, CENTRE_SHARE.value)
    off = np.abs(point - run.hottest)
    inside = off <= 2.0 * CENTRE_SHARE.sd * np.abs(lag) + 0.05
    assert inside[1500 if drive is jump else 0 :].mean() >= 0.95


def test_heated_from_outside_the_hottest_point_is_the_casing() -> None:
    run = cylinder(0.5, np.zeros(600), np.full(600, 40.0), start=20.0)
    point, _ = stated(run, 0.5)
    assert np.array_equal(point, run.surface)
    assert np.array_equal(run.hottest, run.surface)


temperature = st.floats(-40.0, 150.0) | st.just(np.nan)
spread = st.floats(0.0, 20.0)


@given(temperature, temperature, st.floats(-60.0, 60.0), st.floats(0.0, 1.0), spread, spread)
def test_no_hottest_point_is_below_core_or_surface(core, surface, lag, phi, centre_sd, surface_sd) -> None:
    c, s, g, a, b = (np.array([x]) for x in (core, surface, lag, centre_sd, surface_sd))
    point, sd = hottest(c, s, g, phi, a, b)
    if np.isnan(core) or np.isnan(surface):
        assert np.isnan(point[0])
        return
    assert point[0] >= max(core, surface)
    assert min(centre_sd, surface_sd) - 1e-9 <= sd[0] <= max(centre_sd, surface_sd) + 1e-9
    if core >= surface:
        assert sd[0] == centre_sd


def test_a_surface_that_is_surely_warmer_brings_its_own_sd_and_one_that_may_be_does_not() -> None:
    """The moments of the true maximum, by sampling: no narrower than 4/5 of them, at most four times as wide."""
    rng, n = np.random.default_rng(3), 200_000
    surface_sd, centre_sd = 0.1, 2.0
    for below in (0.0, 0.5, 1.0, 2.0, 4.0, 8.0):
        centre = -below + centre_sd * rng.normal(size=n)
        surface = surface_sd * rng.normal(size=n)
        truth = np.sqrt(np.mean(np.maximum(centre, surface) ** 2))
        zero = np.zeros(1)
        one, two = np.array([centre_sd]), np.array([surface_sd])
        point, sd = hottest(np.array([-below]), zero, zero, 0.5, one, two)
        assert point[0] == 0.0
        assert 0.8 * truth < sd[0] < 4.2 * truth
    assert sd[0] == pytest.approx(surface_sd, rel=0.1)


def test_the_share_is_the_files_else_the_effects_else_the_default() -> None:
    priors = {
        k: Prior(v) for k, v in zip(("C_c", "C_s", "R_e", "R_c", "R_u"), (268, 18.8, 3.5e-3, 1.3, 0.8), strict=True)
    }
    plain = StringModel(1, (1,), "single", priors)
    effect = AddedEffect("radial_gradient", None, {"phi": 0.3}, {"phi": 0.05})
    found = StringModel(1, (1,), "single", priors, effects=(effect,))
    told = StringModel(1, (1,), "single", priors, effects=(effect,), centre_share=Share(0.8, 0.1))
    assert [centre_share(m) for m in (plain, found, told)] == [CENTRE_SHARE, Share(0.3, 0.05), Share(0.8, 0.1)]
    assert core_probe(plain) == CORE_PROBE
    assert core_probe(StringModel(1, (1,), "single", priors, core_probe=Share(1.0, 0.0))) == Share(1.0, 0.0)


def test_the_hottest_cell_is_the_first_of_the_highest_that_are_known() -> None:
    assert hottest_of(np.array([30.0, 32.0, 32.0])) == 1
    assert hottest_of(np.array([np.nan, -5.0])) == 1
    assert hottest_of(np.array([np.nan])) is None


def test_a_core_known_to_more_than_3_K_is_compared_by_its_value_less_its_sd():
    assert hottest_of(np.array([30.0, 40.0]), np.array([0.5, 3.0])) == 1
    assert hottest_of(np.array([30.0, 40.0]), np.array([0.5, 10.5])) == 0
    assert hottest_of(np.array([30.0, 90.0]), np.array([0.5, 10.5])) == 1  # one that burns is the hottest all the same
