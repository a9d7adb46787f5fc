"""The line of time and the line through a slow input, against their rules in words and numpy's own fit."""

import itertools
import math

import numpy as np
import pytest

from bms_gateway.engine.line import Line
from bms_gateway.engine.stamps import Clock
from bms_gateway.frames.batch import FrameBatch

S = 1_000_000_000
START = 1_700_000_000 * S


def frames(times: list[int], first: int = 0) -> FrameBatch:
    n = len(times)
    data = np.arange(first, first + 8 * n, dtype=np.uint64).astype(np.uint8).reshape(n, 8)
    return FrameBatch(np.array(times, np.int64), np.arange(first, first + n, dtype=np.uint32), data[:, 0].copy(), data)


def by_the_rules(stamps: list[int]) -> tuple[list[tuple[int, int]], tuple[int, int, int]]:
    """(number, time) of each frame that is given out, and how many were reordered, set back, absurd."""
    out: list[tuple[int, int]] = []
    shift = reordered = set_back = absurd = 0
    last = stamps[0]
    for n, stamp in enumerate(stamps):
        t = stamp + shift
        if t - last > 60 * S:
            if n + 1 == len(stamps):
                break  # held until the next one tells
            if stamps[n + 1] + shift - last <= 60 * S:
                absurd += 1
                continue
        elif last - t > 2 * S:
            set_back += 1
            shift += last - t
            t = last
        elif t < last:
            reordered += 1
            t = last
        last = t
        out.append((n, t))
    return out, (reordered, set_back, absurd)


STEPS = (0, 1, S, -1, -S, -2 * S, -2 * S - 1, 60 * S, 60 * S + 1, -3600 * S, 3600 * S)


@pytest.mark.parametrize("seed", range(40))
def test_every_stamp_is_treated_as_the_rules_say_however_frames_are_cut(seed: int) -> None:
    rng = np.random.default_rng(seed)
    odd = rng.random(60) < (0.1, 0.5, 1.0)[seed % 3]
    stamps = (START + np.cumsum(np.where(odd, rng.choice(STEPS, 60), S // 10))).tolist()
    expected, counts = by_the_rules(stamps)
    whole = frames(stamps)
    for edges in ([0, 60], [0, *sorted(rng.integers(0, 61, 6).tolist()), 60], list(range(61))):
        clock, got = Clock(), []
        for a, b in itertools.pairwise(edges):
            part = clock.straighten(whole[a:b])
            got += zip(part.can_id.tolist(), part.time_ns.tolist(), strict=True)
            for c, length, data in zip(part.can_id, part.length, part.data, strict=True):
                assert (length, data.tolist()) == (whole.length[c], whole.data[c].tolist())
        assert got == expected
        assert (clock.reordered, clock.set_back, clock.absurd) == counts
        assert (clock.first_ns, clock.last_ns) == (stamps[0], expected[-1][1])


def test_what_was_odd_is_told_except_reordering() -> None:
    clock = Clock()
    assert clock.faults() == ""
    assert (clock.first_ns, clock.last_ns, clock.shift_ns) == (0, None, 0)
    clock.straighten(frames([START, START - 1]))
    assert clock.faults() == ""
    clock.straighten(frames([START - 5 * S, START - 5 * S]))
    assert clock.faults() == "clock set back 1×"
    assert clock.shift_ns == 5 * S
    clock.straighten(frames([START + 100 * S, START]))
    assert clock.faults() == "clock set back 1×; 1 frames dropped whose stamps lie far ahead of all others"


def test_an_empty_batch_changes_nothing() -> None:
    clock = Clock()
    assert len(clock.straighten(FrameBatch.empty())) == 0
    assert clock.last_ns is None


@pytest.mark.parametrize("count", range(1, 12))
def test_a_slow_input_is_the_end_of_the_line_through_its_last_eight_readings(count: int) -> None:
    rng = np.random.default_rng(count)
    t = START + np.cumsum(rng.integers(1, 2 * S, count))
    y = 25.0 + rng.normal(0.0, 1.0, count)
    line = Line()
    line.update(t[:1], y[:1])
    line.update(t[:0], y[:0])
    line.update(t[1:], y[1:])
    at = int(t[-1]) + S // 3
    x = (t[-8:] - at) * 1e-9
    expected = y[-1] if count < 4 else np.polyval(np.polyfit(x, y[-8:], 1), 0.0)
    assert line.at(at) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("oldest_s", "counts"), [(20, True), (20 + 1e-9, False)])
def test_readings_of_over_20_s_ago_belong_to_another_slope(oldest_s: float, counts: bool) -> None:
    newest = START + 100 * S
    t = np.array([newest - round(oldest_s * 1e9), newest - 3 * S, newest - 2 * S, newest - S, newest])
    y = np.array([60.0, 25.0, 26.0, 27.0, 28.0])
    line = Line()
    line.update(t, y)
    used = slice(None) if counts else slice(1, None)
    fit = np.polyfit((t[used] - newest) * 1e-9, y[used], 1)
    assert line.at(newest + S) == pytest.approx(np.polyval(fit, 1.0), rel=1e-9)


def test_readings_of_one_instant_have_no_slope() -> None:
    line = Line()
    assert math.isnan(line.at(START))
    line.update(np.full(6, START), np.arange(6.0))
    assert line.at(START + S) == 5.0
    line.forget()
    assert math.isnan(line.at(START))


def test_faults_are_told_once_in_the_order_of_time() -> None:
    clock = Clock()
    clock.straighten(frames([START, START - 5 * S, START - 10 * S, START - 9 * S, START - 20 * S, START - 18 * S]))
    assert clock.last_ns == START + 3 * S
    assert len(clock._news) == 2  # the first two at one time
    assert clock.news(START) == ""
    assert clock.news(START + 1) == "clock set back 2×"
    assert clock.news(START + S) == ""
    assert clock.news(START + 2 * S) == "clock set back 3×"
    assert clock.news(START + 9 * S) == ""
    assert clock.faults() == "clock set back 3×"
