"""When the last value of a signal is stale whose message has it only now and then."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_gateway.frames.freshness import Turns
from bms_gateway.frames.guard import Guard
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.rules import Rule

S = 1_000_000_000
SLOW = Rule("surface", stale_after_ns=10 * S, round_ns=33 * S)
FAST = Rule("surface", stale_after_ns=10 * S)


def qualities(rule: Rule, times_s: list[int], end_s: int) -> list[Quality]:
    """Quality at the end of each second of a channel that comes at these times; another one comes each second."""
    guard = Guard((rule, FAST))
    found = []
    for second in range(end_s):
        channel = np.array([1] + [0] * times_s.count(second))
        time_ns = np.full(len(channel), second * S, np.int64)
        flag = np.zeros(len(channel), np.uint8)
        told = guard.update(time_ns, channel, np.full(len(channel), 25.0), flag, (second + 1) * S, active=False)
        found.append(Quality(int(told.channel_quality[0])))
    return found


@pytest.mark.parametrize("every_s", [1, 5, 11, 20, 33])
def test_a_value_that_comes_in_its_turn_is_never_stale(every_s: int) -> None:
    assert set(qualities(SLOW, list(range(0, 400, every_s)), 400)) == {Quality.GOOD}
    if every_s > 10:
        assert Quality.STALE in qualities(FAST, list(range(0, 400, every_s)), 400)


@pytest.mark.parametrize(("every_s", "after_s"), [(1, 10), (3, 10), (5, 15), (33, 99)])
def test_a_value_that_comes_no_more_is_stale_after_three_rounds(every_s: int, after_s: int) -> None:
    last = 10 * every_s
    found = qualities(SLOW, list(range(0, last + 1, every_s)), last + 200)
    assert found.index(Quality.STALE) == last + after_s  # the age at the end of this second is above the limit
    assert set(found[last + after_s :]) == {Quality.STALE}


def test_a_lost_value_does_not_make_the_round_longer() -> None:
    times = [0, 2, 4, 30, 32]  # silent for 26 s
    assert qualities(SLOW, times, 80).index(Quality.STALE, 33) == 42


def test_no_round_is_longer_than_the_dbc_allows() -> None:
    assert qualities(SLOW, [0, 300, 600], 900).index(Quality.STALE, 600) == 699


@given(st.lists(st.lists(st.integers(0, 2), max_size=6), max_size=12))
def test_the_round_is_the_shorter_of_the_last_two_times_from_value_to_value(seconds: list[list[int]]) -> None:
    rules = (SLOW, Rule("current", stale_after_ns=2 * S, round_ns=7 * S), FAST)
    turns, received = Turns(rules), np.full(3, -1, np.int64)
    gaps: list[list[float]] = [[], [], []]
    for second, came in enumerate(seconds):
        channel = np.array(came, np.intp)
        time_ns = second * S + np.arange(len(came)) * S // 10
        turns.take(channel, time_ns, received)
        for c in set(came):
            newest, n = int(time_ns[channel == c][-1]), came.count(c)
            if received[c] >= 0:
                gaps[c].append((newest - int(received[c])) // n)
            received[c] = newest
    wanted = [max(r.stale_after_ns, 3 * min([r.round_ns, *gaps[c][-2:]])) for c, r in enumerate(rules)]
    assert turns.stale_ns().tolist() == wanted
