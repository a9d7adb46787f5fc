"""The line of time: forward only, the same however frames are cut."""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.engine.stamps import AHEAD_NS, Clock
from bms_gateway.frames.batch import FrameBatch

S = 1_000_000_000


def frames(times: list[int]) -> FrameBatch:
    n = len(times)
    return FrameBatch(
        np.array(times, np.int64),
        np.arange(n, dtype=np.uint32),
        np.full(n, 8, np.uint8),
        np.zeros((n, 8), np.uint8),
    )


def straight(times: list[int], cuts: list[int]) -> tuple[list[int], list[int], Clock]:
    clock, out_t, out_id = Clock(), [], []
    whole = frames(times)
    edges = [0, *sorted({c % (len(times) + 1) for c in cuts}), len(times)]
    for a, b in pairwise(edges):
        part = clock.straighten(whole[a:b])
        out_t += part.time_ns.tolist()
        out_id += part.can_id.tolist()
    return out_t, out_id, clock


steps = st.sampled_from([0, 1, 1000, S // 10, S, -1000, -S, -3 * S, -3600 * S, 61 * S, 3600 * S, 10**18])


@settings(max_examples=300, deadline=None)
@given(st.lists(steps, min_size=1, max_size=40), st.lists(st.integers(0, 40), max_size=8))
def test_time_never_runs_back_and_does_not_depend_on_the_cuts(deltas: list[int], cuts: list[int]) -> None:
    times = (10**15 + np.cumsum(np.clip(np.array(deltas, np.int64), -(10**14), 10**14))).tolist()
    one_t, one_id, _ = straight(times, [])
    cut_t, cut_id, _ = straight(times, cuts)
    assert one_t == sorted(one_t)
    assert (one_t, one_id) == (cut_t, cut_id)


def test_a_clock_set_back_moves_later_stamps_on_and_time_goes_on() -> None:
    out, ids, clock = straight([100 * S, 101 * S, 11 * S, 12 * S, 13 * S], [])
    assert out == [100 * S, 101 * S, 101 * S, 102 * S, 103 * S]
    assert ids == [0, 1, 2, 3, 4]
    assert clock.set_back == 1


def test_one_absurd_stamp_is_dropped_and_a_silence_is_kept() -> None:
    out, ids, clock = straight([100 * S, 100 * S + AHEAD_NS + 1, 101 * S, 5000 * S, 5001 * S], [1, 2])
    assert (out, ids) == ([100 * S, 101 * S, 5000 * S, 5001 * S], [0, 2, 3, 4])
    assert clock.absurd == 1


def test_reordered_frames_take_the_newest_time() -> None:
    out, _, clock = straight([100 * S, 100 * S - 5, 100 * S + 3], [])
    assert out == [100 * S, 100 * S, 100 * S + 3]
    assert clock.reordered == 1


def test_two_clocks_in_turns_do_not_lead_out_of_64_bits() -> None:
    times = [(1 if k // 2 % 2 == 0 else 8_900_000_000) * S + k for k in range(40)]
    out, _, clock = straight(times, [7])
    assert out == sorted(out)
    assert out[-1] < 2**63
    assert clock.absurd > 10
    assert straight(times, [])[0] == out
