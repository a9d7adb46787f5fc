"""Windows: full ones, ones that a gap ends, and what is too short or too blind to count."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.health.collect import Collector, Drive
from tests.health.test_string_health import tick

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
    assert len(one.window.square) == 659
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


def test_a_window_without_a_reading_is_none() -> None:
    c = Collector()
    blind = replace(tick(), surface=np.full(3, NAN))
    assert [c.add(blind, 60.0, 0.5, 1.0) for _ in range(1300)] == [None] * 1300
