"""Rows of a table from the ring, on blocks made here: which stretch, which columns, and what stands in each cell."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.errors import DataError, StateError
from bms_gateway.store import rows as module
from bms_gateway.store.recent import Block
from bms_gateway.store.rows import NEEDED, excerpt

S = 1_000_000
LAYOUT = {"a": {"current_A": 0, "coolant_inlet_C": 20.0, "surface_1_C": 1}, "b": {"current_A": 0, "soc": 2}}


def block(samples, place, layout=None):
    """`samples`: by input, (time_us, value) pairs."""
    made = {i: (np.array([t for t, _ in pairs]), np.array([v for _, v in pairs])) for i, pairs in samples.items()}
    return Block(LAYOUT if layout is None else layout, made, place)


@pytest.fixture
def ring(monkeypatch):
    """Gives the function that lays blocks, and the problems that reading tells."""
    blocks, problems = [], []

    def read(directory, found):
        assert directory == Path("ring")
        found.extend(problems)
        return iter(blocks)

    monkeypatch.setattr(module, "read_recent", read)

    def lay(*new, problem=None):
        blocks[:] = new
        problems[:] = [] if problem is None else [StateError(problem)]
        return Path("ring")

    return lay


def test_each_instant_is_a_row_with_what_came_then_and_what_is_constant(ring):
    folder = ring(block({0: [(5 * S, 1.5), (6 * S + 7, -2.0)], 1: [(5 * S, 25.25)]}, (1, 8)))
    found = excerpt(folder, 60.0)
    assert found.columns == {
        "a": ["current_A", "coolant_inlet_C", "surface_1_C"],
        "b": ["current_A", "coolant_inlet_C"],  # needed, though nothing came; of the state of charge nothing did
    }
    assert list(found.rows("a")) == [["5.000000", "1.5", "20", "25.25"], ["6.000007", "-2.0", "20", ""]]
    assert list(found.rows("b")) == [["5.000000", "1.5", ""], ["6.000007", "-2.0", ""]]
    assert (found.first_us, found.last_us, found.turned_back, found.problems) == (
        6 * S + 7 - 60 * S,
        6 * S + 7,
        False,
        [],
    )


def test_a_string_of_which_only_constants_are_known_has_no_row(ring):
    folder = ring(block({2: [(5 * S, 1.0)]}, (1, 8)))
    found = excerpt(folder, 60.0)
    assert found.columns["a"] == list(NEEDED)
    assert list(found.rows("a")) == []
    assert list(found.rows("b")) == [["5.000000", "", "", "1.0"]]


def test_a_string_without_any_signal_has_no_columns(ring):
    found = excerpt(ring(block({0: [(S, 1.0)]}, (1, 8), {"a": {"current_A": 0}, "c": {"soc": 7}})), 60.0)
    assert list(found.columns) == ["a"]


def test_columns_stand_in_the_order_in_which_they_first_came_the_needed_ones_first(ring):
    first = block({1: [(S, 1.0)]}, (1, 8), {"a": {"surface_1_C": 1}})
    second = block({0: [(2 * S, 3.0)], 1: [(2 * S, 2.0)]}, (1, 90), {"a": {"current_A": 0, "surface_1_C": 1, "soc": 9}})
    found = excerpt(ring(first, second), 60.0)
    assert found.columns == {"a": ["current_A", "coolant_inlet_C", "surface_1_C"]}
    assert list(found.rows("a")) == [["1.000000", "", "", "1.0"], ["2.000000", "3.0", "", "2.0"]]


def test_the_span_is_counted_from_the_newest_sample_and_both_ends_belong_to_it(ring):
    folder = ring(
        block({0: [(S, 1.0), (2 * S - 1, 2.0)]}, (1, 8)),
        block({0: [(2 * S, 3.0), (3 * S, 4.0)], 1: [(4 * S, 5.0)]}, (1, 90)),
    )
    found = excerpt(folder, 2.0)
    assert (found.first_us, found.last_us) == (2 * S, 4 * S)
    assert [row[0] for row in found.rows("a")] == ["2.000000", "3.000000", "4.000000"]
    sooner = excerpt(folder, 1.0, 3 * S)
    assert (sooner.first_us, sooner.last_us) == (2 * S, 3 * S)
    assert [row[0] for row in sooner.rows("a")] == ["2.000000", "3.000000"]
    assert excerpt(folder, 1.0, 9 * S).last_us == 4 * S


@pytest.mark.parametrize(("until_us", "seen"), [(2 * S - 1, ["a"]), (2 * S, ["a", "b"])])
def test_columns_are_those_of_blocks_that_reach_into_the_span(ring, until_us, seen):
    folder = ring(
        block({0: [(S, 1.0)]}, (1, 8), {"a": {"current_A": 0}}),
        block({0: [(2 * S, 1.0)]}, (1, 50), {"b": {"current_A": 0}}),
    )
    assert list(excerpt(folder, 60.0, until_us).columns) == seen


@pytest.mark.parametrize(("last_s", "seen"), [(1.0, ["a", "b"]), (0.999999, ["b"])])
def test_a_block_that_ends_before_the_span_has_no_say(ring, last_s, seen):
    folder = ring(
        block({0: [(S, 1.0)]}, (1, 8), {"a": {"current_A": 0}}),
        block({0: [(2 * S, 1.0)]}, (1, 50), {"b": {"current_A": 0}}),
    )
    assert list(excerpt(folder, last_s).columns) == seen


def test_no_instant_comes_twice_where_a_block_begins_before_the_end_of_the_one_before(ring):
    folder = ring(
        block({0: [(S, 1.0), (3 * S, 2.0)]}, (1, 8)),
        block({0: [(2 * S, 9.0), (3 * S, 9.0), (3 * S + 1, 3.0)]}, (1, 50)),
        block({0: [(2 * S, 9.0), (3 * S, 9.0), (5 * S, 4.0)]}, (1, 70)),
    )
    assert [row[:2] for row in excerpt(folder, 60.0).rows("a")] == [
        ["1.000000", "1.0"],
        ["3.000000", "2.0"],
        ["3.000001", "3.0"],
        ["5.000000", "4.0"],
    ]


def test_after_a_block_that_ends_before_the_one_before_it_began_the_table_begins_anew(ring):
    old = block({0: [(100 * S, 1.0), (101 * S, 1.0)]}, (1, 8))
    again = block({0: [(50 * S, 2.0), (51 * S, 2.0)]}, (1, 50))
    new = block({0: [(20 * S, 3.0), (21 * S, 3.0)]}, (1, 90))
    newest = block({0: [(22 * S, 4.0)]}, (2, 8))
    found = excerpt(ring(old, again, new, newest), 60.0)
    assert [row[:2] for row in found.rows("a")] == [["20.000000", "3.0"], ["21.000000", "3.0"], ["22.000000", "4.0"]]
    assert found.last_us == 22 * S
    assert found.turned_back
    assert not excerpt(ring(old, again, new, newest), 2.0).turned_back
    assert excerpt(ring(old, again, new, newest), 2.000001).turned_back


@pytest.mark.parametrize(("ends_us", "back"), [(99 * S, True), (100 * S, False), (100 * S + 1, False)])
def test_the_clock_went_back_where_a_block_lies_wholly_before_the_one_before(ring, ends_us, back):
    folder = ring(
        block({0: [(100 * S, 1.0), (101 * S, 1.0)]}, (1, 8)), block({0: [(98 * S, 2.0), (ends_us, 2.0)]}, (1, 50))
    )
    found = excerpt(folder, 60.0)
    assert found.turned_back is back
    assert found.last_us == (ends_us if back else 101 * S)


def test_a_string_that_some_blocks_do_not_have_is_read_from_the_others(ring):
    folder = ring(
        block({0: [(S, 1.0)]}, (1, 8)),
        block({0: [(2 * S, 2.0)]}, (1, 50), {"b": {"current_A": 0}}),
        block({0: [(3 * S, 3.0)]}, (1, 90)),
    )
    assert [row[0] for row in excerpt(folder, 60.0).rows("a")] == ["1.000000", "3.000000"]


def test_what_could_not_be_read_is_told_with_the_excerpt_and_where_there_is_none_as_the_reason(ring):
    found = excerpt(ring(block({0: [(S, 1.0)]}, (1, 8)), problem="x: torn"), 60.0)
    assert [str(p) for p in found.problems] == ["x: torn"]
    with pytest.raises(DataError, match=r"^ring: no recent signals are recorded there \(x: torn\)$"):
        excerpt(ring(problem="x: torn"), 60.0)
    with pytest.raises(DataError, match=r"^ring: no recent signals are recorded there$"):
        excerpt(ring(), 60.0)


def test_values_are_written_with_the_digits_that_give_them_back(ring):
    values = [0.1, 1e-30, -3.4028235e38, 123456.789, 16777216.0]
    folder = ring(
        block({0: [(k * S, v) for k, v in enumerate(values, 1)]}, (1, 8), {"a": {"current_A": 0, "soc": 1 / 3}})
    )
    found = list(excerpt(folder, 60.0).rows("a"))
    assert [np.float32(row[1]) for row in found] == [np.float32(v) for v in values]
    assert {row[3] for row in found} == {"0.333333333"}


@pytest.mark.slow
def test_a_table_of_many_columns_is_never_in_memory_as_a_whole(ring):
    """Of a block of some kilobytes, in which a thousand columns show the same samples."""
    columns = {"current_A": 0} | {f"surface_{k}_C": 0 for k in range(1, 1001)}
    found = excerpt(ring(block({0: [(k, 1.5) for k in range(2_000)]}, (1, 8), {"a": columns})), 60.0)
    tracemalloc.start()
    count = sum(len(row) == 1003 for row in found.rows("a"))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count == 2_000
    assert peak < 64 << 20
