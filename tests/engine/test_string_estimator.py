"""What belongs to one string alone: who of its learners is asked, what its voltage says, what its observer takes in."""

from dataclasses import dataclass, field, replace
from math import inf, isnan, nan
from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.engine import Plan, StringPlan
from bms_gateway.engine.current import Means
from bms_gateway.engine.readings import Layout, Reading
from bms_gateway.engine.string_estimator import FLAG_NAMES, Newest, StringEstimator, health_of, hears_cells
from bms_gateway.engine.wiring import Wire
from bms_gateway.frames.quality import Quality
from bms_gateway.health import Mismatch
from bms_gateway.identify import Estimate, Tick, VoltageHeat
from bms_gateway.identify.ticks import ENDLESS
from bms_gateway.thermal import AddedEffect
from tests.engine.packs import plan
from tests.support.engine_parts import slow
from tests.support.engine_parts import wire as made_wire

FALLING = AddedEffect("resistance_temperature", None, {"B": 3000.0}, {"B": 300.0})
COOLED = AddedEffect("natural_convection", None, {"n": 0.2}, {"n": 0.02})


def wire(voltage: int = -1, cell_voltages: int = 0) -> Wire:
    cells = np.where(np.arange(4) < cell_voltages, np.arange(4), -1)
    whole = {"current": 0, "voltage": voltage, "coolant_inlet": 2, "coolant_flow": 3, "soc": 4}
    return made_wire(whole, 4, surface=np.zeros(4, int), cell_voltage=cells)


def string(
    identify: str = "off", voltage: int = -1, cell_voltages: int = 0, *effects: AddedEffect, **model: object
) -> StringEstimator:
    one = plan(1).strings[0]
    own = replace(one, identify=identify, model=replace(one.model, effects=effects, **model))
    (part,) = Layout.of([own.name], [4]).parts
    return StringEstimator.of(own, wire(voltage, cell_voltages), Plan((own,)), Newest.nothing(4), part, Mismatch())


@dataclass
class Heard:
    """A learner that keeps what it is given and wants one job of each tick that it hears."""

    name: str
    ticks: list = field(default_factory=list)
    job: object | None = None
    waits: int = 0

    def add(self, *given: object) -> object | None:
        self.ticks.append(given)
        return self.job

    def take(self, ticks: object) -> None:
        self.ticks.append(ticks)

    def patience(self, dt: float) -> int:
        return self.waits

    def posterior(self) -> str:
        return "posterior"


TICK = Tick(7, 1.0, 100.0, nan, 25.0, np.full(4, nan), np.zeros(4))


def test_nothing_is_known_before_the_first_tick() -> None:
    newest = Newest.nothing(3)
    rows = (newest.core, newest.core_sd, newest.surface, newest.centre, newest.centre_sd)
    assert all(np.isnan(row).all() and row.shape == (3,) for row in rows)
    assert newest.quality.tolist() == [Quality.NEVER] * 3
    assert newest.quality.dtype == np.uint8


def test_a_new_tick_leaves_the_last_ones_numbers_as_they_were() -> None:
    newest = Newest.nothing(3)
    names = ("core", "core_sd", "surface", "quality", "centre", "centre_sd")
    before = [getattr(newest, name) for name in names]
    newest.renew()
    after = [getattr(newest, name) for name in names]
    for k, (old, new) in enumerate(zip(before, after, strict=True)):
        assert new.shape == (3,)
        assert new.dtype == old.dtype
        assert not any(np.shares_memory(new, other) for other in (*before, *after[:k]))


def test_a_string_sees_its_own_of_the_newest_numbers() -> None:
    newest = Newest.nothing(9)
    names = ("core", "core_sd", "surface", "quality", "centre", "centre_sd")
    for k, name in enumerate(names):
        getattr(newest, name)[:] = 10 * k + np.arange(9)
    one = replace(string(), newest=newest, mine=slice(2, 6))
    for k, name in enumerate(names):
        assert getattr(one, name).tolist() == [10 * k + c for c in range(2, 6)]
    assert one.hottest == 3
    newest.centre[:] = np.nan
    assert one.hottest is None


