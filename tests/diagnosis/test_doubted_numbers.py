"""Numbers of a model for which the readings ask for more: none of them is called identified."""

from dataclasses import replace

import pytest

from bms_gateway.diagnosis.calibrate import DOUBTED, changes, statuses
from bms_gateway.diagnosis.core_known import known_core
from bms_gateway.report.core_text import DOUBTFUL_NUMBERS, numbers_remark
from bms_gateway.report.html import numbers_html
from tests.diagnosis.hidden_record import hidden, record_of
from tests.truth.hidden import Scenario, make_log

KNOWN = ("identified", "weakly identified")
STRING = {"cells": 3, "sensors": (1, 2, 3), "seconds": 1800, "seed": 31, "noise": 0.2, "columns": ("soc",)}


def as_from_a_data_sheet(model):
    """The model with heat capacities that are hardly known, so that they can make up for what it lacks."""
    wide = {name: replace(model.priors[name], rel_sd=sd) for name, sd in (("C_c", 0.12), ("C_s", 0.6))}
    return replace(model, priors={**model.priors, **wide})


@pytest.fixture(scope="module")
def asked():
    """Cores of a model that follows the surfaces, by readings that ask for a gradient in the roll all the same."""
    record, model = record_of(make_log(Scenario({"radial_gradient": (0.2, None)}, **STRING)))
    core = known_core(as_from_a_data_sheet(model), [record])
    assert core.identified.model_error_K == 0.0
    assert any("radial_gradient" in why for why in core.why)
    return core


def test_no_number_is_identified_where_the_readings_ask_for_more(asked):
    assert asked.lacks
    assert asked.numbers_doubted
    plain, told = ([c.status for c in changes(asked.identified.fit, doubted=d)] for d in (False, True))
    assert set(KNOWN) & set(plain)
    assert told == [DOUBTED if s in KNOWN else s for s in plain]
    assert not set(KNOWN) & set(statuses(asked.identified.fit, doubted=True))


def test_pages_say_it_beside_the_numbers(asked):
    html = numbers_html(asked.identified.fit, asked)
    assert DOUBTFUL_NUMBERS in html
    assert f'<span class="alarm">{DOUBTED}</span>' in html
    assert ">identified<" not in html
    assert numbers_remark(asked) == DOUBTFUL_NUMBERS


def test_numbers_of_a_sound_model_stay_identified():
    _, record, model = hidden(None, **STRING)
    core = known_core(as_from_a_data_sheet(model), [record])
    assert not core.lacks
    assert numbers_remark(core) == ""
    assert "identified" in [c.status for c in changes(core.identified.fit, doubted=core.numbers_doubted)]


def test_numbers_with_a_model_error_keep_their_sd_which_allow_for_it():
    _, record, model = hidden("radial_gradient", "strong", **STRING)
    core = known_core(as_from_a_data_sheet(model), [record])
    assert core.lacks
    assert core.identified.model_error_K > 0.0
    assert not core.numbers_doubted
    assert "allow for what it lacks" in numbers_remark(core)
