"""What the inputs say of strings at a tick, against what was put on the bus: wiring, means, lines, ages, constants."""

from dataclasses import replace
from math import isnan, nan

import numpy as np
import pytest

from bms_gateway.engine import Channel, Plan
from bms_gateway.engine.inputs import Inputs
from bms_gateway.engine.integrals import Integrals
from bms_gateway.engine.readings import Readings
from bms_gateway.engine.samples import Samples
from bms_gateway.engine.wiring import Wiring, identifies_cells
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.own_dbc import own_signal
from bms_gateway.frames.quality import Quality
from tests.engine.input_frames import FALLING, START, Put, S, amps, frames, put, strings, ticks, volts
from tests.engine.packs import database


def told(inputs: Inputs, seconds: int = 20, **how: object) -> Readings:
    return ticks(inputs, put(seconds, **how), seconds)[-1]


def test_means_of_the_current_come_to_every_string_that_shares_it() -> None:
    r = told(Inputs(strings(), database()))
    t = [19 + k / 10 for k in range(10)]
    I, V = np.array([amps(x) for x in t]), np.array([volts(x) for x in t])  # noqa: E741
    mean = [np.mean(x) for x in (I, I * I, V, I * V, np.abs(I))]
    assert r.means[:, 0] == pytest.approx(mean, rel=1e-3)
    assert r.means[:, 1] == pytest.approx([mean[0], mean[1], nan, nan, mean[4]], rel=1e-3, nan_ok=True)
    assert r.means[:, 2] == pytest.approx([-mean[0] / 2, mean[1] / 4, nan, nan, mean[4] / 2], rel=1e-3, nan_ok=True)
    assert np.isnan(r.means[:, 3]).all()
    assert r.current_quality.tolist() == [Quality.GOOD] * 3 + [Quality.ESTIMATED]


def test_coolant_and_charge_come_from_the_bus_or_are_constants() -> None:
    r = told(Inputs(strings(), database()))
    assert r.inlet == pytest.approx([22.0, 18.5, 22.0, nan], abs=0.02, nan_ok=True)  # the line, at the tick's end
    assert r.slow["coolant_flow"] == pytest.approx([1e-4, 2e-4, nan, nan], rel=0.01, nan_ok=True)
    assert r.slow["soc"] == pytest.approx([nan, nan, 0.5, nan], abs=0.01, nan_ok=True)


def test_a_constant_does_for_a_flow_that_is_no_longer_heard_and_for_nothing_else() -> None:
    one = strings().strings[0]
    both = (*one.channels[:3], Channel("coolant_flow", None, None, 3e-4), one.channels[3], *one.channels[4:])
    last = ticks(Inputs(Plan((replace(one, channels=both),)), database()), put(90, silent=20.0), 90)
    assert last[15].slow["coolant_flow"] == pytest.approx([1e-4], rel=0.01)
    assert last[-1].slow["coolant_flow"] == pytest.approx([3e-4])
    assert isnan(told(Inputs(strings(), database()), 90, silent=20.0).slow["soc"][2])


def test_a_surface_counts_in_the_tick_in_which_it_came() -> None:
    r = told(Inputs(strings(), database()))
    y = [26.96, nan, nan, 27.98, nan, 2 * 25.96 - 20, nan, nan, nan, nan, 28.98, nan, *[nan] * 4]
    assert r.y == pytest.approx(y, abs=0.02, nan_ok=True)
    age = np.zeros(16)
    age[[0, 3, 5, 10]] = 0.4, 0.2, 0.4, 0.2
    assert r.age == pytest.approx(age)
    sound = np.full(16, Quality.ESTIMATED)
    sound[[0, 3, 5, 10]] = Quality.GOOD
    assert r.quality.tolist() == sound.tolist()
    assert [(p.start, p.stop) for p in r.parts] == [(0, 4), (4, 8), (8, 12), (12, 16)]
    later = told(Inputs(strings(), database()), 90, silent=20.0)
    assert later.y[0] == pytest.approx(25.0 + 8.96, abs=0.02)
    assert isnan(later.y[5])
    assert later.age[5] == 0.0
    assert later.quality[5] == Quality.STALE


