"""Steps that a bus rounds temperatures to, against the greatest common divisor of whole numbers."""

from math import gcd

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bms_gateway.health.heat.thermocouples import SAME, Thermocouples, finer


@example(7713, 0.01, 3.0)  # Euclid's errors grew until a step of 0.002 was found
@example(332, 0.01, 3.0)
@given(st.integers(0, 10_000), st.sampled_from([0.01, 0.1, 0.25, 0.5, 1.0]), st.sampled_from([0.02, 0.3, 3.0]))
def test_steps_are_what_all_readings_that_were_asked_about_have_in_common(seed, step, noise) -> None:
    rng = np.random.default_rng(seed)
    counts = np.abs(np.round(rng.normal(20.0, noise, (30, 6)) / step)).astype(int)
    counts[rng.uniform(size=counts.shape) < 0.02] = 0
    missing = rng.uniform(size=counts.shape) < 0.1
    found, truth = np.full(6, np.inf), [0] * 6
    for now, gone in zip(counts, missing, strict=True):
        asked = rng.uniform(size=6) < 0.7
        found = finer(found, np.where(gone, np.nan, step * now), asked)
        truth = [gcd(t, int(k)) if a and not g else t for t, k, a, g in zip(truth, now, asked, gone, strict=True)]
        for f, t in zip(found, truth, strict=True):
            assert not t or f == pytest.approx(step * t, abs=SAME / 100.0)


def test_the_step_of_a_bus_is_found_from_noisy_readings() -> None:
    rng = np.random.default_rng(1)
    thermocouples = Thermocouples(2, 3)
    for _ in range(5):
        y = np.round(rng.normal(25.0, 0.3, (10, 2, 3)) / 0.1) * 0.1
        thermocouples.take(y)
    assert np.allclose(thermocouples.step, 0.1)


@pytest.mark.parametrize("step", [0.5, 1.0])
@pytest.mark.parametrize("rate", [0.2, 1.0, 2.0])
def test_means_over_a_second_of_a_coarse_reading_do_not_make_it_fine(step, rate) -> None:
    """A log that was resampled from ten readings a second to one has the mean of both where a reading changed."""
    rng = np.random.default_rng(2)
    time_s = np.arange(6000) / 10.0
    true = 20.0 + rng.uniform(0.0, step, 3) + rate * time_s[:, None] / 60.0
    y = (np.floor(true / step) * step).reshape(-1, 10, 3).mean(axis=1)
    assert (np.abs(y / step - np.rint(y / step)) > SAME).sum() > 2
    thermocouples, moved = Thermocouples(1, 3), np.zeros(3, bool)
    for k in range(1, len(y)):
        thermocouples.take(y[k, None, None])
        moved |= np.abs(y[k] - y[k - 1]) > SAME
        assert k < 30 or (thermocouples.step[0, moved] > step - SAME).all()
    assert np.allclose(thermocouples.step[0, np.ptp(y, axis=0) > 3.0 * step], step)
    kept = Thermocouples(1, 3)
    kept.restore(thermocouples.snapshot())
    assert (kept.step[0, moved] > step - SAME).all()


def test_a_fine_reading_that_is_held_for_seconds_stays_fine() -> None:
    rng = np.random.default_rng(3)
    y = np.repeat(np.round(rng.normal(25.0, 0.05, (40, 1, 3)) / 0.01) * 0.01, 8, axis=0)
    thermocouples = Thermocouples(1, 3)
    thermocouples.take(y)
    assert (thermocouples.step < 0.05).all()
