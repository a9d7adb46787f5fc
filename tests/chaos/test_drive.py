"""What the broken sensors of the bench show."""

import numpy as np
import pytest

from bms_gateway.chaos.sensors import Frozen, Slow
from bms_gateway.chaos.simulated_pack import Change, Sensed

T = np.arange(0.0, 300.0)
BROKEN = (T >= 90.0) & (T < 200.0)


def shown(change: Change, noise: float = 0.0, at_once: int = 300) -> np.ndarray:
    """A surface that warms by 0.05 K/s, as its sensor shows it: broken from 90 to 200 s, so many seconds at once."""
    rng = np.random.default_rng(1)
    series = Sensed(T, 20.0 + 0.05 * T, noise=noise, rng=rng, change=change, start_s=90.0, end_s=200.0)
    return np.concatenate([series.at(T[k : k + at_once]) for k in range(0, 300, at_once)])


@pytest.mark.parametrize("at_once", [300, 50])
def test_a_frozen_sensor_keeps_its_reading_of_when_it_froze_not_of_the_start(at_once: int) -> None:
    read = shown(Frozen(), noise=0.1, at_once=at_once)
    assert (read[BROKEN] == read[90]).all()
    assert read[90] == pytest.approx(20.0 + 0.05 * 90.0, abs=0.5)
    assert np.abs(read - 20.0 - 0.05 * T)[~BROKEN].max() < 0.5


def test_a_slow_sensor_begins_to_lag_where_it_comes_off() -> None:
    read = shown(Slow())
    assert read[90] == pytest.approx(24.5)
    lag = 0.05 * 90.0 * -np.expm1(-(T[BROKEN] - 90.0) / 90.0)  # of a first-order sensor behind a ramp
    assert read[BROKEN] == pytest.approx((20.0 + 0.05 * T)[BROKEN] - lag, abs=0.06)
    assert read[~BROKEN] == pytest.approx((20.0 + 0.05 * T)[~BROKEN])
