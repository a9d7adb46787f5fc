"""Logs with something hidden in the independent finer physics: what the diagnosis calls it."""

from functools import cache

import numpy as np
import pytest

from bms_gateway.diagnosis.diagnosis import diagnose
from tests.benchmarks.diagnosis_case import examine
from tests.benchmarks.diagnosis_scores import missed, names, visible
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import Scenario, make_log, make_logs
from tests.truth.sizes import SIZES
from tests.truth.suites import SENSORS, controls, one_cell, pairs, singles, suited

SEED = 6_100_000
"""Packs that nothing was tuned on."""
SECONDS = 1800
SINGLES = (
    ("entropic_heat", "medium", 3),
    ("resistance_temperature", "strong", 3),
    ("flow_dependent_cooling", "medium", 5),
    ("ambient_loss", "strong", 3),
    ("coolant_delay", "medium", 3),
    ("cell_resistance", "strong", 5),
    ("thermocouple_lag", "medium", 3),
    ("current_offset", "medium", 1),
    ("cell_cooling", "strong", 12),
)
CONTROLS = (
    {"cycle": "urban", "inlet": "steps"},
    {"cycle": "pulses", "inlet": "constant", "columns": ()},
    {"cycle": "sweep", "noise": 0.3, "step": 0.5, "inlet": "sine"},
    {"cycle": "us06", "missing": 0.1, "jitter": 0.3, "noise": 0.2},
    {"cycle": "mixed", "flow": "steps", "columns": ("flow", "soc", "voltage")},
    {"cycle": "mixed", "cells": 1, "sensors": (1,), "step": 0.25},
)
UNKNOWNS = ("sun_load", "loose_thermocouple")
DEAR = ("coolant_delay", "cell_cooling", "loose_thermocouple", "entropic_heat", "flow_dependent_cooling")
"""The longest to diagnose; the pair and the others say nearly the same."""
PAIR = ("flow_dependent_cooling", "busbar_joule")


def dear_ones_slow(names):
    return [pytest.param(name, marks=pytest.mark.slow) if name in DEAR else name for name in names]


def single(i, effect, size, cells, **more):
    return suited({effect: size}, cells, SEED + i, reading=(0.1, 0.1), seconds=SECONDS, **more)


@cache
def logs():
    """All logs of the plain tests, made together."""
    made = {("single", effect): single(i, effect, size, cells) for i, (effect, size, cells) in enumerate(SINGLES)}
    for i, more in enumerate(CONTROLS):
        made["control", i] = Scenario(seed=SEED + 100 + i, seconds=SECONDS, **more)
    for i, name in enumerate(UNKNOWNS):
        made["unknown", name] = Scenario(
            {name: ("strong", None)}, cells=3, sensors=SENSORS[3], seed=SEED + 200 + i, seconds=SECONDS
        )
    made["pair", 0] = suited(dict.fromkeys(PAIR, "medium"), 3, SEED + 310, reading=(0.05, 0.1), seconds=SECONDS)
    return dict(zip(made, make_logs(list(made.values())), strict=True))


def diagnosed(log):
    record, model = record_of(log)
    return diagnose(model, [record])


@pytest.mark.parametrize("effect", dear_ones_slow(effect for effect, _, _ in SINGLES))
@pytest.mark.plain_cases(3)
def test_a_hidden_effect_is_named_with_its_cell_and_the_rest_is_noise(effect):
    log = logs()["single", effect]
    found = diagnosed(log)
    assert found.verdict == "missing_effect", found.sentence
    assert [s.candidate.name for s in found.selected] == [effect]
    assert found.selected[0].candidate.cell == log.cells[effect]
    assert found.after.heldout_rmse_K < 1.15 * np.hypot(log.scenario.noise, log.scenario.step / np.sqrt(12))


@pytest.mark.parametrize("i", range(len(CONTROLS)), ids=[c["cycle"] for c in CONTROLS])
def test_nothing_is_found_where_nothing_is_hidden(i):
    found = diagnosed(logs()["control", i])
    assert (found.verdict, found.unknown_remains, found.selected) == ("adequate", False, ()), found.sentence


@pytest.mark.parametrize("name", dear_ones_slow(UNKNOWNS))
def test_what_is_in_no_catalogue_is_called_unknown(name):
    found = diagnosed(logs()["unknown", name])
    assert found.verdict == "unknown_effect" or found.unknown_remains, found.sentence


