"""Means over a tick at the limits of the rules: how long a sample is held, how much of a tick must be known."""

import numpy as np
import pytest

from bms_gateway.engine.current import Current, Means

S = 1_000_000_000
MS = 1_000_000


def run(*ticks: tuple[dict[int, float], dict[int, float]], t0: int = 10 * S) -> list[Means]:
    """Means of ticks of a second; each has currents and voltages by ms from its start."""
    line, told = Current(), []
    for k, (amps, volts) in enumerate(ticks):
        start = t0 + k * S
        t = [np.array([start + ms * MS for ms in one], np.int64) for one in (amps, volts)]
        v = [np.array(list(one.values()), np.float64) for one in (amps, volts)]
        told.append(line.update(t[0], v[0], t[1], v[1], start, start + S))
    return told


def integral(pieces: list[tuple[float, float]]) -> tuple[float, float, float]:
    """Means of I, I² and |I| of (seconds, A)."""
    whole = sum(s for s, _ in pieces)
    return tuple(sum(s * f(a) for s, a in pieces) / whole for f in (lambda a: a, lambda a: a * a, abs))


def test_the_current_is_held_between_samples_and_its_magnitude_is_a_mean_too() -> None:
    (_, m) = run(({900: -30.0}, {}), ({250: 10.0, 750: -20.0}, {}))
    assert (m.I, m.I2, m.I_abs) == pytest.approx(integral([(0.25, -30.0), (0.5, 10.0), (0.25, -20.0)]))
    assert np.isnan([m.V, m.IV]).all()


def test_half_of_a_tick_must_be_covered() -> None:
    (half,), (less,) = run(({500: 7.0}, {})), run(({501: 7.0}, {}))
    assert half.I == half.I_abs == 7.0
    assert half.I2 == 49.0
    assert np.isnan([less.I, less.I2, less.I_abs]).all()


@pytest.mark.parametrize(("at_ms", "known"), [(0, 2), (499, 2), (500, 2), (501, 1), (999, 1)])
def test_a_sample_is_held_for_a_second_and_a_half(at_ms: int, known: int) -> None:
    """So it covers at least half of its own tick and of the next, or of the next alone and of the one after that."""
    told = [bool(np.isfinite(m.I)) for m in run(({at_ms: 5.0}, {}), ({}, {}), ({}, {}))]
    assert told == [at_ms <= 500, True, at_ms >= 1000]
    assert sum(told) == known


def test_a_single_sample_in_a_long_tick_counts_for_a_second_and_a_half() -> None:
    line = Current()
    none = np.empty(0, np.int64)
    m = line.update(np.array([0, 1_600 * MS]), np.array([10.0, 40.0]), none, np.empty(0), 0, 2 * S)
    assert (m.I, m.I2, m.I_abs) == pytest.approx(integral([(1.5, 10.0), (0.4, 40.0)]))


def test_voltage_and_current_of_the_same_instants_make_the_power() -> None:
    _, m = run(({500: 10.0}, {800: 3.0}), ({200: -20.0, 600: 40.0}, {400: 4.0, 600: 5.0}))
    # the voltage in force at the start of each piece of current
    pieces = [(0.2, 10.0, 3.0), (0.4, -20.0, 3.0), (0.4, 40.0, 5.0)]
    assert pytest.approx(sum(s * v for s, _, v in pieces)) == m.V
    assert pytest.approx(sum(s * a * v for s, a, v in pieces)) == m.IV
    assert pytest.approx(sum(s * a for s, a, _ in pieces)) == m.I


def test_a_voltage_is_held_for_a_second_and_a_half_and_then_unknown() -> None:
    steady = dict.fromkeys(range(0, 1000, 100), 10.0)
    told = run((steady, {600: 3.0}), (steady, {}), (steady, {}), (steady, {650: 4.0}), ({}, {}))
    assert [m.I for m in told[:4]] == pytest.approx([10.0] * 4)
    # from 0.6 s to 2.1 s: 0.4 of the first tick, all of the second, two pieces of the third; then 0.3 of the fourth
    assert [bool(np.isfinite(m.V)) for m in told[:4]] == [False, True, False, False]
    assert pytest.approx((3.0, 30.0)) == (told[1].V, told[1].IV)
    assert np.isfinite(told[4].I_abs)


def test_half_of_a_tick_must_have_a_voltage_too() -> None:
    steady = dict.fromkeys(range(0, 1000, 100), 10.0)
    ((half,), (less,)) = run((steady, {500: 3.0})), run((steady, {501: 3.0}))
    assert pytest.approx((3.0, 30.0, 10.0)) == (half.V, half.IV, half.I)
    assert pytest.approx(10.0) == less.I
    assert np.isnan([less.V, less.IV]).all()


@pytest.mark.parametrize(("late_ns", "known"), [(0, True), (1, False)])
def test_a_voltage_of_a_second_and_a_half_ago_is_the_oldest_that_counts(late_ns: int, known: bool) -> None:
    line, none = Current(), np.empty(0, np.int64)
    line.update(np.array([900 * MS]), np.array([10.0]), np.array([600 * MS]), np.array([3.0]), 0, S)
    line.update(np.array([1_900 * MS]), np.array([10.0]), none, np.empty(0), S, 2 * S)
    m = line.update(np.array([2_100 * MS + late_ns]), np.array([10.0]), none, np.empty(0), 2 * S, 3 * S)
    assert pytest.approx(10.0) == m.I
    assert bool(np.isfinite(m.V)) == known


def test_a_gap_forgets_both() -> None:
    line = Current()
    one, none = np.array([900 * MS]), np.empty(0, np.int64)
    line.update(one, np.array([10.0]), one, np.array([3.0]), 0, S)
    line.forget()
    m = line.update(np.array([S]), np.array([10.0]), none, np.empty(0), S, 2 * S)
    assert (m.I, m.I2) == (10.0, 100.0)
    assert np.isnan(m.V)
