"""A sound sensor is not called stuck for its noise: the chance by itself, the guard's own counting, many hours at rest.

A value that a channel stays at is left when a count has run out: each equal sample adds one, to at most three, each
other takes one. White noise of standard deviation σ in steps of q gives the same value again with probability
erf(q / (σ √8)) at most, which makes the count a walk; how long it lasts is found here from the walk alone.
"""

from dataclasses import replace
from math import erf, sqrt

import numpy as np
import pytest

from bms_gateway.frames.anchor import SETTLED, Anchors, Standing
from bms_gateway.frames.database import Database
from bms_gateway.frames.guard import Guard
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.repeats import Repeats
from bms_gateway.frames.rules import Rule, default_rule
from tests.frames.guard_runs import FINE, run

S = 1_000_000_000
HOURS = 1e4
"""A sound sensor may be called stuck once in so many."""


def lasts(same: float, samples: int) -> float:
    """Chance that a value is stayed at for so many samples, its first one included."""
    chance = {1: 1.0}
    for _ in range(samples - 1):
        after = dict.fromkeys((1, 2, 3), 0.0)
        for count, p in chance.items():
            after[min(count + 1, 3)] += p * same
            if count > 1:
                after[count - 1] += p * (1.0 - same)
        chance = after
    return sum(chance.values())


def rule_of(step: float) -> Rule:
    """A thermometer's rule, the DBC counting in `step`."""
    text = f'VERSION ""\nBS_:\nBU_: A\nBO_ 1 M: 8 A\n SG_ t : 0|16@1+ ({step},-100) [0|0] "C" A\n'
    return default_rule("surface", Database.load({"a.dbc": text}).resolve("M.t"))


def same_again(noise: float, step: float) -> float:
    return erf(step / (noise * sqrt(8.0)))


def noisy(rng: np.random.Generator, channels: int, noise: float, step: float, seconds: int) -> np.ndarray:
    """Readings (T, C) at rest."""
    level = rng.uniform(20.0, 40.0, channels)
    return np.round((level + noise * rng.standard_normal((seconds, channels))) / step) * step


@pytest.mark.parametrize("samples", [2, 5, 12, 30])
def test_the_guard_leaves_a_value_as_the_walk_does(samples: int) -> None:
    channels, noise, step = 4000, 0.01, 0.01
    rng = np.random.default_rng(samples)
    first = np.zeros((1, channels))  # in the middle of a step, where the same value is likeliest
    values = np.round(np.concatenate([first, noise * rng.standard_normal((samples - 1, channels))]) / step) * step
    anchors, every = Anchors(channels), np.ones(channels, np.bool_)
    for value in 25.0 + values:
        anchors.follow(slice(None), value, every, np.ones(channels), Standing(np.zeros(channels), 20.0, ~every, None))
    still = float(np.mean(anchors.held == samples))
    p = lasts(same_again(noise, step), samples)
    assert still == pytest.approx(p, abs=4.5 * sqrt(p * (1.0 - p) / channels) + 1e-9)


@pytest.mark.parametrize("noise", [0.05, 0.1])
@pytest.mark.parametrize("step", [0.01, 0.02, 0.05, 0.1])
def test_noise_holds_no_value_for_as_long_as_makes_a_channel_stuck(noise: float, step: float) -> None:
    """Neither as a home, to which it might come back, nor by standing: a sample a second, current all the time."""
    rule, p = rule_of(step), same_again(noise, step)
    limit = rule.stuck_after_s if step <= 0.05 else 1800.0
    assert 3600.0 * HOURS * lasts(p, int(SETTLED * limit)) < 1.0
    assert 3600.0 * HOURS * lasts(p, int(limit)) < 1.0


