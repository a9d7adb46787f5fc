"""A current logged too seldom: what happened between its rows is not taken for a missing effect."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.diagnosis.coarse_rows import HOPELESS, doubt, left_open
from bms_gateway.diagnosis.diagnosis import diagnose
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.identify.map_fit import fitted
from bms_gateway.identify.problem import Problem
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import Scenario, make_log

SHORT = Scenario(cells=1, sensors=(1,), seconds=2400, noise=0.05, seed=7)


def every(scenario, k):
    """Record and model of every k-th row of a log."""
    log = make_log(scenario)
    table = {name: column[::k] for name, column in log.table.items()}
    return record_of(replace(log, table=table, core=log.core[::k], surface=log.surface[::k]))


@pytest.mark.parametrize(("cycle", "k"), [("urban", 2), ("us06", 5), ("mixed", 3), ("mixed", 10), ("pulses", 5)])
def test_what_happened_between_rows_is_no_effect(cycle, k):
    # each of them was given a name, or called unknown, when the rows were taken at their word
    record, model = every(replace(SHORT, cycle=cycle), k)
    found = diagnose(model, [record])
    assert not found.selected, found.sentence
    assert found.verdict == "adequate" or doubt(record) > HOPELESS
    assert "rows of the current" in found.sentence
    assert type(found.unknown_remains) is bool  # numpy's own is none for JSON


def test_what_stands_out_is_named_all_the_same():
    record, model = every(
        replace(SHORT, cycle="sweep", seed=11, effects={"resistance_temperature": ("medium", None)}), 2
    )
    assert doubt(record) > 0.0
    assert [s.candidate.key for s in diagnose(model, [record]).selected] == ["resistance_temperature"]


def test_dense_rows_leave_nothing_open():
    record, model = every(replace(SHORT, cycle="mixed"), 1)
    assert doubt(record) == 0.0
    assert left_open(fitted(Problem(model, [measured(record, model)])), [0.0]) == 0.0


@pytest.mark.parametrize("k", [2, 5])
def test_what_is_left_open_is_what_thinned_rows_do_to_a_right_model(k):
    # the same fit, driven by all rows and by every k-th
    dense, model = every(replace(SHORT, cycle="mixed"), 1)
    thin, _ = every(replace(SHORT, cycle="mixed"), k)
    fit = fitted(Problem(model, [measured(dense, model)]))
    told = left_open(fit, [doubt(thin)])
    (m,) = fit.problem.records
    u, v = m.drive, thin.drive
    seen = np.interp((np.arange(u.N) + 0.5) * u.dt, (np.arange(v.N) + 0.5) * v.dt, v.I2)
    other = Problem(model, [replace(m, drive=replace(u, I2=seen))])
    moved = other.predict(fit.theta, fit.prediction.X, fit.nu).y - fit.y
    assert 0.4 < told / np.sqrt(np.mean(moved**2)) < 2.5
