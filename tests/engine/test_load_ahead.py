"""What the load of the time ahead is taken for, and how far off such guesses are said to be."""

import numpy as np
import pytest

from bms_gateway.engine.load_ahead import Load
from bms_gateway.observe.ahead import HORIZONS_S


def step(load: Load, current: np.ndarray, inlet: float = 25.0, heat: np.ndarray | None = None) -> None:
    """One step of ten seconds of one string."""
    I = np.asarray(current, float)[:, None]  # noqa: E741
    nan = np.full_like(I, np.nan)
    means = np.stack((I, I**2, nan, nan, np.abs(I)), axis=1)
    load.take(means, np.array([inlet]), () if heat is None else [np.array([h]) for h in heat])


def test_a_steady_current_counts_after_twenty_seconds_and_a_restless_one_by_its_mean() -> None:
    load, rng = Load(1), np.random.default_rng(0)
    squares = []
    for _ in range(60):
        I = rng.choice([0.0, 100.0], 10)  # noqa: E741
        squares.append(np.mean(I**2))
        step(load, I)
    assert not load.steady[0]
    assert load.square[0] == pytest.approx(np.mean(squares[-20:]), rel=0.25)
    for _ in range(2):
        step(load, np.full(10, -60.0))
    assert load.steady[0]
    assert load.square[0] == pytest.approx(3600.0)
    assert load.current[0] == pytest.approx(-60.0)
    step(load, np.full(10, np.nan))  # the ammeter is lost: the load of before goes on, and nobody calls it steady
    assert not load.steady[0]
    assert np.isfinite(load.square[0])


def test_the_error_that_is_told_is_that_of_the_guesses() -> None:
    load, rng = Load(1), np.random.default_rng(1)
    levels = np.repeat(rng.choice([0.0, 2000.0, 8000.0], 400), 2)  # A² of each ten seconds
    guesses = []
    for u in levels:
        step(load, np.full(10, np.sqrt(u)) * (1.0 + 0.3 * rng.uniform(-1, 1, 10)), inlet=25.0 + rng.normal(0, 0.3))
        guesses.append(load.square[0])
    told, inlet = load.square_sd()[:, 0], load.inlet_sd()[:, 0]
    for h, seconds in enumerate(HORIZONS_S):
        k = round(seconds / 10)
        came = np.convolve(levels, np.ones(k) / k, "valid")  # mean of levels i to i + k - 1
        error = came[1:] * 1.03 - np.array(guesses)[: len(came) - 1]
        assert told[h] == pytest.approx(np.sqrt(np.mean(error[-360:] ** 2)), rel=0.25)
    assert inlet == pytest.approx(np.full(4, 0.3 * np.sqrt(2)), rel=0.2)


def test_a_long_steady_charge_earns_a_narrow_band_and_the_first_minutes_have_that_of_drives() -> None:
    load = Load(1)
    for _ in range(3):
        step(load, np.full(10, 50.0))
    assert load.square_sd()[-1, 0] == pytest.approx(2500.0, rel=0.1)
    for _ in range(720):
        step(load, np.full(10, 50.0))
    assert (load.square_sd()[:, 0] < 400.0).all()


def test_heat_per_square_is_that_of_the_voltage_and_a_snapshot_goes_on() -> None:
    load = Load(1)
    assert np.isnan(load.heat_per_square[0])
    for _ in range(30):
        step(load, np.full(10, 50.0), heat=np.full(10, 10.0))
    assert load.heat_per_square[0] == pytest.approx(10.0 / 2500.0)
    other = Load(1)
    other.restore(load.snapshot())
    assert np.array_equal(load.inlet_sd(), other.inlet_sd())
    for a in (load, other):
        step(a, np.full(10, 50.0), heat=np.full(10, 10.0))
    assert other.heat_per_square[0] == load.heat_per_square[0]
    spoilt = load.snapshot() | {"weight": [1.0, None, 1.0, 1.0]}
    with pytest.raises((ValueError, TypeError)):
        Load(1).restore(spoilt)
