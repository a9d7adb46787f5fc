"""A current logged too seldom: what happened between its rows is not taken for a missing effect."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.diagnosis import core_known
from bms_gateway.diagnosis.coarse_rows import HOPELESS, SHOWN, doubt, left_open, less_steps, shows_steps
from bms_gateway.diagnosis.core_known import known_core
from bms_gateway.diagnosis.diagnosis import diagnose
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.residuals import structured
from bms_gateway.identify.map_fit import fitted
from bms_gateway.identify.problem import Problem
from tests.diagnosis.hidden_record import record_of
from tests.diagnosis.two_nodes import two_nodes
from tests.truth.hidden import Scenario, make_log

SHORT = Scenario(cells=1, sensors=(1,), seconds=2400, noise=0.05, seed=7)


def every(scenario, k):
    """Record and model of every k-th row of a log."""
    log = make_log(scenario)
    table = {name: column[::k] for name, column in log.table.items()}
    return record_of(replace(log, table=table, core=log.core[::k], surface=log.surface[::k]))


@pytest.mark.parametrize(("cycle", "k"), [("urban", 2), ("us06", 5), ("mixed", 3), ("mixed", 10), ("pulses", 5)])
@pytest.mark.plain_cases(2)
def test_what_happened_between_rows_is_no_effect(cycle, k):
    # each of them was given a name, or called unknown, when the rows were taken at their word
    record, model = every(replace(SHORT, cycle=cycle), k)
    found = diagnose(model, [record])
    assert not found.selected, found.sentence
    assert found.verdict == "adequate" or doubt(record) > HOPELESS
    assert "between its rows" in found.sentence
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


@pytest.mark.parametrize(("seed", "noise"), [(12, 0.05), (13, 0.05), (14, 0.02), (15, 0.02)])
@pytest.mark.plain_cases(1)
def test_steps_between_rows_of_a_second_are_no_effect(seed, noise):
    # half a second of heat of a small cell stands out of the noise: it was called unknown, or a drift
    record, model = two_nodes(seed, noise=noise)
    found = diagnose(model, [record])
    assert found.verdict == "adequate", found.sentence
    assert not found.unknown_remains
    # and a command that has no diagnosis at hand judges the core by the same search
    core = known_core(model, [record])
    assert core.why == known_core(model, [record], found.identified[0], found.search).why
    assert not any("ask for" in why or "lack something" in why for why in core.why)


@pytest.mark.parametrize(("seed", "bleed_W"), [(12, 0.1), (17, 0.15)])
@pytest.mark.plain_cases(1)
def test_heat_without_current_is_unknown_although_the_rows_leave_room_for_its_size(seed, bleed_W):
    # a balancing resistor was called "adequate": the unknown current between the rows might be as large
    record, model = two_nodes(seed, bleed_W=bleed_W)
    found = diagnose(model, [record])
    assert found.verdict == "unknown_effect", found.sentence
    assert found.unknown_remains
    assert not found.selected
    core = known_core(model, [record])
    assert not core.proven
    assert core.why == known_core(model, [record], found.identified[0], found.search).why


@pytest.mark.parametrize("more", [False, True])
def test_a_core_is_not_proven_where_the_rows_explain_a_part_only(more, monkeypatch):
    record, model = two_nodes(12, bleed_W=0.02)
    found = diagnose(model, [record])
    opened = replace(found.search, left_open=0.1, rounds=[])
    monkeypatch.setattr(core_known, "more_than_rows", lambda *_: more)
    core = core_known.known_core(model, [record], found.identified[0], opened)
    assert (core_known.LACKS_UNKNOWN in core.why) is more
    assert core.proven is not more


def test_steps_where_the_readings_put_them_leave_white_noise():
    record, model = two_nodes(16, noise=0.02)
    fit = fitted(Problem(model, [measured(record, model)]))
    assert structured(fit)
    assert not structured(less_steps(fit, [record]))
    record, _ = two_nodes(16, noise=0.02, on_the_row=True)
    record = replace(record, sampling=replace(record.sampling, doubt=0.0))  # nothing is open: nothing is taken away
    fit = fitted(Problem(model, [measured(record, model)]))
    assert np.allclose(less_steps(fit, [record]).r, fit.r, atol=1e-3)


def test_the_readings_show_whether_the_current_stepped_between_its_rows():
    gained = []
    for on_the_row in (False, True):
        record, model = two_nodes(16, noise=0.02, on_the_row=on_the_row)
        fit = fitted(Problem(model, [measured(record, model)]))
        gained.append(shows_steps(fit, [record], np.ones(len(fit.y), np.bool_)))
    between, on = gained
    assert between > SHOWN > on


def test_only_readings_that_count_show_steps():
    record, model = two_nodes(16, noise=0.02)
    fit = fitted(Problem(model, [measured(record, model)]))
    counted = np.arange(len(fit.y)) < len(fit.y) // 2
    (m,) = fit.problem.records
    spoilt = replace(m, y=np.where(counted, m.y, m.y + 5.0))
    other = replace(fit, problem=Problem(model, [spoilt]))
    assert shows_steps(other, [record], counted) == shows_steps(fit, [record], counted)
    assert shows_steps(fit, [record], ~counted) > 0.0
    assert shows_steps(fit, [record], np.zeros(len(fit.y), np.bool_)) == 0.0


def test_an_offset_of_the_current_is_not_taken_for_steps_between_its_rows():
    """Steps counted by readings beyond the trained currents, which the offset was not judged by: "adequate"."""
    offset = Scenario(
        effects={"current_offset": ("weak", None)}, cells=1, sensors=(1,), noise=0.05, step=0.1, cycle="sweep",
        inlet="steps", seed=91001020, columns=("flow", "soc"),
    )  # fmt: skip
    record, model = record_of(make_log(offset))
    found = diagnose(model, [record])
    assert [s.candidate.key for s in found.selected] == ["current_offset"], found.sentence


@pytest.mark.parametrize("R_s", [0.0015, 0.004])
@pytest.mark.slow
def test_an_effect_beside_steps_between_rows_is_called_by_no_other_name(R_s):
    record, model = two_nodes(17, R_s=R_s)
    found = diagnose(model, [record])
    assert found.verdict in ("missing_effect", "unknown_effect")
    assert {s.candidate.name for s in found.selected} <= {"surface_joule"}, found.sentence