@pytest.mark.parametrize("commissioned", [True, False])
@pytest.mark.parametrize("cells", [True, False])
def test_a_tick_goes_to_cells_health_and_identifier_in_this_order(commissioned: bool, cells: bool) -> None:
    s = string()
    s.identifier, collector = Heard("identifier", job="window"), Heard("health", job="drive")
    s.health = SimpleNamespace(commissioned=commissioned, add=collector.add)
    s.cells = Heard("cells", job="pairs") if cells else None
    s.electrical = VoltageHeat(1.0, 0.1, 12.0, 0.1, 4 * 5e-3, 1e-4)
    jobs = s.learn(TICK, 10.0, 0.5, 1.1, "pairs of voltages")
    assert jobs == ["pairs"] * cells + ["drive"] * commissioned + ["window"]
    assert s.identifier.ticks == [(TICK,)]
    assert collector.ticks == [(TICK, 10.0, 0.5, 1.1, pytest.approx(5e-3))] * commissioned
    if cells:
        ((tick, pairs, current, flow, posterior),) = s.cells.ticks
        assert (tick, pairs, current, flow, posterior()) == (TICK, "pairs of voltages", 10.0, 1.1, "posterior")
    s.identifier.job = collector.job = None
    assert s.learn(TICK, 10.0, 0.5, 1.1, None) == ["pairs"] * cells


@pytest.mark.parametrize(
    ("identifier", "commissioned", "cells", "ticks"),
    [
        (40, True, False, 30),
        (40, False, False, 40),
        (40, True, True, 0),
        (ENDLESS, True, False, 30),
        (ENDLESS, False, False, ENDLESS),
        (0, False, False, 0),
        (0, True, False, 0),
    ],
)
def test_ticks_wait_as_long_as_the_most_impatient_lets_them(
    identifier: int, commissioned: bool, cells: bool, ticks: int
) -> None:
    s = string()
    s.identifier, collector = Heard("identifier", waits=identifier), Heard("collector", waits=30)
    s.health = SimpleNamespace(commissioned=commissioned, collector=collector)
    s.cells = Heard("cells") if cells else None
    assert s.patience(1.0) == ticks
    s.take("ticks that waited")
    assert s.identifier.ticks == ["ticks that waited"]
    assert collector.ticks == (["ticks that waited"] if commissioned else [])


def test_the_voltage_makes_the_heat_of_a_mean_cell() -> None:
    s = string("off", 1)
    given = []
    said = VoltageHeat(6.0, 0.1, 12.0, 0.1, 0.02, 1e-4)
    s.voltage = SimpleNamespace(update=lambda *what: given.append(what) or said)
    assert s.heat(10.0, 12.0, 118.0, 2.0) == 1.5
    assert given == [(10.0, 12.0, 118.0, 2.0)]
    assert s.electrical is said
    assert isnan(string("off", -1).heat(10.0, 12.0, 118.0, 2.0))


@pytest.mark.parametrize(("voltage", "effects", "tracks"), [(-1, (), False), (0, (), True), (1, (FALLING,), False)])
def test_heat_is_looked_for_where_there_is_a_voltage_and_no_effect(voltage, effects, tracks) -> None:
    assert (string("off", voltage, 0, *effects).voltage is not None) == tracks


def test_a_voltage_is_followed_with_the_strings_capacity_and_8_Ah_where_the_model_has_none() -> None:
    courses = {}
    for capacity in (None, 8.0, 20.0):
        s = string("off", 1, capacity_Ah=capacity)
        rng = np.random.default_rng(1)
        for _ in range(600):
            amps = float(rng.uniform(-50, 50))
            s.heat(amps, 13.0 - 0.02 * amps, 13.0 * amps - 0.02 * amps**2, 1.0)
        courses[capacity] = s.electrical
    assert courses[None] == courses[8.0] != courses[20.0]


