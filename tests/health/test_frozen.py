"""A thermocouple that freezes is not taken for heat of its cell, is reported, and is used again once it moves."""

import numpy as np
import pytest

from bms_gateway.health.heat.thermocouples import Thermocouples
from tests.benchmarks.bench_heat import follow
from tests.benchmarks.heat_case import Case, make, with_seeds

AT, LASTS = 3600, 900
SEEDS = range(4000, 4012)


@pytest.mark.parametrize("pack", ["small", "liquid", pytest.param("forced", marks=pytest.mark.slow)])
@pytest.mark.parametrize("drive", ["urban", pytest.param("us06", marks=pytest.mark.slow)])
def test_one_that_freezes_is_hardly_ever_called_heat(pack: str, drive: str) -> None:
    """Of these 72 strings, 42 had an alarm of heat."""
    frozen = Case(pack, 0, 6000, drive, "held", at=AT, lasts=LASTS)
    told = follow(make(with_seeds(frozen, SEEDS)))
    after = [[a for a in x.alerts if a[0] > AT] for x in told]
    assert sum(any(code == "unexplained_heat" for _, code, _ in x) for x in after) <= 1
    assert not any(code in ("cooling", "missing_heat", "inlet") for x in after for _, code, _ in x)
    assert {cell for x in after for _, code, cell in x if code == "thermocouple"} == {6}
    assert sum(any(code == "thermocouple" for _, code, _ in x) for x in after) >= 6


def ticks(y: np.ndarray) -> Thermocouples:
    """Give readings (K, 3) to three thermocouples of a string, ten ticks at a time."""
    sensors = Thermocouples(1, 3)
    for some in y.reshape(-1, 10, 1, 3):
        sensors.take(some)
    return sensors


@pytest.mark.parametrize("noise", [0.01, 0.05, 0.2])
def test_only_one_that_stands_longer_than_it_ever_did_is_unusually_still(noise: float) -> None:
    rng, t = np.random.default_rng(3), np.arange(3000)
    y = np.round((30.0 + 0.004 * t[:, None] + noise * rng.standard_normal((3000, 3))) / 0.1) * 0.1
    assert not ticks(y).still.any()
    y[-300:, 1] = y[-301, 1]
    still = ticks(y).still[0]
    assert still[1] == pytest.approx(300, abs=30)
    assert still[[0, 2]].tolist() == [0.0, 0.0]


def test_one_that_often_stands_for_minutes_is_not_unusually_still_after_four() -> None:
    y = np.round(0.1 + 30.0 + np.arange(3000)[:, None] // 120 * 0.5 + np.zeros((3000, 3)), 1)
    y[-120:, 1] = y[-121, 1]
    assert not ticks(y).still.any()
