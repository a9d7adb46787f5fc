"""What a sound string does and no alarm may call a fault: simulated, and measured by others."""

import pytest

from tests.benchmarks.heat_case import Case
from tests.benchmarks.heat_life import summary, upper
from tests.benchmarks.heat_records import paths, read, told
from tests.data import need
from tests.health.heat_runs import raised


def test_air_that_swings_about_a_string_at_rest_is_no_heat() -> None:
    # Bug: films that were held while they did tell something made slow surprises, which became heat of the last cells.
    case = Case("forced", 0, 7200, "rest", at=7200)
    assert raised(case, [20353, 20357]) == [[], []]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["leaf_cell_pouch_1c", "leaf_cell_pouch_3c", "s40t_21700_liquidcooled_1C"])
def test_positions_on_real_cells_that_differ_by_more_than_cells_do_are_no_fault_of_a_thermocouple(name: str) -> None:
    need("bench"), need("surface_cells")
    assert [told(read(path)) for path in paths() if path.name.startswith(name)] == [[]]


def test_the_rate_of_false_alarms_comes_with_the_bound_of_poisson() -> None:
    assert upper(0, 1000.0) == pytest.approx(2.9957, abs=1e-4)  # e^−2.9957 = 0.05
    assert upper(3, 1000.0) == pytest.approx(7.7537, abs=1e-4)  # tables of the Poisson distribution
    lines = [{"hours": 72.0, "alerts": []}, {"hours": 216.0, "alerts": [[1, 60, "cooling", None]]}]
    text = summary(lines)
    assert text.startswith("288 h of sound strings, 1 alert")
    assert "unexplained_heat: 0, 0.00 per 1,000 h, with 95 % below 10.40" in text
    assert "cooling: 1, 3.47 per 1,000 h, with 95 % below 16.47" in text
