"""Each cause raises its own flag, with a sentence that says why and what to do, and no other's."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.errors import StateError
from bms_gateway.health import HealthJob, HealthResult, StringHealth
from bms_gateway.health.causes import current_shape
from bms_gateway.health.trend import Kind, L, S
from bms_gateway.health.window_fit import DriveWindow
from bms_gateway.thermal import AddedEffect
from tests.health.health_ticks import tick
from tests.health.observed import unsure_of_heat
from tests.health.strings import DAY_NS, Life, model

LN = np.log
NAMES = tuple(model().priors)
MEAN = LN([p.value for p in model().priors.values()])


def test_growth_raises_its_levels_and_falls_when_it_is_gone() -> None:
    life = Life()
    life.drive(40)
    for growth in np.linspace(0.0, 0.34, 300):
        life.drive(1, growth=float(LN(1 + growth)))
    life.drive(30, growth=float(LN(1.34)))
    assert life.codes() == [("ageing", 1), ("ageing", 2), ("ageing", 3)]
    assert life.told[0].text.endswith(
        "watch: plan an inspection (a current sensor that has come to read low looks the same: no voltage is heard "
        "that could tell)"
    )
    assert "inspected before the next drive" in life.told[2].text
    assert [c.code for c in life.health.conditions()] == ["ageing"]


def test_a_clogged_filter_raises_cooling_alone_and_says_whether_the_flow_is_known() -> None:
    life = Life()
    life.drive(40)
    life.drive(10, cooling=0.3)
    assert life.codes() == [("cooling", 1)]
    assert "this is no ageing" in life.told[0].text
    assert "the bus does not tell the coolant's flow" in life.told[0].text
    life.health.flow_known = True
    life.drive(10, cooling=0.6)
    assert life.codes()[-1] == ("cooling", 2)
    assert "flow" not in life.told[-1].text
    life.drive(10)
    assert life.told[-1].text == "cooling is as at commissioning again"


@pytest.mark.parametrize(
    ("sensors", "drift", "cell", "told"),
    [
        ((1, 3), (0.0, 2.5), 3, "the thermocouple of cell 3 has drifted"),
        ((1, 3), (-2.4, -2.4), None, "check the inlet's sensor first"),
        ((2,), (2.5,), 2, "the thermocouple of cell 2 or the inlet's sensor has drifted"),
    ],
)
def test_a_thermocouple_that_drifts_raises_its_own_flag(sensors, drift, cell, told) -> None:
    life = Life(StringHealth(model(sensors=sensors), known=True))
    life.drive(40)
    for size in np.linspace(0.0, 1.0, 30):
        life.drive(1, drift=tuple(size * d for d in drift))
    life.drive(20, drift=drift)
    assert {c.code for c in life.told} == {"thermocouple"}
    assert life.told[-1].cell == cell
    assert told in life.told[-1].text
    assert abs(life.health.ageing.growth) < 0.06
    life.drive(60)
    assert life.told[-1].text == "thermocouples agree with the inlet's as at commissioning again"
    assert life.health.drift.worst == 0


def test_a_jump_that_no_voltage_can_tell_names_both_causes() -> None:
    life = Life()
    life.drive(40)
    life.drive(8, level=0.35)
    assert life.codes() == [("current", 1)]
    assert "either the current sensor's scale is wrong or a joint has come loose" in life.told[0].text
    assert life.health.ageing.flag.level == 0
    life.drive(30)
    assert life.codes()[-1] == ("current", 0)
    assert life.told[-1].text == "the current agrees with the heat again"


def test_the_voltage_tells_a_wrong_scale_from_a_joint() -> None:
    for level, ratio, expected in ((0.25, 0.125, "current"), (0.35, 0.0, "ageing")):
        life = Life()
        life.drive(40, ratio=0.2)
        life.drive(60, ratio=0.2 + ratio, level=level)
        if expected == "current":
            assert ("current", 2) in life.codes()
            assert "heat and voltage contradict" in life.health.current.sentence()
            assert -0.16 < np.exp(-life.health.current.scale) - 1 < -0.05
        else:
            assert {c.code for c in life.told} == {"ageing"}
            assert life.health.ageing.growth == pytest.approx(np.exp(level) - 1, abs=0.08)
            assert "no voltage is heard" not in life.told[-1].text


def test_voltage_is_a_witness_within_a_month_of_drives_that_do_not_tell_their_heat() -> None:
    """A joint that comes loose is told within days then; by windows alone the voltage took 120 drives to be learnt."""
    life = Life()

    def drive(times: int, level: float = 0.0) -> None:
        for _ in range(times):
            seen = unsure_of_heat(life.rng, core=life.rng.uniform(10, 40), level=level)
            electrical = level + life.rng.normal(0.0, 0.02)
            ratio = 0.2 + float(seen.mean[0]) + seen.B * seen.warmth - electrical - 2500.0 * seen.warmth
            life.told += life.health.accept(HealthResult(seen, 1.0, "", ratio), life.day * DAY_NS)
            life.day += 1

    drive(40)
    assert life.health.current.heard
    drive(10, level=0.3)
    assert life.health.ageing.flag.level == 3
    assert {code for code, _ in life.codes()} == {"ageing"}
    assert abs(life.health.current.scale) < 0.04


def test_a_clipped_current_is_found_by_its_shape_and_the_heat() -> None:
    life = Life()
    life.drive(40)
    life.drive(20, shape="never reads beyond 70.0 A, which it reads 11 % of the time,", level=0.8)
    assert life.codes() == [("current", 2)]
    assert life.told[0].text.startswith("the current sensor never reads beyond 70.0 A")
    assert abs(life.health.ageing.growth) < 0.05
    usual = Life()
    usual.drive(80, shape="stands at 40.0 A")  # a charger does that, and the heat agrees
    assert usual.told == []


def test_shapes_of_currents() -> None:
    rng = np.random.default_rng(1)
    wild = rng.normal(0, 50, 1200)
    assert current_shape(wild) == ""
    assert current_shape(np.zeros(1200)) == ""
    assert current_shape(np.full(5, np.nan)) == ""
    assert current_shape(np.full(1200, -40.0)) == "stands at -40.0 A"
    assert "never reads beyond 60.0 A" in current_shape(np.clip(wild, -60, 60))


def test_cells_age_by_themselves() -> None:
    life = Life()
    h = life.health
    for _ in range(3):
        h.fitted(LN([3.5e-3, 3.6e-3, 3.4e-3]), np.full(3, 0.02), None)
    life.drive(60)
    assert life.told == []
    told = []
    for _ in range(40):
        told += h.fitted(LN([3.5e-3, 3.6e-3 * 1.27, 3.4e-3]), np.full(3, 0.02), None)
    assert {c.cell for c in told if c.level} == {2}
    assert "of cell 2 +" in told[0].text
    assert h.cells.ageing[1].growth == pytest.approx(1.27 / 1.27 ** (1 / 3) - 1, abs=0.04)
    assert [c.cell for c in h.conditions()] == [2]
    assert "of cell 2 of R_e reset: new cell: made anew" in h.reset(2, "new cell", 5)
    assert list(h.conditions()) == []
    for _ in range(10):
        h.fitted(LN([3.5e-3, 3.3e-3, 3.4e-3]), np.full(3, 0.02), None)
    life.drive(5)
    assert list(h.conditions()) == []
    assert h.cells.ageing[1].growth == pytest.approx(h.ageing.growth, abs=0.02)


def test_a_reset_is_noted_once_and_begins_again() -> None:
    life = Life()
    life.drive(40)
    for growth in np.linspace(0.0, 0.3, 150):
        life.drive(1, growth=float(LN(1 + growth)))
    h = life.health
    assert h.ageing.flag.level >= 2
    assert "baseline of R_e reset: new module" in h.reset(None, "new module", 7)
    assert h.reset(None, "new module", 7) == ""
    assert h.ageing.flag.level == 0
    life.drive(60, growth=float(LN(1.3)))
    assert h.ageing.growth == pytest.approx(0.0, abs=0.05)
    assert "not told apart" in h.reset(1, "new cell", 8)
    assert [text for _, text in h.history.events] == [
        "baseline of R_e reset: new module", "baseline of cell 1 of R_e reset: new cell"
    ]  # fmt: skip


def test_a_commissioned_file_is_the_baseline_where_its_temperature_is_known() -> None:
    falling = AddedEffect("resistance_temperature", None, {"B": 3000.0}, {"B": 200.0})
    sharp = Life(StringHealth(model(0.02, fitted=True, effects=(falling,)), known=True))
    sharp.drive(12, growth=float(LN(1.25)), B=0.0, job_B=0.0)
    assert sharp.health.ageing.growth == pytest.approx(0.25, abs=0.06)
    assert sharp.codes()[-1] == ("ageing", 2)
    vague = Life(StringHealth(model(0.02, fitted=True), known=True))
    vague.drive(12, growth=float(LN(1.25)))
    assert abs(vague.health.ageing.growth) < 0.06


def test_a_string_is_commissioned_once_its_identifier_has_known_it_for_some_windows() -> None:
    h = StringHealth(model())
    cov = 1e-4 * np.eye(len(NAMES))
    assert not h.commissioned
    assert h.baseline != h.baseline
    assert h.add(tick(), 60.0, 0.5, 1.0, np.nan) is None
    found = [h.offer(NAMES, MEAN + 0.1, cov, 4e-3, k != 1) for k in range(6)]
    assert found == [False, False, False, False, True, False]
    assert h.parameters.R_u[0] == pytest.approx(0.79 * np.exp(0.1))
    assert h.baseline == pytest.approx(4e-3)
    assert not StringHealth(model(), thermal=False).offer(NAMES, MEAN, cov, 4e-3, True)


def test_a_full_window_becomes_a_job_and_a_cool_one_does_not() -> None:
    rng = np.random.default_rng(2)
    h = StringHealth(model(), known=True)
    jobs = []
    for _ in range(1300):
        noisy = replace(tick(), surface=np.array([25.0, np.nan, 26.0]) + rng.normal(0, 0.1, 3))
        jobs.append(h.add(noisy, 60.0, 0.5, 1.0, 3e-3))
    (job,) = [j for j in jobs if j is not None]
    assert isinstance(job, HealthJob)
    result = job.run()
    assert result.share == 1.0
    assert np.isfinite(result.ratio)
    h.accept(result, 1)
    cool = StringHealth(model(), known=True)
    assert not any(cool.add(tick(square=1.0), 1.0, 0.5, 1.0, np.nan) for _ in range(1300))
    assert replace(job, electrical=float("nan")).run().ratio != result.ratio


def test_a_drive_in_doubt_is_fitted_without_each_thermocouple_where_others_were_heard() -> None:
    h, rng = StringHealth(model(), known=True), np.random.default_rng(3)
    surface = np.full((300, 3), np.nan)
    surface[:, [0, 2]] = 25.0 + rng.normal(0, 0.1, (300, 2))
    w = DriveWindow(np.full(300, 3600.0), np.full(301, 20.0), surface, np.zeros((300, 3)), 4.0, 0.5, 1.0)
    job = h.job(w, np.full(300, 60.0))
    assert job.run().without == {}
    assert not job.doubtful
    asked = replace(job, doubtful=True).run()
    assert set(asked.without) == {0, 1}
    assert [len(o.mean) for o in (asked.seen, *asked.without.values())] == [7, 6, 6]
    alone = replace(w, surface=np.where(np.arange(3) == 2, surface, np.nan))
    assert set(replace(job, window=alone, doubtful=True).run().without) == {0}  # without the other nothing is left
    h.trend.unrest = 0.1
    assert h.job(w, np.full(300, 60.0)).doubtful


def test_heat_is_levelled_to_one_charge_where_the_capacity_is_known() -> None:
    h, full = StringHealth(model(), known=True), StringHealth(replace(model(), capacity_Ah=8.0), known=True)
    w = DriveWindow(np.full(300, 3600.0), np.full(301, 20.0), np.full((300, 3), 25.0), np.zeros((300, 3)), 4.0, 0.5)
    for health in (h, full):
        health.trend.x[S] = 0.5
    assert (h.job(w, np.full(300, 10.0)).window.square == 3600.0).all()
    levelled = full.job(w, np.full(300, 10.0)).window.square
    assert (np.diff(levelled) > 0.0).all()
    assert levelled[-1] / levelled[0] == pytest.approx(np.exp(0.5 * 10.0 * 299 * 4.0 / 3600.0 / 8.0))


def test_a_window_is_not_begun_while_another_is_under_way() -> None:
    h = StringHealth(model(), known=True)
    jobs = [h.add(tick(), 60.0, 0.5, 1.0, np.nan) for _ in range(2500)]
    assert sum(j is not None for j in jobs) == 1


def test_the_state_survives_a_restart() -> None:
    life = Life()
    life.drive(30, ratio=0.1)
    life.health.fitted(np.zeros(3), np.full(3, 0.02), np.zeros(3))
    life.drive(10, shape="stands at 40.0 A", level=0.7, cooling=0.4)
    two = StringHealth(model())
    two.restore(json.loads(json.dumps(life.health.snapshot(), allow_nan=False)))
    assert two.snapshot() == life.health.snapshot()
    assert [c.text for c in two.conditions()] == [c.text for c in life.health.conditions()]
    assert two.parameters.R_e == pytest.approx(life.health.parameters.R_e)
    fresh = StringHealth(model())
    fresh.restore(json.loads(json.dumps(StringHealth(model()).snapshot(), allow_nan=False)))
    assert not fresh.commissioned
    state = life.health.snapshot()
    with pytest.raises(StateError, match="another string"):
        StringHealth(model()).restore(state | {"frozen": {"R_xy": 1.0}})
    with pytest.raises(StateError, match="of the cells"):
        StringHealth(model()).restore(state | {"cells": state["cells"] | {"base": [0.0]}})
    assert life.health.trend.x[L] == pytest.approx(0.0, abs=0.1)
    assert Kind.USUAL.value


def test_every_raised_flag_is_a_condition_that_says_what_to_do() -> None:
    life = Life()
    life.drive(5)
    h = life.health
    assert list(h.conditions()) == []
    for flag, level in ((h.current, 1), (h.ageing, 3), (h.cooling, 2), (h.drift, 1), (h.mismatch, 1)):
        flag.flag.level = level
    found = list(h.conditions())
    assert [(c.code, c.level) for c in found] == [
        ("current", 1), ("ageing", 3), ("cooling", 2), ("thermocouple", 1), ("mismatch", 1)
    ]  # fmt: skip
    for c in found:
        assert any(word in c.text for word in ("check", "inspect", "compare", "diagnose")), c.text


def test_a_string_without_a_baseline_can_be_reset() -> None:
    h = StringHealth(model())
    assert "made anew" in h.reset(None, "new pack", 1)
    assert not h.commissioned
