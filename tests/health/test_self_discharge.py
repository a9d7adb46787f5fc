"""A cell that discharges itself is told by mA from its voltage at rest; relaxation, balance and noise are not.

The truth is written here: a curve, two RC pairs a cell, a leak, and a converter with steps of 1 mV.
"""

import json

import numpy as np
import pytest

from bms_gateway.health.self_discharge import SelfDischarge
from tests.health.nights import AH, N, Night, curve, night

S = 10**9


def slope(soc: float) -> float:
    return float((curve(np.array(soc + 1e-4)) - curve(np.array(soc - 1e-4))) / 2e-4)


def watched(
    s: SelfDischarge, n: Night, *, hear: tuple[int, int] = (60, 60), start_s: float = 0.0
) -> list[tuple[float, int]]:
    """Feed a night; (hours of rest, cell) of what comes. Frames for the second number of seconds every first."""
    told, last = [], 0.0
    dt = float(n.time_s[1] - n.time_s[0])
    for t, V, amps in zip(n.time_s, n.V, n.current, strict=True):
        if t >= 1800 and t % hear[0] >= hear[1]:
            continue
        if t - last > 60.0 + dt:
            s.pass_time(t - last)
        last = t
        for leak, raised in s.take(int((start_s + t) * S), float(amps), float(amps) * dt / 3600.0, V):
            if raised:
                told.append(((t - 1800) / 3600.0, leak.cell))
    return told


@pytest.mark.parametrize("seed", range(3))
def test_a_soft_short_is_told_within_hours_with_its_current(seed: int) -> None:
    s = SelfDischarge(N, AH)
    told = watched(s, night(np.random.default_rng([seed, 1]), 4.0, 0.08))
    assert [cell for _, cell in told] == [6]
    assert told[0][0] < 2.0
    leak = s.leaks[6]
    assert abs(leak.current - 0.08) < 2.0 * leak.current_sd
    assert leak.slope == pytest.approx(-0.08 / AH * slope(0.58), rel=0.15)
    assert "mA" in leak.text
    assert leak.level == (2 if leak.watts >= 0.3 else 1)


def test_frames_once_an_hour_and_restarts_between_tell_it_too() -> None:
    n = night(np.random.default_rng(5), 9.0, 0.08)
    s, told = SelfDischarge(N, AH), []
    for t, V, amps in zip(n.time_s, n.V, n.current, strict=True):
        if t < 1800 or t % 3600 == 0:
            if t > 1860:
                kept = json.loads(json.dumps(s.snapshot()))
                s = SelfDischarge(N, AH)
                s.restore(kept)
                s.pass_time(3600.0)
            told += [(t, x.cell) for x, raised in s.take(int(t * S), float(amps), float(amps) / 60.0, V) if raised]
    assert [cell for _, cell in told] == [6]
    assert list(s.leaks) == [6]  # and it stays, though every hour is another run


@pytest.mark.parametrize("step", [1e-3, 5e-3])
def test_nothing_is_told_of_sound_cells(step: float) -> None:
    for seed in range(12):
        n = night(np.random.default_rng([seed, 2]), 9.0, step=step, every=60, soc=0.3 + 0.05 * (seed % 6))
        assert watched(SelfDischarge(N, AH), n) == []


def test_a_cell_above_the_others_is_being_balanced_and_not_told_before_it_is_level() -> None:
    n = night(np.random.default_rng(7), 6.0, 0.05)
    n.V[:, 5] += 0.06
    assert watched(SelfDischarge(N, AH), n) == []


def test_the_charge_between_two_rests_gives_the_slope_of_the_curve() -> None:
    rng = np.random.default_rng(9)
    s = SelfDischarge(N, None)  # nobody knows the capacity
    first, second = night(rng, 2.0, soc=0.7), night(rng, 4.0, 0.08, soc=0.45)
    watched(s, first)
    watched(s, second, start_s=first.time_s[-1] + 60.0)
    leak = s.leaks[6]
    assert leak.current == pytest.approx(0.08, rel=0.6)


def test_a_current_ends_the_rest_and_not_the_alert() -> None:
    s = SelfDischarge(N, AH)
    n = night(np.random.default_rng(3), 4.0, 0.08)
    watched(s, n)
    assert list(s.leaks) == [6]
    watched(s, night(np.random.default_rng(4), 0.1), start_s=n.time_s[-1] + 60.0)
    assert list(s.leaks) == [6]


def test_a_state_of_another_string_is_refused() -> None:
    with pytest.raises(ValueError, match="not of this string"):
        SelfDischarge(4, AH).restore(SelfDischarge(N, AH).snapshot())
