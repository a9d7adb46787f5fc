"""A coolant of another flow or medium than the file says shows in a cooling of the cells that goes with their place."""

from dataclasses import replace

import pytest

from bms_gateway.diagnosis.along_coolant import BEYOND, coolant_doubts, trend
from bms_gateway.diagnosis.calibrate import identify
from bms_gateway.diagnosis.core_known import known_core
from tests.diagnosis.hidden_record import hidden

ALL = (1, 2, 3, 4, 5, 6)
STRING = {"cells": 6, "sensors": ALL, "seconds": 1800, "seed": 5, "noise": 0.08}


def with_coolant(model, times):
    """The model with a multiple of its C_f: another flow, or water where there is air."""
    C_f = model.priors["C_f"]
    return replace(model, priors={**model.priors, "C_f": replace(C_f, value=C_f.value * times)})


def fit(times):
    _, record, model = hidden(None, **STRING)
    return identify(with_coolant(model, times), [record]).closest


def test_the_right_coolant_leaves_no_trend():
    found = fit(1.0)
    assert abs(trend(found)[1]) < BEYOND
    assert list(coolant_doubts(found)) == []


@pytest.mark.parametrize(("times", "way", "than"), [(30.0, "grows", "more"), (0.5, "falls", "less")])
@pytest.mark.plain_cases(1)
def test_a_wrong_coolant_is_named(times, way, than):
    (told,) = coolant_doubts(fit(times))
    assert told.startswith(f"R_u {way} along the coolant")
    assert f"along the string {than} than its coolant has it" in told
    assert f"C_f = {11.33 * times:.4g} W/K" in told


@pytest.mark.parametrize("effect", ["entropic_heat", "radial_gradient", "ambient_loss"])
@pytest.mark.plain_cases(1)
def test_the_right_coolant_is_not_doubted_where_an_effect_is_missing(effect):
    """What a model lacks bends all its numbers, and they may go with the place then."""
    _, record, model = hidden(effect, "strong", **STRING)
    found = identify(model, [record]).closest
    assert list(coolant_doubts(found)) == []


def test_it_stands_among_the_reasons_against_a_core():
    _, record, model = hidden(None, **STRING)
    core = known_core(with_coolant(model, 30.0), [record])
    assert any("coolant's flow and medium" in why for why in core.why)
    assert not any("coolant's flow and medium" in why for why in known_core(model, [record]).why)
