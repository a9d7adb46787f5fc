"""A current that its voltage contradicts: made-up faults on a drive whose voltage follows V = OCV − R·I."""

import numpy as np
import pytest

from bms_gateway.frames.ammeter import ENOUGH, STANDS, Ammeter
from bms_gateway.frames.database import Database
from bms_gateway.frames.rules import default_rule

R, OCV = 0.1, 400.0


def drive(ticks: int, seed: int = 0) -> np.ndarray:
    """True current (ticks, 10) of a drive with regeneration, level within each second."""
    rng = np.random.default_rng(seed)
    return np.repeat(np.round(rng.uniform(-100.0, 200.0, ticks), 1)[:, None], 10, axis=1)


def volts(current: np.ndarray, seed: int = 1) -> np.ndarray:
    noise = 0.05 * np.random.default_rng(seed).standard_normal(current.shape)
    return np.round(OCV - R * current + noise, 1)


def run(shown: np.ndarray, V: np.ndarray, meter: Ammeter | None = None) -> tuple[np.ndarray, np.ndarray]:
    """What is refused and whether the sign is called wrong, after each tick."""
    meter = meter or Ammeter(0.1)
    refused, turned = [], []
    for i, v in zip(shown, V, strict=True):
        meter.update(i, v)
        refused.append(meter.stands_at[0] if meter.stands_at else np.nan)
        turned.append(meter.reversed)
    return np.array(refused), np.array(turned)


@pytest.mark.parametrize("seed", range(5))
def test_a_sound_sensor_is_never_suspected(seed):
    true = drive(600, seed)
    refused, turned = run(true, volts(true, seed))
    assert np.isnan(refused).all()
    assert not turned.any()


@pytest.mark.parametrize("level", [0.0, 37.5, -40.0])
def test_a_stuck_sensor_is_refused_within_half_a_minute_and_believed_again_when_it_moves(level):
    true = drive(300)
    shown = true.copy()
    shown[100:200] = level
    refused, turned = run(shown, volts(true))
    assert np.isnan(refused[:100]).all()
    assert (refused[130:200] == level).all()
    assert np.isnan(refused[220:]).all()
    assert not turned.any()


@pytest.mark.parametrize(("low", "high", "end"), [(0.0, 1e9, 0.0), (-1e9, 120.0, 120.0)])
def test_a_clipped_sensor_is_refused_at_its_end_only_until_it_passes_it(low, high, end):
    rng = np.random.default_rng(2)
    # a few seconds of each direction in turn, as driving has them
    level = np.repeat(np.where(np.arange(100) % 2, -1.0, 1.0) * rng.uniform(60.0, 90.0, 100), 4)
    true = np.repeat(np.round(level * rng.uniform(0.6, 1.4, 400) + 80.0 * (end > 0), 1)[:, None], 10, axis=1)
    shown = np.where(np.arange(400)[:, None] < 300, np.clip(true, low, high), true)
    refused, _ = run(shown, volts(true))
    assert (refused[150:300] == end).all()
    assert set(refused[~np.isnan(refused)]) == {end}
    assert np.isnan(refused[320:]).all()


def test_a_sensor_saturated_at_both_ends_is_refused_at_both():
    true = drive(400, 4)
    level = np.repeat(np.where(np.arange(80) % 2, -1.0, 1.0), 5)[:, None] * (60.0 + np.abs(true))
    meter = Ammeter(0.1)
    run(np.clip(level, -50.0, 50.0), volts(level), meter)
    assert meter.stands_at == (50.0, -50.0)


def test_relaxation_of_the_voltage_after_loads_of_one_direction_accuses_nobody():
    pulse = np.r_[np.full(10, 150.0), np.zeros(50)]
    true = np.repeat(np.tile(pulse, 20)[:, None], 10, axis=1)
    slow = np.zeros(len(true))
    for k in range(1, len(slow)):
        slow[k] = slow[k - 1] + (0.1 * true[k, 0] - slow[k - 1]) / 8.0
    refused, turned = run(true, volts(true) - slow[:, None])
    assert np.isnan(refused).all()
    assert not turned.any()


def test_a_flickering_last_digit_of_a_coarse_voltage_is_no_move():
    V = 400.0 + np.random.default_rng(3).integers(-1, 2, (600, 1)) * np.ones((1, 10))
    refused, _ = run(np.zeros((600, 10)), V, Ammeter(1.0))
    assert np.isnan(refused).all()
    refused, _ = run(np.zeros((600, 10)), V, Ammeter(0.01))
    assert refused[-1] == 0.0  # the same from a voltage of fine steps is a load that nobody measured


