"""What a report holds packed."""

import json
import sys

import numpy as np
import pytest

from bms_gateway.errors import UsageError
from bms_gateway.report.page import differences, packed
from tests.report.html_page import added_up


def test_a_python_without_lzma_is_told_what_to_do(monkeypatch):
    monkeypatch.setitem(sys.modules, "lzma", None)
    with pytest.raises(UsageError, match=r"needs the module lzma.*liblzma-dev"):
        packed("figure", b"content")


NUMBERS = [
    [21.5, 21.52, None, 21.49],
    [-0.0, 0.0, -0.001, 1234567.891],
    [None, None],
    [],
    [0.1 + 0.2, 1.0],  # of more digits than a figure has
    [1e-9, 2.0],
    ["1", "2"],
    [1, 2],
]


@pytest.mark.parametrize("values", NUMBERS)
def test_numbers_that_are_written_as_steps_are_the_same_numbers(values):
    assert added_up(json.loads(json.dumps(differences(values)))) == values


def test_all_numbers_of_four_digits_are_the_same():
    values = np.round(np.random.default_rng(5).normal(20.0, 300.0, 5000), 4).tolist()
    assert isinstance(differences(values), dict)
    assert added_up(differences(values)) == values