@pytest.mark.parametrize(
    ("R", "sd", "known"), [(0.02, 0.00199, True), (0.02, 0.002, False), (0.0, -1.0, False), (-0.02, -1.0, False)]
)
def test_a_resistance_is_known_to_within_a_tenth(R: float, sd: float, known: bool) -> None:
    s = string("off", 1)
    assert isnan(s.resistance())
    s.electrical = VoltageHeat(6.0, 0.1, 12.0, 0.1, R, sd)
    assert s.resistance() == 0.005 if known else isnan(s.resistance())
    R_e = next(e for e in s.known() if e.name == "R_e")
    assert (R_e.value, R_e.unit) == (R / 4, "mOhm")
    assert R_e.sd == pytest.approx(np.hypot(sd / 4, 0.25 * R / 4))  # the steps may lack polarisation
    assert R_e.status == ("identified" if known else "learning")
    others = [e for e in s.known() if e.name != "R_e"]
    assert others == [e for e in s.identifier.estimates() if e.name != "R_e"]


def test_a_resistance_is_kept_to_the_method_while_the_voltage_makes_no_heat() -> None:
    s = string("off", 1)
    for electrical in (None, VoltageHeat(nan, nan, 12.0, 0.1, 0.02, 1e-4)):
        s.electrical = electrical
        assert s.known() == s.identifier.estimates()


def test_cells_as_identified_are_told_after_what_is_common() -> None:
    s = string()
    one = Estimate("R_e_1", 4e-3, 1e-4, "mOhm", "identified")
    s.cells = SimpleNamespace(estimates=lambda: (one,))
    assert s.known() == (*s.identifier.estimates(), one)
    s.cells = SimpleNamespace(estimates=lambda: None)
    assert s.known() == s.identifier.estimates()


def test_the_flow_is_told_over_nominal() -> None:
    assert string(flow=2e-4).flow_ratio(3e-4) == pytest.approx(1.5)
    assert isnan(string(flow=None).flow_ratio(3e-4))


@pytest.mark.parametrize(
    ("volts", "cells"), [(13.2, 4), (8.0, 4), (7.99, 4), (4.6, 1), (4.61, 4), (2.0, 1), (1.99, 4), (nan, 4)]
)
def test_a_voltage_between_those_of_one_cell_is_the_mean_of_the_cells(volts: float, cells: int) -> None:
    s = string("off", 1, 0, FALLING, flow=2e-4)
    means = Means(10.0, 120.0, volts, 10.0 * volts, 11.0)
    m = s.measured(Reading(means, 0, slow(25.0, 1e-4, 0.6), np.zeros(4), np.zeros(4), np.zeros(4, np.uint8)))
    assert (m.I, m.I2, m.I_abs, m.inlet, m.flow, m.soc) == (10.0, 120.0, 11.0, 25.0, 0.5, 0.6)
    assert pytest.approx((volts / cells, 10.0 * volts / cells), nan_ok=True) == (m.V, m.IV)


@pytest.mark.parametrize(
    ("cells", "volts", "of_one"),
    [(1, 1.5, 1.5), (1, 2.0, 2.0), (1, 3.3, 3.3), (2, 3.99, 3.99), (2, 4.0, 2.0), (2, 4.6, 2.3), (2, 1.9, 0.95)],
)
def test_a_voltage_that_two_cells_may_have_is_shared_by_them(cells: int, volts: float, of_one: float) -> None:
    model = SimpleNamespace(cells=cells, flow=None)
    s = SimpleNamespace(plan=SimpleNamespace(model=model), flow_ratio=string("off", 1).flow_ratio)
    nothing = np.zeros(cells)
    means, inlet = Means(V=volts, IV=10.0 * volts), slow(25.0, nan, nan)
    reading = Reading(means, 0, inlet, nothing, nothing, nothing.astype(np.uint8))
    m = StringEstimator.measured(s, reading)
    assert (of_one, 10.0 * of_one) == (m.V, m.IV)


@pytest.mark.parametrize(("voltages", "enough"), [(0, False), (1, False), (2, True), (4, True)])
def test_cells_are_told_apart_where_half_of_them_are_wired(voltages: int, enough: bool) -> None:
    one: StringPlan = plan(1).strings[0]
    assert hears_cells(one, wire(-1, voltages)) == enough
    assert not hears_cells(replace(one, identify="rls"), wire(-1, 4))
    five = replace(one, model=replace(one.model, cells=5))
    assert hears_cells(five, wire(-1, voltages)) == (voltages >= 3)
    assert (string("window", -1, voltages).cells is not None) == enough