def test_a_wrong_sign_is_told_and_taken_back():
    true = drive(400)
    shown = true.copy()
    shown[100:250] *= -1.0
    refused, turned = run(shown, volts(true))
    assert not turned[:100].any()
    assert turned[220:250].all()
    assert not turned[-20:].any()
    assert np.isnan(refused).all()
    assert run(-true, volts(true))[1].tolist().index(True) >= ENOUGH


def test_ten_steps_tell_nothing_where_voltage_and_current_have_nothing_in_common():
    rng = np.random.default_rng(5)
    _, turned = run(drive(600, 7), OCV + rng.uniform(-20, 20, (600, 1)) * np.ones((1, 10)))
    assert not turned.any()


def test_without_voltage_or_current_nothing_is_judged_and_a_gap_is_no_step():
    meter = Ammeter(0.1)
    none = np.empty(0)
    for k in range(50):
        meter.update(np.full(2, 20.0), none)
        meter.update(none, np.full(2, OCV + 5.0 * (-1) ** k))
    assert meter.stands_at == ()
    meter = Ammeter(0.1)
    for k in range(50):
        meter.update(np.full(2, 20.0), np.full(2, OCV + 5.0 * (-1) ** k))
        meter.forget()
    assert meter.stands_at == ()


def test_a_current_that_moves_within_a_tick_to_the_same_mean_is_neither_accused_nor_forgiven():
    meter = Ammeter(0.1)
    for k in range(50):
        meter.update(np.array([20.0 - k, 20.0 + k]), np.full(2, OCV + 5.0 * (-1) ** k))
        assert meter.stands_at == ()
    for k in range(50):
        meter.update(np.full(2, 20.0), np.full(2, OCV + 5.0 * (-1) ** k))
    assert meter.stands_at == (20.0,)
    for k in range(500):
        meter.update(np.array([20.0, 20.0 + k % 2]) - 0.5 * (k % 2), np.full(2, OCV + 5.0 * (-1) ** k))
        if k == 0:
            refused = meter.stands_at
    assert refused == (20.0,)


def test_the_value_refused_is_the_one_that_was_seen_standing():
    meter = Ammeter(0.1)
    for k in range(2 * STANDS):
        assert meter.stands_at == ()
        meter.update(np.full(3, 20.0), np.full(3, OCV + 5.0 * (-1) ** k))
    meter.update(np.full(3, 20.0), np.full(3, OCV + 5.0))
    assert meter.stands_at == (20.0,)
    for k in range(4):  # another value that stands has to wait for the first to be acquitted
        meter.update(np.full(3, 30.0), np.full(3, OCV + 5.0 * (-1) ** k))
    assert meter.stands_at == (20.0,)


DBC = (
    'VERSION ""\nBS_:\nBU_: A\nBO_ 1 M: 8 A\n SG_ signed : 0|16@1- (0.1,0) [0|0] "A" A\n'
    ' SG_ unsigned : 16|16@1+ (0.01,0) [0|0] "A" A\n SG_ declared : 32|16@1- (0.1,0) [-500|500] "A" A\n'
    ' SG_ charger : 48|8@1- (1,0) [-100|0] "A" A\n'
)


@pytest.mark.parametrize(
    ("name", "scale", "lower", "upper"),
    [
        ("signed", 1.0, -3000.0, 3000.0),
        ("signed", 0.1, -327.675, 327.665),
        ("unsigned", 1.0, -3000.0, 655.345),
        ("unsigned", -1.0, -655.345, 3000.0),
        ("declared", 1.0, -499.95, 499.95),
        ("charger", 1.0, -99.5, 3000.0),
    ],
)
def test_a_current_at_an_end_of_its_signal_is_out_of_range_but_zero_is_no_end(name, scale, lower, upper):
    info = Database.load({"a.dbc": DBC}).resolve(f"M.{name}")
    rule = default_rule("current", info, scale)
    assert (rule.lower, rule.upper) == (pytest.approx(lower), pytest.approx(upper))


def test_bytes_of_two_measurements_and_open_contactors_accuse_no_current() -> None:
    """Samples of a voltage of 500 V that read a few volts, and noise before contactors close, are no moves."""
    rng = np.random.default_rng(5)
    meter = Ammeter(0.01)
    for _ in range(30):
        meter.update(np.zeros(10), rng.choice([0.0, 2.6, 17.9, 38.4], 10))
    for k in range(200):
        amps = 0.0 if k % 20 < 10 else 80.0 + 40.0 * np.sin(k)
        V = np.full(10, 500.0 - 0.4 * amps)
        torn = rng.random(10) < 0.13
        meter.update(np.full(10, amps), np.where(torn, rng.choice([2.6, 17.9, 38.4], 10), V))
        if k % 50 == 7:  # all of a tick
            meter.update(np.zeros(10), np.full(10, 25.6))
    assert meter.stands_at == ()
    assert meter.resistance == pytest.approx(0.4, rel=0.01)
    assert not meter.reversed
