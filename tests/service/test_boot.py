"""A service that starts again in the same boot knows how long it was off, whatever the wall clock shows."""

import json
import time

import pytest

from bms_gateway.bus import clock
from bms_gateway.service import boot
from bms_gateway.service.boot import BOOT_ID_GIVEN, boot_id, noted, on_this_line

SECOND = 10**9
TODAY = 1_700_000_000 * SECOND


@pytest.fixture
def clocks(monkeypatch):
    """Wall clock and time since boot, ns, as they are to be, in a boot that is called `one`."""
    now = {"wall": TODAY, "boot": 500 * SECOND}
    monkeypatch.setattr(time, "time_ns", lambda: now["wall"])
    monkeypatch.setattr(boot, "boot_ns", lambda: now["boot"])
    monkeypatch.setenv(BOOT_ID_GIVEN, "one")
    return now


def stored(bus_ns, tick_end_ns):
    return json.loads(json.dumps({"version": 1, "tick_end_ns": tick_end_ns, "clock": noted(bus_ns)}))


@pytest.mark.parametrize("set_s", [0, 3600, -3600, -1_600_000_000])
@pytest.mark.parametrize("before_s", [0, -7200])
def test_the_gap_is_that_of_the_steady_clock(clocks, set_s, before_s):
    """Bus time was off the wall clock already when the state was saved, and the wall clock is set once more."""
    bus_ns = clocks["wall"] + before_s * SECOND
    state = stored(bus_ns, bus_ns - 3 * SECOND)
    clocks["boot"] += 20 * SECOND
    clocks["wall"] += (20 + set_s) * SECOND
    moved, sure = on_this_line(state)
    assert sure
    assert clocks["wall"] - moved["tick_end_ns"] == 23 * SECOND
    assert {**moved, "tick_end_ns": 0} == {**state, "tick_end_ns": 0}


@pytest.mark.parametrize(
    "clock",
    [None, 3, {}, {"boot": "two", "ahead_ns": 5}, {"boot": "one", "ahead_ns": "5"}, {"boot": "", "ahead_ns": 5}],
)
def test_a_state_of_another_boot_keeps_its_time(clocks, clock):
    state = {"tick_end_ns": TODAY - 5, "clock": clock}
    assert on_this_line(state) == (state, False)
    assert on_this_line({"tick_end_ns": TODAY}) == ({"tick_end_ns": TODAY}, False)
    assert on_this_line({"tick_end_ns": None, "clock": noted(TODAY)})[1] is False


def test_where_nothing_tells_boots_apart_the_wall_clock_counts(clocks, monkeypatch, tmp_path):
    monkeypatch.delenv(BOOT_ID_GIVEN)
    monkeypatch.setattr(boot, "BOOT_ID", tmp_path / "none")
    state = stored(TODAY, TODAY)
    clocks["wall"] += 50 * SECOND
    assert on_this_line(state) == (state, False)


def test_a_clock_that_begins_in_1970_gives_no_time_before_it(clocks):
    state = stored(TODAY, TODAY)
    clocks["wall"] = 2 * SECOND
    clocks["boot"] += 20 * SECOND
    assert on_this_line(state)[0]["tick_end_ns"] == 0


def test_this_machine_tells_its_boots_apart(monkeypatch):
    monkeypatch.delenv(BOOT_ID_GIVEN, raising=False)
    assert len(boot_id()) >= 32
    assert boot_id() == boot_id()
    assert abs(noted(clock.boot_ns() + 7)["ahead_ns"] - 7) < SECOND
