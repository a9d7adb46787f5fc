"""The heat that a fit misses: how much, where, and what it follows."""

import re
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.diagnosis.latent import follow_sentence, latent
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.identify.map_fit import fitted
from bms_gateway.identify.problem import Problem
from bms_gateway.report.html_ranking import follows_table
from tests.diagnosis.hidden_record import hidden


def missing(*effect, **scenario):
    log, record, model = hidden(*effect, **scenario)
    return log, latent(fitted(Problem(model, [measured(record, model)])))


@pytest.fixture(scope="module")
def asymmetric():
    return missing("current_offset", "strong", cycle="pulses", seed=6)


def test_nothing_is_missing_from_a_pack_without_a_hidden_effect():
    _, got = missing(seed=4)
    assert got.sentence == "No heat is missing that the readings could show."
    assert max(h.rms_W for h in got.heats) < 0.3
    for h in got.heats:
        assert (np.abs(h.heat_W) <= 4 * h.sd_W + 0.05).all()


@pytest.mark.parametrize(
    ("effect", "scenario", "node", "features"),
    [
        (("entropic_heat", "medium", None), {"cycle": "sweep", "seed": 3}, "core", {"I"}),
        (("surface_joule", "strong", None), {"cycle": "pulses", "seed": 6}, "surface", {"I2"}),
        (
            ("resistance_temperature", "medium", None),
            {"cycle": "mixed", "seed": 6, "cells": 1, "sensors": (1,)},
            "core",
            {"I2_warmth"},
        ),
        (("resistance_drift", "strong", None), {"seed": 6}, "core", {"I2_time"}),
    ],
)
@pytest.mark.plain_cases(2)
def test_the_missing_heat_follows_what_makes_it(effect, scenario, node, features):
    _, got = missing(*effect, **scenario)
    assert got.follows[0].feature in features
    assert got.follows[0].node == got.node == node
    assert got.follows[0].share > 0.4
    assert got.follows[0].title in got.sentence


def test_what_is_not_told_apart_has_no_share_and_less_heat_is_called_so(asymmetric):
    """Six features had "100 %" each, of which none explained a twentieth, and a negative heat was "a heat"."""
    _, got = asymmetric
    first, second = got.follows[:2]
    assert got.alike == (first,)
    assert second.share < 0.95 * first.share
    assert re.search(
        r"goes with less heat in the cores than modelled that follows I \([0-9.]+ mW per A less\)\.$", got.sentence
    )
    near = replace(second, odds=first.odds - 0.5)
    told = follow_sentence("core", got.heats, (first, near), missing=True)
    assert "%" not in told
    assert told.startswith("The misfit goes with heat in the cores; these readings do not tell what it follows: I and ")
    html = follows_table(replace(got, follows=(first, near, *got.follows[2:])))
    assert html.count("not told apart") == 2
    assert not re.search(r"[0-9]e[+−-][0-9]", html)


def test_a_share_does_not_depend_on_how_many_readings_a_fit_averages():
    """The noise was counted by the readings, of which a fit takes means: all features explained 100 % of the rest."""
    shares = [missing("resistance_temperature", "weak", seed=3, noise=noise)[1].follows for noise in (0.05, 0.1)]
    for follows in shares:
        assert follows[0].feature == "I2_warmth"
        assert 0.4 < follows[0].share < 0.8
        assert sum(f.share > 0.9 for f in follows) == 0


def test_its_slope_is_the_coefficient_of_what_is_hidden(asymmetric):
    log, got = asymmetric
    # a current that reads b too much: I² R_e is I_read² R_e − 2 b I_read R_e
    b = log.parameters["current_offset"]["b"][0]
    first = got.follows[0]
    assert (first.node, first.feature) == ("core", "I")
    assert first.slope == pytest.approx(-2 * b * np.mean(log.pack["R_e"]), rel=0.15)


def test_the_curve_is_the_heat_that_the_pack_makes(asymmetric):
    log, got = asymmetric
    b, R_e = log.parameters["current_offset"]["b"][0], log.pack["R_e"]
    current = log.table["current_A"]
    for h in (h for h in got.heats if h.node == "core"):
        slow = [np.mean(current[max(int(t) - 60, 0) : int(t) + 60]) for t in h.time_s]
        true = -2 * b * R_e[h.cell - 1] * np.array(slow)
        assert np.corrcoef(true, h.heat_W)[0, 1] > 0.85


def test_heats_come_with_their_features_for_a_plot(asymmetric):
    _, got = asymmetric
    assert {(h.node, h.cell) for h in got.heats} == {(n, k) for n in ("core", "surface") for k in (1, 3, 5)}
    for f in got.follows:
        mine = [h for h in got.heats if h.node == f.node]
        assert len(f.values) == len(mine)
        assert all(len(x) == len(h.time_s) for x, h in zip(f.values, mine, strict=True))
        assert 0.0 <= f.share <= 1.0