def test_one_string_is_taken_out_of_all() -> None:
    r = told(Inputs(strings(), database()))
    one = r[2]
    assert (one.means.I, one.means.I2, one.means.I_abs) == tuple(r.means[[0, 1, 4], 2])
    assert (one.current_quality, one.inlet, one.slow["soc"]) == (Quality.GOOD, r.inlet[2], r.slow["soc"][2])
    assert isnan(one.slow["coolant_flow"])
    assert one.y.tolist()[2] == r.y[10]
    assert one.age.tolist()[2] == r.age[10]
    assert one.quality.tolist() == r.quality[8:12].tolist()
    assert one.cells is None
    assert r[1].slow["coolant_flow"] == 2e-4
    pairs = replace(r, cells=["a", "b", "c", None])
    assert [pairs[i].cells for i in range(4)] == ["a", "b", "c", None]


def test_strings_with_a_sensor_of_a_quality_are_told() -> None:
    r = told(Inputs(strings(), database()))
    assert r.seen(np.uint8(Quality.GOOD)).tolist() == [True, True, True, False]
    later = told(Inputs(strings(), database()), 90, silent=20.0)
    assert later.seen(np.uint8(Quality.GOOD)).tolist() == [True, False, True, False]
    assert later.seen(np.uint8(Quality.STALE)).tolist() == [False, True, False, False]


def test_wires_say_where_each_quantity_stands_and_the_same_signal_stands_once() -> None:
    inputs = Inputs(strings(), database())
    one, two, three, blind = inputs.wires
    assert one.current == two.current != three.current >= 0  # another scale is another input
    assert one.whole["coolant_inlet"] == three.whole["coolant_inlet"] >= 0
    assert (one.voltage >= 0, two.voltage, three.voltage) == (True, -1, -1)
    assert (one.whole["soc"], two.whole["soc"], three.whole["soc"] >= 0) == (-1, -1, True)
    assert (two.whole["coolant_inlet"], two.whole["coolant_flow"], two.constants) == (
        -1,
        -1,
        {"coolant_inlet": 18.5, "coolant_flow": 2e-4},
    )
    assert [np.flatnonzero(w.surface >= 0).tolist() for w in inputs.wires] == [[0, 3], [1], [2], []]
    assert (blind.current, blind.whole["coolant_inlet"], list(blind.constants)) == (-1, -1, ["coolant_inlet"])
    assert isnan(blind.constants["coolant_inlet"])
    every = [i for i in one.whole.values() if i >= 0] + [three.current, three.whole["soc"]]
    every += [i for w in inputs.wires for i in w.surface.tolist() if i >= 0]
    assert sorted(every) == list(range(10))
    assert np.isin(frames(put(1)).can_id, inputs.can_ids).all()


def test_frames_that_carry_no_input_are_left_out_and_others_not_even_copied() -> None:
    inputs, some = Inputs(strings(), database()), frames(put(2))
    assert inputs.wanted(some) is some
    strange = some.can_id.copy()
    strange[[0, 5]] = 1, 0xFFFF_FFFF
    rest = inputs.wanted(FrameBatch(some.time_ns, strange, some.length, some.data))
    keep = np.setdiff1d(np.arange(len(some)), [0, 5])
    for name in ("time_ns", "can_id", "length", "data"):
        np.testing.assert_array_equal(getattr(rest, name), getattr(some, name)[keep])


@pytest.mark.parametrize(("flows", "active"), [(0.0, False), (1.0, False), (-1.1, True), (nan, False)])
def test_sensors_are_suspected_while_more_than_an_ampere_flows(flows: float, active: bool) -> None:
    made = Integrals(Wiring.of(strings()).wires[:1], [0.001] * 10)
    (wire,) = Wiring.of(strings()).wires[:1]
    at = START + np.arange(10, dtype=np.int64) * S // 10
    samples = Samples(at, np.full(10, wire.current), np.full(10, flows), np.zeros(10, np.uint8))
    quality = np.full(10, Quality.GOOD if np.isfinite(flows) else Quality.ERROR, np.uint8)
    made.update(samples, quality, np.full(10, Quality.GOOD, np.uint8), START, START + S)
    assert made.active == active


