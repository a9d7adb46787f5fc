"""A surface that fell is believed where its neighbours, its coolant or rest explain it."""

import numpy as np
import pytest

from bms_gateway.health.confirm import Confirm, Surfaces
from bms_gateway.health.limits import Limits, Points, Sensed

RISE = 2.69e-3 * 0.607  # K/A²: 80 A hold a surface at least 10 K above its coolant
COOLS_S = 60.0


def confirm(cells=1):
    return Confirm([slice(0, cells)], np.array([RISE]), np.array([COOLS_S]))


@pytest.mark.parametrize(
    ("current", "inlet", "reading", "others", "confirmed"),
    [
        (80.0, 66.0, 66.0, [], False),  # reads the coolant: it came off
        (70.0, 77.0, 40.0, [], False),  # reads the air, far below the coolant
        (70.0, 66.0, 66.0, [79.0, 80.0], False),
        (70.0, 66.0, 76.0, [79.0, 80.0], True),
        (80.0, 40.0, 52.0, [], True),  # the coolant has become cold
        (5.0, 60.0, 60.5, [], True),
        (80.0, np.nan, 60.0, [], False),
        (80.0, np.nan, 60.0, [62.0], True),
    ],
)
def test_a_reading_is_confirmed_by_neighbours_by_its_coolant_or_by_rest(current, inlet, reading, others, confirmed):
    good = np.array([reading, *others])
    judge, fallen = confirm(len(good)), np.arange(len(good)) == 0
    none, still = np.zeros(len(good), bool), np.zeros(len(good))
    for t in range(300):
        found = judge.step(float(t), np.array([current**2]), np.array([inlet]), Surfaces(good, fallen, none, still))
    assert (bool(found[0]), found[1:].all()) == (confirmed, True)


@pytest.mark.parametrize(("others", "first"), [([], 180), ([60.0, 90.0, 95.0], 180), ([28.0, 27.0, 26.0], 0)])
def test_at_rest_a_surface_that_fell_is_confirmed_when_its_cell_has_had_time_to_cool_or_by_its_neighbours(
    others, first
):
    good = np.array([25.0, *others])
    judge, fallen, none = confirm(len(good)), np.arange(len(good)) == 0, np.zeros(len(good), bool)
    told = [
        bool(judge.step(float(t), np.zeros(1), np.array([25.0]), Surfaces(good, fallen, none, np.zeros(len(good))))[0])
        for t in range(300)
    ]
    assert told.index(True) == first
    assert all(told[first:])


@pytest.mark.parametrize(("current", "confirmed"), [(80.0, False), (0.0, True)])
def test_an_alarm_does_not_end_while_its_surface_still_falls_under_current(current, confirmed):
    judge, over = confirm(), np.ones(1, bool)
    square, inlet, rate = np.array([current**2]), np.array([66.0]), np.array([-0.1])
    for t in range(300):
        found = judge.step(float(t), square, inlet, Surfaces(np.array([77.5]), ~over, over, rate))
    assert found.tolist() == [confirmed]
    slow = Surfaces(np.array([77.5]), ~over, over, 0.1 * rate)
    assert judge.step(300.0, square, inlet, slow).tolist() == [True]


def test_a_thermocouple_that_comes_off_slowly_ends_no_alarm_and_a_cell_that_cools_does():
    for end, ended in ((66.0, False), (76.0, True)):
        judge, at = confirm(), Limits(["s"], [slice(0, 1)], 80.0, 80.0)
        no = np.zeros(1, bool)
        for t in range(900):
            y = np.array([end + (82.0 - end) * np.exp(-max(t - 300, 0) / 40.0)])
            s = at.surface
            sure = judge.step(float(t), np.array([6400.0]), np.array([66.0]), Surfaces(y, s.fallen, s.over, s.rate))
            at.step(float(t), Points(y, np.full(1, 0.5), y, ~no), Sensed(y, no, no, None, sure), False)
        assert (list(at.conditions()) == []) is ended
