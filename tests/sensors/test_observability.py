"""Exact ranks against rational arithmetic written out in the tests, by both of the product's ways."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.sensors import determined_states, exact_rank, exact_ranks, hidden_states, observability, paper_rank
from tests.sensors.rational import rank, rates_matrix
from tests.sensors.strings import COUPLINGS, cells

FOURS = list(itertools.combinations(range(1, 13), 4))


@pytest.mark.parametrize("condition", COUPLINGS)
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_the_exact_rank_is_the_rational_one_of_every_set(n, condition):
    A, p = rates_matrix(n, **COUPLINGS[condition]), cells(n, condition)
    sets = [s for m in range(n + 1) for s in itertools.combinations(range(1, n + 1), m)]
    expected = [rank(A, s) for s in sets]
    assert [exact_rank(p, s) for s in sets] == expected
    assert exact_ranks(p, sets).tolist() == expected
    assert [2 * n - hidden_states(p, s) for s in sets] == expected


@pytest.mark.parametrize(
    ("condition", "sensors"),
    [
        ("full", (1,)),
        ("full", (12,)),
        ("natural", (2,)),
        ("natural", (2, 5, 8, 11)),
        ("natural", (2, 5, 8, 10)),
        ("no-conduction", (3, 6, 9)),
        ("no-conduction", (12,)),
    ],
)
def test_the_exact_rank_of_twelve_cells_is_the_rational_one(condition, sensors):
    expected = rank(rates_matrix(12, **COUPLINGS[condition]), sensors)
    p = cells(12, condition)
    assert exact_rank(p, sensors) == exact_ranks(p, [sensors])[0] == 24 - hidden_states(p, sensors) == expected


@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_cells_that_are_cooled_differently_are_ranked_rationally_too(data):
    n = data.draw(st.integers(1, 4))
    # few values, so that cells are alike now and then and modes have nodes
    R_u = data.draw(st.lists(st.sampled_from([0.5, 0.79, 1.0, 2.0]), min_size=n, max_size=n))
    R_cc = data.draw(st.sampled_from([None, 0.5, 4.0, 32.0]))
    C_f = data.draw(st.sampled_from([None, 4.0, 11.33]))
    sensors = tuple(sorted(data.draw(st.sets(st.integers(1, n), max_size=2))))
    p = cells(n, "single", R_u=np.array(R_u), R_cc=R_cc or np.inf, C_f=C_f or np.inf)
    expected = rank(rates_matrix(n, R_cc, C_f, R_u), sensors)
    assert exact_rank(p, sensors) == expected
    hidden = hidden_states(p, sensors)
    assert hidden in (None, 2 * n - expected)
    assert hidden is not None or R_cc is None or n == 1


def test_one_sensor_anywhere_determines_a_full_string_of_any_length():
    for n in range(1, 13):
        assert (exact_ranks(cells(n), [(k,) for k in range(1, n + 1)]) == 2 * n).all()


@pytest.mark.parametrize(
    ("condition", "sets"), [("full", 495), ("natural", 494), ("no-conduction", 165), ("single", 0)]
)
@pytest.mark.parametrize("R_cc", [1.0, 4.0, 31.84, 60.0])
def test_how_many_sets_of_four_determine_twelve_cells_at_any_conduction(condition, sets, R_cc):
    p = cells(12, condition, **({"R_cc": R_cc} if condition in ("full", "natural") else {}))
    ranks = exact_ranks(p, FOURS)
    assert (ranks == 24).sum() == sets
    if condition == "natural":
        assert [s for s, r in zip(FOURS, ranks, strict=True) if r < 24] == [(2, 5, 8, 11)]  # on the nodes of a mode


def test_without_conduction_a_sensor_sees_what_is_upstream():
    p = cells(9, "no-conduction")
    assert [exact_rank(p, (k,)) for k in range(1, 10)] == [2 * k for k in range(1, 10)]


def test_cells_that_differ_in_all_have_a_rank_but_no_polynomials():
    p = cells(4, R_c=np.array([1.2, 1.3, 1.4, 1.5]))
    assert hidden_states(p, (2,)) is None
    assert exact_rank(p, (2,)) == 8


def test_the_ntu_node_and_no_sensor_are_ranked_too():
    assert exact_rank(cells(6, coolant="ntu"), (3,)) == 12
    assert hidden_states(cells(6, coolant="ntu"), (3,)) == 0
    assert exact_rank(cells(6), ()) == paper_rank(cells(6), ()) == 0
    assert exact_ranks(cells(6), [(), (3,)]).tolist() == [0, 12]


@pytest.mark.parametrize(
    ("n", "condition", "hidden"), [(35, "natural", 34), (40, "full", 0), (60, "no-conduction", 60)]
)
def test_both_ways_agree_on_long_strings(n, condition, hidden):
    p, middle = cells(n, condition), ((n + 1) // 2,)
    assert hidden_states(p, middle) == hidden
    assert exact_rank(p, middle) == 2 * n - hidden


def test_a_hundred_cells_are_ranked_and_a_thousand_too():
    assert exact_rank(cells(100), (50,)) == 200
    assert exact_rank(cells(100, "natural"), (3, 70)) == 200
    assert determined_states(cells(1000), (500,)) == 2000
    assert determined_states(cells(1000, "no-conduction"), (500,)) == 1000


def test_double_precision_gives_up_where_the_exact_rank_is_full():
    assert exact_rank(cells(40), (1,)) == 80
    assert paper_rank(cells(40), (1,)) < 80


def test_a_sensor_more_never_widens_a_band_and_the_answer_names_the_worst_cell():
    p = cells(6)
    one, two = observability(p, (6,)), observability(p, (1, 6))
    assert (two.core_sd <= one.core_sd + 1e-9).all()
    assert two.observable
    assert two.states == two.exact_rank == two.paper_rank == 12
    assert two.core_sd[two.worst_cell - 1] == two.core_sd.max()
    assert observability(cells(101), (1,)).paper_rank is None
