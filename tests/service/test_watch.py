"""What the watch calls wrong: causes without their consequences, one sentence each, nothing while all is well."""

import logging

import numpy as np
import pytest

from bms_gateway.bus.port import Link
from bms_gateway.service.alerts import Alerts, Severity
from bms_gateway.service.journal import NOTICE
from tests.service.pack import Pack


def prompt():
    return Alerts(grace_s=3.0, hold_s=2.0, clear_s=3.0)


def test_a_sound_pack_raises_nothing_from_its_first_second_on():
    pack = Pack(40)
    assert pack.drive(40) == "OK"
    assert pack.changes == []


def test_a_sensor_that_falls_silent_is_one_alert_with_reason_and_remedy_and_it_ends(caplog):
    pack = Pack(45, alerts=prompt())
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
    pack = Pack(30, alerts=prompt())
    pack.drive(6)
    assert pack.drive(20, without=["string_1_electrical"]).startswith("ALARM: string_1: current not used")


def test_a_bus_that_goes_silent_is_not_blamed_on_its_sensors():
    pack = Pack(40, alerts=prompt())
    pack.drive(6)
    assert pack.drive(30, without=list(pack.ids)) == "OK"
    assert pack.changes == []


@pytest.mark.parametrize(
    ("link", "says"), [(Link.DOWN, "ip link set can0 up"), (Link.ABSENT, "adapter"), (Link.BUS_OFF, "termination")]
)
def test_a_bus_that_is_gone_is_the_only_alarm_and_its_return_begins_a_new_grace_time(link, says):
    pack = Pack(60, alerts=prompt())
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
    pack = Pack(12, alerts=prompt())
    line = pack.drive(12, without=["string_1_coolant"])
    assert line.startswith("WARNING: string_1: never received: string_1_coolant.coolant_inlet: check the names")


def test_a_hot_core_is_an_alarm_with_a_hysteresis_of_its_own():
    pack = Pack(40, alerts=prompt())
    pack.drive(6)
    hottest = max(float(np.nanmax(s.core)) for s in pack.engine.strings)
    pack.watch.core_max_C = hottest - 0.5
    line = pack.drive(6)
    assert line.startswith("ALARM: string_")
    assert "°C, the limit is" in line
    hottest = max(float(np.nanmax(s.core)) for s in pack.engine.strings)
    pack.watch.core_max_C = hottest + 1.0
    assert pack.drive(6).startswith("ALARM")  # not 2 K below yet
    pack.watch.core_max_C = hottest + 5.0
    assert pack.drive(6) == "OK"


def test_flags_restored_with_the_state_are_raised_after_the_grace_time():
    pack = Pack(20, alerts=prompt())
    ageing = pack.engine.strings[0].health.ageing
    ageing.flag.level, ageing.growth, ageing.growth_sd = 3, 0.31, 0.02
    assert pack.drive(2) == "OK"
    assert pack.drive(3).startswith("ALARM: string_1: resistance growth +31 ± 2 % since commissioning: alarm")
    pack.engine.strings[1].health.mismatch.flag.level = 1
    pack.drive(1)
    assert [c.name for c in pack.watch.alerts.raised] == ["ageing", "mismatch"]


def test_lost_and_foreign_frames_stay_an_alert_for_a_minute_and_are_added_up():
    pack = Pack(10, alerts=Alerts(grace_s=0.0))
    pack.drive(3)
    pack.port.counters.dropped = 7
    assert pack.drive(1).startswith("WARNING: 7 frames lost in the kernel")
    pack.port.counters.dropped = 9
    assert pack.drive(1).startswith("WARNING: 9 frames lost in the kernel")
    pack.port.counters.impostors = 1
    assert pack.drive(1).startswith("ALARM: 1 frames with identifiers of this node")
    now = float(pack.start + pack.at)
    pack.watch.look(now + 57)
    assert pack.watch.alerts.severity is Severity.ALARM
    pack.watch.look(now + 61)
    assert pack.watch.alerts.line == "OK"


def test_a_state_that_cannot_be_saved_and_a_part_that_failed_are_told():
    pack = Pack(10, alerts=prompt())
    pack.gateway.tally.save_problem = "/var/lib/bms-gateway: the state cannot be saved: No space left on device"
    pack.gateway.tally.failed_parts["mqtt"] = "KeyError: 'x'"
    line = pack.drive(8)
    assert [c.name for c in pack.watch.alerts.raised] == ["part", "state"]
    assert line == "WARNING: mqtt has failed (KeyError: 'x'): restart the service (and 1 more)"


def test_a_suspended_computer_gets_a_new_grace_time(monkeypatch):
    pack = Pack(30, alerts=prompt())
    pack.drive(8)
    asleep = [pack.watch._asleep_s + 3600.0]
    monkeypatch.setattr("bms_gateway.service.watch._asleep_s", lambda: asleep[0])
    pack.port.counters.dropped = 3
    assert pack.drive(3) == "OK"
    assert pack.drive(1).startswith("WARNING: 3 frames lost")
