"""Heat that wanders in one cell beside a current that steps between its rows: the rows are no excuse for it."""

from functools import cache

import numpy as np
import pytest

from bms_gateway.config.model_file import parse_model
from bms_gateway.diagnosis.diagnosis import diagnose
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.record import make_record
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.diagnosis.residuals import within
from bms_gateway.diagnosis.wandering import WANDERS, heat_in_one_cell
from bms_gateway.identify.map_fit import fitted, stacked
from bms_gateway.identify.problem import Problem
from tests.benchmarks.diagnosis_case import seen
from tests.benchmarks.diagnosis_scores import missed, shows
from tests.diagnosis.hidden_record import record_of
from tests.diagnosis.two_nodes import two_nodes
from tests.truth.hidden import Scenario, make_log

SENSORS = {3: (1, 3), 5: (1, 3, 5), 8: (1, 3, 6, 8)}
PER_S = 20
MODEL = """cells = {cells}
sensors = {sensors}
condition = "full"
effects = []
[parameters]
C_c = {{ value = 60.0, unit = "J/K", rel_sd = 0.05 }}
C_s = {{ value = 5.0, unit = "J/K", rel_sd = 0.05 }}
R_e = {{ value = 25.0, unit = "mOhm", rel_sd = 0.3 }}
R_c = {{ value = 1.2, unit = "K/W", rel_sd = 0.3 }}
R_u = {{ value = 7.0, unit = "K/W", rel_sd = 0.3 }}
R_cc = {{ value = 20.0, unit = "K/W", rel_sd = 0.4 }}
C_f = {{ value = 1.5, unit = "W/K", rel_sd = 0.05 }}
"""


def telegraph(rng, size, longest_s):
    """0 or 1 (size,), in turn, for a minute and more."""
    out, k = np.zeros(size), 0
    for at in range(size):
        long = int(rng.uniform(60.0, longest_s) * PER_S)
        out[k : k + long] = at % 2
        k += long
        if k >= size:
            break
    return out


@cache
def string(seed, cells=5, *, loose=0.0, cell=2):
    """Record and model of small cells in one stream: rows a second apart, and a current that steps at any instant.

    `loose` times a hundredth of I² W heats the casing of one cell whenever its joint is loose.
    """
    rng = np.random.default_rng(seed)
    current, k = np.zeros(1800 * PER_S), 0
    while k < len(current):
        long = int(rng.exponential(25.0) * PER_S) + 1
        current[k : k + long] = 5.0 * rng.choice([0, 0, 1, 2, 4, -1, -2])
        k += long
    t = np.arange(len(current)) / PER_S
    joint = 0.01 * loose * current**2 * telegraph(np.random.default_rng(seed + 1000), len(t), 400.0)
    air = 25.0 + 4.0 * np.sin(2.0 * np.pi * t / 700.0)
    R = 0.022 * (1.0 + 0.02 * rng.normal(size=cells))
    # the stream of cell k is the air and what the cells before gave to it: T_f = M T_s + a T_in
    share = 1.0 / (6.0 * 1.5)
    M, a = np.zeros((cells, cells)), np.zeros(cells)
    row, air_left = np.zeros(cells), 1.0
    for c in range(cells):
        M[c], a[c] = row, air_left
        row, air_left = row * (1.0 - share), air_left * (1.0 - share)
        row[c] += share
    neighbours = np.diag(np.full(cells - 1, 1.0), 1) + np.diag(np.full(cells - 1, 1.0), -1)
    between = (neighbours - np.diag(neighbours.sum(axis=1))) / 20.0
    stays = between - (np.eye(cells) - M) / 6.0
    core, surface, seen = np.full(cells, 25.0), np.full(cells, 25.0), np.empty((len(t), cells))
    for i, (amps, around, heat) in enumerate(zip(current.tolist(), air.tolist(), joint.tolist(), strict=True)):
        seen[i] = surface
        inwards = (core - surface) / 1.3
        into = inwards + stays @ surface + a * (around / 6.0)
        into[cell - 1] += heat
        core = core + (amps**2 * R - inwards) / 62.0 / PER_S
        surface = surface + into / 5.2 / PER_S
    model = parse_model(MODEL.format(cells=cells, sensors=list(SENSORS[cells])))
    read = {k: seen[::PER_S, k - 1] + rng.normal(0.0, 0.02, 1800) for k in SENSORS[cells]}
    rows = Columns(
        time_s=t[::PER_S],
        current_A=current[::PER_S],
        coolant_inlet_C=air[::PER_S],
        surface_C=read,
        source="small cells",
    )
    return make_record(rows, model), model


def evidence(record, model):
    fit = fitted(Problem(model, [measured(record, model)]))
    return heat_in_one_cell(fit, [record], stacked(fit.problem)[4] | within(fit))


@pytest.mark.parametrize(("seed", "cells"), [(20, 3), (22, 3), (25, 5), (30, 8)])
def test_steps_between_rows_are_no_heat_in_one_cell(seed, cells):
    assert evidence(*string(seed, cells)) < 0.5 * WANDERS


@pytest.mark.parametrize("seed", [14, 15])
def test_steps_of_a_single_cell_are_no_other_heat(seed):
    assert evidence(*two_nodes(seed, noise=0.02)) < 0.5 * WANDERS


@pytest.mark.parametrize(("seed", "cell"), [(12, 4), (15, 2)])
def test_a_loose_joint_is_heat_in_one_cell(seed, cell):
    assert evidence(*string(seed, loose=0.15, cell=cell)) > WANDERS


def test_heat_that_no_current_makes_is_seen_in_a_single_cell():
    assert evidence(*two_nodes(12, bleed_W=0.1)) > 2.0 * WANDERS


@pytest.mark.slow
def test_rows_that_leave_room_for_its_size_do_not_hide_a_loose_joint():
    # it was "adequate": steps of the current between its rows, as many as there are, explained its heat
    record, model = string(12, loose=0.15, cell=4)
    found = diagnose(model, [record])
    assert found.verdict == "unknown_effect", found.sentence
    assert not found.selected


def test_steps_between_rows_are_nothing_missing_in_a_string():
    record, model = string(12)
    assert diagnose(model, [record]).verdict == "adequate"


@pytest.mark.slow
def test_a_loose_joint_of_the_finer_truth_is_unknown():
    loose = Scenario(
        {"loose_joint": ("medium", None)}, 8, (1, 3, 6, 8), noise=0.1, cycle="mixed", seed=93004033
    )  # fmt: skip
    record, model = record_of(make_log(loose))
    assert diagnose(model, [record]).verdict == "unknown_effect"


@pytest.mark.parametrize(("size", "there"), [(0.02, False), ("medium", True)])
def test_a_benchmark_asks_for_no_more_than_readings_show(size, there):
    hidden = Scenario({"sun_load": (size, None)}, 3, (1, 3), seconds=900, seed=6_100_301)
    twins = tuple(
        make_log(Scenario(e, 3, (1, 3), seconds=900, seed=6_100_301, noise=0.0)) for e in (hidden.effects, {})
    )
    record, model = record_of(make_log(hidden))
    told = seen(record, fitted(Problem(model, [measured(record, model)])), twins)
    quiet = {"suite": "unknowns", "seen": told}, {"verdict": "adequate", "named": [], "remains": False}
    assert shows(quiet[0]) == there
    assert bool(missed(*quiet)) == there
