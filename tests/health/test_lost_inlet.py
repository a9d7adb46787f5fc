"""An inlet that is not read for minutes: the coolant may move, no sensor or film is blamed, and faults are told on.

The truth is `tests.truth.pack` by way of the benchmark's cases.
"""

import pytest

from tests.benchmarks.bench_gaps import Gap, follow
from tests.benchmarks.heat_case import Case, make, with_seeds

AT = 1800


@pytest.mark.parametrize(
    ("pack", "drive", "lasts", "ramp"), [("liquid", "us06", 600, -4.0), ("small", "urban", 120, 4.0)]
)
@pytest.mark.plain_cases(2)
def test_coolant_that_moves_while_its_inlet_is_not_read_is_no_fault(
    pack: str, drive: str, lasts: int, ramp: float
) -> None:
    """Bug: the inlet was said to be off what the cells feel while it was not available, or the cooling to be worse."""
    case = Case(pack, 0, AT + lasts + 900, drive, ramp=ramp, ramp_at=AT)
    assert follow(make(with_seeds(case, range(30, 36))), Gap("inlet", AT, lasts)) == [[]] * 6


@pytest.mark.parametrize(("fault", "size", "code"), [("fan", 0.0, "cooling"), ("heat", 10.0, "unexplained_heat")])
@pytest.mark.plain_cases(2)
def test_a_fault_that_begins_while_the_inlet_is_not_read_is_told(fault: str, size: float, code: str) -> None:
    lasts = 300
    case = Case("liquid", 0, AT + lasts + 900, "us06", fault, size=size, at=AT + 150)
    for told in follow(make(with_seeds(case, range(30, 36))), Gap("inlet", AT, lasts)):
        assert [c for _, c, _, level in told if level] == [code]
        assert case.at < told[0][0] <= AT + lasts + 480


@pytest.mark.parametrize("what", ["string", "bus"])
def test_a_frozen_inlet_is_not_right_again_before_it_has_read_something_else(what: str) -> None:
    """After a silence of 90 s the same reading as before was said to agree with the cells again."""
    case = Case("small", 0, AT + 3000, "urban", "frozen", at=600, ramp=4.0, ramp_at=600)
    told = [
        [(at, level) for at, code, _, level in changes if code == "inlet"]
        for changes in follow(make(with_seeds(case, range(30, 36))), Gap(what, AT, 90))
    ]
    assert sum(bool(x) for x in told) >= 5
    assert all(level and at < AT for x in told for at, level in x)
