"""A current logged too seldom: what happened between its rows is not taken for a missing effect."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.config.model_file import parse_model
from bms_gateway.diagnosis.coarse_rows import HOPELESS, SHOWN, doubt, left_open, shows_steps
from bms_gateway.diagnosis.diagnosis import diagnose
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.record import make_record
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.identify.map_fit import fitted
from bms_gateway.identify.problem import Problem
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import Scenario, make_log

SHORT = Scenario(cells=1, sensors=(1,), seconds=2400, noise=0.05, seed=7)


SMALL_CELL = """cells = 1
sensors = [1]
condition = "single"
effects = []
[parameters]
C_c = { value = 60.0, unit = "J/K", rel_sd = 0.05 }
C_s = { value = 5.0, unit = "J/K", rel_sd = 0.05 }
R_e = { value = 25.0, unit = "mOhm", rel_sd = 0.3 }
R_c = { value = 1.2, unit = "K/W", rel_sd = 0.3 }
R_u = { value = 7.0, unit = "K/W", rel_sd = 0.3 }
"""


def two_nodes(seed, *, noise=0.05, on_the_row=False, R_s=0.0):
    """Record and model of a cell of two nodes, 1,800 rows a second apart: its current steps at any instant."""
    rng = np.random.default_rng(seed)
    per_s = 20
    current, k = np.zeros(1800 * per_s), 0
    while k < len(current):
        long = int(rng.exponential(25.0) * per_s) + 1
        if on_the_row:
            long = max(round(long / per_s), 1) * per_s
        current[k : k + long] = 5.0 * rng.choice([0, 0, 1, 2, 4, -1, -2])
        k += long
    t = np.arange(len(current)) / per_s
    air = 25.0 + 4.0 * np.sin(2.0 * np.pi * t / 700.0)
    core, surface, seen = 25.0, 25.0, np.empty(len(t))
    for i, (amps, around) in enumerate(zip(current.tolist(), air.tolist(), strict=True)):
        seen[i] = surface
        inwards = (core - surface) / 1.3
        core += (amps**2 * 0.022 - inwards) / 62.0 / per_s
        surface += (inwards + amps**2 * R_s - (surface - around) / 6.0) / 5.2 / per_s
    y = seen[::per_s] + rng.normal(0.0, noise, 1800)
    model = parse_model(SMALL_CELL)
    rows = Columns(
        time_s=t[::per_s], current_A=current[::per_s], coolant_inlet_C=air[::per_s], surface_C={1: y}, source="small"
    )
    return make_record(rows, model), model


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


@pytest.mark.parametrize(("seed", "noise"), [(12, 0.05), (13, 0.05), (14, 0.02), (15, 0.02)])
def test_steps_between_rows_of_a_second_are_no_effect(seed, noise):
    # half a second of heat of a small cell stands out of the noise: it was called unknown, or a drift
    record, model = two_nodes(seed, noise=noise)
    found = diagnose(model, [record])
    assert found.verdict == "adequate", found.sentence
    assert not found.unknown_remains


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
def test_an_effect_beside_steps_between_rows_is_called_by_no_other_name(R_s):
    record, model = two_nodes(17, R_s=R_s)
    found = diagnose(model, [record])
    assert found.verdict in ("missing_effect", "unknown_effect")
    assert {s.candidate.name for s in found.selected} <= {"surface_joule"}, found.sentence
