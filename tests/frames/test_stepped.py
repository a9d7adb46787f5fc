"""A thermocouple that steps down alone is not used because it stands calmly at its new value.

Each series goes through the guard and through its rules in words, which have to agree sample by sample.
"""

import numpy as np
import pytest

from bms_gateway.frames.quality import Quality
from bms_gateway.frames.rules import Rule
from tests.frames.guard_pair import Both, S

COARSE = Rule("surface", 0, -38.5, 150.0, -38.9, 200.0, 10 * S, 2.5, 0.2, 210.0)
AT, LENGTH = 300, 2400


def string(seed: int, channels: int = 4, *, noise: float = 0.05) -> np.ndarray:
    """Surfaces of a string (T, C) in steps of 0.1 K: they warm up by 6 K, each a little differently."""
    rng = np.random.default_rng(seed)
    t = np.arange(LENGTH)[:, None]
    true = 27.0 + 6.0 * (1.0 - np.exp(-t / 900.0)) * (1.0 + 0.05 * np.arange(channels))
    return np.round(true + noise * rng.standard_normal((LENGTH, channels)), 1)


def told_of(series: np.ndarray, *, rules: Rule = COARSE) -> np.ndarray:
    """Qualities (T, C) of one sample a second and channel; current flows."""
    both = Both((rules,) * series.shape[1])
    return np.array(
        [
            both.judge([(k * S, c, float(v), Quality.GOOD) for c, v in enumerate(row)], (k + 1) * S, active=True)
            for k, row in enumerate(series)
        ]
    )


def good(told: np.ndarray, channel: int, start: int, end: int | None = None) -> float:
    """Share of good samples."""
    return float(np.mean(told[start:end, channel] == Quality.GOOD))


@pytest.mark.parametrize("seed", range(3))
def test_one_that_freezes_below_its_neighbours_is_never_used_again(seed):
    series = string(seed)
    series[AT:, 2] = series[AT, 2] - 5.0
    told = told_of(series)
    assert good(told, 2, 5, AT) == 1.0
    assert good(told, 2, AT) == 0.0
    assert set(told[AT:, 2]) <= {Quality.JUMPY, Quality.STUCK}
    assert good(np.delete(told, 2, axis=1).reshape(-1, 1), 0, 30) > 0.999


def test_one_that_freezes_and_is_passed_by_its_cooling_neighbours_is_not_used_either():
    series = string(1)[::-1].copy()
    series[AT:, 2] = series[AT, 2] - 4.0
    told = told_of(series)
    assert (np.abs(series[AT:, 2] - series[AT:, 1]) < 0.5).any()
    assert good(told, 2, AT) == 0.0


def test_one_that_reads_the_coolant_since_its_contact_came_off_waits_a_quarter_of_an_hour():
    series = string(2)
    fallen = 27.0 + 0.3 * np.sin(np.arange(LENGTH) / 40.0) - 4.0
    series[AT:, 2] = np.round(fallen[AT:], 1)
    told = told_of(series)
    assert good(told, 2, AT, AT + 900) == 0.0
    assert good(told, 2, AT + 902) == 1.0


def test_cold_water_on_a_sensor_costs_a_minute_beyond_the_time_in_which_it_warms_up():
    series = string(3)
    splash = -6.0 * np.exp(-np.arange(LENGTH - AT) / 30.0)
    series[AT:, 2] = np.round(series[AT:, 2] + splash, 1)
    told = told_of(series)
    assert told[AT + 10, 2] == Quality.JUMPY
    warm = AT + int(30 * np.log(6.0 / 1.25))  # within half a jump
    assert good(told, 2, AT, warm) == 0.0
    assert good(told, 2, warm + 70) == 1.0


@pytest.mark.parametrize("away", [1, 20, 400])
def test_a_contact_that_came_off_and_is_fastened_is_used_within_80_s(away):
    series = string(4)
    series[AT : AT + away, 2] -= 8.0
    told = told_of(series)
    assert good(told, 2, AT, AT + away) == 0.0
    assert good(told, 2, AT + away + 80) == 1.0
    assert away > 1 or good(told, 2, AT + away + 13) == 1.0  # a glitch costs what it did


def test_a_step_of_all_neighbours_and_one_up_hold_nothing_back():
    """Other units in their sender, and a cell that heats: what is hot must be seen."""
    together, up = string(5), string(6)
    together[AT:] -= 5.0
    up[AT:, 2] += 5.0
    up[AT + 400 :, 2] -= 5.0
    assert (told_of(together)[AT + 13 :] == Quality.GOOD).all()
    told = told_of(up)
    assert good(told, 2, AT + 13, AT + 400) == 1.0
    assert good(told, 2, AT + 430) == 1.0


def test_two_thermocouples_say_nothing_of_each_other():
    series = string(7, 2)
    series[AT:, 1] -= 5.0
    assert good(told_of(series), 1, AT + 13) == 1.0


@pytest.mark.parametrize("noise", [0.1, 0.4])
@pytest.mark.parametrize("seed", range(4))
def test_single_glitches_of_noisy_sensors_cost_some_seconds_each(noise, seed):
    series = string(10 + seed, noise=noise)
    series[AT::400, 2] -= 9.0
    told = told_of(series)
    assert good(told, 2, AT) > 0.96  # six glitches of 13 samples, as it was
    assert good(told, 1, 30) > 0.99
