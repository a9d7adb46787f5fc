"""Heat from voltage: the energy balance of an equivalent circuit that the tracker knows nothing of."""

import numpy as np
import pytest

from bms_gateway.identify import VoltageTracker
from tests.truth.cycle import repeated


def circuit(minutes, seed=1, R=0.012, R1=0.004, tau=20.0, slope=0.05, U0=3.3, sub=10, mean=0.0):
    """Per second: mean I, V, I·V, and the true mean heat, of a cell with one RC pair and a sloping U(Q)."""
    current = repeated(minutes, seed) * 0.1 + mean
    V1 = Q = 0.0
    h = 1 / sub
    out = []
    for amps in current:
        V_sum = heat = 0.0
        for _ in range(sub):
            V1 += h / tau * (R1 * amps - V1)
            Q += amps * h / 3600
            V = U0 - slope * Q - R * amps - V1
            V_sum += V / sub
            heat += amps * (R * amps + V1) / sub
        out.append((amps, V_sum, amps * V_sum, heat))
    return np.array(out)


def test_heat_agrees_with_the_circuits_overpotential():
    rows = circuit(60)
    tracker = VoltageTracker(capacity=2.5)
    got = [tracker.update(*row[:3], 1.0) for row in rows]
    heat = np.array([g.heat for g in got])
    late = slice(600, None)
    assert np.isnan(heat[:60]).all()
    assert heat[late].sum() == pytest.approx(rows[late, 3].sum(), rel=0.02)
    error = heat[late] - rows[late, 3]
    assert np.mean(np.abs(error) <= 2 * np.array([g.heat_sd for g in got])[late] + 1e-9) > 0.9
    assert got[-1].resistance == pytest.approx(0.016, rel=0.1)


def test_a_gap_forgets_and_missing_values_teach_nothing():
    rows = circuit(10)
    tracker = VoltageTracker()
    for row in rows:
        last = tracker.update(*row[:3], 1.0)
    before = last.open_circuit
    hole = tracker.update(np.nan, 3.3, np.nan, 1.0)
    assert np.isnan(hole.heat)
    assert hole.open_circuit == pytest.approx(before, abs=1e-3)
    assert np.isnan(tracker.update(1.0, 3.3, 3.3, 3600.0).heat)


@pytest.mark.parametrize("tau", [15.0, 25.0, 40.0])
def test_heat_of_polarisation_is_there_while_the_mean_current_discharges(tau):
    """Nearly half of the resistance polarises, and U must not follow what the mean current makes of it."""
    rows = circuit(40, R=0.0088, R1=0.0072, tau=tau, mean=5.0)
    tracker = VoltageTracker(capacity=2.5)
    got = [tracker.update(*row[:3], 1.0) for row in rows]
    late = slice(600, None)
    assert np.array([g.heat for g in got])[late].sum() == pytest.approx(rows[late, 3].sum(), rel=0.08)
    assert got[-1].resistance == pytest.approx(0.016, rel=0.15)


def test_it_is_least_squares_with_a_wandering_truth_to_twelve_digits():
    """Oracle: the update in matrices, straight from the text book, and the mean of a lag over a tick."""
    cells, capacity, rows = 12, 8.0, circuit(30)
    tracker = VoltageTracker(capacity, cells)
    walk = np.array([0.02 * cells / 2, 0.5 * cells / capacity / 20, 1e-3 * cells, 1e-3 * cells]) ** 2 / 600.0
    theta = np.array([cells * rows[0, 1], 0.0, 0.0, 0.0])
    P = np.diag([0.3 * cells, 0.5 * cells / capacity, 0.1 * cells, 0.1 * cells]) ** 2
    charge, lag, within = np.cumsum(rows[:, 0]) / 3600.0, 0.0, (np.arange(10_000) + 0.5) / 10_000.0
    for (amps, volts, watts, _), Q in zip(rows, charge, strict=True):
        lagged = amps + (lag - amps) * np.exp(-within / 25.0).mean()
        lag = amps + (lag - amps) * np.exp(-1.0 / 25.0)
        phi = np.array([1.0, amps / 7200.0 - Q, -amps, -lagged])
        P = P + np.diag(walk)
        K = P @ phi / (phi @ P @ phi + (0.02 * cells) ** 2 * 5.0)
        theta = theta + K * (cells * volts - phi @ theta)
        P = (np.eye(4) - np.outer(K, phi)) @ P
        got = tracker.update(amps, cells * volts, cells * watts, 1.0)
    at, both = np.array([1.0, amps / 7200.0 - Q, 0.0, 0.0]), np.array([0.0, 0.0, 1.0, 1.0])
    assert got.open_circuit == pytest.approx(at @ theta, rel=1e-10)  # the heat of a tick belongs to its middle
    assert got.open_circuit_sd == pytest.approx(np.sqrt(at @ P @ at), rel=1e-9)
    assert got.resistance == pytest.approx(both @ theta, rel=1e-9)
    assert got.resistance_sd == pytest.approx(np.sqrt(both @ P @ both), rel=1e-9)
    assert got.heat == pytest.approx(at @ theta * amps - cells * watts, rel=1e-9)
