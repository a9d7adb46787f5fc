"""One ranking over everything: what each of several effects is worth, what would come next, or be in its place."""

import numpy as np
import pytest

from bms_gateway.diagnosis.ranking import ranking
from bms_gateway.diagnosis.residuals import rmse
from bms_gateway.identify.map_fit import stacked
from tests.diagnosis.decided import by_first, by_second

ROLES = ["named", "tied", "next", "instead"]


@pytest.mark.parametrize("made", [by_first, by_second])
def test_what_is_named_comes_first_and_nothing_stands_twice(made):
    d = made()
    found = ranking(d)
    assert [x.effects for x in found if x.role == "named"] == [(s.candidate.key,) for s in d.selected]
    assert [ROLES.index(x.role) for x in found] == sorted(ROLES.index(x.role) for x in found)
    assert len({x.effects for x in found}) == len(found)
    assert len(found) > len(d.selected)


@pytest.mark.parametrize("made", [by_first, by_second])
def test_each_of_a_pair_is_worth_what_is_lost_without_it(made):
    d = made()
    named = [x for x in ranking(d) if x.role == "named"]
    assert {s.candidate.name for s in d.selected} == {"entropic_heat", "resistance_temperature"}
    for x in named:
        assert x.evidence > 3.0
        assert x.error_K < 0.9 * x.without_K


def test_leaving_the_later_of_two_out_gives_back_what_the_first_alone_reached():
    d = by_first()
    first, later = d.selected
    alone = next(t.fit for t in d.search.rounds[0] if t.candidate.key == first.candidate.key)
    row = next(x for x in ranking(d) if x.effects == (later.candidate.key,))
    assert row.without_K == pytest.approx(rmse(alone, ~stacked(alone.problem)[4]), rel=0.05)
    assert row.error_K == rmse(d.search.final, ~stacked(d.search.final.problem)[4])


def test_the_later_of_two_is_shown_at_the_odds_that_let_it_in():
    d = by_first()
    later = d.search.chosen[-1]
    row = next(x for x in ranking(d) if x.effects == (later.candidate.key,))
    assert row.evidence == pytest.approx(later.log_odds, rel=0.05)  # it was weighed beside the first then too


def test_the_second_search_tells_the_hypotheses_that_come_closest():
    d = by_second()
    chosen = {s.candidate.key for s in d.selected}
    score = {frozenset(r.effects): r.log_odds for r in d.second.ranking}
    for x in ranking(d):
        if x.role == "next":
            assert x.evidence == score[frozenset(chosen | set(x.effects))]
        elif x.role != "named":
            assert x.evidence == score[frozenset(x.effects)]
    used = [m.used for f in d.fits for m in f.problem.records]
    assert not any(np.all(u) for u in used)  # what is stated of both models was fitted without the held-out blocks


def test_what_the_evidence_is_weighed_against_is_the_model_of_its_round():
    """A tie of the second round was said to be weighed against a model that lacks nothing."""
    d = by_first()
    first, later = (s.candidate.key for s in d.selected)
    for x in ranking(d):
        rounds = [r for r in d.search.rounds if any(x.evidence == t.log_odds for t in r)]
        if x.role == "named":
            assert set(x.beside) == {first, later} - set(x.effects)
        elif rounds and rounds[0] is d.search.rounds[0]:
            assert x.beside == ()
        elif rounds:
            assert x.beside in {(first,), (first, later)}
    second = by_second()
    chosen = {s.candidate.key for s in second.selected}
    assert all(set(x.beside) == chosen for x in ranking(second) if x.role != "named")
