"""Heat that is little above what thermocouples err by: told, told apart from their drift, and worth what it is."""

import numpy as np
import pytest

from bms_gateway.health.heat.thermocouples import Thermocouples
from tests.benchmarks.heat_case import Case
from tests.health.heat_runs import raised

VAR, DRIVEN, REST = np.full((1, 3), 1e-3), np.zeros(1, np.bool_), np.ones(1, np.bool_)
SOUND = np.ones((1, 3), np.bool_)


def stated(t: Thermocouples) -> float:
    """Variance that a mean of ten even readings is stated to have, K²."""
    return float(t.take(np.full((10, 1, 3), 25.0))[1].mean())


def test_means_of_readings_become_surer_only_by_hours_of_innovations_that_are_smaller_than_stated() -> None:
    rng, t = np.random.default_rng(1), Thermocouples(1, 3)
    first = stated(t)
    few = [stated(t) for _ in range(6) if t.learn(rng.normal(0.0, 0.01, (1, 3)), VAR, SOUND, DRIVEN, 10.0) is None]
    assert min(few) > 0.95 * first  # a minute of them says little
    for _ in range(720):
        t.learn(rng.normal(0.0, 0.01, (1, 3)), VAR, SOUND, DRIVEN, 10.0)
    assert 0.2 * first < stated(t) < 0.5 * first
    again = Thermocouples(1, 3)
    again.restore(t.snapshot())
    assert stated(again) == pytest.approx(stated(t))
    t.learn(np.zeros((1, 3)), VAR, SOUND, REST, 10.0)
    assert stated(t) > 0.95 * first  # at rest nothing has been learnt
    for _ in range(120):
        again.learn(rng.normal(0.0, 0.08, (1, 3)), VAR, SOUND, DRIVEN, 10.0)
    assert stated(again) > 0.95 * first  # larger ones are believed within minutes


@pytest.mark.parametrize("what", ["suspected", "as stated", "lasting"])
def test_means_of_readings_do_not_become_surer_by(what: str) -> None:
    rng, t = np.random.default_rng(2), Thermocouples(1, 3)
    first, sound, off = stated(t), SOUND if what != "suspected" else ~SOUND, np.zeros((1, 3))
    for k in range(2000):
        if what != "lasting" or k % 60 == 0:  # each small, but with one sign for ten minutes
            off = rng.normal(0.0, {"suspected": 0.01, "as stated": 0.035, "lasting": 0.012}[what], (1, 3))
        t.learn(off, VAR, sound, DRIVEN, 10.0)
    assert stated(t) > 0.7 * first


@pytest.mark.slow
@pytest.mark.parametrize(("cell", "watts"), [(6, 1.0), (7, 10.0)])
def test_little_heat_in_liquid_cooled_cells_is_told_while_driving(cell: int, watts: float) -> None:
    # Bug: readings counted for a quarter of what they say, and heat that was alone and steady became usual.
    found = raised(Case("liquid", 0, drive="urban", fault="heat", cell=cell, size=watts), range(320, 332))
    assert sum(any(code == "unexplained_heat" for _, code, _ in alerts) for alerts in found) >= 8


@pytest.mark.slow
@pytest.mark.parametrize("pack", ["forced", "liquid", "small"])
def test_a_thermocouple_that_drifts_is_told_and_is_no_heat(pack: str) -> None:
    # Bug: in forced air, what a drift said for heat beside the thermocouple became usual, and the drift was not told.
    found = raised(Case(pack, 0, 6300, drive="us06", fault="drift", size=2.0), range(340, 352))
    assert sum(any(code == "thermocouple" for _, code, _ in alerts) for alerts in found) >= 9
    assert sum(any(code == "unexplained_heat" for _, code, _ in alerts) for alerts in found) <= 2


@pytest.mark.slow
def test_a_cell_that_heats_is_not_told_as_a_thermocouple_that_came_off() -> None:
    # Bug: the first half minute of heat looks like a lag, and a thermocouple that came off was told after 20 s.
    found = raised(Case("liquid", 0, drive="urban", fault="heat", size=3.0), range(600, 612))
    assert [a for alerts in found for a in alerts if a[1] != "unexplained_heat"] == []
    assert all(found)
