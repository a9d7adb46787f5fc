"""JSON that would cost too much memory is told before it is parsed, and nothing else is."""

import pytest

from bms_gateway.store.dear import MAX_COMMAS, MAX_MARKS, is_dear


def test_the_bounds_are_those_of_memory():
    """Sixty bytes for each mark, and thirty for each number, beside the text itself."""
    assert (MAX_COMMAS, MAX_MARKS) == (4_000_000, 1_000_000)


def test_as_many_values_as_may_be_are_taken_and_one_more_is_not():
    assert not is_dear(b"," * MAX_COMMAS)
    assert is_dear(b"," * (MAX_COMMAS + 1))


@pytest.mark.parametrize("marks", [b'"', b"[", b"{", b'"[{'])
def test_as_many_texts_lists_and_tables_as_may_be_are_taken_and_one_more_is_not(marks):
    most = (marks * MAX_MARKS)[:MAX_MARKS]
    assert not is_dear(most)
    assert is_dear(most + marks[:1])


def test_what_costs_nothing_is_not_counted():
    assert not is_dear(b"0123456789.eE+-:]} \n" * 1_000_000)
