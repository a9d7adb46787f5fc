"""The smoother takes noise and rounding off an inlet, adds no lag and leaves clean steps alone."""

import numpy as np
import pytest

from bms_gateway.diagnosis.smooth import smooth

T = np.arange(3600.0)
SINE = 25 + 3 * np.sin(2 * np.pi * T / 300)
STEPS = np.where(T % 600 < 300, 22.0, 28.0)
RAMP = 20 + T / 300


def measured(x, sigma, step=0.0, seed=0):
    y = x + sigma * np.random.default_rng([seed, 5]).standard_normal(len(x))
    return np.round(y / step) * step if step else y


def rms(e):
    return float(np.sqrt(np.mean(e**2)))


@pytest.mark.parametrize("clean", [SINE, STEPS, RAMP, np.full(3600, 25.0), np.where(T < 900, 25.0, 25.5)])
def test_a_clean_inlet_passes_unchanged(clean):
    assert np.array_equal(smooth(T, clean, coarsest=1.0), clean)


@pytest.mark.parametrize("sigma", [0.05, 0.2])
@pytest.mark.parametrize(("clean", "share"), [(SINE, 0.4), (STEPS, 0.2), (RAMP, 0.3), (np.full(3600, 25.0), 0.2)])
def test_noise_shrinks_to_a_share(clean, share, sigma):
    for seed in range(3):
        assert rms(smooth(T, measured(clean, sigma, seed=seed)) - clean) < share * sigma


@pytest.mark.parametrize(("sigma", "step"), [(0.05, 0.0), (0.2, 0.0), (0.0, 0.5), (0.05, 0.1), (0.2, 0.5), (0.05, 0.5)])
def test_nothing_arrives_later_than_it_is(sigma, step):
    slope = np.gradient(SINE)
    for seed in range(3):
        error = smooth(T, measured(SINE, sigma, step, seed), coarsest=1.0) - SINE
        lag = -np.sum(error * slope) / np.sum(slope**2)
        assert abs(lag) < 0.3


def test_steps_stay_where_they_are_under_noise():
    out = smooth(T, measured(STEPS, 0.05))
    assert np.abs(out - STEPS).max() < 0.05


@pytest.mark.parametrize(("step", "least"), [(0.1, 0.03), (0.5, 0.06)])
def test_a_staircase_becomes_the_line_that_it_stands_for(step, least):
    for clean in (SINE, RAMP):
        rounded = measured(clean, 0.0, step)
        assert rms(smooth(T, rounded, coarsest=1.0) - clean) < min(least, 0.7 * rms(rounded - clean))


def test_levels_of_a_flow_are_levels_and_no_rounding():
    flow = np.where(T % 600 < 300, 0.0095, 0.012)
    assert np.array_equal(smooth(T, flow), flow)
