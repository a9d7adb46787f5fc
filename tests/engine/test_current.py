"""Means over a tick against an integral on a fine grid."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.engine.current import HOLD_S, Current

S = 1_000_000_000
NONE = np.empty(0, np.int64)
NO_V = np.empty(0)


def fine(times: np.ndarray, values: np.ndarray, t0: int, t1: int) -> np.ndarray:
    """Value in force on a 0.1 ms grid of the tick, NaN where the newest sample is older than the hold."""
    grid = np.arange(t0, t1, 100_000) + 50_000
    at = np.searchsorted(times, grid, side="right") - 1
    value = np.where(at >= 0, values[np.maximum(at, 0)], np.nan)
    return np.where((at >= 0) & (grid - times[np.maximum(at, 0)] <= HOLD_S * S), value, np.nan)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 29_999), st.floats(-200, 200)), min_size=1, max_size=40), st.integers(0, 99))
def test_the_means_are_those_of_the_held_samples(points: list[tuple[int, float]], seed: int) -> None:
    unique = dict(points)
    times = np.array(sorted(unique), np.int64) * 100_000  # on the fine grid's edges, over 3 s
    I = np.array([unique[k] for k in sorted(unique)])  # noqa: E741
    V = 3.3 + np.random.default_rng(seed).normal(0, 0.1, len(I))
    line = Current()
    for t0 in range(0, 3 * S, S):
        now = (times >= t0) & (times < t0 + S)
        m = line.update(times[now], I[now], times[now], V[now], t0, t0 + S)
        want_I, want_V = fine(times, I, t0, t0 + S), fine(times, V, t0, t0 + S)
        share = np.isfinite(want_I).mean()
        if abs(share - 0.5) < 1e-3:
            continue
        if share < 0.5:
            assert np.isnan(m.I2)
        else:
            assert pytest.approx(np.nanmean(want_I), abs=1e-6) == m.I
            assert pytest.approx(np.nanmean(want_I**2), abs=1e-6) == m.I2
            assert pytest.approx(np.nanmean(want_I * want_V), abs=1e-6) == m.IV


def test_a_current_that_stops_becomes_unknown() -> None:
    line = Current()
    line.update(np.array([S // 2]), np.array([100.0]), NONE, NO_V, 0, S)
    assert pytest.approx(1e4) == line.update(NONE, NO_V, NONE, NO_V, S, 2 * S).I2
    assert np.isnan(line.update(NONE, NO_V, NONE, NO_V, 2 * S, 3 * S).I2)


def test_after_a_gap_the_old_sample_is_forgotten() -> None:
    line = Current()
    line.update(np.array([S - 1]), np.array([100.0]), NONE, NO_V, 0, S)
    line.forget()
    assert np.isnan(line.update(NONE, NO_V, NONE, NO_V, S, 2 * S).I2)
