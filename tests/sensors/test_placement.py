"""The best places are those that a plain search over scipy's Riccati solutions finds; long strings come close."""

import itertools
from math import comb

import numpy as np
import pytest

from bms_gateway.errors import UsageError
from bms_gateway.sensors import PlacementProblem, even_sets, observable_sets, steady_core_sd
from bms_gateway.sensors import placement as module
from bms_gateway.thermal import Disturbance
from tests.sensors.strings import COUPLINGS, cells, riccati


@pytest.mark.parametrize("condition", COUPLINGS)
def test_the_best_of_few_sets_is_what_a_plain_search_finds(condition):
    p = cells(6, condition)
    found = PlacementProblem(p).best(2)
    worst = {s: riccati(p, s).max() for s in itertools.combinations(range(1, 7), 2)}
    assert found.exhaustive
    assert found.sets == comb(6, 2)
    assert found.best[0].worst_sd == pytest.approx(min(worst.values()), rel=1e-6)
    assert [x.worst_sd for x in found.best] == pytest.approx(sorted(worst.values())[: len(found.best)], rel=1e-6)
    for x in found.best:
        assert x.worst_sd == pytest.approx(worst[x.sensors], rel=1e-6)
        assert x.core_sd[x.worst_cell - 1] == x.core_sd.max()


@pytest.mark.parametrize(
    ("m", "sensors", "sd"), [(1, (12,), 0.732), (2, (1, 12), 0.485), (3, (1, 2, 12), 0.467), (4, (1, 2, 11, 12), 0.429)]
)
def test_best_places_on_twelve_cells_are_as_derived(m, sensors, sd):
    found = PlacementProblem(cells(12)).best(m)
    assert found.best[0].sensors == sensors
    assert found.best[0].worst_sd == pytest.approx(sd, rel=0.01)
    assert found.even.worst_sd >= found.best[0].worst_sd


def test_two_end_sensors_beat_the_papers_four():
    assert steady_core_sd(cells(12), (1, 12)).max() < steady_core_sd(cells(12), (3, 6, 9, 12)).max()


def test_what_is_lost_is_the_set_without_the_sensor():
    p = cells(8)
    found = PlacementProblem(p).best(3)
    assert len(found.losses) == 3
    for k, left in zip(found.best[0].sensors, found.losses, strict=True):
        rest = tuple(j for j in found.best[0].sensors if j != k)
        assert left.sensors == rest
        np.testing.assert_allclose(left.core_sd, riccati(p, rest), rtol=1e-5)
        assert left.worst_sd >= found.best[0].worst_sd
    assert found.nothing.worst_sd == pytest.approx(riccati(p, ()).max(), rel=1e-9)


@pytest.mark.parametrize("condition", COUPLINGS)
@pytest.mark.parametrize("m", [1, 2, 3, 4, 6])
def test_the_search_finds_what_trying_all_finds(monkeypatch, condition, m):
    p = cells(12, condition)
    all_tried = PlacementProblem(p).best(m)
    monkeypatch.setattr(module, "EXHAUSTIVE", 0)
    searched = PlacementProblem(p).best(m)
    assert not searched.exhaustive
    assert searched.best[0].worst_sd <= all_tried.best[0].worst_sd * 1.01


@pytest.mark.parametrize(("n", "m"), [(40, 5), (120, 4), (250, 3)])
@pytest.mark.plain_cases(1)
def test_a_long_string_is_placed_at_least_as_well_as_evenly(n, m):
    p = cells(n)
    found = PlacementProblem(p).best(m)
    assert not found.exhaustive
    even = min(steady_core_sd(p, s).max() for s in even_sets(n, m))
    assert found.even.worst_sd == pytest.approx(even, rel=1e-9)
    assert found.best[0].worst_sd <= even * (1 + 1e-9)
    assert len(found.best[0].sensors) == m


def test_a_search_is_the_same_every_time():
    first, second = PlacementProblem(cells(30)).best(5), PlacementProblem(cells(30)).best(5)
    assert [x.sensors for x in first.best] == [x.sensors for x in second.best]
    assert all(np.array_equal(a.core_sd, b.core_sd) for a, b in zip(first.best, second.best, strict=True))


@pytest.mark.parametrize("wanted", [2.0, 1.0, 0.6, 0.55, 0.5, 0.485])
def test_the_fewest_sensors_are_no_more_than_needed(wanted):
    p = cells(8)
    found = PlacementProblem(p).fewest(wanted)
    assert found.worst_sd <= wanted
    if found.sensors:
        less = itertools.combinations(range(1, 9), len(found.sensors) - 1)
        problem = PlacementProblem(p)
        assert all(x.worst_sd > wanted for x in problem.measure(less))


def test_what_cannot_be_had_is_answered_with_a_sensor_on_every_cell():
    found = PlacementProblem(cells(5)).fewest(0.05)
    assert found.sensors == (1, 2, 3, 4, 5)
    assert found.worst_sd > 0.05


def test_a_long_string_needs_few_sensors_for_little_certainty():
    found = PlacementProblem(cells(100)).fewest(0.5)
    assert found.worst_sd <= 0.5
    assert len(found.sensors) <= 3


def test_sensors_follow_the_errors_that_are_declared():
    """With errors of each cell's own only, and nothing between cells, all unsensed cells are equally badly known."""
    found = PlacementProblem(cells(5, "single"), Disturbance(heat_common=0.0, inlet=0.0, heat_cell=0.3)).best(2)
    assert found.best[0].worst_sd == pytest.approx(found.nothing.worst_sd, rel=1e-9)
    assert found.best[0].sensors == (1, 2)  # of equals, the one whose cells come first


def test_of_equally_bad_worst_cells_the_better_mean_decides():
    found = PlacementProblem(cells(12, "natural")).best(5)
    means = [
        round(float(x.core_sd.mean()), 6)
        for x in found.best
        if round(x.worst_sd, 6) == round(found.best[0].worst_sd, 6)
    ]
    assert means == sorted(means)


@pytest.mark.parametrize("m", [0, 6])
def test_a_number_of_sensors_that_cannot_be_is_said(m):
    with pytest.raises(UsageError, match="valid: 1 to 5"):
        PlacementProblem(cells(5)).best(m)


def test_even_spacing_is_what_people_do():
    assert even_sets(12, 4) == [(1, 5, 8, 12), (2, 5, 8, 11), (3, 6, 9, 12)]
    assert even_sets(12, 1) == [(12,), (6,)]
    for n, m in itertools.product(range(1, 30), range(1, 30)):
        for s in even_sets(n, min(m, n)):
            assert len(set(s)) == min(m, n)
            assert min(s) >= 1
            assert max(s) <= n


def test_sets_are_counted_where_they_can_be():
    assert observable_sets(cells(12, "no-conduction"), 4) == (165, 1)
    assert observable_sets(cells(12, "natural"), 4)[0] == 494
    assert observable_sets(cells(100), 10) == (None, None)
    assert observable_sets(cells(60), 2) == (comb(60, 2), None)
