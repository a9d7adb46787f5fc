"""White noise and resolution are told from readings alone, whatever is rounded, missing or unevenly sampled."""

import numpy as np
import pytest

from bms_gateway.identify.sensor_noise import (
    LEAST_K,
    LEAST_STEPS,
    estimate_noise,
    resolution,
    shared_noise,
    slow_rounding,
    white_noise,
)


def readings(sigma, step, *, seed=0, dt=1.0, missing=0.1, jitter=0.3, n=3600):
    """A surface that warms up and swings, as a logger sees it."""
    rng = np.random.default_rng([seed, 77])
    t = (np.arange(n) + jitter * rng.uniform(-1, 1, n)) * dt
    y = 25 + 8 * (1 - np.exp(-t / 1500)) + 1.5 * np.sin(t / 200) + sigma * rng.standard_normal(n)
    keep = rng.random(n) >= missing
    return t[keep], (np.round(y / step) * step if step else y)[keep]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sigma", [0.05, 0.1, 0.2, 0.3])
@pytest.mark.parametrize("step", [0.0, 0.01, 0.1])
def test_noise_above_half_a_step_is_found_within_a_tenth(sigma, step, seed):
    t, y = readings(sigma, step, seed=seed)
    q = resolution(y)
    assert q == pytest.approx(step, abs=2e-3)
    assert white_noise(t, y, q) == pytest.approx(sigma, rel=0.1 if sigma > step / 2 else 0.2)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("sigma", "step"), [(0.02, 0.1), (0.05, 0.25), (0.1, 0.5), (0.2, 0.5), (0.3, 0.5)])
def test_noise_below_half_a_step_is_found_within_a_third_and_a_twentieth_of_the_step(sigma, step, seed):
    t, y = readings(sigma, step, seed=seed)
    assert resolution(y) == pytest.approx(step)
    assert abs(white_noise(t, y, step) - sigma) <= sigma / 3 + step / 20


@pytest.mark.parametrize("step", [0.1, 0.5, 1.0])
def test_a_clean_staircase_has_no_noise_but_the_least_that_can_be_told(step):
    t, y = readings(0.0, step, jitter=0.0)
    assert white_noise(t, y, resolution(y)) <= max(LEAST_K, LEAST_STEPS * step) * 1.5


def test_steps_that_a_file_rounds_unevenly_are_found():
    _, y = readings(0.05, 0.0625)
    assert resolution(np.round(y, 2)) == pytest.approx(0.0625, abs=0.008)


def test_values_that_a_file_interpolates_between_levels_do_not_hide_the_step():
    _, y = readings(0.0, 1.0, missing=0.0, jitter=0.0)
    change = np.flatnonzero(np.diff(y))
    y[change] = 0.37 * y[change] + 0.63 * y[change + 1]
    assert resolution(y) == pytest.approx(1.0)


@pytest.mark.parametrize("dt", [0.5, 2.0, 10.0])
def test_the_sampling_interval_does_not_matter(dt):
    t, y = readings(0.1, 0.0, dt=dt)
    assert white_noise(t, y, 0.0) == pytest.approx(0.1, rel=0.1)


def test_events_of_the_signal_are_not_noise():
    t, y = readings(0.05, 0.0)
    y[1000:] += 4.0
    y[2000] += 20.0
    assert white_noise(t, y, 0.0) == pytest.approx(0.05, rel=0.1)


def test_each_sensor_has_its_own():
    (t, a), (u, b) = readings(0.1, 0.0), readings(0.3, 0.5)
    sensor = np.repeat([0, 1], [len(a), len(b)])
    noise = estimate_noise(np.concatenate([t, u]), np.concatenate([a, b]), sensor, 2)
    assert noise.sigma == pytest.approx([0.1, 0.3], rel=0.1)
    assert noise.step == pytest.approx([0.0, 0.5], abs=2e-3)
    assert noise.total[1] == pytest.approx(np.hypot(0.3, 0.5 / np.sqrt(12)), rel=0.1)


def between(sigma, step, seed, *, share=0.5, n=3600):
    """Readings that a logger puts between two others, and the sd of their error."""
    rng = np.random.default_rng([seed, 78])
    t = np.arange(n + 1.0)
    true = 25.0 + rng.uniform(0.0, 1.0) + 8.0 * (1.0 - np.exp(-t / 1500.0)) + 1.5 * np.sin(t / 200.0)

    def seen(x):
        return np.round(x / step) * step if step else x

    y = seen(true + sigma * rng.standard_normal(n + 1))
    y, true = (x[:-1] + share * (x[1:] - x[:-1]) for x in (y, true))
    return t[:-1] + share, seen(y), float(np.std(seen(y) - true))


@pytest.mark.parametrize("seed", range(900, 903))
@pytest.mark.parametrize(("sigma", "step"), [(0.05, 0.0), (0.06, 0.1), (0.1, 0.1), (0.2, 0.1), (0.05, 0.05)])
def test_noise_that_readings_share_with_their_neighbours_is_found_whole(sigma, step, seed):
    t, y, error = between(sigma, step, seed)
    found = estimate_noise(t, y, np.zeros(len(y), np.intp), 1)
    assert white_noise(t, y, resolution(y)) < 0.75 * found.sigma[0]  # between neighbours most of it is not seen
    assert found.total[0] == pytest.approx(error, rel=0.1)


@pytest.mark.parametrize("seed", range(900, 903))
@pytest.mark.parametrize("step", [0.0, 0.05, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("sigma", [0.0, 0.01, 0.03, 0.1, 0.3])
@pytest.mark.plain_cases(10)
def test_white_noise_steps_and_fast_signals_are_not_taken_for_shared_noise(sigma, step, seed):
    rng = np.random.default_rng([seed, 79])
    t = np.arange(3600.0)
    heat = np.repeat(rng.choice([0.0, 0.02, 0.06, 0.15, -0.05], 240), 15)  # of a current that steps every 15 s
    fast = np.convolve(heat - heat.mean(), 0.98 ** np.arange(400.0))[:3600]
    for signal in (
        8.0 * (1.0 - np.exp(-t / 600.0)),
        2.0 * np.sin(t / 10.0),
        fast,
        np.cumsum(rng.standard_normal(3600)),
    ):
        y = 25.0 + signal + sigma * rng.standard_normal(3600)
        y = np.round(y / step) * step if step else y
        for thin in (1, 10):  # fewer readings, between which the signal moves farther
            assert shared_noise(t[::thin], y[::thin], resolution(y[::thin])) == 0.0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("sigma", "step"), [(0.0, 1.0), (0.05, 1.0), (0.05, 0.5), (0.1, 0.5), (0.3, 0.5), (0.2, 1.0)])
def test_the_rounding_error_that_lasts_is_that_of_the_mean_reading(sigma, step, seed):
    """Monte Carlo: of many readings of one place, the error of their mean is what noise does not whiten."""
    rng = np.random.default_rng(seed)
    at = rng.uniform(0.0, step, 400)[:, None]
    lasts = (np.round((at + sigma * rng.standard_normal((400, 2000))) / step) * step - at).mean(axis=1)
    t, y = readings(sigma, step, seed=seed)
    assert slow_rounding(t, y) == pytest.approx(np.sqrt(np.mean(lasts**2)), abs=0.06 * step)


def test_fine_readings_round_nothing_away():
    assert slow_rounding(*readings(0.05, 0.0)) == 0.0
    assert slow_rounding(np.empty(0), np.empty(0)) == 0.0
    assert slow_rounding(np.arange(50.0), np.full(50, 21.0)) == 0.0
