"""What the engine tells beside its estimates: faults of sensors and of time, counts, and what was asked for."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.engine import Channel, Engine, Estimated, Notice, Parameters, Plan, SendFrames, drain, drive
from bms_gateway.engine.estimators import Estimators
from bms_gateway.engine.events import Decoded, Judged, Level
from bms_gateway.engine.inputs import Inputs
from bms_gateway.errors import ConfigError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.own_dbc import own_signal
from bms_gateway.frames.quality import Quality
from bms_gateway.health.string_health import Change, HealthResult, StringHealth
from bms_gateway.thermal import AddedEffect
from tests.engine.packs import EPOCH_S, SENSORS, database, plan
from tests.engine.told_strings import MESSAGES, S, commissioned, drawn, said, warm, with_channels
from tests.frames.payloads import OWN, parsed

VOLTAGE = Channel("voltage", None, own_signal(1, "voltage"))


def notices(events: list, code: str) -> list[tuple[int, Level, str]]:
    return [(e.time_ns // S - EPOCH_S, e.level, e.text) for e in events if isinstance(e, Notice) and e.code == code]


def states(events: list) -> dict[int, int]:
    """State that the status frame says, by second."""
    message = parsed(OWN).get_message_by_name("gateway_status")
    found = {}
    for e in events:
        if isinstance(e, SendFrames):
            for can_id, data in zip(e.batch.can_id.tolist(), e.batch.data, strict=True):
                if can_id & 0x1FFF_FFFF == message.frame_id:
                    found[e.time_ns // S - EPOCH_S] = message.decode(bytes(data), decode_choices=False)["state"]
    return found


STARTING, RUNNING, DEGRADED, SILENT = range(4)


def test_a_current_that_stands_while_the_voltage_moves_is_refused_told_and_believed_again() -> None:
    frames = said(90, current=lambda t: 20.0 if 20 <= t < 60 else drawn(t))
    engine = Engine(with_channels(VOLTAGE), database())
    events = list(drive(engine, [frames]))
    assert engine.faults == []
    bad, good = notices(events, "sensor")
    signal = own_signal(1, "current")
    assert bad[1:] == (
        Level.WARNING,
        f"current is not used: it stands at 20 A while the voltage moves: stuck, saturated or clipped ({signal})",
    )
    assert good[1:] == (Level.NOTICE, f"current is good again ({signal})")
    assert 20 < bad[0] < 60 <= good[0] < 75
    assert engine.rejected["stuck"] % 10 == 0
    assert engine.rejected["stuck"] >= 10 * (60 - bad[0])
    state = states(events)
    assert (state[1], state[bad[0] - 1], state[bad[0]], state[good[0]]) == (STARTING, RUNNING, DEGRADED, RUNNING)


def test_while_it_is_refused_it_is_among_the_faults() -> None:
    engine = Engine(with_channels(VOLTAGE), database())
    list(drive(engine, [said(50, current=lambda t: 20.0 if t >= 20 else drawn(t))]))
    (fault,) = engine.faults
    assert (fault.string, fault.channel.quantity, fault.quality) == ("string_1", "current", Quality.STUCK)


def test_a_current_of_the_wrong_sign_is_told_and_taken_back() -> None:
    engine = Engine(with_channels(VOLTAGE), database())
    events = list(drive(engine, [said(200, current=lambda t: -drawn(t) if t < 60 else drawn(t))]))
    wrong, right = notices(events, "current_sign")
    assert wrong[1] == Level.WARNING
    assert wrong[2].startswith("current and voltage rise together: the sign of the current is wrong")
    assert right[1] == Level.NOTICE
    assert "move against each other again" in right[2]
    assert own_signal(1, "current") in wrong[2]
    assert wrong[0] <= 15
    assert right[0] > 60


def test_what_was_asked_for_is_told_at_every_tick_and_nothing_else() -> None:
    frames = said(8)
    plain = list(drive(Engine(with_channels(VOLTAGE), database()), [frames]))
    assert not [e for e in plain if isinstance(e, Decoded | Judged)]
    engine = Engine(with_channels(VOLTAGE), database())
    engine.recording = engine.judging = True
    events = list(drive(engine, [frames]))
    decoded, judged = ([e for e in events if isinstance(e, kind)] for kind in (Decoded, Judged))
    ticks = [e.time_ns for e in events if isinstance(e, Estimated)]
    assert [e.time_ns for e in decoded] == [e.time_ns for e in judged] == ticks
    wire = engine.wires[0]
    amps = np.concatenate([e.value[e.input == wire.current] for e in decoded])
    assert amps == pytest.approx([drawn(k / 10) for k in range(10 * len(ticks))], abs=6e-4)
    stamps = np.concatenate([e.sample_ns for e in decoded])
    assert stamps.min() == EPOCH_S * S
    last = judged[-1]
    (one,) = last.strings
    squares = [drawn(k / 10) ** 2 for k in range(10 * len(ticks) - 10, 10 * len(ticks))]
    assert one.string == "string_1"
    assert one.square == pytest.approx(np.mean(squares), rel=1e-4)
    assert one.current == pytest.approx(drawn(len(ticks) - 1), rel=1e-4)
    assert one.inlet == pytest.approx(20.0 + 0.02 * len(ticks), abs=0.02)
    assert np.isfinite(one.innovation).tolist() == [k in SENSORS for k in range(1, 5)]
    assert one.flags == ()
    assert last.frames == 13 * len(ticks)


def test_repeated_frames_and_unknown_multiplexer_values_are_counted_at_their_tick() -> None:
    frames = said(6)
    first = np.flatnonzero(frames.can_id == frames.can_id[0])[7]
    order = np.sort(np.append(np.arange(len(frames)), [first, first]))
    twice = FrameBatch(frames.time_ns[order], frames.can_id[order], frames.length[order], frames.data[order])
    surfaces = np.flatnonzero(twice.can_id == database().message("string_1_surface").can_id)
    twice.length[surfaces[2]] = 1
    engine = Engine(with_channels(VOLTAGE), database())
    list(drive(engine, [twice]))
    assert engine.rejected["repeated"] == 2
    assert engine.rejected["unknown_multiplexer"] == 1


def test_constants_stand_in_for_what_the_bus_does_not_carry() -> None:
    cold, hot = (
        Engine(with_channels(Channel("coolant_inlet", None, None, C), without=("coolant_inlet",)), database())
        for C in (10.0, 30.0)
    )
    for engine in (cold, hot):
        engine.judging = True
    told = [[e for e in drive(engine, [said(8)]) if isinstance(e, Judged)] for engine in (cold, hot)]
    assert {e.strings[0].inlet for e in told[0]} == {10.0}
    assert {e.strings[0].inlet for e in told[1]} == {30.0}
    unknown = Channel("coolant_inlet", None, None, None)
    engine = Engine(with_channels(unknown, without=("coolant_inlet",)), database())
    engine.judging = True
    assert all(np.isnan(e.strings[0].inlet) for e in drive(engine, [said(3)]) if isinstance(e, Judged))


def test_a_pack_current_that_strings_share_is_one_input() -> None:
    one = with_channels()
    second = replace(one.strings[0], name="string_2", number=2)
    engine = Engine(Plan((one.strings[0], second)), database())
    assert engine.wires[0].current == engine.wires[1].current
    told = [e.strings() for e in drive(engine, [said(8)]) if isinstance(e, Estimated)]
    assert len(told) == 7
    for a, b in told:
        np.testing.assert_array_equal(a.core, b.core)


def test_a_scale_and_an_offset_mend_a_signal() -> None:
    mended = Channel("coolant_inlet", None, own_signal(1, "coolant_inlet"), scale=2.0, offset=-5.0)
    engine = Engine(with_channels(mended, without=("coolant_inlet",)), database())
    engine.judging = True
    last = [e for e in drive(engine, [said(12)]) if isinstance(e, Judged)][-1]
    seconds = last.time_ns // S - EPOCH_S
    assert last.strings[0].inlet == pytest.approx(2.0 * (20.0 + 0.02 * seconds) - 5.0, abs=0.03)


def test_inputs_that_never_come_are_told_once_after_ten_seconds() -> None:
    frames = said(30)
    surface = database().message("string_1_surface").can_id
    keep = frames.can_id != surface
    some = FrameBatch(frames.time_ns[keep], frames.can_id[keep], frames.length[keep], frames.data[keep])
    soc = Channel("soc", None, own_signal(2, "soc"))  # decoded for the record alone: nobody is told
    engine = Engine(with_channels(soc), database())
    events = list(drive(engine, [some]))
    missing = ", ".join(own_signal(1, "surface", k) for k in SENSORS)
    assert notices(events, "unheard") == [(10, Level.WARNING, f"not received so far: {missing}")]
    assert engine.unheard == {"string_1": missing}
    assert engine.faults == []
    assert set(states(events).values()) == {STARTING}


def test_stamps_that_step_back_are_told_and_counted_and_time_goes_on() -> None:
    frames = said(10)
    back = frames.time_ns - np.where(np.arange(len(frames)) >= 65, 3600 * S, 0)
    engine = Engine(with_channels(), database())
    events = list(drive(engine, [FrameBatch(back, frames.can_id, frames.length, frames.data)]))
    ((_, level, text),) = notices(events, "clock")
    assert (level, text) == (Level.WARNING, "time stamps: clock set back 1×")
    assert engine.clock_faults == "clock set back 1×"
    assert engine.clock_counts == {"reordered": 0, "set_back": 1, "absurd": 0}
    assert 9.0 <= engine.duration_s <= 10.0


def test_what_an_engine_is_can_be_asked_before_the_first_frame() -> None:
    the_plan = with_channels(VOLTAGE)
    engine = Engine(the_plan, database())
    assert engine.plan is the_plan
    assert engine.duration_s == 0.0
    assert engine.next_deadline() is None
    assert set(engine.can_ids.tolist()) == {database().message(m).can_id for m in MESSAGES}
    parts = ("core", "summary", "hottest", "parameters", "health", "flags", "growth", "heat", "forecast")
    ours = {f"string_1_{p}" for p in parts}
    assert set(engine.sends) == {
        m.can_id for m in database().messages.values() if m.name.startswith("gateway_") or m.name in ours
    }
    assert set(engine.sends.values()) <= {S, 10 * S}


def test_one_that_only_listens_sends_nothing() -> None:
    engine = Engine(replace(with_channels(), transmit=False), database())
    assert engine.sends == {}
    events = list(drive(engine, [said(5)]))
    assert [e for e in events if isinstance(e, Estimated)]
    assert not [e for e in events if isinstance(e, SendFrames)]


def test_results_of_jobs_that_nobody_waits_for_are_passed_over() -> None:
    engine = Engine(with_channels(), database())
    assert not engine.awaits(1)
    engine.finish(1, object())
    assert engine.next_output() is None


def test_a_baseline_is_reset_for_strings_and_cells_that_there_are_and_once_for_each_wish() -> None:
    engine = Engine(with_channels(), database())
    with pytest.raises(ConfigError, match="there is no string 'string_9'; did you mean 'string_1'"):
        engine.reset_baseline("string_9", None, "new", time_ns=1)
    for cell in (0, 5):
        with pytest.raises(ConfigError, match=rf"there is no cell {cell} in string_1; valid: 1 to 4"):
            engine.reset_baseline("string_1", cell, "new", time_ns=1)
    for cell, when in ((None, 5), (1, 6), (4, 7)):
        done = engine.reset_baseline("string_1", cell, "cells replaced", time_ns=when)
        told = [e for e in drain(engine) if isinstance(e, Notice)]
        assert [(e.code, e.level, e.string, e.cell, e.time_ns) for e in told] == (
            [("baseline", Level.NOTICE, "string_1", cell, when)] if done else []
        )
        assert not engine.reset_baseline("string_1", cell, "cells replaced", time_ns=when)
        assert not list(drain(engine))


def test_frames_stamped_after_now_are_taken_as_now_and_those_before_a_fired_timer_as_of_the_open_tick() -> None:
    frames = said(3)
    engine = Engine(with_channels(), database())
    now = int(frames.time_ns[5])
    engine.receive(frames[:10], now_ns=now)
    deadline = (EPOCH_S + 1) * S
    engine.handle_timer(now_ns=deadline)
    assert engine.frames == 10
    list(drain(engine))
    engine.receive(frames[10:13], now_ns=deadline + 5)
    engine.handle_timer(now_ns=deadline + S)
    assert engine.frames == 13
    assert {e.time_ns for e in drain(engine)} == {deadline + S}


def test_a_string_is_not_served_by_a_channel_of_one_cell() -> None:
    engine = Engine(with_channels(replace(VOLTAGE, cell=2)), database())
    assert engine.wires[0].voltage == -1


def test_nobody_is_told_of_what_is_only_recorded() -> None:
    frames = said(30)
    coolant = np.flatnonzero(frames.can_id == database().message("string_1_coolant").can_id)
    frames.data[coolant[20:], 3] ^= 0xFF  # from the 21st second on the check sum is wrong
    told = {}
    for wanted in ((), (Channel("soc", None, own_signal(1, "soc")),)):
        engine = Engine(with_channels(*wanted), database())
        events = notices(list(drive(engine, [frames])), "sensor")
        told[len(wanted)] = events, [f.channel.quantity for f in engine.faults]
    assert told[0] == told[1]
    assert told[0][1] == ["coolant_inlet"]
    assert [text.split(" is ")[0] for _, _, text in told[0][0]] == ["coolant inlet"]


def test_ticks_on_which_nothing_is_due_send_nothing() -> None:
    engine = Engine(replace(with_channels(), tick_ns=S // 2), database())
    sent = [e for e in drive(engine, [said(5)]) if isinstance(e, SendFrames)]
    for e in sent:
        assert bool(len(e.batch)) == (e.time_ns % S == 0)
        assert (e.batch.time_ns == e.time_ns).all()
    assert len(sent) == 9


def test_a_parameter_that_nobody_knows_leaves_as_not_available() -> None:
    engine = Engine(with_channels(), database())
    message = parsed(OWN).get_message_by_name("string_1_parameters")
    engine.strings[0].estimates = tuple(e for e in engine.strings[0].estimates if e.name != "R_c")
    content = {}
    for e in drive(engine, [said(12)]):
        if isinstance(e, SendFrames):
            for can_id, data in zip(e.batch.can_id.tolist(), e.batch.data, strict=True):
                if can_id & 0x1FFF_FFFF == message.frame_id:
                    content |= message.decode(bytes(data), decode_choices=False, scaling=False)
    ones = {name: (1 << message.get_signal_by_name(name).length) - 1 for name in content}
    assert {name for name in ("R_e", "R_e_sd", "R_c", "R_c_sd", "R_u") if content[name] == ones[name]} == {
        "R_c",
        "R_c_sd",
    }


def test_after_a_silence_all_goes_on_whatever_was_held_before() -> None:
    """What stopped is told as old, not as standing, and as good again."""
    frames = [said(20), FrameBatch.empty(), said(30, start=900)]
    events = list(drive(Engine(with_channels(VOLTAGE), database()), frames))
    assert [n[2] for n in notices(events, "silent")] == [
        "no wanted frame for 60 s: waiting for the bus, sending nothing"
    ]
    ((when, _, text),) = notices(events, "awake")
    silence_s = (int(frames[-1].time_ns[0]) - int(frames[0].time_ns[-1])) * 1e-9
    assert 880.0 <= silence_s <= 881.0  # the minute before the first word of it is a part of it
    assert (when, text) == (900, f"frames again after {silence_s:.0f} s: state carried over the gap")
    told = [text for _, _, text in notices(events, "sensor")]
    assert len(told) == 10
    assert all("nothing new is received" in text for text in told[:5])
    assert all("is good again" in text for text in told[5:])
    after = [e for e in events if isinstance(e, Estimated)][-1]
    assert np.isfinite(after.core).all()


def stored(the_plan: Plan, seconds: int = 20) -> dict:
    engine = Engine(the_plan, database())
    list(drive(engine, [said(seconds)]))
    return json.loads(json.dumps(engine.snapshot()))


def test_a_clock_that_was_set_back_while_we_were_off_tells_nothing_of_the_time_that_passed() -> None:
    engine = Engine(with_channels(), database())
    engine.restore(stored(with_channels()))
    events = list(drive(engine, [said(15, start=-3600)]))
    ((_, level, text),) = notices(events, "awake")
    assert level == Level.INFO
    assert text == "frames again after a time that the clock does not tell: state carried over the gap"
    assert [e for e in events if isinstance(e, Estimated)][-1].time_ns // S - EPOCH_S == -3600 + 14


FALLING = AddedEffect("resistance_temperature", None, {"B": 3000.0}, {"B": 300.0})


@pytest.mark.parametrize("effects", [(), (FALLING,)])
def test_parameters_outlive_temperatures_that_do_not_belong(effects: tuple[AddedEffect, ...]) -> None:
    one = with_channels().strings[0]
    the_plan = Plan((replace(one, model=replace(one.model, effects=effects)),))
    state = stored(the_plan)
    known = [e["strings"] for e in state["estimators"]["observers"]]
    assert known == [["string_1"]]
    identifier = state["estimators"]["strings"]["string_1"]["identifier"]
    if "mean" in identifier:
        identifier["mean"][identifier["names"].index("R_e")] += 0.1
    state["estimators"]["observers"][0]["strings"] = ["string_7"]
    del state["estimators"]["strings"]["string_1"]["health"]  # as of before it had a memory of its own
    engine = Engine(the_plan, database())
    before = {e.name: e.value for e in engine.strings[0].estimates}
    engine.restore(state)
    assert [e.text for e in drain(engine) if isinstance(e, Notice)] == ["string_1: temperatures start anew"]
    after = {e.name: e.value for e in engine.strings[0].estimates}
    assert after["R_e"] == pytest.approx(before["R_e"] * np.exp(0.1 if "mean" in identifier else 0.0))


def test_a_voltage_that_is_the_mean_of_the_cells_does_as_well_as_their_sum() -> None:
    one = with_channels(VOLTAGE).strings[0]
    the_plan = Plan((replace(one, model=replace(one.model, effects=(FALLING,))),))
    sums, means = (
        [
            e.core
            for e in drive(
                Engine(the_plan, database()), [said(12, voltage=lambda t, n=n: n * round(3.3 - 1e-3 * drawn(t), 4))]
            )
            if isinstance(e, Estimated)
        ]
        for n in (4, 1)
    )
    np.testing.assert_allclose(sums, means, atol=1e-6)


def test_surfaces_that_the_model_cannot_explain_are_told() -> None:
    engine = Engine(Plan((replace(plan(1, rel_sd=0.01).strings[0]),)), database())
    events = list(drive(engine, [said(200, surface=lambda t: warm(t) + 1.2 * (-1) ** int(t))]))
    ((when, level, text),) = notices(events, "mismatch")
    assert level == Level.WARNING
    assert text.startswith("the model does not explain the surfaces")
    assert when > 120  # not in the first two minutes, in which the observer finds the state


def test_what_the_health_of_a_string_finds_is_told_with_its_weight(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [Change("cooling", 1, "cools worse"), Change("ageing", 0, "as it was", 3)]
    monkeypatch.setattr(StringHealth, "accept", lambda *_: found)
    estimators = Estimators(with_channels(), Inputs(with_channels(), database()).wires)
    told = estimators.accept(0, HealthResult(None, 0.0, "", 0.0), 7)
    assert told == [
        Notice(7, Level.WARNING, "cooling", "cools worse", "string_1", None),
        Notice(7, Level.NOTICE, "ageing", "as it was", "string_1", 3),
    ]


def test_commissioning_from_the_first_drives_is_told_and_kept_in_the_history(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(StringHealth, "offer", lambda *_: True)
    by_rls = Plan((replace(with_channels().strings[0], identify="rls"),))
    engine = Engine(by_rls, database())
    ((when, level, text),) = notices(list(drive(engine, [said(45)])), "ageing")
    assert (when, level) == (40, Level.INFO)  # with the first whole minute of bus time
    assert text.startswith("commissioned: from now on growth of R_e is followed")
    assert "commissioned from the first drives" in json.dumps(engine.snapshot())


def test_cells_told_apart_at_commissioning_keep_their_ratio() -> None:
    engine = Engine(commissioned(0.05), database())
    cells = {e.name: e for e in engine.strings[0].estimates if e.name.startswith("R_e_")}
    R = np.array([cells[f"R_e_{k}"].value for k in range(1, 5)])
    assert R / R[0] == pytest.approx(np.array([0.9, 1.0, 1.2, 1.05]) / 0.9)
    common = next(e.value for e in engine.strings[0].estimates if e.name == "R_e")
    assert np.exp(np.mean(np.log(R))) == pytest.approx(common)
    assert all(e.sd > 0.0 and "commissioning" in e.status for e in cells.values())
    alike = Engine(with_channels(), database())
    ours, theirs = ([e.core for e in drive(x, [said(20)]) if isinstance(e, Estimated)][-1] for x in (engine, alike))
    assert ours[2] - ours[1] > theirs[2] - theirs[1] + 0.1  # the one of the highest resistance


def test_a_state_of_another_commissioning_is_not_used() -> None:
    state = stored(commissioned(0.05))
    for error, same in ((0.05, True), (0.06, False)):
        engine = Engine(commissioned(error), database())
        engine.restore(state)
        told = [e.text for e in drain(engine) if isinstance(e, Notice)]
        assert told == ([] if same else ["string_1: new or changed, starts from its model file"])


def test_the_resistance_that_the_voltage_shows_is_told_where_it_makes_the_heat() -> None:
    """Beside a string without a voltage, which keeps to its own."""
    with_voltage, without = with_channels(VOLTAGE).strings[0], plan(2).strings[1]
    both = Plan(tuple(replace(s, identify="rls") for s in (with_voltage, without)))
    frames = said(165, voltage=lambda t: 13.2 - 4 * 5e-3 * drawn(t))
    told = [e for e in drive(Engine(both, database()), [frames]) if isinstance(e, Parameters)]
    last = {e.string: {p.name: p for p in e.estimates} for e in told}
    assert last["string_1"]["R_e"].value == pytest.approx(5e-3, rel=0.05)
    assert last["string_1"]["R_e"].status in ("identified", "learning")
    assert last["string_2"]["R_e"].value == pytest.approx(3.5e-3, rel=0.05)