def test_what_the_guard_let_pass_is_kept_beside_all_that_came() -> None:
    inputs = Inputs(strings(), database())
    taken, good = inputs.good
    assert [len(x) for x in (taken.time_ns, taken.input, taken.value, taken.flag, good)] == [0] * 5
    content = put(20)
    wild = [(t, m, s, x, 140.0 if s == "surface_01" and t == 19.6 else v) for t, m, s, x, v in content]
    ticks(inputs, wild, 20)
    taken, good = inputs.good
    wire = inputs.wires[0].surface[0]
    assert taken.value[(taken.input == wire)].tolist() == pytest.approx([140.0])
    assert not good[taken.input == wire].any()
    assert good[taken.input != wire].all()
    assert inputs.rejected == {"jumpy": 1, "never": 4}  # the first of each surface, which had not yet moved


def test_inputs_that_never_came_are_told_by_the_string_that_first_names_them() -> None:
    inputs = Inputs(strings(), database())
    ticks(inputs, [x for x in put(2) if x[1] != "string_1_electrical" and not x[1].startswith("string_3")], 2)
    assert inputs.unheard() == {
        "string_1": f"{own_signal(1, 'current')}, {own_signal(1, 'voltage')}",
        "string_3": f"{own_signal(1, 'current')}, {own_signal(3, 'soc')}, {own_signal(3, 'surface', 3)}",
    }


def test_after_a_gap_nothing_of_before_is_held() -> None:
    inputs = Inputs(strings(), database())
    ticks(inputs, put(20), 20)
    inputs.forget()
    content = [(t, *x) for t, *x in put(22) if t >= 20.7]
    (r,) = ticks(inputs, content, 1, 20)
    assert np.isnan(r.means[:2]).all()  # three tenths of a second are too little
    assert isnan(r.inlet[0])  # no line goes on
    kept = Inputs(strings(), database())
    ticks(kept, put(20), 20)
    (r,) = ticks(kept, content, 1, 20)
    assert np.isfinite(r.means[:2, 0]).all()
    assert np.isfinite(r.inlet[0])


def with_first(quantity: str) -> Plan:
    """The first string alone, one of its channels named before all others."""
    one = strings().strings[0]
    ordered = sorted(one.channels, key=lambda c: c.quantity != quantity)
    return Plan((replace(one, channels=tuple(ordered)),))


