"""Bus time from stamps of the wall clock: what is believed, to the nanosecond, and what becomes of the rest."""

import numpy as np
import pytest

from bms_gateway.bus.clock import LATE_NS, SLEW, SPLIT_NS, STEP_NS, BusClock
from tests.bus.times import SECOND, Time

MS = 1_000_000


@pytest.fixture
def time():
    return Time()


def stamps(*ns):
    return np.array(ns, np.int64)


def test_the_limits_are_those_of_the_text():
    assert (STEP_NS, LATE_NS, SLEW, SPLIT_NS) == (10 * MS, 2 * SECOND, 1_000, MS)


def test_a_new_clock_has_met_nothing(time):
    clock = time.bus_clock()
    assert (clock.offset_ns, clock.steps, clock.last_step_ns, clock.misdated) == (0, 0, 0, 0)


@pytest.mark.parametrize(("beyond_ns", "steps"), [(0, 0), (1, 1)])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_step_is_what_slewing_cannot_be(time, sign, beyond_ns, steps):
    clock = time.bus_clock()
    time.pass_s(100.0)
    time.wall_off_ns += sign * (STEP_NS + 100 * SECOND // SLEW + beyond_ns)
    clock.now_ns()
    assert clock.steps == steps


def test_what_slewing_may_do_counts_from_the_last_look_on(time):
    clock = time.bus_clock()
    time.pass_s(100.0)
    clock.now_ns()
    time.wall_off_ns += 5 * STEP_NS
    clock.now_ns()
    assert clock.steps == 1


@pytest.mark.parametrize(("apart_ns", "reads"), [(MS, 1), (MS + 1, 2)])
def test_two_readings_with_something_between_them_are_taken_again(apart_ns, reads):
    steady, taken = iter([0, apart_ns, apart_ns, apart_ns]), []
    BusClock(lambda: taken.append(1) or 0, lambda: next(steady))
    assert len(taken) == reads


def drained(time, clock, *ns, **how):
    """What a drain now makes of stamps."""
    clock.begin()
    return clock.to_bus(stamps(*ns), **how).tolist()


def test_stamps_up_to_a_little_after_now_are_believed(time):
    clock = time.bus_clock()
    now = time.wall_ns()
    assert drained(time, clock, now + STEP_NS) == [now + STEP_NS]
    assert clock.misdated == 0
    assert drained(time, clock, now + STEP_NS + 1) == [now]
    assert clock.misdated == 1


def test_stamps_are_believed_from_a_little_before_the_drain_that_left_nothing(time):
    clock = time.bus_clock()
    time.pass_s(50.0)
    clock.begin()
    begun = time.wall_ns()
    time.pass_s(20.0)  # held up within the drain
    clock.to_bus(stamps(begun))
    time.pass_s(30.0)
    assert drained(time, clock, begun - LATE_NS) == [begun - LATE_NS]
    assert clock.misdated == 0
    time.pass_s(1.0)
    last = begun + 50 * SECOND  # the drain before
    assert drained(time, clock, last - LATE_NS, last - LATE_NS - 1) == [last - LATE_NS] * 2
    assert clock.misdated == 1


def test_a_drain_that_left_something_is_no_limit(time):
    clock = time.bus_clock()
    start = time.wall_ns()
    time.pass_s(60.0)
    assert drained(time, clock, start + 1, emptied=False) == [start + 1]
    assert drained(time, clock, start + 2) == [start + 2]
    assert clock.misdated == 0
    assert drained(time, clock, start + 3) == [time.wall_ns()]


def test_a_stamp_that_cannot_be_true_becomes_that_before_it_else_that_after_it_else_now(time):
    clock = time.bus_clock()
    time.pass_s(60.0)
    now, wrong = time.wall_ns(), time.wall_ns() + 3600 * SECOND
    a, b = now - 5 * MS, now - 3 * MS
    assert drained(time, clock, wrong, a, wrong, 5, b, wrong) == [a, a, a, a, b, b]
    assert clock.misdated == 4
    assert drained(time, clock, wrong, 7) == [now, now]
    assert clock.misdated == 6


@pytest.mark.parametrize("set_by_s", [7.0, -7.0])
def test_long_after_the_clock_was_set_stamps_are_moved_by_as_much(time, set_by_s):
    clock = time.bus_clock()
    start = time.wall_ns()
    time.wall_off_ns += round(set_by_s * 1e9)
    for k in range(1, 4):
        time.pass_s(1.0)
        assert drained(time, clock, time.wall_ns()) == [start + k * SECOND]
    assert (clock.misdated, clock.steps, clock.last_step_ns) == (0, 1, round(set_by_s * 1e9))
    assert clock.offset_ns == -round(set_by_s * 1e9)


@pytest.mark.parametrize("second_s", [5.0, -5.0])
@pytest.mark.parametrize("at", [0, 40, 99])
def test_a_second_step_is_found_from_where_the_first_has_left_the_line(time, second_s, at):
    """Before the first of 99 frames, between two of them, after the last."""
    clock = time.bus_clock()
    start = time.wall_ns()
    time.wall_off_ns += 3600 * SECOND
    time.pass_s(1.0)
    drained(time, clock, time.wall_ns())
    raw = [time.wall_ns() + k * 100 * MS for k in range(1, 100)]
    raw[at:] = [t + round(second_s * 1e9) for t in raw[at:]]
    time.pass_s(10.0)
    time.wall_off_ns += round(second_s * 1e9)
    assert drained(time, clock, *raw) == [start + SECOND + k * 100 * MS for k in range(1, 100)]
    assert (clock.misdated, clock.steps) == (0, 2)
