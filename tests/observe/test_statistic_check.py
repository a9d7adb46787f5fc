"""Readings of some cell among several, judged by signal."""

import json

import numpy as np
import pytest

from bms_gateway.observe import AdaptiveObserver
from bms_gateway.observe.statistic_check import StatisticSurprise
from tests.benchmarks.heat_case import model

CELLS = 4
NOISE = 0.1


def check() -> StatisticSurprise:
    return StatisticSurprise([model("liquid", CELLS, (1, 2, 3, 4)).nominal], np.arange(CELLS)[None], 1.0, NOISE)


def told(of: StatisticSurprise, cell: int, said: float, innovation: float) -> np.ndarray | None:
    """Let a greatest reading be that of `cell`; what it makes of the cores, K²."""
    source, at = np.zeros((1, CELLS), np.int8), np.full((1, CELLS), np.nan)
    source[0, cell], at[0, cell] = 1, said
    of.assign(source, at)
    value = np.where(source == 1, innovation, np.nan)
    sd = np.where(source == 1, 0.15, np.nan)
    return of.step(at, value, sd, sd, np.ones((1, 2), np.bool_), np.array([25.0]))


def test_what_is_odd_belongs_to_the_cell_that_the_reading_is_taken_for() -> None:
    of, rng = check(), np.random.default_rng(1)
    for k in range(200):
        noise = float(rng.normal(0.0, NOISE))
        assert told(of, k % CELLS, 30.0 + noise, noise) is None
    grown = [told(of, 2, 30.0 + k, 1.0) for k in range(20)][-1]
    assert grown is not None
    assert grown.shape == (1, CELLS)
    assert grown[0, 2] > 0.0
    assert (grown[0, [0, 1, 3]] == 0.0).all()


def test_its_steps_are_known_wherever_it_is() -> None:
    of = check()
    for k in range(100):
        assert told(of, k % CELLS, 30.0 + k // 10 % 2, 0.3 * np.sin(k)) is None
    assert of.rounded(np.full((1, CELLS), 0.15))[0, 99 % CELLS] == pytest.approx(np.hypot(0.15, 1.0 / np.sqrt(12.0)))


def test_a_restart_changes_nothing() -> None:
    first, rng = check(), np.random.default_rng(2)
    for k in range(100):
        told(first, k % CELLS, 30.0, float(rng.normal(0.0, NOISE)))
    second = check().restored(json.loads(json.dumps(first.snapshot())))
    for k in range(100):
        x = float(rng.normal(0.0, NOISE)) + (k > 50)
        one, other = (told(of, k % CELLS, 30.0 + x, x) for of in (first, second))
        assert (one is None) == (other is None)
        assert one is None or (one == other).all()


def test_a_state_that_was_judged_by_cell_is_taken_up() -> None:
    """The rest of such a state is as good as ever; what its readings were like is learnt anew."""
    strings = [model("liquid", CELLS, (1, 2, 3, 4))]
    of_cells, of_signals = AdaptiveObserver(strings, 1.0), AdaptiveObserver(strings, 1.0, several=True)
    y = np.array([[30.0, np.nan, np.nan, np.nan]])
    for _ in range(30):
        of_cells.step(np.array([900.0]), None, np.array([25.0]), y, np.zeros((1, CELLS)))
    of_signals.restore(json.loads(json.dumps(of_cells.snapshot())))
    assert of_signals.estimate().core == pytest.approx(of_cells.estimate().core)
