"""Windows: full ones, ones that a gap ends, and what is too short or too blind to count."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.health.collect import WINDOW_S, Collector, Drive
from bms_gateway.identify import Ticks
from tests.health.health_ticks import tick

NAN = float("nan")


def fed(c: Collector, ticks: int, soc: float = 0.5, flow: float = 1.0, **more) -> list[Drive]:
    found = [c.add(tick(**more), 60.0, soc, flow) for _ in range(ticks)]
    return [d for d in found if d is not None]


def test_a_window_has_twenty_minutes() -> None:
    (one,) = fed(Collector(), 1300)
    w = one.window
    assert len(w.square) == len(w.inlet) - 1 == len(one.current) == 1200
    assert (w.soc, w.flow, w.dt) == (0.5, pytest.approx(1.0), 1.0)


def test_unknown_charge_and_flow_stay_unknown() -> None:
    (one,) = fed(Collector(), 1201, soc=NAN, flow=NAN)
    assert one.window.soc != one.window.soc
    assert one.window.flow != one.window.flow


@pytest.mark.parametrize(("seconds", "windows"), [(500, 0), (700, 1)])
def test_a_gap_ends_a_window_which_counts_if_it_is_long_enough(seconds: int, windows: int) -> None:
    c = Collector()
    found = fed(c, seconds)
    found += [d for d in [c.add(tick(dt=3600.0), 60.0, 0.5, 1.0)] if d is not None]
    assert len(found) == windows


def test_a_flow_that_moves_ends_a_window() -> None:
    c = Collector()
    fed(c, 700)
    (one,) = fed(c, 1, flow=1.5)
    assert one.window.flow == pytest.approx(1.0)


def test_a_lost_current_is_bridged_for_ten_seconds_and_then_ends_the_window() -> None:
    c = Collector()
    fed(c, 650)
    assert fed(c, 10, square=NAN) == []
    (one,) = fed(c, 1, square=NAN)
    assert len(one.window.square) == 649  # what was held to the end is not in it
    assert np.isfinite(one.window.square).all()
    assert fed(c, 30, square=NAN) == []
    first = Collector()
    assert fed(first, 5, square=NAN) == []  # nothing to begin from
    fed(first, 1)
    fed(first, 2, square=NAN)
    fed(first, 700)
    (held,) = fed(first, 1, dt=3600.0)
    assert held.window.square[0] == 0.0


def test_a_lost_inlet_is_bridged_for_a_minute() -> None:
    c = Collector()
    fed(c, 650)
    assert fed(c, 60, inlet=NAN) == []
    (one,) = fed(c, 1, inlet=NAN)
    assert (one.window.inlet == 20.0).all()
    assert len(one.window.inlet) == len(one.window.square) + 1 == len(one.window.surface) + 1 == 650


@pytest.mark.parametrize("together", [False, True])
def test_an_inlet_that_comes_back_was_on_a_straight_line(together: bool) -> None:
    c = Collector()
    fed(c, 300)
    fed(c, 49, inlet=NAN)
    if together:
        one, K = np.ones(600), 600
        c.take(
            Ticks(
                1.0, 3600.0 * one, 0.0 * one, 25.0 * one, 60.0 * one, 0.5 * one, np.full((K, 3), 25.0), np.zeros((K, 3))
            )
        )
    else:
        fed(c, 600, inlet=25.0)
    (one,) = fed(c, 1, dt=3600.0)
    assert one.window.inlet[299:350] == pytest.approx(20.0 + 0.1 * np.arange(51))
    assert (one.window.inlet[350:] == 25.0).all()


def test_a_window_without_a_reading_is_none() -> None:
    c = Collector()
    blind = replace(tick(), surface=np.full(3, NAN))
    assert [c.add(blind, 60.0, 0.5, 1.0) for _ in range(1300)] == [None] * 1300


@pytest.mark.parametrize("part", [1, 7, 400])
def test_regular_ticks_taken_together_make_the_window_that_they_make_one_by_one(part: int) -> None:
    rng = np.random.default_rng(1)
    K, one, many = 1210, Collector(), Collector()
    square, current, inlet = rng.uniform(0, 6000, K), rng.normal(0, 60, K), rng.normal(20, 1, K)
    soc = np.where(rng.random(K) < 0.1, NAN, rng.uniform(0.2, 0.9, K))
    surface, age = rng.normal(25, 1, (K, 3)), rng.uniform(0, 1, (K, 3))
    ticks = [
        replace(tick(square=float(square[k]), inlet=float(inlet[k])), surface=surface[k], age=age[k]) for k in range(K)
    ]
    (whole,) = [d for k, t in enumerate(ticks) if (d := one.add(t, float(current[k]), float(soc[k]), NAN)) is not None]
    assert many.patience(1.0) == 0  # the instant from which a window runs comes by itself
    found, k = [], 0
    while k < K:
        if n := min(part, many.patience(1.0), K - k):
            at = slice(k, k + n)
            many.take(Ticks(1.0, square[at], square[at], inlet[at], current[at], soc[at], surface[at], age[at]))
            k += n
            continue
        drive = many.add(ticks[k], float(current[k]), float(soc[k]), NAN)
        found += [drive] if drive is not None else []
        k += 1
    (together,) = found
    for name in ("square", "inlet", "surface", "age"):
        assert np.array_equal(getattr(together.window, name), getattr(whole.window, name)), name
    assert np.array_equal(together.current, whole.current)
    assert together.window.soc == whole.window.soc
    assert len(whole.current) * whole.window.dt == WINDOW_S


def test_no_tick_is_taken_together_with_those_of_another_length() -> None:
    c = Collector()
    fed(c, 5)
    assert c.patience(1.0) > 1000
    assert c.patience(2.0) == 0
