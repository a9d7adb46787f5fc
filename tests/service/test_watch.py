"""What the watch calls wrong: causes without their consequences, one sentence each, nothing while all is well."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.bus.port import Link
from bms_gateway.health.alerts import AlertSettings, Severity
from bms_gateway.service.journal import NOTICE
from bms_gateway.service.watch import OLD_S
from bms_gateway.thermal import Posterior
from tests.service.pack import Pack


def prompt():
    return AlertSettings(grace_s=3.0, hold_s=2.0, clear_s=3.0)


def test_a_sound_pack_raises_nothing_from_its_first_second_on():
    pack = Pack(40)
    assert pack.drive(40) == "OK"
    assert pack.changes == []


def test_a_sensor_that_falls_silent_is_one_alert_with_reason_and_remedy_and_it_ends(caplog):
    pack = Pack(45, settings=prompt())
    pack.drive(6)
    with caplog.at_level(logging.INFO):
        line = pack.drive(20, without=["string_2_surface"])
        assert line.startswith(
            "WARNING: string_2: surface of cells 1, 4 not used: nothing new is received (string_2_su"
        )
        assert "check its sender and the wiring" in line
        assert [c.raised for c in pack.changes] == [True]
        assert pack.drive(15) == "OK"
    assert [c.raised for c in pack.changes] == [True, False]
    told = [r for r in caplog.records if getattr(r, "code", "") == "alert-sensor"]
    assert [(r.levelno, r.string) for r in told] == [(logging.WARNING, "string_2"), (NOTICE, "string_2")]


def test_a_lost_current_is_an_alarm():
    pack = Pack(30, settings=prompt())
    pack.drive(6)
    assert pack.drive(20, without=["string_1_electrical"]).startswith("ALARM: string_1: current not used")


def test_a_bus_that_goes_silent_is_not_blamed_on_its_sensors():
    pack = Pack(40, settings=prompt())
    pack.drive(6)
    assert pack.drive(30, without=list(pack.ids)) == "OK"
    assert pack.changes == []


@pytest.mark.parametrize(
    ("link", "says"), [(Link.DOWN, "ip link set can0 up"), (Link.ABSENT, "adapter"), (Link.BUS_OFF, "termination")]
)
def test_a_bus_that_is_gone_is_the_only_alarm_and_its_return_begins_a_new_grace_time(link, says):
    pack = Pack(60, settings=prompt())
    pack.drive(6)
    pack.port.link = link
    line = pack.drive(20, without=list(pack.ids))
    assert line.startswith("ALARM: can0: ")
    assert says in line
    assert len(pack.watch.alerts.raised) == 1
    pack.port.link = Link.UP
    pack.drive(3, without=["string_2_surface"])
    assert all(c.condition.name == "bus" for c in pack.changes)
    assert "surface" in pack.drive(8, without=["string_2_surface"])


def test_inputs_that_never_came_are_told_by_name():
    pack = Pack(12, settings=prompt())
    line = pack.drive(12, without=["string_1_coolant"])
    assert line.startswith("WARNING: string_1: never received: string_1_coolant.coolant_inlet: check the names")


def test_a_hot_point_is_an_alarm_with_a_hysteresis_of_its_own():
    """The limit is of the hottest point: the cores of its string are all below it."""
    pack = Pack(40, settings=prompt())
    pack.drive(6)
    hottest = max(float(np.nanmax(s.centre)) for s in pack.engine.strings)
    pack.limit(core_max_C=hottest - 0.05)
    assert all(float(np.nanmax(s.core)) < hottest - 0.05 for s in pack.engine.strings)
    line = pack.drive(6)
    assert line.startswith("ALARM: string_")
    assert "hottest point of cell" in line
    assert "°C), the limit is" in line
    hottest = max(float(np.nanmax(s.centre)) for s in pack.engine.strings)
    pack.limit(core_max_C=hottest + 1.0)
    assert pack.drive(6).startswith("ALARM")  # not 2 K below yet
    pack.limit(core_max_C=hottest + 5.0)
    assert pack.drive(6) == "OK"


def test_flags_restored_with_the_state_are_raised_after_the_grace_time():
    pack = Pack(20, settings=prompt())
    ageing = pack.engine.strings[0].health.ageing
    ageing.flag.level, ageing.growth, ageing.growth_sd = 3, 0.31, 0.02
    assert pack.drive(2) == "OK"
    assert pack.drive(3).startswith("ALARM: string_1: resistance growth +31 ± 4 % since commissioning: alarm")
    pack.engine.strings[1].health.mismatch.flag.level = 1
    pack.drive(1)
    assert [c.name for c in pack.watch.alerts.raised] == ["ageing", "mismatch"]


def test_lost_and_foreign_frames_stay_an_alert_for_a_minute_and_are_added_up():
    pack = Pack(10, settings=AlertSettings(grace_s=0.0))
    pack.drive(3)
    pack.port.counters.dropped = 7
    assert pack.drive(1).startswith("WARNING: 7 frames lost in the kernel")
    pack.port.counters.dropped = 9
    assert pack.drive(1).startswith("WARNING: 9 frames lost in the kernel")
    pack.port.counters.impostors = 1
    assert pack.drive(1).startswith("ALARM: 1 frame with identifiers of this node")
    now = float(pack.start + pack.at)
    pack.watch.look(now + 57)
    assert pack.watch.alerts.severity is Severity.ALARM
    pack.watch.look(now + 61)
    assert pack.watch.alerts.line == "OK"


def test_a_state_that_cannot_be_saved_and_a_part_that_failed_are_told():
    pack = Pack(10, settings=prompt())
    pack.gateway.tally.save_problem = "/var/lib/bms-gateway: the state cannot be saved: No space left on device"
    pack.gateway.tally.failed_parts["mqtt"] = "KeyError: 'x'"
    line = pack.drive(8)
    assert [c.name for c in pack.watch.alerts.raised] == ["part", "state"]
    assert line == "WARNING: mqtt has failed (KeyError: 'x'): restart the service (and 1 more)"


def test_an_old_state_and_a_fit_that_is_not_made_are_told():
    pack = Pack(10, settings=prompt())
    pack.drive(8)
    now, tally = float(pack.start + pack.at), pack.gateway.tally

    def raised(since_s):
        for second in range(4):  # beyond the hold time
            pack.watch.look(since_s + second)
        return {c.name: c.text for c in pack.watch.alerts.raised}

    tally.saved_s = now - OLD_S + 4.0
    assert raised(now) == {}
    tally.saved_s = now - OLD_S - 60.0
    tally.fit_problems = {3: "it had not ended after 60 s and was killed", 4: "the same"}
    assert raised(now) == {
        "fit": "parameters are not identified further, estimates go on with those known: a fit was not made: "
        "it had not ended after 60 s and was killed (2 fits wait); it is tried again",
        "state": "nothing has been saved (the state on disk is 4 min old); repair this, or the learnt state is lost "
        "at the next stop",
    }
    tally.save_problem = "/x: the state cannot be saved: Input/output error"
    assert raised(now)["state"].startswith(f"{tally.save_problem} (the state on disk is 4 min old); repair this")
    tally.saved_s, tally.save_problem, tally.fit_problems = now, "", {}
    assert raised(now + 4.0) == {}


def test_a_state_kept_unread_is_told_until_a_person_has_seen_to_it():
    pack = Pack(10, settings=prompt())
    kept = ["/x: a stored state could not be read and was kept as state.unread: stop the service and move it back"]
    pack.gateway.unread = lambda: "".join(kept)
    assert pack.drive(8) == f"WARNING: {kept[0]}"
    kept.clear()
    assert pack.drive(2) == "OK"


def test_a_suspended_computer_gets_a_new_grace_time(monkeypatch):
    pack = Pack(30, settings=prompt())
    pack.drive(8)
    asleep = [pack.watch.asleep_s + 3600.0]
    monkeypatch.setattr("bms_gateway.service.watch.slept_s", lambda: asleep[0])
    pack.port.counters.dropped = 3
    assert pack.drive(3) == "OK"
    assert pack.drive(1).startswith("WARNING: 3 frames lost")


def test_a_string_whose_core_is_not_proven_is_a_warning_with_why_and_what_to_do():
    pack = Pack(30, settings=prompt())
    first = pack.engine.strings[0].plan
    why = ("The model does not explain the surfaces: it needs an error of its own of 0.2 K.", "R_c ends at its bound.")
    model = replace(first.model, posterior=Posterior(*first.model.free_numbers, not_proven=why))
    pack.engine.strings[0].plan = replace(first, model=model)
    line = pack.drive(10)
    assert line.startswith("WARNING: string_1: cores not proven, sent as doubtful: The model does not explain")
    assert "(and 1 more)" in line
    assert "diagnose" in line
    (change,) = pack.changes
    assert (change.condition.name, change.condition.severity, change.raised) == ("unproven", Severity.WARNING, True)
    pack.engine.strings[0].plan = first
    assert pack.drive(5) == "OK"
