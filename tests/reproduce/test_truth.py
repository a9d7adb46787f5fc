"""The scenes that the reproduction sets are what an independent integrator makes of them."""

import numpy as np
import pytest

from bms_gateway.reproduce import string_runs
from bms_gateway.reproduce.identification import trajectory
from bms_gateway.reproduce.noise import by_rls, by_window
from bms_gateway.reproduce.setting import INLET, cell, drive, moving_inlet, run, settled, string
from bms_gateway.thermal.cycles import URBAN_ASSAULT_S
from tests.truth.string import C_F, TruthString, rk4

FIG_7 = [52.9, 54.1, 55.2, 56.4, 57.6]


def five(**values):
    return TruthString.of(5, R_cc=32.0, C_f=C_F, **values)


def still(K):
    return np.full(K + 1, INLET)


@pytest.fixture(scope="module")
def current():
    return drive("urban-assault", string_runs.SEED, 4 * URBAN_ASSAULT_S)


@pytest.mark.parametrize("hot", [False, True])
def test_the_simulated_string_is_the_true_one(current, hot):
    R_e = np.array([3.5, 4.3, 4.3, 4.3, 3.5]) * 1e-3 if hot else np.full(5, 3.5e-3)
    core, surface = rk4(five(R_e=R_e), current[:1800], still(1800), 25.0)
    x = run(string(R_e), current[:1800], np.full(10, 25.0))
    assert np.abs(x[:, 0::2] - core).max() < 1e-3
    assert np.abs(x[:, 1::2] - surface).max() < 1e-3


def test_the_simulated_cell_is_the_true_one_under_a_moving_inlet(current):
    inlet = moving_inlet(1800, 1.0)
    core, surface = rk4(TruthString.of(1), current[:1800], inlet, 25.0)
    x = run(cell(), current[:1800], np.full(2, 25.0), inlet)
    assert np.abs(x - np.hstack([core, surface])).max() < 1e-3


def test_fig_7_to_9_and_11_hold_for_the_true_string(current):
    core, surface = rk4(five(), current, still(len(current)), 25.0, substeps=1)
    profile = core[-URBAN_ASSAULT_S:].mean(axis=0)
    assert profile == pytest.approx(FIG_7, abs=0.2)
    warm = profile, surface[-URBAN_ASSAULT_S:].mean(axis=0)
    cold, outside = rk4(five(), np.zeros(3600), still(3600), warm, substeps=1)
    assert 40 < settled(cold - INLET, 0.5).max() < 47  # Fig 8
    assert (cold[600] - outside[600]).mean() == pytest.approx(6.4, abs=0.3)

    short = current[:3000]
    core, surface = rk4(five(), short, still(3000), (37.0, 30.0), substeps=1)
    start = np.full(10, 30.0)
    free = settled(string_runs.open_loop(short, start)[:, 0::2] - core, 0.25)
    assert 30 < free.min() < free.max() < 37  # Fig 9
    alone = string_runs.closed_loop(short, surface, start, string_runs.INDEPENDENT)
    assert np.all((settled(alone[:, 0::2] - core, 0.25) > 20) == [False, True, True, True, False])
    together = string_runs.closed_loop(short, surface, start, string_runs.COMMON)
    assert settled(together[:, 0::2] - core, 0.25).max() < 0.5

    R_e = np.array([3.5, 4.3, 4.3, 4.3, 3.5]) * 1e-3
    core, surface = rk4(five(R_e=R_e), current, still(len(current)), 25.0, substeps=1)
    truth = np.stack([core, surface], axis=2).reshape(len(core), 10)

    def norms(estimate):
        return string_runs.error_norms((estimate - truth)[-URBAN_ASSAULT_S:])

    start = np.full(10, 25.0)
    assert norms(string_runs.open_loop(current, start)) == pytest.approx((12.4, 6.9), abs=0.15)
    assert norms(string_runs.closed_loop(current, surface, start, string_runs.WHITE)) == pytest.approx(
        (9.3, 4.9), abs=0.15
    )
    assert norms(string_runs.closed_loop(current, surface, start, string_runs.COMMON)) == pytest.approx(
        (9.7, 5.2), abs=0.15
    )


def test_identification_settles_in_minutes_and_the_papers_tuning_in_ten():
    fast = [settled(trajectory("urban-assault", s, paper=False, seconds=1332), 0.05).max() for s in range(3)]
    slow = [settled(trajectory("urban-assault", s, paper=True, seconds=1332), 0.05).max() for s in range(3)]
    assert max(fast) < 5
    assert 4 < min(slow) < max(slow) < 15
    assert all(s > 1.5 * f for s, f in zip(slow, fast, strict=True))


@pytest.mark.slow
def test_the_window_beats_least_squares_on_true_surfaces_with_noise():
    error = []
    for seed in (101, 102, 103):
        drawn = drive("urban-assault", seed, 89 * 60)
        core, surface = rk4(TruthString.of(1), drawn, still(len(drawn)), 25.0, substeps=1)
        noisy = surface[:, 0] + 0.1 * np.random.default_rng(seed).standard_normal(len(surface))
        reference, ours = by_rls(drawn, core[:, 0], noisy), by_window(drawn, core[:, 0], noisy)
        assert not reference.core < ours.core  # NaN at the fold
        assert (np.abs(ours.error) < 3 * ours.sd).all()
        error.append(ours.core)
    assert np.median(error) < 1.3
    exact = by_rls(drawn, core[:, 0], surface[:, 0])
    assert np.abs(exact.error).max() < 0.005
