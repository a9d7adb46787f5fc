"""A channel that was parked is not believed because it twitches; one that goes with its neighbours is.

Each series goes through the guard and through its rules in words, which have to agree sample by sample.
"""

import numpy as np
import pytest

from bms_gateway.frames.quality import Quality
from bms_gateway.frames.rules import Rule
from tests.frames.guard_pair import Both, S

FINE = Rule("surface", 0, -38.5, 150.0, -38.9, 200.0, 5 * S, 2.5, 0.2, 20.0, needs_proof=True)
REST, DRIVE = 40, 200


def told_of(series: np.ndarray, *, rest: int = REST) -> np.ndarray:
    """Qualities (T, C) of one sample a second and channel of `series` (T, C); current flows from `rest` on."""
    both = Both((FINE,) * series.shape[1])
    return np.array(
        [
            both.judge([(k * S, c, float(v), Quality.GOOD) for c, v in enumerate(row)], (k + 1) * S, active=k >= rest)
            for k, row in enumerate(series)
        ]
    )


def string(seed: int, channels: int, *, noise: float = 0.4, rest: int = REST, level: float = 25.5) -> np.ndarray:
    """Thermometers of a string (T, C): at rest they cool by hundredths, under current they warm up amid noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(rest + DRIVE)[:, None]
    amid = np.where(t < rest, 0.0, noise) * rng.standard_normal((rest + DRIVE, channels))
    heat = -0.001 * np.minimum(t, rest) + 0.01 * np.maximum(t - rest, 0)
    return np.round(level + rng.uniform(-0.5, 0.5, channels) + heat + amid, 2)


def twitching(seed: int, depth: float, *, rest: int = REST) -> np.ndarray:
    """An input (T,) without a sensor: one value, of which every other sample under current is drawn down."""
    rng = np.random.default_rng(seed)
    drawn = (np.arange(rest + DRIVE) >= rest) & (rng.random(rest + DRIVE) < 0.5)
    return np.round(24.52 - drawn * depth * rng.random(rest + DRIVE), 2)


@pytest.mark.parametrize(("depth", "share"), [(2.0, 0.2), (2.8, 0.1), (4.0, 0.01), (6.0, 0.0)])
@pytest.mark.parametrize("seed", range(6))
def test_a_parked_input_that_twitches_when_current_begins_to_flow_is_not_good(seed, depth, share):
    """What is drawn down by less than its neighbours' noise is no different from them at first."""
    series = string(seed, 6)
    series[:, 2] = twitching(seed, depth)
    told = told_of(series)
    good = told[:, 2] == Quality.GOOD
    assert good.mean() <= share
    assert not good[np.abs(series[:, 2] - np.median(series, axis=1)) > 4.0].any()
    sound = np.delete(told, 2, axis=1)
    assert np.mean(sound[REST + 10 :] == Quality.GOOD) > 0.99


@pytest.mark.parametrize("noise", [0.02, 0.1, 0.4, 0.5])
@pytest.mark.parametrize("seed", range(4))
def test_of_sound_thermometers_hardly_a_sample_is_lost_when_noise_begins(seed, noise):
    told = told_of(string(seed, 8, noise=noise))
    assert (told[REST + 5 :] == Quality.GOOD).mean() >= 0.99


@pytest.mark.parametrize("seed", range(4))
def test_one_that_is_four_times_as_noisy_as_its_neighbours_is_believed(seed):
    rng = np.random.default_rng(seed + 100)
    series = string(seed, 6, noise=0.1)
    series[REST:, 0] = np.round(series[REST:, 0] + 0.4 * rng.standard_normal(DRIVE), 2)
    assert (told_of(series)[REST + 5 :, 0] == Quality.GOOD).mean() >= 0.95


def test_a_thermometer_far_from_its_neighbours_is_believed_once_it_goes_with_them():
    series = string(3, 6, noise=0.05)
    series[:, 1] -= 10.0
    told = told_of(series)
    moves = int(np.argmax(np.diff(series[:, 0]) != 0.0))
    assert not (told[:7, 1] == Quality.GOOD).any()
    assert (told[moves + 25 :, 1] == Quality.GOOD).all()
    assert (told[moves + 25 :, 0] == Quality.GOOD).all()


def test_one_plugged_in_at_another_temperature_is_believed_soon():
    """It leaves its neighbours once, and stays where it is."""
    series = string(4, 6, noise=0.05)
    series[: REST + 60, 1] = 24.52
    series[:, 1] += np.where(np.arange(len(series)) < REST + 60, 0.0, 6.0)
    told = told_of(series)[:, 1]
    assert not (told[: REST + 60] == Quality.GOOD).any()
    assert (told[REST + 60 + 12 :] == Quality.GOOD).all()


def test_pulses_of_noise_at_rest_cost_no_thermometer_its_trust():
    """Disturbed for seconds and not warmed, all come back to their own hundredths: together, which says nothing."""
    rng = np.random.default_rng(5)
    series = np.round(np.broadcast_to(25.0 + rng.uniform(-0.5, 0.5, 6), (160, 6)), 2).copy()
    series[20:] += 0.01
    noisy = np.arange(160) % 10 >= 7
    series[noisy] = np.round(series[noisy] + 0.3 * rng.standard_normal((noisy.sum(), 6)), 2)
    told = told_of(series, rest=0)
    assert (told[40:] == Quality.GOOD).mean() >= 0.99


def test_two_say_nothing_of_each_other_and_a_middle_that_jumps_nothing_of_any():
    """Senders that begin with zeros, and a string of two of which one is parked: as if alone."""
    series = string(6, 5, noise=0.05)
    begin = series.copy()
    begin[0, :3] = 0.0
    told = told_of(begin)
    assert (told[REST + 5 :] == Quality.GOOD).all()
    assert (told[2 : REST // 2, 3:] != Quality.JUMPY).all()
    pair = series[:, :2].copy()
    pair[:, 1] -= 15.0
    assert (told_of(pair)[REST:] == Quality.GOOD).all()
