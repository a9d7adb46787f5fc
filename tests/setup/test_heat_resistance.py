"""The resistance by which a current makes heat, from voltage and current; the truth is the heat of a cell by hand."""

import numpy as np
import pytest

from bms_gateway.setup.heat_resistance import heat_resistance
from tests.records.ten_hertz import CAPACITY_AH, means


def cell(share: float, tau: float, seed: int) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Current and voltage of a resistor of 30 mΩ, `share` of it with a capacitor; heat over ∫I², and at once."""
    rng = np.random.default_rng(seed)
    n, R = 18_000, 0.03
    level = np.repeat(rng.choice([0.0, 0.2, 0.5, 1.0, -0.4, 0.3], n // 90 + 1), 90)[:n]
    I = np.convolve(60.0 * level, np.ones(12) / 12, "same")  # noqa: E741
    slow = np.zeros(n)
    for k in range(1, n):
        slow[k] = slow[k - 1] + 0.1 / tau * (share * R * I[k] - slow[k - 1])
    soc = 0.85 - np.cumsum(I) * 0.1 / 3600 / CAPACITY_AH
    V = 3.35 + 0.75 * soc + 0.12 * np.sin(3 * soc) - (1 - share) * R * I - slow + rng.normal(0, 0.002, n)
    heat = (1 - share) * R * I**2 + (slow**2 / (share * R) if share else 0.0)
    return means(I), means(V), float(heat.sum() / (I**2).sum()), (1 - share) * R


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("share", "tau"), [(0.0, 1.0), (0.45, 25.0), (0.3, 60.0), (0.5, 10.0)])
def test_the_resistance_is_that_of_the_heat(share: float, tau: float, seed: int) -> None:
    I, V, truth, _ = cell(share, tau, seed)  # noqa: E741
    assert heat_resistance(I, V, 1.0) == pytest.approx(truth, rel=0.08)


def test_the_steps_alone_would_miss_the_polarisation() -> None:
    I, V, truth, at_once = cell(0.45, 25.0, 1)  # noqa: E741
    assert at_once < 0.8 * truth
    assert heat_resistance(I, V, 1.0) > 0.92 * truth


def test_a_log_that_does_not_show_it_gives_none() -> None:
    I, V, _, _ = cell(0.45, 25.0, 1)  # noqa: E741
    assert heat_resistance(I[:200], V[:200], 1.0) is None
    assert heat_resistance(I, np.full(len(V), np.nan), 1.0) is None
    assert heat_resistance(np.roll(I, 200), V, 1.0) is None
    assert heat_resistance(-I, V, 1.0) is None
    assert heat_resistance(np.zeros(len(I)), V, 1.0) is None