@pytest.mark.parametrize("quantity", ["current", "voltage", "coolant_inlet", "coolant_flow", "surface"])
def test_the_order_in_which_channels_are_named_makes_no_difference(quantity: str) -> None:
    inputs, usual = Inputs(with_first(quantity), database()), Inputs(with_first("current"), database())
    got, expected = told(inputs), told(usual)
    for name in ("means", "current_quality", "y", "age", "quality"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
    np.testing.assert_array_equal([*got.slow.values()], [*expected.slow.values()])
    assert np.isfinite(got.means).all()


@pytest.mark.parametrize("quantity", ["current", "voltage"])
def test_a_voltage_that_rises_with_the_current_makes_no_heat(quantity: str) -> None:
    inputs = Inputs(with_first(quantity), database())
    r = told(inputs, 60, current=lambda t: -amps(t))
    assert np.isnan(r.means[[2, 3]]).all()
    assert np.isfinite(r.means[[0, 1, 4]]).all()


def test_cells_are_identified_by_the_windowed_method_where_there_are_several_and_no_effects() -> None:
    one = strings().strings[0]
    assert identifies_cells(one)
    assert not identifies_cells(replace(one, identify="rls"))
    assert not identifies_cells(replace(one, identify="off"))
    assert not identifies_cells(replace(one, model=replace(one.model, effects=(FALLING,))))
    assert identifies_cells(replace(one, model=replace(one.model, cells=2, sensors=(1, 2))))
    priors = {k: p for k, p in one.model.priors.items() if k not in ("R_cc", "C_f")}
    single = replace(one.model, cells=1, sensors=(1,), condition="single", priors=priors)
    assert not identifies_cells(replace(one, model=single))


def hearing(identify: str) -> Inputs:
    """The first string with the voltages of its second and third cell, named before its surfaces."""
    one = strings().strings[0]
    cells = tuple(Channel("cell_voltage", k, own_signal(1, "cell_voltage", k)) for k in (2, 3))
    return Inputs(
        Plan((replace(one, channels=(*one.channels[:4], *cells, *one.channels[4:]), identify=identify),)), database()
    )


def test_voltages_of_cells_meet_the_current_of_their_instants() -> None:
    inputs = hearing("window")
    (wire,) = inputs.wires
    assert np.flatnonzero(wire.cell_voltage >= 0).tolist() == [1, 2]
    assert np.flatnonzero(wire.surface >= 0).tolist() == [0, 3]
    content = put(3)
    message, where = (
        own_signal(1, "cell_voltage", 2).split(".")[0],
        database().resolve(own_signal(1, "cell_voltage", 2)),
    )
    names = {k: own_signal(1, "cell_voltage", k).split(".")[1] for k in (2, 3)}
    assert where.can_id in inputs.can_ids.tolist()
    content += [(2.5, message, names[2], 0, 3.31), (2.5, message, names[3], 0, 3.35)]
    (pairs,) = ticks(inputs, sorted(content, key=lambda x: x[0]), 3)[-1].cells
    assert pytest.approx([nan, 3.31, 3.35, nan], abs=1e-3, nan_ok=True) == pairs.V
    assert pytest.approx([nan, amps(2.5), amps(2.5), nan], abs=0.01, nan_ok=True) == pairs.I


def test_voltages_of_cells_that_nobody_asks_for_are_passed_over() -> None:
    inputs = hearing("rls")
    (wire,) = inputs.wires
    assert (wire.cell_voltage == -1).all()
    assert np.flatnonzero(wire.surface >= 0).tolist() == [0, 3]
    assert database().resolve(own_signal(1, "cell_voltage", 2)).can_id not in inputs.can_ids.tolist()


@pytest.mark.parametrize("gap", [True, False])
def test_a_voltage_of_a_cell_meets_no_current_of_before_a_gap(gap: bool) -> None:
    inputs = hearing("window")
    message, name = own_signal(1, "cell_voltage", 2).split(".")
    ticks(inputs, put(3), 3)
    if gap:
        inputs.forget()
    (pairs,) = ticks(inputs, [(3.1, message, name, 0, 3.31)], 1, 3)[0].cells
    assert (pairs is None) == gap
    assert gap or pairs.I[1] == pytest.approx(amps(2.9), abs=0.01)


def test_a_channel_of_one_cell_is_none_of_its_voltages_unless_it_says_so() -> None:
    one = strings().strings[0]
    odd = Channel("voltage", 2, own_signal(1, "voltage"))
    inputs = Inputs(
        Plan((replace(one, channels=(odd, *(c for c in one.channels if c.quantity != "voltage"))),)), database()
    )
    assert inputs.wires[0].voltage == -1
    assert (inputs.wires[0].cell_voltage == -1).all()
    assert inputs.wires[0].of(odd) == -1


def test_a_reading_stamped_with_the_start_of_a_tick_is_one_of_that_tick() -> None:
    content = [(float(k), "string_1_surface", "surface_01", 0, 25.0 + 0.1 * k) for k in range(4)]
    _, *later = ticks(Inputs(strings(), database()), content, 4)  # at first it has not been seen to move
    assert [r.y[0] for r in later] == pytest.approx([25.1, 25.2, 25.3], abs=0.05)
    assert [r.age[0] for r in later] == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("gaps", [False, True])
def test_a_step_over_a_gap_says_nothing_of_the_sign_of_the_current(gaps: bool) -> None:
    """Current and voltage rise and fall together from tick to tick, as with a wrong sign; within a tick they stand."""
    inputs = Inputs(strings(), database())
    signs = []
    for k in range(60):
        both = [(k + x / 10, "string_1_electrical", x) for x in range(10)]
        content: Put = [(t, name, "current", None, 10.0 + 40.0 * (k % 2)) for t, name, _ in both]
        content += [(t, name, "voltage", None, 13.0 + 0.5 * (k % 2)) for t, name, _ in both]
        ticks(inputs, content, 1, first=k)
        signs += [n for n in inputs.changes(START + (k + 1) * S) if n.code == "current_sign"]
        if gaps:
            inputs.forget()
    assert bool(signs) != gaps
