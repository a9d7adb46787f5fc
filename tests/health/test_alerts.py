"""Alerts neither come too early nor flap, and one line tells the state."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.health.alerts import Alerts, Condition, Severity


def plug(severity=Severity.WARNING, **more):
    return Condition("sensor", severity, "surface of cell 3 not used", "string_1", 3, **more)


def test_nothing_is_raised_in_the_grace_time_and_what_is_still_wrong_afterwards_is():
    alerts = Alerts(grace_s=10.0, hold_s=3.0)
    alerts.begin(0.0)
    assert [alerts.update(t, [plug(), plug(part="b", settled=True)]) for t in range(10)] == [[]] * 10
    assert alerts.line == "OK"
    assert [c.raised for c in alerts.update(10.0, [plug(), plug(part="b", settled=True)])] == [True, True]


def test_a_signal_that_estimates_do_without_is_told_last():
    alerts = Alerts(grace_s=0.0, hold_s=0.0)
    voltage, inlet, hot = plug(part="voltage", minor=True), plug(part="coolant_inlet"), plug(Severity.ALARM, part="hot")
    for t, now in enumerate(([voltage], [voltage, inlet], [voltage, inlet, hot])):
        alerts.update(float(t), now)
    assert alerts.raised == [hot, inlet, voltage]


def test_a_second_grace_time_holds_back_new_alerts_and_keeps_old_ones():
    alerts = Alerts(grace_s=10.0, hold_s=0.0)
    old, new = plug(), plug(part="new")
    assert len(alerts.update(0.0, [old])) == 1
    alerts.begin(1.0)
    assert alerts.update(2.0, [old, new]) == []
    assert alerts.raised == [old]
    assert [c.condition for c in alerts.update(11.0, [old, new])] == [new]


def test_a_rattling_plug_is_no_alert_and_one_good_reading_ends_none():
    alerts = Alerts(hold_s=3.0, clear_s=10.0)
    for t in range(20):
        assert alerts.update(t, [plug()] if t % 3 else []) == []
    alerts.update(20.0, [])
    for t in range(60, 64):
        changes = alerts.update(t, [plug()])
    assert [c.raised for c in changes] == [True]
    for t in range(64, 104):  # again and again good for a moment
        assert alerts.update(t, [plug()] if t % 5 == 0 else []) == []
    ended = [t for t in range(104, 130) if alerts.update(t, [])]
    assert ended == [110]
    assert alerts.line == "OK"


def test_an_alert_that_becomes_an_alarm_is_told_again_and_comes_first():
    alerts = Alerts(hold_s=0.0)
    other = Condition("loss", Severity.WARNING, "9 frames lost", settled=True)
    assert len(alerts.update(0.0, [other, plug()])) == 2
    assert alerts.line == "WARNING: 9 frames lost (and 1 more)"
    assert [c.condition.severity for c in alerts.update(1.0, [other, plug(Severity.ALARM)])] == [Severity.ALARM]
    assert (alerts.severity, alerts.line) == (
        Severity.ALARM,
        "ALARM: string_1: surface of cell 3 not used (and 1 more)",
    )
    assert [c.raised for c in alerts.update(2.0, [plug(Severity.ALARM)])] == [False]


def test_a_phase_that_comes_and_goes_is_told_once_it_has_stayed_and_no_more_often_than_every_thirty_seconds():
    for period, least, most in ((2, 0, 0), (12, 3, 20), (100, 6, 6)):
        alerts, told = Alerts(grace_s=0.0, hold_s=3.0), []
        for t in range(600):
            phase = "unseen" if t % period >= period // 2 else ""
            told += [t for _ in alerts.update(float(t), [plug(Severity.ALARM, phase=phase)])]
        assert least <= len(told) - 1 <= 2 * most
        assert min(np.diff(told), default=30) >= 30


@settings(deadline=None)
@given(st.lists(st.sampled_from([(), ("a",), ("b",), ("a", "b")]), max_size=200), st.integers(0, 5), st.integers(0, 5))
def test_every_raise_is_followed_by_its_end_before_the_next(steps, hold, clear):
    alerts, up = Alerts(grace_s=0.0, hold_s=hold, clear_s=clear), set()
    for t, names in enumerate(steps):
        for change in alerts.update(float(t), [plug(part=name) for name in names]):
            part = change.condition.part
            assert (part in up) is not change.raised
            (up.add if change.raised else up.discard)(part)
        assert {c.part for c in alerts.raised} == up
        assert (alerts.line == "OK") is not up or not up
