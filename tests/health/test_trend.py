"""The filter over windows: growth follows the truth, weather and noise do not pass for it, jumps are put where they
belong."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.errors import StateError
from bms_gateway.health.trend import CONFIRM, B, G, J, Kind, L, Prior, Trend, U
from tests.health.observed import observed, unsure_of_heat


def driven(trend: Trend, windows: int, seed: int = 1, growth=lambda k: 0.0, **more) -> list[Kind]:
    rng = np.random.default_rng(seed)
    return [
        trend.update(
            observed(rng, growth=np.log1p(growth(k)), core=rng.uniform(5, 45), flow=rng.choice([0.7, 1.0]), **more)
        )
        for k in range(windows)
    ]


@pytest.mark.parametrize("true_B", [1500.0, 3500.0])
def test_growth_is_followed_through_all_weathers_and_the_exponent_is_learnt(true_B: float) -> None:
    trend = Trend(2)
    driven(trend, 300, growth=lambda k: 0.001 * k, B=true_B)
    growth, sd = trend.of(G)
    assert np.expm1(growth) == pytest.approx(0.30, abs=0.03)
    assert sd < 0.02
    assert trend.exponent == pytest.approx(true_B, abs=50)


def test_growth_under_way_from_the_first_drive_is_not_taken_for_the_baseline() -> None:
    """Windows without noise: a rate pulled to rest by 0.1 % a drive leaves 0.0044 of it there, by 0.2 % 0.0013."""
    trend, rng = Trend(2), np.random.default_rng(1)
    for k in range(60):
        trend.update(observed(growth=np.log1p(0.00075 * k), core=rng.uniform(5, 45)))
    assert np.expm1(trend.of(G)[0]) == pytest.approx(0.00075 * 59, abs=0.002)


def test_offsets_that_only_the_exponent_moves_are_no_drift_and_teach_it() -> None:
    """A window referred with an exponent 1000 K too low finds offsets that are not there."""
    rng, trend = np.random.default_rng(1), Trend(2)
    for _ in range(40):
        seen = observed(rng, core=30.0)
        by_B = np.array([0.08, 0.05, -0.03, 0.1, 0.0, -0.6, -0.6]) * rng.uniform(0.2, 1.5) / 1000.0
        assert trend.update(replace(seen, mean=seen.mean - 1000.0 * by_B, by_B=by_B)) is Kind.USUAL
    assert trend.exponent == pytest.approx(3500.0, abs=200.0)
    assert np.abs(trend.x[trend.drifts]).max() < 0.15


def test_without_growth_there_is_none() -> None:
    trend = Trend(2)
    kinds = driven(trend, 300)
    assert abs(trend.of(G)[0]) < 0.02
    assert kinds.count(Kind.USUAL) > 290


def test_one_window_that_is_far_off_moves_nothing() -> None:
    trend = Trend(2)
    driven(trend, 60)
    before = trend.of(G)[0]
    assert trend.update(observed(growth=0.6)) in (Kind.JUMP, Kind.STRANGE)
    assert trend.of(G)[0] == pytest.approx(before, abs=0.005)


@pytest.mark.parametrize("seed", range(1, 5))
def test_a_first_window_that_was_bent_by_a_wrong_exponent_makes_no_baseline(seed: int) -> None:
    """A hard drive, B off by 1000 K and told to first order only: taken as it came, G was 0.06 for a hundred drives."""
    trend, rng = Trend(2), np.random.default_rng(seed)
    bent = observed(rng)
    bent.mean[[0, 1, 4]] += (-0.28, 0.2, -0.3)
    trend.update(bent)
    driven(trend, 40, seed=seed + 100)
    assert abs(trend.of(G)[0]) < 0.04


@pytest.mark.parametrize("seed", range(1, 5))
def test_a_window_that_surprises_while_the_baseline_is_made_moves_it_little(seed: int) -> None:
    trend, rng = Trend(2), np.random.default_rng(seed)
    driven(trend, 5, seed=seed)
    odd = observed(rng)
    odd.mean[:5] += (0.3, -0.3, 0.5, -0.5, 0.5)
    assert trend.surprising(odd)
    level = trend.of(L)[0]
    assert trend.update(odd) is Kind.USUAL
    assert abs(trend.of(L)[0] - level) < 0.06
    driven(trend, 40, seed=seed + 100)
    assert abs(trend.of(G)[0]) < 0.04


@pytest.mark.parametrize("seed", range(1, 13))
def test_a_jump_of_R_e_is_no_growth(seed: int) -> None:
    """Sixty quiet windows move G by 0.012 rms and 0.030 at most (sixty seeds), with a jump by 0.015 and 0.031."""
    trend = Trend(2)
    driven(trend, 60, seed=seed)
    before = trend.of(G)[0]
    kinds = driven(trend, CONFIRM, seed=seed + 100, level=0.3)
    assert kinds == [Kind.JUMP] * CONFIRM
    assert trend.of(J)[0] == pytest.approx(0.3, abs=0.07)
    driven(trend, 60, seed=seed + 200, level=0.3)
    assert trend.of(J)[0] == pytest.approx(0.3, abs=0.04)
    assert trend.of(G)[0] == pytest.approx(before, abs=0.035)


@pytest.mark.parametrize("seed", range(1, 5))
def test_a_jump_that_seven_numbers_together_would_hide_is_seen_in_R_e_alone(seed: int) -> None:
    """Taken for usual, it was growth of a fifth within ten drives."""
    trend, rng = Trend(2), np.random.default_rng(seed)
    driven(trend, 60, seed=seed)
    seen = observed(level=0.2)  # without noise, and so no surprise on the whole
    assert not trend.surprising(seen)
    assert [trend.update(observed(rng, level=0.2, scale=0.3)) for _ in range(CONFIRM)] == [Kind.JUMP] * CONFIRM
    driven(trend, 30, seed=seed + 100, level=0.2)
    assert trend.of(J)[0] == pytest.approx(0.2, abs=0.06)
    assert abs(trend.of(G)[0]) < 0.06


def test_a_fan_that_stops_and_a_thermocouple_that_moves_are_taken_up_at_once() -> None:
    for more, at, value in (({"cooling": 0.6}, U, 0.6), ({"drift": (3.0, 0.0)}, None, 3.0)):
        trend = Trend(2)
        driven(trend, 60)
        before = trend.of(G)[0]
        kinds = driven(trend, 2, seed=2, **more)
        assert kinds[0] is Kind.OPENED
        found = trend.of(U)[0] if at == U else trend.x[trend.drifts][0]
        assert found == pytest.approx(value, rel=0.2)
        assert abs(trend.of(G)[0] - before) < 0.02


def test_what_nothing_explains_is_passed_over_and_growth_is_held() -> None:
    trend = Trend(2)
    driven(trend, 60)
    before = trend.x.copy()
    odd = observed()
    odd.mean[2:5] = (1.0, -1.0, 1.0)
    assert trend.update(odd) is Kind.STRANGE
    assert trend.x[L] == pytest.approx(before[L])
    for _ in range(5):
        trend.update(odd)
    assert trend.restless
    driven(trend, 5, growth=lambda k: 0.05)
    assert trend.of(G)[0] == pytest.approx(before[G], abs=0.01)
    driven(trend, 60)
    assert not trend.restless


def test_a_window_whose_current_is_wrong_leaves_growth_alone() -> None:
    trend = Trend(2)
    driven(trend, 60)
    before = trend.of(G)[0]
    for _ in range(20):
        trend.update(observed(growth=0.05), believe=False)
    assert trend.of(G)[0] == pytest.approx(before, abs=0.02)


def test_growth_that_a_wrong_current_has_begun_does_not_go_on_once_that_is_known() -> None:
    """It went on at its rate: a current 7 % too low was 16 % of growth when it was told, 27 % sixty drives later."""
    trend = Trend(2)
    driven(trend, 60)
    driven(trend, 20, seed=2, growth=lambda k: 0.006 * k)
    begun = trend.of(G)[0]
    assert begun > 0.05
    rng = np.random.default_rng(3)
    for _ in range(60):
        trend.update(observed(rng, growth=0.5), believe=False)
    assert trend.of(G)[0] == pytest.approx(begun, abs=0.01)


@pytest.mark.parametrize("seed", range(1, 13))
def test_a_commissioned_level_makes_growth_known_from_the_first_windows(seed: int) -> None:
    """0.031 at most over forty seeds; the level's own 0.02 is in none of them."""
    trend = Trend(2, Prior(level_sd=0.02, grown_sd=0.3, B=2500.0, B_sd=100.0))
    driven(trend, 6, seed=seed, growth=lambda k: 0.2)
    growth, sd = trend.of(G)
    assert np.expm1(growth) == pytest.approx(0.2, abs=0.04)
    assert sd < 0.03