@pytest.mark.slow
def test_two_hidden_effects_are_both_named():
    found = diagnosed(logs()["pair", 0])
    assert sorted(s.candidate.name for s in found.selected) == sorted(PAIR), found.sentence


def test_the_same_record_gives_the_same_verdict_to_the_last_bit():
    log = logs()["single", "current_offset"]
    one, other = diagnosed(log), diagnosed(log)
    assert one.sentence == other.sentence
    assert np.array_equal(one.search.final.theta, other.search.final.theta)


@pytest.mark.slow
def test_of_all_effects_that_show_nearly_all_are_named_first_and_nothing_else_is():
    scenarios = [suited({name: "medium"}, 5, SEED + 1000 + i, seconds=SECONDS) for i, name in enumerate(SIZES)]
    seen = [o for log in make_logs(scenarios) if visible(o := examine("singles", log))]
    assert len(seen) >= 25
    first = sum(names(o["ours"])[:1] == [o["hidden"][0]["effect"]] for o in seen)
    assert first >= 0.9 * len(seen), [f"{o['name']}: {missed(o, o['ours'])}" for o in seen if missed(o, o["ours"])]


def test_a_number_at_its_bound_that_leaves_nothing_needs_no_second_search():
    # all of R_c is spread over the jelly roll: the whole share is the right number, and a second search, coarser by
    # what it grants the model, used to name a superfluous effect beside it
    (scenario,) = (s for s in one_cell(300) if s.seed == 3_001_050)
    record, model = record_of(make_logs([scenario])[0])
    found = diagnose(model, [record])
    assert [s.candidate.name for s in found.selected] == list(scenario.effects) == ["radial_gradient"]
    assert found.selected[0].parameters["phi"].value == pytest.approx(1.0, abs=0.02)
    assert found.second is None
    assert not found.unknown_remains


@pytest.mark.parametrize(
    ("base", "seed"), [pytest.param(9400, 94_002_050, marks=pytest.mark.slow), (9600, 96_002_035), (9900, 99_002_035)]
)
def test_noise_taken_for_too_small_under_coarse_steps_is_nothing_unknown(base, seed):
    # steps of five and ten sd: the noise was found a fifth too small, and white readings failed the held-out blocks by
    # it; where few readings stand near the edge of their level, those of the held-out blocks may be such by chance, or
    # because the temperature stood near one there
    (scenario,) = (s for s in controls(base) if s.seed == seed)
    record, model = record_of(make_logs([scenario])[0])
    assert diagnose(model, [record]).verdict == "adequate"


@pytest.mark.slow
@pytest.mark.parametrize(("base", "seed"), [(9600, 96_005_008), (9600, 96_005_004)])
def test_two_effects_are_found_beside_others_that_come_near_them(base, seed):
    """The way to both leads over a first effect that explains a little less; a rival once ended after two steps."""
    (scenario,) = (s for s in pairs(base) if s.seed == seed)
    record, model = record_of(make_logs([scenario])[0])
    found = diagnose(model, [record])
    assert sorted(s.candidate.name for s in found.selected) == sorted(scenario.effects), found.sentence
    assert not found.unknown_remains


@pytest.mark.slow
def test_a_rival_that_comes_late_is_told_as_tied():
    """Its third step gained little of what it promised, and it was given up with half of the way to go."""
    (scenario,) = (s for s in singles(9700) if s.seed == 97_000_138)
    record, model = record_of(make_logs([scenario])[0])
    found = diagnose(model, [record])
    named = {found.selected[0].candidate.name, *found.selected[0].tied_with}
    assert {"neighbour_heat", "thermocouple_offset"} <= named, found.sentence


@pytest.mark.slow
def test_what_takes_the_place_of_an_earlier_effect_is_the_best_at_its_end():
    """After eight steps voltage_heat led in its place by 155 in evidence; at their ends it was 15 behind."""
    log = make_log(
        Scenario(
            effects={"entropic_heat": ("medium", None), "ambient_loss": ("medium", None)},
            cells=12, sensors=tuple(range(1, 13)), noise=0.1, cycle="urban", inlet="steps", flow="steps", seed=4711,
            columns=("flow", "soc", "voltage"),
        )
    )  # fmt: skip
    record, model = record_of(log)
    found = diagnose(model, [record])
    assert sorted(s.candidate.name for s in found.selected) == ["ambient_loss", "entropic_heat"], found.sentence
