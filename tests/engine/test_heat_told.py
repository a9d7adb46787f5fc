"""A cell that heats by itself, through the estimators: told, flagged, in the estimates of its tick and in the bands."""

import numpy as np
import pytest

from bms_gateway.engine.conditions import of_strings
from bms_gateway.engine.estimators import Estimators
from bms_gateway.engine.events import Estimated, Notice
from bms_gateway.engine.plan import Plan, StringPlan
from bms_gateway.engine.readings import Layout, Readings
from bms_gateway.frames.quality import Quality
from bms_gateway.health.alerts import Severity
from tests.benchmarks.heat_case import CELLS, SENSORS, Case, make, model
from tests.support.engine_parts import slow, wire

SECOND = 1_000_000_000
CASE = Case("small", 71, seconds=1620, drive="us06", at=1200, fault="heat", size=3.0)


@pytest.fixture(scope="module")
def told():
    """Estimators, their events, and the truth."""
    made, layout = make([CASE])[0], Layout.of(["string_1"], [CELLS])
    plan = Plan((StringPlan("string_1", 1, model("small"), (), "off"),))
    estimators = Estimators(plan, [wire({"current": 0, "coolant_inlet": 1}, CELLS)])
    quality = np.where(np.isin(np.arange(1, CELLS + 1), SENSORS), Quality.GOOD, Quality.NEVER).astype(np.uint8)
    nan, good, events = np.full(1, np.nan), np.full(1, np.uint8(Quality.GOOD)), []
    for k in range(CASE.seconds):
        i = made.current[k : k + 1]
        means = np.array([i, i**2, nan, nan, np.abs(i)])
        inlet = made.inlet[k : k + 1]
        readings = Readings(means, good, slow(inlet, nan, nan), made.y[k], np.zeros(CELLS), quality, layout.parts)
        events += estimators.step(readings, (k + 1) * SECOND).events
    return estimators, events, made


def test_it_is_told_and_flagged_with_its_cell_and_its_watts(told) -> None:
    estimators, events, _ = told
    first = next(e for e in events if isinstance(e, Notice) and e.code == "unexplained_heat")
    assert CASE.at < first.time_ns / SECOND <= CASE.at + 180
    assert first.cell in (5, 6, 7)
    assert "heats by itself" in first.text
    s = estimators.strings[0]
    assert f"unexplained_heat:{first.cell}" in s.flags
    change = next(c for c in s.health.conditions() if c.code == "unexplained_heat")
    assert change.level == 2
    assert abs(change.facts["heat_W"] - CASE.size) < 2 * change.facts["heat_sd_W"] + 0.5


def test_its_alert_is_an_alarm_with_the_watts(told) -> None:
    estimators, _, _ = told
    alarm = next(c for c in of_strings(estimators.strings) if c.name == "unexplained_heat")
    assert alarm.severity is Severity.ALARM
    assert set(alarm.facts) == {"heat_W", "heat_sd_W"}


def test_its_watts_stand_beside_the_cores_and_a_tick_that_was_told_keeps_them(told) -> None:
    _, events, _ = told
    ticks = [e for e in events if isinstance(e, Estimated)]
    before, after = ticks[CASE.at - 1], ticks[-1]
    near = np.array([4, 5, 6])
    assert np.nansum(before.heat) < 0.3
    assert np.nansum(after.heat[near]) == pytest.approx(CASE.size, abs=1.0)
    assert np.isnan(after.heat[[3, 7, 11]]).all()  # two away from every sensor


def test_the_cores_go_with_it_inside_their_band(told) -> None:
    _, events, made = told
    ticks = [e for e in events if isinstance(e, Estimated)]
    late = range(CASE.at + 300, CASE.seconds, 10)
    off = np.array([np.abs(ticks[k].core - made.core[k]) <= 2 * ticks[k].core_sd for k in late])
    assert off[:, 5].mean() >= 0.9
    assert off.mean() >= 0.9


def test_the_hottest_point_is_never_below_core_surface_or_a_good_reading(told) -> None:
    # Bug: while the watch took a thermocouple for wrong the hottest point went below the surface with the core.
    _, events, made = told
    for k, e in enumerate(e for e in events if isinstance(e, Estimated)):
        known = np.isfinite(e.centre)
        assert (e.centre[known] >= np.fmax(e.core, e.surface)[known] - 1e-9).all()
        read = known & np.isfinite(made.y[k])
        assert (e.centre[read] >= made.y[k][read] - 0.3 - 1e-9).all()