def stuck_at_rest(channels: int, seconds: int, noise: float, sent: float, counted: float) -> int:
    """Samples called stuck, of strings of eight sensors at rest under current."""
    base = rule_of(counted)
    guard = Guard([replace(base, group=k // 8) for k in range(channels)])
    rng, every, stuck = np.random.default_rng(3), np.arange(channels), 0
    level, flag = rng.uniform(20.0, 40.0, channels), np.zeros(channels, np.uint8)
    for t in range(seconds):
        value = np.round((level + noise * rng.standard_normal(channels)) / sent) * sent
        got = guard.update(np.full(channels, t * S), every, value, flag, (t + 1) * S, True)
        stuck += int(np.count_nonzero(got.quality == Quality.STUCK))
    return stuck


WAYS = [(0.05, 0.01, 0.01), (0.1, 0.01, 0.01), (0.05, 0.05, 0.05), (0.05, 0.1, 0.01), (0.1, 0.1, 0.1)]


@pytest.mark.parametrize(("noise", "sent", "counted"), WAYS)
def test_sound_sensors_at_rest_are_not_called_stuck(noise: float, sent: float, counted: float) -> None:
    """In a hundred hours; those of 0.05 K in hundredths were, 15 times."""
    assert stuck_at_rest(400, 900, noise, sent, counted) == 0


@pytest.mark.slow
def test_in_ten_thousand_hours_neither() -> None:
    assert stuck_at_rest(10_000, 3_600, 0.05, 0.01, 0.01) == 0


def of_first(series: np.ndarray, active: np.ndarray | bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Qualities (T,) of the samples of the first of some channels, one a second, and of that channel itself."""
    channels = series.shape[1]
    guard, every, flag = Guard([FINE] * channels), np.arange(channels), np.zeros(channels, np.uint8)
    on = np.broadcast_to(np.asarray(active), len(series))
    got = [
        guard.update(np.full(channels, t * S), every, row, flag, (t + 1) * S, bool(on[t]))
        for t, row in enumerate(series)
    ]
    return np.array([g.quality[0] for g in got]), np.array([g.channel_quality[0] for g in got])


def first_stuck(told: np.ndarray) -> int:
    """When it is first called so, after a start of 20 s."""
    return 20 + int(np.argmax(told[20:] == Quality.STUCK))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("channels", [2, 4])
@pytest.mark.parametrize("noise", [0.03, 0.05, 0.1])
@pytest.mark.parametrize("begins", [90, 500])
def test_a_sensor_that_freezes_amid_noise_is_held_back_at_once_and_stuck_in_less_than_a_minute_of_current(
    begins: int, noise: float, channels: int, seed: int
) -> None:
    """Whether it froze soon after a start or late, and though its only peer gives a value twice now and then."""
    series = noisy(np.random.default_rng(seed), channels, noise, 0.01, begins + 300)
    series[begins:, 0] = series[begins - 1, 0]
    samples, channel = of_first(series)
    assert (samples[20:begins] == Quality.GOOD).all()
    assert begins + 4 <= first_stuck(samples) <= begins + 20
    assert (samples[begins + 20 :] == Quality.STUCK).all()
    found = begins + SETTLED * FINE.stuck_after_s
    assert found - 2 <= first_stuck(channel) <= found + 10  # its clock stands while its peer gives a value twice


def test_a_lone_sensor_that_freezes_amid_its_noise_is_held_back_and_counts_again_when_it_moves() -> None:
    series = noisy(np.random.default_rng(7), 1, 0.05, 0.01, 500)
    series[300:400] = series[299]
    samples, channel = of_first(series)
    assert (samples[20:300] == Quality.GOOD).all()
    assert first_stuck(samples) <= 300 + 10
    assert (samples[310:400] == Quality.STUCK).all()
    assert (samples[400:] == Quality.GOOD).all()
    assert (channel[20:] == Quality.GOOD).all()


def test_what_stands_still_when_noise_ends_at_rest_is_not_held_back() -> None:
    """Nor is it called stuck when current flows again and its peers move as slowly as it does."""
    series = noisy(np.random.default_rng(6), 4, 0.05, 0.01, 1500)
    series[300:] = np.round(series[299] + 0.001 * np.maximum(np.arange(-900, 300), 0)[:, None], 2)
    samples, channel = of_first(series, np.arange(1500) // 300 % 4 != 1)
    assert (samples[20:] == Quality.GOOD).all()
    assert (channel[20:] == Quality.GOOD).all()


def test_a_sensor_seen_for_seconds_has_shown_no_noise() -> None:
    series = noisy(np.random.default_rng(9), 4, 0.1, 0.01, 100)
    series[15:, 0] = series[14, 0]
    samples, _ = of_first(series)
    assert (samples[10:] == Quality.GOOD).all()


def test_where_sensors_are_quiet_one_may_stand_for_five_minutes() -> None:
    """Its peers move on; that it was never noisy itself, or that they are not, is a reason to wait."""
    rng = np.random.default_rng(5)
    moving = np.round(25.0 + 0.002 * np.arange(1200)[:, None] + 0.002 * rng.standard_normal((1200, 3)), 2)
    noisy_one = np.round(25.0 + 0.05 * rng.standard_normal((1200, 1)), 2)
    noisy_one[600:] = noisy_one[599]
    quiet_one = np.round(25.0 + 0.004 * np.arange(1200)[:, None], 2)
    quiet_one[600:] = quiet_one[599]
    told, _ = run([FINE] * 4, np.hstack([noisy_one, moving]))
    assert (told[20:890, 0] == Quality.GOOD).all()
    told, _ = run([FINE] * 4, np.hstack([quiet_one, noisy(rng, 3, 0.05, 0.01, 1200)]))
    assert (told[20:890, 0] == Quality.GOOD).all()
    assert (told[910:, 0] == Quality.STUCK).all()


STEPS = [(0.05, 0.1), (0.1, 0.1), (0.045, 0.1), (0.25, 0.5)]
"""Noise and step of readings that give the same value twice in 27 to 60 % of the samples."""


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("noise", "step"), STEPS)
def test_a_sensor_that_freezes_in_steps_as_wide_as_its_noise_is_held_back_in_90_s(
    noise: float, step: float, seed: int
) -> None:
    """It was used for five minutes and more, and seemed to come loose, or its cell to have a short."""
    rng = np.random.default_rng(seed)
    warming = 0.003 * np.arange(1300)[:, None]
    series = np.round((30.0 + rng.uniform(0, 1, 3) + warming + noise * rng.standard_normal((1300, 3))) / step) * step
    series[1000:1200, 0] = series[999, 0]
    guard, every, flag = Guard([rule_of(step)] * 3), np.arange(3), np.zeros(3, np.uint8)
    told = [
        guard.update(np.full(3, t * S), every, row, flag, (t + 1) * S, True).quality[0] for t, row in enumerate(series)
    ]
    assert set(told[60:1000]) == {Quality.GOOD}
    assert told.index(Quality.STUCK, 60) <= 1090
    assert set(told[1090:1200]) == {Quality.STUCK}
    assert set(told[1201:]) == {Quality.GOOD}


@pytest.mark.parametrize("follows", [0.0, 0.5, 0.8])
@pytest.mark.parametrize("noise", [0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0])
def test_of_sound_sensors_that_repeat_much_hardly_a_sample_is_held_back(noise: float, follows: float) -> None:
    """In 1,200 hours of warming and cooling through all places between two steps, the noise white or with a memory."""
    channels, rng, before = 600, np.random.default_rng(11), None
    repeats, all_, n, held = Repeats(channels), np.ones(channels, np.bool_), np.zeros(channels), 0
    place = rng.uniform(0.0, 1.0, channels)
    for t in range(7200):
        n = follows * n + sqrt(1.0 - follows**2) * rng.standard_normal(channels)
        value = np.round(place + 1.2 * np.sin(2.0 * np.pi * t / 3600.0) + noise * n)  # in steps
        if before is not None:
            repeats.count(slice(None), all_, value - before, all_)
            held += int(np.count_nonzero(repeats.freezes(slice(None))))
        before = value
    assert held < 1e-5 * 7200 * channels


def test_an_input_disturbed_before_it_had_a_home_is_found_after_twenty_seconds_at_it() -> None:
    series = noisy(np.random.default_rng(2), 4, 0.05, 0.01, 300)
    series[:, 0] = 24.52
    series[30:34, 0] = (23.9, 23.1, 22.8, 23.3)
    told, _ = run([FINE] * 4, series)
    assert told[:, 0].tolist().index(Quality.STUCK, 30) <= 34 + 25
    assert (told[59:, 0] == Quality.STUCK).all()
