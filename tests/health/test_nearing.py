"""When a string that heats into its limit is told, told again, and not any more."""

from dataclasses import replace
from math import inf, nan

import pytest

from bms_gateway.health.alerts import Severity
from bms_gateway.health.nearing import Approach, Nearing

SOON = Approach(3, 52.04, 243.0, 180.0, 400.0, 78.2, 51.7)


def test_two_forecasts_in_a_row_are_told_with_cell_time_load_and_what_is_permitted() -> None:
    n = Nearing("string_1", 60.0)
    n.take(SOON, 66.0)
    assert n.condition is None
    n.take(SOON, 66.0)
    c = n.condition
    assert c is not None
    assert (c.name, c.severity, c.string, c.cell, c.settled) == ("forecast", Severity.WARNING, "string_1", 3, True)
    assert c.facts["in_s"] == 243.0
    assert c.text == (
        "hottest point of cell 3 reaches 60 °C in 4 min (3 min to 7 min) at this load (78 A; now 52.0 °C): lower the "
        "current or cool the string; 52 A can be held for 10 min"
    )


def test_a_current_of_nought_is_no_current_that_can_be_held() -> None:
    n = Nearing("string_1", 60.0)
    for _ in range(2):
        n.take(replace(SOON, permitted_A=0.0), 66.0)
    assert n.condition is not None
    assert n.condition.text.endswith("no current can be held for 10 min")
    n.take(None, 58.2)
    assert n.condition.text.endswith("if the load comes back: no current can be held for 10 min")


def test_one_burst_is_not_told_and_near_misses_do_not_end_it() -> None:
    n = Nearing("s", 60.0)
    for approach, hottest in ((SOON, 66.0), (None, 57.0), (SOON, 66.0), (None, 59.5)):
        n.take(approach, hottest)
        assert n.condition is None
    n.take(SOON, 66.0)
    n.take(SOON, 66.0)
    for hottest in (59.5, 59.2, *[58.0] * 11, 59.5, *[58.0] * 11):  # never for two minutes a kelvin below
        n.take(None, hottest)
        assert n.condition is not None
    n.take(None, 58.0)
    assert n.condition is None


def test_a_load_that_swings_makes_one_warning() -> None:
    n, told = Nearing("s", 60.0), 0
    for k in range(360):  # an hour: half a minute of load, a minute without
        before = n.condition
        n.take(*((SOON, 66.0) if k % 9 < 3 else (None, 55.0)))
        told += before is None and n.condition is not None
    assert told == 1


def test_it_is_over_when_the_limit_is_reached() -> None:
    n = Nearing("s", 60.0)
    for end in (lambda: n.take(replace(SOON, in_s=0.0), 61.0), n.forget):
        n.take(SOON, 66.0)
        n.take(SOON, 66.0)
        assert n.condition is not None
        end()
        assert n.condition is None


@pytest.mark.parametrize(("hottest", "unknown"), [(nan, (1, 2, 3)), (36.4, (3,))])
def test_it_is_not_over_because_its_cell_is_not_known_any_more(hottest: float, unknown: tuple[int, ...]) -> None:
    # Bug: a cell with a short was not known any more, the others stayed cool, and the warning was over.
    n = Nearing("s", 60.0)
    n.take(SOON, 66.0)
    n.take(SOON, 66.0)
    for _ in range(60):
        n.take(None, hottest, unknown)
        assert n.condition is not None
    assert n.condition.text == (
        "hottest point of cell 3 was to reach 60 °C at the load of 10 min ago (78 A); it is not known any more: treat "
        "the cell as hot, lower the current or cool the string"
    )
    for _ in range(12):
        assert n.condition is not None
        n.take(None, 50.0, (1,))  # of others it does not matter
    assert n.condition is None
    assert n.why_over == "the load does not lead to 60 °C any more: at most 50.0 °C within 10 min"


def test_it_is_another_phase_the_nearer_it_comes_and_says_what_is_doubtful_and_charging() -> None:
    n, phases = Nearing("s", 60.0), []
    for in_s in (590.0, 590.0, 250.0, 110.0, 40.0):
        n.take(Approach(1, 55.0, in_s, in_s / 2, inf, -40.0, 20.0, doubtful=True), 70.0)
        phases.append(None if n.condition is None else n.condition.phase)
    assert phases == [None, "", "300", "120", "60"]
    assert n.condition is not None
    assert (
        "in 40 s (20 s or later) at this load (40 A charging; now 55.0 °C); its core is not proven" in n.condition.text
    )


def test_what_was_forecast_at_another_load_is_told_as_past() -> None:
    n = Nearing("s", 60.0)
    n.take(SOON, 66.0)
    n.take(SOON, 66.0)
    for _ in range(4):
        n.take(None, 58.24)
    assert n.condition is not None
    assert n.condition.text == (
        "hottest point of cell 3 was to reach 60 °C at the load of 40 s ago (78 A); the present load does not lead to "
        "it (at most 58.2 °C within 10 min); if the load comes back: 52 A can be held for 10 min"
    )
    n.take(None, nan)
    assert n.condition is not None
    assert "58.2" not in n.condition.text
    n.take(SOON, 66.0)
    assert n.condition is not None
    assert "at this load (78 A" in n.condition.text


def test_on_a_silent_bus_it_is_told_as_what_was_to_come() -> None:
    n = Nearing("s", 60.0)
    n.silent(30.0)
    assert n.condition is None
    n.take(SOON, 66.0)
    n.take(SOON, 66.0)
    n.silent(240.0)
    assert n.condition is not None
    assert n.condition.text == (
        "hottest point of cell 3 was to reach 60 °C at the load of before the bus fell silent (78 A, 4 min ago)"
    )
