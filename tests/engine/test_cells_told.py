"""What the engine makes of a fit of single cells: told, taken by the observer and by the health of each cell."""

from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.engine import Notice, Parameters
from bms_gateway.engine.cell_voltage import CellVoltages
from bms_gateway.engine.estimators import Estimators
from bms_gateway.engine.events import Level
from bms_gateway.engine.inputs import Inputs
from bms_gateway.health.string_health import Change, StringHealth
from bms_gateway.identify.cell_kept import numbers_kept
from bms_gateway.identify.cell_live import CellResult
from bms_gateway.identify.cell_prior import Layout
from tests.engine.packs import database
from tests.engine.told_strings import commissioned

R_E = np.array([1.0, 1.1, 1.3, 0.9]) * 4e-3


class Fitted:
    """Cells as identified, by word of a test."""

    def __init__(self, model, known: bool) -> None:
        self.model, self.known, self.warning = model, known, ""

    def accept(self, result) -> None:
        self.warning = result.warning

    def numbers(self):
        return numbers_kept(self.model) if self.known else None

    def estimates(self):
        return ()


def accepted(monkeypatch: pytest.MonkeyPatch, *results: CellResult, known: bool = True, kept: bool = True):
    """Events of results one after the other, and what the health was given."""
    given = []
    plan = commissioned(0.05)
    monkeypatch.setattr("bms_gateway.engine.estimators.sentence", lambda fit: f"so it is {fit.layout.cells}")
    monkeypatch.setattr(
        StringHealth, "fitted", lambda _, *what: given.append(what) or [Change("cell_ageing", 1, "grown", 3)]
    )
    if not kept:
        monkeypatch.setattr("bms_gateway.engine.estimators.baseline_of", lambda _: None)
    estimators = Estimators(plan, Inputs(plan, database()).wires)
    estimators.strings[0].cells = Fitted(plan.strings[0].model, known)
    return [estimators.accept(0, result, 7) for result in results], given


def result(over: bool, warning: str = "") -> CellResult:
    fit = SimpleNamespace(
        layout=Layout.of(commissioned(0.05).strings[0].model), R_e=R_E, rel_sd=np.full(4, 0.02), doubt=1.0
    )
    return CellResult(fit, np.full(4, np.nan), over, warning)


def test_a_fit_under_way_is_told_and_nothing_is_said_of_health(monkeypatch) -> None:
    (events,), given = accepted(monkeypatch, result(over=False))
    assert [type(e) for e in events] == [Parameters, Notice]
    assert events[1] == Notice(7, Level.INFO, "cells", "so it is 4", "string_1")
    assert given == []


@pytest.mark.parametrize("kept", [True, False])
def test_one_that_is_over_is_held_against_the_baseline_of_commissioning(monkeypatch, kept: bool) -> None:
    (events,), ((ln_R, rel_sd, base),) = accepted(monkeypatch, result(over=True), kept=kept)
    assert events[-1] == Notice(7, Level.WARNING, "cell_ageing", "grown", "string_1", 3)
    np.testing.assert_allclose(ln_R, np.log(R_E))
    np.testing.assert_array_equal(rel_sd, np.full(4, 0.02))
    if kept:
        ratio = np.log([0.9, 1.0, 1.2, 1.05])
        np.testing.assert_allclose(base, ratio - ratio.mean(), atol=1e-9)
    else:
        assert base is None


def test_one_of_which_nothing_is_known_says_nothing_of_health(monkeypatch) -> None:
    (events,), given = accepted(monkeypatch, result(over=True), known=False)
    assert given == []
    assert len(events) == 2


def test_skewed_stamps_are_told_once(monkeypatch) -> None:
    results = (result(False, "late"), result(False, "late"), result(False, ""), result(False, "later"))
    told, _ = accepted(monkeypatch, *results)
    skew = [[e.text for e in events if isinstance(e, Notice) and e.code == "skew"] for events in told]
    assert skew == [["late"], [], [], ["later"]]
    assert [e.level for e in told[0] if isinstance(e, Notice)] == [Level.INFO, Level.WARNING]


def test_a_voltage_may_be_the_first_input_and_a_current_without_voltages_stops_no_other() -> None:
    pairing = CellVoltages([(1, np.array([2])), (3, np.array([0, -1]))])
    assert pairing.inputs == [0, 2]
    time, value = np.array([5, 1, 2, 4], np.int64), np.array([3.3, 10.0, 20.0, 30.0])
    edge = np.array([0, 1, 3, 3, 4])
    runs = {i: (time[edge[i] : edge[i + 1]], value[edge[i] : edge[i + 1]]) for i in (1, 3)}
    first, second = pairing.update(time, value, edge, runs)
    assert first is None
    assert (second.I[0], second.V[0]) == (30.0, 3.3)
    assert np.isnan(second.I[1])


@pytest.mark.parametrize(("late_ns", "known"), [(0, True), (1, False)])
def test_a_current_of_a_second_and_a_half_ago_is_the_oldest_that_counts(late_ns: int, known: bool) -> None:
    pairing = CellVoltages([(0, np.array([1]))])
    time, value = np.array([7, 7 + 1_500_000_000 + late_ns], np.int64), np.array([30.0, 3.3])
    (means,) = pairing.update(time, value, np.array([0, 1, 2]), {0: (time[:1], value[:1])})
    assert (means is not None) == known
