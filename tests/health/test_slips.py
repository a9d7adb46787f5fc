"""A thermocouple that leaves a cell while it heats, and heat that was there when the gateway started."""

import numpy as np
import pytest

from bms_gateway.health.heat import HeatWatch
from bms_gateway.health.heat.heat_tick import HeatTick
from tests.benchmarks.heat_case import SENSORS, Case, Made, make, model

CELL = 6
PLACE = SENSORS.index(CELL)


def alerts(made: Made, y: np.ndarray) -> tuple[HeatWatch, list[tuple[int, str, int | None, int]]]:
    """Watch a string whose thermocouples read y (K, n): (s, code, cell, level) as reported."""
    c = made.case
    watch, told = HeatWatch([model(c.pack)], 1.0), []
    for k in range(c.seconds):
        I, inlet = made.current[k : k + 1], made.inlet[k : k + 1]  # noqa: E741
        for _, f in watch.add((k + 1) * 10**9, HeatTick(I**2, I, inlet, y[k][None, :], np.zeros((1, c.cells)))) or ():
            told.append((k + 1, f.code, f.cell, f.level))
    return watch, told


def slipping(made: Made, at: int, slowly_s: float) -> np.ndarray:
    """Readings of which those of one cell go over to the inlet's temperature from `at` on."""
    y = made.y.copy()
    left = 1.0 - np.exp(-np.maximum(np.arange(len(y)) - at, 0) / slowly_s)
    y[:, CELL - 1] += left * (made.inlet - y[:, CELL - 1])
    return y


@pytest.mark.parametrize(
    ("pack", "watts", "slowly_s"),
    [("liquid", 30.0, 150.0), pytest.param("liquid", 30.0, 20.0, marks=pytest.mark.slow), ("small", 3.0, 60.0)],
)
def test_a_thermocouple_that_leaves_its_cell_ends_no_heat(pack: str, watts: float, slowly_s: float) -> None:
    (made,) = make([Case(pack, 11, 5400, "urban", "heat", CELL, watts, at=2400)])
    watch, told = alerts(made, slipping(made, 3000, slowly_s))
    heat = [(t, level) for t, code, _, level in told if code == "unexplained_heat"]
    assert heat
    assert 2400 < heat[0][0] < 3000
    assert all(level for _, level in heat), "the alarm is over while the cell heats"
    assert any(code == "thermocouple" and cell == CELL and t > 3000 for t, code, cell, _ in told)
    core, sd = (x[0, CELL - 1] for x in watch.cores(np.full((1, 12), np.nan), np.zeros((1, 12))))
    assert sd > 8.0, "nothing shows this core"
    assert core + 2.0 * sd > made.core[-1, CELL - 1]
    heard = [x for x in told if x[1] in ("missing_heat", "cooling")]
    assert not heard, "what one thermocouple does is no fault of the current or of the coolant"


@pytest.mark.parametrize("pack", ["small", "liquid"])
def test_heat_that_ends_is_no_thermocouple_that_left(pack: str) -> None:
    watts = {"small": 3.0, "liquid": 30.0}[pack]
    (made,) = make([Case(pack, 12, 6000, "urban", "heat", CELL, watts, at=2400, lasts=1200)])
    _, told = alerts(made, made.y)
    heat = [(t, level) for t, code, _, level in told if code == "unexplained_heat"]
    assert heat[-1][1] == 0
    assert heat[-1][0] > 3600
    assert not any(code == "thermocouple" for _, code, _, _ in told)


def test_heat_that_was_there_at_the_start_is_reported_and_stays() -> None:
    cases = [Case("small", seed, 3600, "urban", "heat", CELL, 3.0, at=30) for seed in (21, 22, 23)]
    for made in make(cases):
        watch, told = alerts(made, made.y)
        heat = [(t, level) for t, code, _, level in told if code == "unexplained_heat"]
        assert heat
        assert heat[0][0] < 600
        assert all(level for _, level in heat)
        core, sd = (x[0, CELL - 1] for x in watch.cores(np.full((1, 12), np.nan), np.zeros((1, 12))))
        assert abs(core - made.core[-1, CELL - 1]) < 2.5 * sd