@pytest.mark.parametrize(
    ("identify", "effects", "commissioned"),
    [("off", (), True), ("window", (), False), ("off", (COOLED,), False), ("window", (COOLED,), False)],
)
def test_a_health_takes_the_model_for_commissioned_where_nothing_else_is_identified(
    identify: str, effects: tuple[AddedEffect, ...], commissioned: bool
) -> None:
    one = plan(1).strings[0]
    own = replace(one, identify=identify, model=replace(one.model, effects=effects))
    assert health_of(own).commissioned == commissioned
    assert string(identify, -1, 0, *effects).health.commissioned == commissioned


def test_windows_speak_of_health_for_effects_that_change_the_heat_alone() -> None:
    """Those with other effects keep their numbers, and their windows say nothing."""
    one = plan(1).strings[0]
    for effects, thermal in (((), True), ((FALLING,), True), ((COOLED,), False)):
        own = replace(one, model=replace(one.model, effects=effects))
        assert health_of(own).thermal == thermal
    mismatch = Mismatch()
    assert health_of(one, mismatch=mismatch).mismatch is mismatch


def test_flags_have_a_name_for_every_level() -> None:
    s = string()
    told = [
        SimpleNamespace(code=c, level=k, cell=None) for c, names in FLAG_NAMES.items() for k in range(1, len(names))
    ]
    s.health = SimpleNamespace(conditions=lambda: [*told, SimpleNamespace(code="ageing", level=1, cell=3)])
    assert s.flags == (
        *("R_e_watch", "R_e_warning", "R_e_alarm", "cooling_warning", "cooling_alarm"),
        *("thermocouple_warning", "thermocouple_alarm", "current_suspected", "current_confirmed"),
        *("mismatch_suspected", "mismatch_confirmed", "unexplained_heat", "unexplained_heat"),
        *("missing_heat", "missing_heat", "inlet_warning", "inlet_alarm"),
        *("self_discharge_warning", "self_discharge_alarm", "R_e_watch:3"),
    )


def test_an_infinite_spread_is_no_knowledge_of_a_resistance() -> None:
    s = string("off", 1)
    s.electrical = VoltageHeat(6.0, 0.1, 12.0, 0.1, 0.02, inf)
    assert isnan(s.resistance())


def test_cells_as_commissioned_go_with_what_is_common_to_them() -> None:
    s = string()
    R = np.array([3e-3, 4e-3, 5e-3, 6e-3])
    own = np.zeros((4, 3, 3))
    own[:, 0, 0], own[:, 0, 1], own[:, 1, 0], own[:, 1, 1] = np.array([0.01, 0.02, 0.03, 0.04]) ** 2, 5.0, 6.0, 7.0
    s.kept = SimpleNamespace(values={"R_e": R}, own=own)
    common = (Estimate("R_c", 9.0, 1.0, "K/W", "learning"), Estimate("R_e", 7e-3, 0.7e-3, "mOhm", "learning"))
    s.identifier = SimpleNamespace(estimates=lambda: common)
    told = s.known()
    assert told[:2] == common
    ratio = R / np.prod(R) ** 0.25
    for k, e in enumerate(told[2:]):
        assert (e.name, e.unit) == (f"R_e_{k + 1}", "mOhm")
        assert e.status.startswith("fixed: ")
        assert e.value == pytest.approx(7e-3 * ratio[k])
        assert e.sd == pytest.approx(7e-3 * ratio[k] * np.hypot(0.1, 0.01 * (k + 1)))
    assert len(told) == 6


def test_what_a_model_says_is_known_from_the_beginning() -> None:
    s = string()
    assert s.estimates == s.known() == s.identifier.estimates()
    assert s.effects == ()
    assert (s.ageing, s.mismatch) == (s.health.ageing, s.health.mismatch)
