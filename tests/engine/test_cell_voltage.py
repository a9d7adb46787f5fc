"""Voltages and currents of the same instants, against a search sample by sample."""

import numpy as np
import pytest

from bms_gateway.engine.cell_voltage import CellVoltages
from bms_gateway.engine.current import HOLD_S

S = 1_000_000_000
WIRES = [(0, np.array([2, 3, -1])), (1, np.array([4, 5, 6])), (0, np.array([7, -1, -1])), (-1, np.array([3, -1, -1]))]
INPUTS = 8


def tick(rng, t0):
    """Samples of all inputs in [t0, t0 + 1 s), sorted by input, each in order; any may have none."""
    runs = [np.sort(rng.integers(t0, t0 + S, rng.integers(0, 6))) for _ in range(INPUTS)]
    time = np.concatenate(runs).astype(np.int64)
    edge = np.concatenate([[0], np.cumsum([len(r) for r in runs])]).astype(np.intp)
    return time, rng.normal(0, 50, len(time)), edge


def by_hand(samples, current, cell):
    """Means of (I, I^2, V, I V) over the cell's newest tick; `samples` holds every tick so far."""
    pairs = []
    time, value, edge = samples[-1]
    for t, v in zip(time[edge[cell] : edge[cell + 1]], value[edge[cell] : edge[cell + 1]], strict=True):
        before = [
            (at, amp)
            for time_, value_, edge_ in samples
            for at, amp in zip(
                time_[edge_[current] : edge_[current + 1]], value_[edge_[current] : edge_[current + 1]], strict=True
            )
            if at <= t
        ]
        if before and t - before[-1][0] <= HOLD_S * 1e9:
            amp = before[-1][1]
            pairs.append((amp, amp * amp, v, amp * v))
    return np.mean(pairs, axis=0) if pairs else np.full(4, np.nan)


@pytest.mark.parametrize("seed", range(5))
def test_every_voltage_meets_the_newest_current_at_its_instant(seed) -> None:
    rng = np.random.default_rng(seed)
    pairing, seen = CellVoltages(WIRES), []
    assert pairing.inputs == [2, 3, 4, 5, 6, 7]
    for k in range(12):
        time, value, edge = tick(rng, k * S)
        seen.append((time, value, edge))
        currents = {i: (time[edge[i] : edge[i + 1]], value[edge[i] : edge[i + 1]]) for i in (0, 1)}
        got = pairing.update(time, value, edge, currents)
        for (current, cells), means in zip(WIRES, got, strict=True):
            for j, cell in enumerate(cells):
                expected = by_hand(seen, current, cell) if current >= 0 and cell >= 0 else np.full(4, np.nan)
                if means is None:
                    assert np.isnan(expected).all()
                else:
                    found = [means.I[j], means.I2[j], means.V[j], means.IV[j]]
                    assert found == pytest.approx(expected, nan_ok=True)


def test_after_a_gap_no_current_is_held() -> None:
    pairing = CellVoltages([(0, np.array([1]))])
    nothing = np.empty(0, np.int64), np.empty(0)
    pairing.update(
        np.array([5], np.int64), np.array([50.0]), np.array([0, 1, 1]), {0: (np.array([5]), np.array([50.0]))}
    )
    one = np.array([10], np.int64), np.array([3.3]), np.array([0, 0, 1])
    assert pytest.approx([50.0]) == pairing.update(*one, {0: nothing})[0].I
    pairing.forget()
    assert pairing.update(*one, {0: nothing}) == [None]
