"""Electrical resistance of each cell by energy balance, against exact arithmetic and known losses."""

from fractions import Fraction

import numpy as np
import pytest

from bms_gateway.identify.electrical import ElectricalSums, PairMeans
from tests.support.cell_resistances import electrical_resistance
from tests.truth.unequal import drives, overpotential


def exact(current, voltage):
    """Least squares of V on 1, Q, I in rational numbers."""
    V = [Fraction(x) for x in voltage]
    rows, q = [], Fraction(0)
    for i in map(Fraction, current):
        rows.append((Fraction(1), q + i / 7200, i))
        q += i / 3600
    G = [[sum(a[r] * a[c] for a in rows) for c in range(3)] for r in range(3)]
    h = [sum(a[r] * v for a, v in zip(rows, V, strict=True)) for r in range(3)]
    for k in range(3):  # Gauss without rounding
        for r in range(k + 1, 3):
            f = G[r][k] / G[k][k]
            G[r] = [a - f * b for a, b in zip(G[r], G[k], strict=True)]
            h[r] -= f * h[k]
    return float(-h[2] / G[2][2])


def test_it_is_the_exact_least_squares_solution() -> None:
    rng = np.random.default_rng(0)
    current = np.round(rng.normal(0, 60, 1200))
    voltage = 3.3 - 2e-3 * np.cumsum(current)[:, None] / 3600 - np.outer(current, [2e-3, 3.1e-3])
    voltage = np.round(voltage + rng.normal(0, 2e-3, voltage.shape), 4)
    got = electrical_resistance(current, voltage)
    assert got.value == pytest.approx([exact(current, voltage[:, k]) for k in range(2)], rel=1e-9)


def test_it_holds_every_time_scale_of_the_loss() -> None:
    """A pulse resistance would be short by the slow share; the energy balance counts all the heat."""
    d = drives([0], minutes=60)
    eta = overpotential(d.current)
    loss = float(np.mean(d.current * eta) / np.mean(d.current**2))
    voltage = 3.3 - np.outer(eta, [2e-3, 4e-3])
    assert electrical_resistance(d.current, voltage).value == pytest.approx(loss * np.array([2e-3, 4e-3]), rel=0.01)


def test_cells_compare_to_a_tenth_of_a_per_cent() -> None:
    d = drives(range(3))
    for i in range(3):
        got = electrical_resistance(d.current, d.voltage(i, 0.03, skew_s=0.0))
        off = np.log(got.value / d.R_el(0.03)[i])
        assert np.std(off) < 1.5e-3
        assert (got.rel_sd < 1.5e-3).all()
        assert abs(off.mean()) < 0.01


def test_a_skew_costs_what_it_says() -> None:
    d = drives([1])
    aligned, skewed = (3.3 - np.outer(x, [3e-3]) for x in (d.current, np.append(0.0, d.current[:-1])))
    honest = electrical_resistance(d.current, aligned)
    late = electrical_resistance(d.current, skewed)
    assert 1.0 - late.value / honest.value == pytest.approx(honest.skew_share, rel=0.1)
    assert "sample both within" in honest.warning(1.0, 0.03)
    assert honest.warning(0.1, 0.03) == ""


def test_a_cell_without_samples_has_no_resistance_and_one_with_some_does() -> None:
    current = np.tile([60.0, 60.0, -60.0, -60.0], 400)
    voltage = 3.3 - np.outer(current, [2e-3, 2e-3, 2e-3])
    voltage[:, 1] = np.nan
    voltage[::3, 2] = np.nan
    got = electrical_resistance(current, voltage)
    assert np.isnan(got.value).tolist() == [False, True, False]
    assert got.value[[0, 2]] == pytest.approx([2e-3, 2e-3])
    assert np.isnan(got.rel_sd[1])


@pytest.mark.parametrize("current", [np.zeros(1800), np.full(1800, 50.0), np.tile([60.0, -60.0], 300)])
def test_too_little_says_nothing(current) -> None:
    """Standing still, discharging at one current, or ten minutes only."""
    got = electrical_resistance(current, 3.3 - np.outer(current, [2e-3, 3e-3]))
    assert not got.known


def test_samples_that_always_fall_on_the_same_part_of_a_cycle_say_nothing() -> None:
    """Every second one of these: charge and current are then one straight line, and which it was cannot be told."""
    current = np.tile([60.0, 60.0, -60.0, -60.0], 400)
    voltage = 3.3 - np.outer(current, [2e-3])
    voltage[::2] = np.nan
    assert not electrical_resistance(current, voltage).known


def test_means_within_a_tick_count() -> None:
    """A current that swings within the tick: mean(I V) and mean(I^2) hold what the means of I and V lose."""
    sums = ElectricalSums(1)
    rng = np.random.default_rng(2)
    for _ in range(1500):
        i = rng.normal(0, 50, 10)
        v = 3.4 - 2.5e-3 * i
        one = [np.array([np.mean(x)]) for x in (i, i * i, v, i * v)]
        sums.update(PairMeans(*one), float(np.mean(i)), 1.0)
    assert sums.result().value == pytest.approx([2.5e-3], rel=1e-9)
