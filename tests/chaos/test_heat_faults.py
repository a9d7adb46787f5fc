"""Faults of the bench that heat, or that look like it."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.bus.virtual import PackFault, VirtualPack
from bms_gateway.chaos.catalogue import Chaos
from bms_gateway.chaos.observed_run import Line, Record
from bms_gateway.chaos.reaction import Told, Untold
from bms_gateway.config import load_config, shipped
from bms_gateway.thermal import StringParameters
from tests.chaos.bench import config

CELL = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79}
REST = (0.0, np.inf)
NAMES = {f"short-{w}W{where}" for w in (1, 3, 10) for where in ("", "-rest", "-beside")}
NAMES |= {"fan-stopped", "pump-stopped", "inlet-frozen", "thermocouple-off", "thermocouple-loose"}
NAMES |= {"current-without-heat"}


@pytest.fixture(scope="module")
def three_sensed(tmp_path_factory: pytest.TempPathFactory) -> Chaos:
    """Twelve cells of which three have a thermocouple."""
    folder = tmp_path_factory.mktemp("heat")
    file = config(folder)
    model = shipped("deploy/example/string.toml").read_text(encoding="utf-8")
    sensed = model.replace("sensors = [1, 12]", "sensors = [2, 6, 10]")
    assert sensed != model
    (folder / "string.toml").write_text(sensed, encoding="utf-8")
    loaded = load_config(file)
    return Chaos(loaded.plan, loaded.database)


def test_the_catalogue_has_every_fault_of_heat(three_sensed: Chaos) -> None:
    heat = {name for name, s in three_sensed.scenarios.items() if s.kind == "heat"}
    assert heat == NAMES
    unseen = {name for name in heat if three_sensed.scenarios[name].unfit}
    assert unseen == {"short-1W-beside", "short-3W-beside"}  # no thermocouple can tell them in this pack


def test_a_string_with_two_thermocouples_is_not_asked_and_told_why(tmp_path) -> None:
    loaded = load_config(config(tmp_path))
    scenarios = Chaos(loaded.plan, loaded.database).scenarios
    heat = {name: s.unfit for name, s in scenarios.items() if s.kind == "heat"}
    assert len(heat) > 10
    assert all("fewer than three thermocouples" in why for why in heat.values()), heat


@pytest.mark.parametrize("name", ["short-10W-rest", pytest.param("short-10W", marks=pytest.mark.slow)])
def test_a_short_is_told_in_time_and_nothing_else(three_sensed: Chaos, name: str) -> None:
    outcome = three_sensed.run(name)
    assert outcome.holds, outcome.seen


def alone(plan, fault: PackFault | None, cells: int = 1):
    """Cores of a pack of one string at rest, °C, after ten minutes; by hand: nothing conducts between its cells."""
    model = plan.strings[0].model
    single = replace(model, cells=cells, sensors=(1,), condition="natural")
    string = replace(plan.strings[0], model=single, channels=plan.strings[0].channels[:2])
    pack = VirtualPack(replace(plan, strings=(string,)), 3, scatter=0.0, inlet_swing_K=0.0)
    pack.parameters = (StringParameters.of(cells, **CELL),)
    return np.concatenate([s[0].core_C[:-1] for s in pack.segments(1200, rest_s=REST, fault=fault)])


def test_a_short_warms_its_cell_by_its_watts_over_the_capacity_and_in_the_end_by_its_resistances() -> None:
    plan = load_config(shipped("deploy/example/gateway.toml")).plan
    sound = alone(plan, None)
    sick = alone(plan, PackFault((100.0, 10_000.0), {1: 10.0}))
    more = (sick - sound)[:, 0]
    assert np.abs(more[:101]).max() == 0.0
    assert more[105] == pytest.approx(10.0 * 5.0 / CELL["C_c"], rel=0.02)
    left = np.exp(-1099.0 / _slowest(CELL["R_u"]))
    assert more[-1] == pytest.approx(10.0 * (CELL["R_c"] + CELL["R_u"]) * (1.0 - left), rel=0.02)
    healed = alone(plan, PackFault((100.0, 400.0), {1: 10.0})) - sound
    assert healed[1190, 0] == pytest.approx(healed[400, 0] * np.exp(-790.0 / _slowest(CELL["R_u"])), rel=0.05)


def test_without_a_fan_heat_leaves_by_as_much_less() -> None:
    plan = load_config(shipped("deploy/example/gateway.toml")).plan
    start = (0.0, 10_000.0)
    cold = alone(plan, None) - 25.0
    warm = alone(plan, PackFault(start, R_u=3.0)) - 25.0
    rate = [-np.log(x[900, 0] / x[700, 0]) / 200.0 for x in (cold, warm)]
    assert rate[0] == pytest.approx(1.0 / _slowest(CELL["R_u"]), rel=0.05)
    assert rate[1] == pytest.approx(1.0 / _slowest(3.0 * CELL["R_u"]), rel=0.05)


def _slowest(R_u: float) -> float:
    """Longest time constant of core and surface, s, by the roots of their characteristic polynomial."""
    a, b, c = 1 / (CELL["C_c"] * CELL["R_c"]), 1 / (CELL["C_s"] * CELL["R_c"]), 1 / (CELL["C_s"] * R_u)
    s, p = a + b + c, a * c
    return 2.0 / (s - np.sqrt(s * s - 4.0 * p))


def test_an_alert_that_comes_late_or_should_not_come_is_a_failure() -> None:
    record = Record(100.0, 400.0, lines=[Line(150.0, "unexplained_heat", "cell 6"), Line(450.0, "cooling", "fan")])
    assert Told("unexplained_heat", within_s=60.0).first_s(record) == 150.0
    assert Told("unexplained_heat", within_s=40.0).first_s(record) is None
    assert Untold.of("unexplained_heat").first_s(record) is None
    assert Untold.of("cooling", "inlet").first_s(record) == 400.0
    assert "within 1 min" in Told("unexplained_heat", within_s=60.0).text