def test_the_resistance_of_a_window_is_told_by_what_many_have_taught_of_its_heat() -> None:
    """Alone, a window tells R_e to 0.13; and what it tells owes nothing to what R_e was before."""
    trend, rng = Trend(2), np.random.default_rng(1)
    for _ in range(60):
        trend.update(unsure_of_heat(rng, core=rng.uniform(10, 40)))
    before = trend.snapshot()
    windows = [unsure_of_heat(rng, growth=0.5, core=rng.uniform(10, 40)) for _ in range(100)]
    told, sd = np.array([trend.resistance(seen) for seen in windows]).T
    assert trend.snapshot() == before
    assert np.std([seen.mean[0] for seen in windows]) > 0.11
    assert np.std(told) < 0.06
    assert told.mean() == pytest.approx(0.5, abs=0.05)
    assert np.median(sd) < 0.08


def test_a_reset_begins_again_from_what_is_there() -> None:
    trend = Trend(2)
    driven(trend, 100, growth=lambda k: 0.25)
    exponent = trend.of(B)
    trend.reset()
    assert trend.of(G) == (0.0, 0.0)
    assert trend.of(B) == exponent
    driven(trend, 40, growth=lambda k: 0.25)
    assert abs(trend.of(G)[0]) < 0.02


def test_a_new_baseline_is_as_sure_as_it_says() -> None:
    """Forty windows tell growth since a reset to 0.018: 0.013 rms over sixty seeds, and 0.034 at most."""
    found = []
    for seed in range(1, 13):
        trend = Trend(2)
        driven(trend, 20, seed=seed, growth=lambda k: 0.25)
        trend.reset()
        driven(trend, 40, seed=seed + 100, growth=lambda k: 0.25)
        found.append(trend.of(G))
    mean, sd = np.array(found).T
    assert np.abs(mean / sd).max() < 2.5
    assert np.sqrt(np.mean(mean**2)) < 0.02


def test_charge_and_flow_that_nobody_knows_are_no_fault() -> None:
    trend = Trend(2)
    for _ in range(10):
        trend.update(observed(soc=float("nan"), flow=1.0))
    expected = trend.expected(float("nan"), float("nan"))
    assert np.isfinite(expected).all()
    assert expected == pytest.approx(np.zeros(7), abs=0.05)
    assert not trend.surprising(observed())
    assert trend.surprising(observed(growth=1.0))


def test_the_state_survives_a_restart_and_a_foreign_one_is_refused() -> None:
    one, two = Trend(2), Trend(2)
    driven(one, 30)
    two.restore(json.loads(json.dumps(one.snapshot(), allow_nan=False)))
    for trend in (one, two):
        driven(trend, 5, seed=4)
    assert one.snapshot() == two.snapshot()
    state = one.snapshot()
    for damage in ({"x": [0.0]}, {"P": (-np.eye(len(one.x))).tolist()}, {"x": [float("nan")] * len(one.x)}):
        with pytest.raises(StateError, match="starting anew"):
            Trend(2).restore(state | damage)
    with pytest.raises(StateError, match="another string"):
        Trend(3).restore(state)
