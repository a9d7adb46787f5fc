"""The paper's figures come out of its own rank, and the exact ones stand beside them.

Counts of sets near the threshold move by one or two with the processor's rounding; what does not is pinned.
"""

import numpy as np
import pytest

from bms_gateway.sensors import paper_counts, paper_rank, paper_ranks, paper_string, set_ranks, table_2
from bms_gateway.sensors.paper import TABLE_2, TABLE_3
from bms_gateway.thermal import continuous
from tests.truth.string import C_F, TABLE_1, TruthString

ROUNDING = 2


@pytest.mark.parametrize("condition", ["full", "natural", "no-conduction"])
@pytest.mark.parametrize("R_cc", [1.0, 15.0, 31.84, 60.0])
def test_table_2_is_one_sensor_for_three_cells_by_the_papers_rank_and_one_exactly(condition, R_cc):
    if condition == "no-conduction" and R_cc != 1.0:
        pytest.skip("there is no R_cc")
    rows = table_2(condition, R_cc)
    assert tuple(r.paper for r in rows) == TABLE_2 == tuple(r.published for r in rows)
    assert {r.exact for r in rows} == {1}
    if condition == "no-conduction":
        assert [r.exact_set for r in rows] == [(n,) for n in range(1, 13)]


def test_table_3_is_counted_as_printed_and_exactly():
    full = paper_counts("full")
    assert full.paper == pytest.approx(TABLE_3["full"], abs=ROUNDING)
    assert (full.sets, full.exact, full.blind_sets) == (495, 495, ())
    alone = paper_counts("no-conduction")
    assert alone.paper_sets == ((3, 6, 9, 12),)
    assert alone.exact == 165
    assert all(12 not in s for s in alone.blind_sets)
    for R_cc in (43.5, 45.0, 46.75):
        natural = paper_counts("natural", R_cc)
        assert natural.paper == pytest.approx(TABLE_3["natural"], abs=ROUNDING)
        assert (natural.exact, natural.blind_sets) == (494, ((2, 5, 8, 11),))


def test_where_one_count_of_table_3_is_right_the_other_is_not():
    assert paper_counts("natural", 31.84).paper > 53
    assert paper_counts("full", 45.0).paper < 80


@pytest.mark.parametrize(("unit_s", "sets"), [(1.0, 217), (5.0, 404), (60.0, 0)])
def test_the_papers_counts_change_with_the_unit_of_time_which_a_rank_cannot(unit_s, sets):
    counts = paper_counts("full", 5.0, unit_s=unit_s)
    assert counts.paper == pytest.approx(sets, abs=ROUNDING if sets else 0)
    assert counts.exact == 495


def test_figures_12_and_13():
    full = {r.sensors: r for r in set_ranks("full")}
    assert full[1, 2].paper == 9
    assert {r.paper for s, r in full.items() if s != (1, 2)} == {10}
    assert {r.exact for r in full.values()} == {10}
    alone = {r.sensors: r for r in set_ranks("no-conduction")}
    assert (alone[2, 5].paper, alone[1, 5].paper) == (10, 9)
    assert alone[2, 5].exact == alone[1, 5].exact == 10


def test_sets_are_ranked_together_as_one_by_one():
    p = paper_string(5, "no-conduction")
    sets = [(1, 5), (2, 5), (4, 5)]
    assert paper_ranks(p, sets).tolist() == [paper_rank(p, s) for s in sets] == [9, 10, 9]


def test_the_papers_string_is_that_of_the_truth():
    p, t = paper_string(4, "full", 31.84), TruthString.of(4, R_cc=31.84, C_f=C_F)
    assert (p.C_f, p.R_cc, p.R_e[0]) == (pytest.approx(C_F), 31.84, TABLE_1["R_e"])
    A = continuous(p).A
    for j in range(8):
        T = [0.0] * 8
        T[j] = 1.0
        dT_c, dT_s = t.rates(*(np.array(T[i::2]) for i in (0, 1)), 0.0, 0.0)
        assert A[0::2, j] == pytest.approx(dT_c)
        assert A[1::2, j] == pytest.approx(dT_s)
