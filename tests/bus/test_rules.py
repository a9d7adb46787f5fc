"""Filters, pacing and bus time: pure rules without a socket."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.bus.canframe import from_wire
from bms_gateway.bus.clock import STEP_NS, BusClock
from bms_gateway.bus.filters import LIMIT, join_filters
from bms_gateway.bus.pace import BURST, ID_BURST, ID_SHARE, QUEUE, RATE, REST_NS, Pacer
from bms_gateway.bus.port import Counters
from bms_gateway.errors import UsageError
from bms_gateway.frames.batch import EXTENDED
from bms_gateway.frames.own_dbc import MAX_CELLS
from tests.bus.frames import ids, make

SECOND = 1_000_000_000
MS = 1_000_000


def passes(can_id, filters):
    return any(can_id & mask == base & mask for base, mask in filters)


@settings(max_examples=100, deadline=None)
@given(st.sets(ids, max_size=40), st.integers(2, 60), st.lists(ids, max_size=40))
def test_filters_pass_every_wanted_id_and_only_those_while_they_fit(wanted, limit, others):
    filters = join_filters(wanted, limit)
    assert len(filters) <= limit
    assert all(passes(c, filters) for c in wanted)
    assert not any(passes(c | 0x4000_0000, filters) for c in wanted)
    if len(wanted) <= limit:
        twins = [c ^ EXTENDED for c in wanted if c & 0x1FFF_FFFF <= 0x7FF]
        assert not any(passes(c, filters) for c in others + twins if c not in wanted)


def test_filters_for_thousands_of_ids_stay_within_the_kernels_limit():
    rng = np.random.default_rng(1)
    wanted = set((rng.integers(0, 1 << 29, 5_000) | EXTENDED).tolist()) | set(range(0x800))
    filters = join_filters(wanted)
    assert len(filters) <= LIMIT
    assert all(passes(c, filters) for c in wanted)


def test_pacer_refuses_foreign_ids_and_queues_nothing_of_that_batch():
    pacer = Pacer({0x10: SECOND}, Counters())
    with pytest.raises(UsageError, match="0x11 is not an identifier of this node"):
        pacer.offer(make((0, 0x10, b""), (0, 0x11, b"")))
    assert len(pacer) == 0


def send_until(pacer, start, stop, step=MS):
    sent = []
    for now in range(start, stop, step):
        while (wire := pacer.head(now)) is not None:
            pacer.done()
            sent.append((now, wire))
    return sent


def test_pacer_keeps_to_the_rate_and_the_burst():
    counters = Counters()
    pacer = Pacer(dict.fromkeys(range(200), 10 * SECOND), counters, rate=1_000, burst=8)
    pacer.offer(make(*[(0, k, bytes([k])) for k in range(200)]))
    sent = send_until(pacer, 0, SECOND)
    assert [w[8] for _, w in sent] == list(range(200))
    times = np.array([t for t, _ in sent])
    assert np.count_nonzero(times == 0) == 8
    for t in range(0, 150 * MS, MS):
        assert np.count_nonzero((times >= t) & (times < t + 50 * MS)) <= 58
    assert times[-1] < 200 * MS


def test_after_an_outage_old_frames_are_dropped_not_sent_in_a_burst():
    counters = Counters()
    pacer = Pacer({1: SECOND}, counters)
    for second in range(30):  # nothing is taken for 30 s
        pacer.offer(make(*[(second * SECOND, 1, bytes([second, k])) for k in range(10)]))
    sent = send_until(pacer, 29 * SECOND + MS, 31 * SECOND)
    assert {w[8] for _, w in sent} <= {28, 29}
    assert all(now - w[8] * SECOND <= SECOND for now, w in sent)
    assert counters.stale == 290
    assert counters.stale + counters.sent == 300


def test_pacers_queue_is_bounded_and_keeps_the_newest():
    counters = Counters()
    pacer = Pacer({1: SECOND}, counters)
    pacer.offer(make(*[(0, 1, k.to_bytes(4, "big")) for k in range(QUEUE + 7)]))
    assert (len(pacer), counters.overflow) == (QUEUE, 7)
    assert int.from_bytes(pacer.head(0)[8:12], "big") == 7


CYCLE = 2 * SECOND
OURS = {0x10: CYCLE, 0x11: CYCLE, 0x12 | EXTENDED: CYCLE}
OFFERS = st.lists(
    st.tuples(st.integers(0, 300 * MS), st.sampled_from(sorted(OURS)), st.integers(1, 120)), min_size=1, max_size=25
)


@settings(max_examples=100, deadline=None)
@given(OFFERS, st.sampled_from([1, 7, 20]))
def test_whatever_is_queued_the_bus_gets_no_more_than_the_limits_of_all_and_of_each_id(offers, step_ms):
    counters = Counters()
    pacer = Pacer(OURS, counters)
    sent, now, offered = [], 0, 0
    for wait, can_id, count in offers:
        until = now + wait
        sent += send_until(pacer, now, until, step_ms * MS)
        now = until
        pacer.offer(make(*[(now, can_id, bytes([k])) for k in range(count)]))
        offered += count
    sent += send_until(pacer, now, now + 5 * SECOND, step_ms * MS)
    assert len(pacer) == 0
    assert counters.sent == len(sent)
    assert counters.sent + counters.stale + counters.overflow + counters.limited == offered
    times = np.array([t for t, _ in sent])
    senders = np.array([from_wire(w)[0] for _, w in sent])
    assert set(senders.tolist()) <= set(OURS)
    at_once = max(BURST, REST_NS * RATE // SECOND)  # REST_NS gathers in a pause
    assert most_in(times, SECOND // 10) <= RATE // 10 + at_once + 1
    for can_id in OURS:
        mine = times[senders == can_id]
        assert most_in(mine, SECOND) <= RATE / ID_SHARE + ID_BURST * BURST + 1


def most_in(times, window):
    """Most of the times that fall in any window of that length."""
    return max((np.count_nonzero((times >= t) & (times < t + window)) for t in times), default=0)


def test_a_slow_pacer_gathers_no_more_than_its_burst_in_a_pause():
    pacer = Pacer(dict.fromkeys(range(40), 60 * SECOND), Counters(), rate=100, burst=5)
    pacer.offer(make(*[(0, k, b"") for k in range(5)]))
    assert len(send_until(pacer, 0, MS)) == 5
    pacer.offer(make(*[(0, k, b"") for k in range(5, 40)]))
    assert len(send_until(pacer, 10 * SECOND, 10 * SECOND + MS)) == 5
    assert len(send_until(pacer, 10 * SECOND + MS, 10 * SECOND + 100 * MS)) == 9


def test_one_id_gets_so_many_frames_at_once_and_not_one_more():
    counters = Counters()
    pacer = Pacer({1: SECOND}, counters, rate=1e6)
    pacer.offer(make(*[(0, 1, b"")] * (ID_BURST * BURST + 3)))
    assert len(send_until(pacer, 0, 1, 1)) + len(send_until(pacer, 1, 20, 1)) <= ID_BURST * BURST
    send_until(pacer, 20, 100_000, 1_000)
    assert counters.sent + counters.limited == ID_BURST * BURST + 3
    assert counters.sent >= ID_BURST * BURST


def test_one_id_that_runs_wild_does_not_keep_the_others_from_being_sent():
    counters = Counters()
    pacer = Pacer({1: SECOND, 2: SECOND}, counters)
    told = []
    for tick in range(10):
        pacer.offer(make(*[(tick * SECOND, 1, b"w")] * 500, (tick * SECOND, 2, bytes([tick]))))
        told += [w[8] for _, w in send_until(pacer, tick * SECOND, (tick + 1) * SECOND) if from_wire(w)[0] == 2]
    assert told == list(range(10))
    assert counters.sent <= 10 + 10 * RATE / ID_SHARE + ID_BURST * BURST
    assert counters.limited + counters.sent == 5_010


def test_the_limits_are_those_that_are_promised():
    """1,000 frames/s and 8 at once; of one identifier a sixteenth, and 32 at once; 4,096 waiting."""
    counters = Counters()
    pacer = Pacer(dict.fromkeys(range(5000), 100 * SECOND), counters)
    pacer.offer(make(*[(0, k, b"") for k in range(5_000)]))
    assert (len(pacer), counters.overflow) == (4_096, 904)
    assert len(send_until(pacer, 0, 1)) == 8
    assert len(send_until(pacer, MS, SECOND + MS)) == 1_000
    assert len(send_until(pacer, 2 * SECOND, 2 * SECOND + 1)) == 10  # ten milliseconds' worth after a pause

    pacer = Pacer({1: SECOND}, counters)
    for k in range(100):
        pacer.offer(make(*[(k * SECOND // 10, 1, b"")] * 20))
        send_until(pacer, k * SECOND // 10, (k + 1) * SECOND // 10)
    assert counters.sent - 1_018 == 32 + 618  # 62.5 per second until the last of them came, at 9.9 s


@pytest.mark.parametrize("start", [0, 100 * SECOND])
def test_one_id_gets_32_frames_at_one_instant(start):
    counters = Counters()
    pacer = Pacer({1: SECOND}, counters, rate=1e6)
    assert pacer.head(start) is None
    now = start + REST_NS
    pacer.offer(make(*[(now, 1, b"")] * 40))
    while pacer.head(now) is not None:
        pacer.done()
    assert (counters.sent, counters.limited) == (32, 8)


def test_a_frame_waits_to_the_end_of_its_cycle_and_no_longer():
    for late, stale in ((0, 0), (1, 1)):
        counters = Counters()
        pacer = Pacer({1: SECOND}, counters)
        pacer.offer(make((5, 1, b"")))
        assert (pacer.head(SECOND + 5 + late) is None) == bool(stale)
        assert counters.stale == stale


def test_a_token_is_there_after_exactly_its_time():
    pacer = Pacer(dict.fromkeys(range(4), 9 * SECOND), Counters(), rate=1, burst=1)
    pacer.offer(make(*[(0, k, b"") for k in range(4)]))
    assert [now for now, _ in send_until(pacer, 0, 5 * SECOND, SECOND // 2)] == [0, SECOND, 2 * SECOND, 3 * SECOND]


def test_the_largest_string_fits_its_cycle():
    counters = Counters()
    pacer = Pacer({1: SECOND}, counters)
    for tick in range(20):
        pacer.offer(make(*[(tick * SECOND, 1, bytes([k])) for k in range(MAX_CELLS)]))
        assert len(send_until(pacer, tick * SECOND, (tick + 1) * SECOND)) == MAX_CELLS
    assert (counters.limited, counters.stale) == (0, 0)


class Clocks:
    """A wall clock that is set now and then, and a steady one."""

    def __init__(self):
        self.true = 0
        self.wall_off = 1_700_000_000 * SECOND

    def wall(self):
        return self.true + self.wall_off

    def steady(self):
        return self.true + 5


@settings(max_examples=100, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(1, 10 * SECOND), st.one_of(st.just(0), st.integers(-(10**15), 10**15)), st.booleans()),
        max_size=30,
    )
)
def test_bus_time_goes_on_whatever_the_wall_clock_is_set_to(moves):
    clocks = Clocks()
    clock = BusClock(clocks.wall, clocks.steady)
    start = clocks.wall()
    allowed = unread = 0
    for step, set_by, read in moves:
        clocks.true += step
        clocks.wall_off += set_by
        unread += step
        allowed += abs(set_by) if abs(set_by) <= STEP_NS + unread // 500 else 0
        if read or set_by:
            assert abs(clock.now_ns() - start - clocks.true) <= allowed
            unread = 0
    assert abs(clock.now_ns() - start - clocks.true) <= allowed


def test_slewing_is_followed_so_that_stamps_stay_those_of_a_log():
    clocks = Clocks()
    clock = BusClock(clocks.wall, clocks.steady)
    for _ in range(100):
        clocks.true += SECOND
        clocks.wall_off += SECOND // 2_000
        assert clock.now_ns() == clocks.wall()
    assert clock.steps == 0


def test_frames_stamped_before_and_after_a_step_stay_in_order():
    clocks = Clocks()
    clock = BusClock(clocks.wall, clocks.steady)
    start = clocks.wall()
    clock.begin()
    clock.to_bus(np.array([start]))
    stamps = []
    clock.begin()
    for k in range(10):
        clocks.true += MS
        if k == 5:
            clocks.wall_off -= 3600 * SECOND
        stamps.append(clocks.wall())
    np.testing.assert_array_equal(clock.to_bus(np.array(stamps)) - start, np.arange(1, 11) * MS)
    assert (clock.steps, clock.last_step_ns) == (1, -3600 * SECOND)
