"""Thermocouples that no longer follow their cells: told with the cell and what to do, and no ageing."""

import json

import numpy as np
import pytest

from bms_gateway.errors import StateError
from bms_gateway.health import HealthResult, StringHealth
from bms_gateway.health.trend import Kind, Trend
from tests.health.observed import observed
from tests.health.strings import DAY_NS, Life, model

ODD = np.array([0.4, -0.5, 1.0, -1.0, 1.0])
NAN = float("nan")


def loose(life: Life, drives: int, cell: int | None, *, growth: float = 0.0) -> None:
    """Drives that contradict all, but for those of one sensor alone where `cell` (its index) is left out."""
    sensors = len(life.health.model.sensors)
    for _ in range(drives):
        core = life.rng.uniform(10, 40)
        seen = observed(life.rng, core=core, growth=growth, drift=(0.0,) * sensors)
        seen.mean[:5] += ODD
        without = {}
        for k in range(sensors if sensors > 1 else 0):
            without[k] = observed(life.rng, core=core, growth=growth, drift=(0.0,) * (sensors - 1))
            without[k].mean[:5] += 0.0 if k == cell else ODD
        asked = life.health.trend.doubtful
        result = HealthResult(seen, 1.0, "", NAN, without if asked else {})
        life.told += life.health.accept(result, life.day * DAY_NS)
        life.day += 1


@pytest.mark.parametrize("index", [0, 1])
def test_a_loose_thermocouple_is_named_and_growth_goes_on_without_it(index: int) -> None:
    life = Life()
    for k in range(40):
        life.drive(1, growth=float(np.log1p(0.001 * k)))
    for k in range(40, 48):
        loose(life, 1, index, growth=float(np.log1p(0.001 * k)))
    assert life.codes() == [("thermocouple", 1)]
    (told,) = life.told
    assert told.cell == (1, 3)[index]
    assert f"the thermocouple of cell {told.cell} no longer follows its cell" in told.text
    assert "fasten or replace it; this is no ageing of the cells" in told.text
    assert [c.text for c in life.health.conditions()] == [told.text]
    assert life.health.drift.worst == told.cell
    for k in range(48, 150):
        loose(life, 1, index, growth=float(np.log1p(0.001 * k)))
    assert life.health.ageing.growth == pytest.approx(0.15, abs=0.04)
    assert life.codes() == [("thermocouple", 1), ("ageing", 1)]


def test_a_thermocouple_that_was_fastened_is_believed_again() -> None:
    life = Life()
    life.drive(40)
    loose(life, 10, 0)
    life.drive(20)
    assert life.codes() == [("thermocouple", 1), ("thermocouple", 0)]
    assert life.health.drift.worst == 0
    assert life.health.trend.left_out is None


def test_one_left_out_stays_so_through_a_mild_drive_that_would_pass_with_it() -> None:
    """A loose thermocouple is nearly right where its cell is hardly warm; taking that in would move its offset."""
    trend, rng = Trend(2), np.random.default_rng(1)
    for _ in range(60):
        trend.update(observed(rng))
    odd = observed(rng)
    odd.mean[:5] += ODD
    sound, bad = observed(rng, drift=(0.0,)), observed(rng, drift=(0.0,))
    bad.mean[:5] += ODD
    assert trend.update(odd, without={0: sound, 1: bad}) is Kind.LOOSE
    mild = observed(rng, drift=(1.0, 0.3))
    assert not trend.surprising(mild)
    assert trend.update(mild, without={0: sound, 1: sound}) is Kind.LOOSE
    assert trend.left_out == 0
    assert trend.update(observed(rng), without={0: sound, 1: sound}) is Kind.USUAL


@pytest.mark.parametrize(("sensors", "who"), [((1, 3), "a thermocouple"), ((2,), "the thermocouple of cell 2")])
def test_drives_that_nothing_explains_are_told_with_what_to_check_and_growth_is_held(sensors, who) -> None:
    life = Life(StringHealth(model(sensors=sensors), known=True))
    life.drive(40)
    loose(life, 60, None, growth=float(np.log(1.5)))
    assert life.codes() == [("thermocouple", 1)]
    assert life.told[0].cell is None
    assert f"most likely {who} or the inlet's sensor does not touch what it measures" in life.told[0].text
    assert "growth of R_e is held" in life.told[0].text
    assert "bms-gateway export" in life.told[0].text
    assert abs(life.health.ageing.growth) < 0.05
    life.drive(20)
    assert life.codes()[-1] == ("thermocouple", 0)


def test_two_that_each_would_explain_it_name_none() -> None:
    trend, rng = Trend(2), np.random.default_rng(1)
    for _ in range(60):
        trend.update(observed(rng))
    odd = observed(rng)
    odd.mean[:5] += ODD
    either = {k: observed(rng, drift=(0.0,)) for k in (0, 1)}
    assert trend.update(odd, without=either) is Kind.STRANGE
    assert trend.left_out is None


def test_an_inlet_sensor_that_moves_by_half_a_kelvin_is_told_and_is_no_ageing() -> None:
    life = Life()
    life.drive(60)
    life.drive(60, drift=(-0.5, -0.5))
    assert life.codes() == [("thermocouple", 1)]
    assert life.told[0].cell is None
    assert "check the inlet's sensor first" in life.told[0].text
    assert abs(life.health.ageing.growth) < 0.04
    one = Life()
    one.drive(60)
    one.drive(60, drift=(-0.5, 0.0))  # a thermocouple does that
    assert one.told == []


def test_what_was_left_out_survives_a_restart_and_earlier_states_are_taken() -> None:
    life = Life()
    life.drive(40)
    loose(life, 8, 1)
    state = json.loads(json.dumps(life.health.snapshot(), allow_nan=False))
    two = StringHealth(model())
    two.restore(state)
    assert [c.text for c in two.conditions()] == [c.text for c in life.health.conditions()]
    earlier = {key: value for key, value in state.items() if key != "contact"} | {"drift": 0}
    old = StringHealth(model())
    old.restore(earlier)
    assert list(old.conditions()) == []
    for damage in ({"loose": [0.0]}, {"told": 3}, {"told": -2}, {"loose": [0.0, NAN]}, {"strange": NAN}):
        with pytest.raises(StateError, match="stored state is damaged"):
            StringHealth(model()).restore(state | {"contact": state["contact"] | damage})
