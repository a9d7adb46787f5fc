"""Means over intervals are exact: against fine sums of the same function, which know nothing of pieces."""

import numpy as np
import pytest

from bms_gateway.diagnosis.means import mean, mean_magnitude, mean_product, path

FINE = 20_000


@pytest.fixture
def rows():
    rng = np.random.default_rng(8)
    t = np.cumsum(rng.uniform(0.05, 1.7, 80))
    return t, rng.normal(0, 50, 80), rng.normal(3.3, 0.2, 80), rng.random(79) < 0.3


def value(t, x, straight, half_way, at):
    """The function itself, row by row."""
    k = np.clip(np.searchsorted(t, at, "right") - 1, 0, len(t) - 1)
    n = np.minimum(k + 1, len(t) - 1)
    w = np.clip((at - t[k]) / np.where(n > k, t[n] - t[k], 1), 0, 1)
    step = np.where(half_way & (w >= 0.5), x[n], x[k])
    return np.where(straight[np.minimum(k, len(t) - 2)], (1 - w) * x[k] + w * x[n], step)


@pytest.mark.parametrize("half_way", [False, True])
def test_means_squares_magnitudes_and_products(rows, half_way):
    t, x, v, straight = rows
    instants = np.linspace(t[0], t[-1], 23)
    p, q = path(t, x, straight, half_way=half_way), path(t, v, True)
    fine = instants[:-1, None] + np.diff(instants)[:, None] * (np.arange(FINE) + 0.5) / FINE
    f = value(t, x, straight, half_way, fine)
    g = np.interp(fine, t, v)
    tolerance = 3 * np.abs(np.diff(x)).max() / FINE * 3
    assert mean(instants, p) == pytest.approx(f.mean(axis=1), abs=tolerance)
    assert mean_magnitude(instants, p) == pytest.approx(np.abs(f).mean(axis=1), abs=tolerance)
    assert mean_product(instants, p, p) == pytest.approx((f**2).mean(axis=1), abs=300 * tolerance)
    assert mean_product(instants, p, q) == pytest.approx((f * g).mean(axis=1), abs=5 * tolerance)


def test_ten_held_rows_a_second_give_the_mean_square_exactly():
    rng = np.random.default_rng(1)
    t, x = np.arange(601) / 10, rng.normal(0, 80, 601)
    p = path(t, x, False)
    assert mean_product(np.arange(61.0), p, p) == pytest.approx((x[:600] ** 2).reshape(60, 10).mean(axis=1), rel=1e-12)


def test_the_square_of_the_mean_is_never_more_than_the_mean_square(rows):
    t, x, _, straight = rows
    p = path(t, x, straight)
    instants = np.linspace(t[0], t[-1], 40)
    assert (mean_product(instants, p, p) >= mean(instants, p) ** 2 - 1e-9).all()


def test_before_the_first_row_and_after_the_last_the_value_stays():
    p = path(np.array([10.0, 11.0]), np.array([3.0, 5.0]), True)
    assert mean(np.array([0.0, 5.0, 10.0, 11.0, 20.0]), p).tolist() == [3.0, 3.0, 4.0, 5.0]
