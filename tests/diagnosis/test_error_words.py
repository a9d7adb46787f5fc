"""What is said of an error is what it did: an effect that makes the held-out readings worse is not named."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.diagnosis.diagnosis import judged
from bms_gateway.diagnosis.error_words import course
from bms_gateway.diagnosis.residuals import Structure
from bms_gateway.diagnosis.verdict_parts import Errors
from bms_gateway.diagnosis.verdict_words import Others, missing, nothing_missing
from bms_gateway.identify.map_fit import stacked
from bms_gateway.report.html import verdict_tag
from tests.diagnosis.decided import by_first


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        (0.32, 0.4, "rises from 0.32 to 0.4 K"),
        (0.4, 0.32, "falls from 0.4 to 0.32 K"),
        (0.4, 0.399, "stays at 0.4 K"),
        (0.4, 0.401, "stays at 0.4 K"),
        (0.1, 0.1, "stays at 0.1 K"),
        (0.4, float("nan"), "stays at nan K"),
    ],
)
def test_the_word_is_what_the_figures_say(before, after, says):
    assert course(before, after) == says


def spoilt(found, kelvin, rows):
    """The search with its final fit so many kelvin off at these readings: to and fro, so that no mean hides it."""
    y = found.final.prediction.y.copy()
    y[rows] += kelvin * np.where(np.arange(rows.sum()) % 2, 1.0, -1.0)
    return replace(found, final=replace(found.final, prediction=replace(found.final.prediction, y=y)))


@pytest.mark.slow
def test_an_effect_that_raises_the_held_out_error_is_not_named():
    found = by_first().search
    assert found.chosen
    held = ~stacked(found.final.problem)[4]
    d = judged(spoilt(found, 3.0 * by_first().baseline.heldout_rmse_K, held))
    assert d.verdict == "unknown_effect"
    assert not d.selected
    assert "falls" not in d.sentence


def test_an_error_that_rises_is_not_said_to_fall():
    """Within what was trained the effect holds; beyond it, where the total error comes from, it does not."""
    found = by_first().search
    d = judged(found)
    assert f"falls from {d.baseline.heldout_rmse_K:.2g} to {d.after.heldout_rmse_K:.2g} K" in d.sentence
    worse = replace(d.after, heldout_rmse_K=1.3 * d.baseline.heldout_rmse_K)
    text = missing(d.baseline, worse, selected=d.selected, remains=False)
    assert "rises from" in text
    assert "falls from" not in text
    assert "speak for them only where they were fitted" in text
    assert text.startswith("Perhaps missing: ")
    assert missing(d.baseline, d.after, selected=d.selected, remains=False).startswith("Missing: ")
    assert verdict_tag(d) == "Missing effect"
    for held in (1.3, 0.99):
        unshown = replace(d, after=replace(d.after, heldout_rmse_K=held * d.baseline.heldout_rmse_K))
        assert verdict_tag(unshown) == "Perhaps an effect, not shown on held-out readings"


def test_what_is_tied_is_said_of_the_effect_that_it_looks_like():
    d = by_first()
    first, second = d.selected
    tied = (replace(first, tied_with=()), replace(second, tied_with=("charge_transfer",)))
    text = missing(d.baseline, d.after, selected=tied, remains=False)
    assert f"These readings cannot tell {second.candidate.key} from charge_transfer." in text
    assert "tell it" not in text


def test_what_is_called_explained_is_told_with_the_error_that_was_judged():
    """It said "explains these readings: 0.42 K, noise 0.1 K": the error was that of numbers held near a file."""
    white = Structure(0.0, 0.0, 1.0)
    judged = Errors(0.105, 0.108, 0.101, white)
    same = nothing_missing(judged, judged, closest=judged)
    assert "0.11 K on held-out blocks, noise 0.1 K" in same
    assert "stated" not in same
    stated = Errors(0.4, 0.42, 0.101, white)
    apart = nothing_missing(stated, stated, closest=judged)
    assert apart.startswith("The model explains these readings: 0.11 K on held-out blocks, where it comes closest")
    assert "held near what was known and leave 0.42 K" in apart


@pytest.mark.parametrize(("closest_K", "mentioned"), [(1.6, True), (30.0, False)])
def test_what_other_numbers_alone_would_do_is_no_merit_of_an_effect(closest_K, mentioned):
    """Of a file whose R_u was five times too large, "falls from 36 to 0.05 K" was told of polarisation alone."""
    d = by_first()
    far = replace(d.baseline, heldout_rmse_K=36.0)
    text = missing(far, d.after, selected=d.selected, remains=False, others=Others(closest_K))
    assert "falls from 36 to " in text
    assert (f"Without them, other numbers of the same model leave {closest_K} K." in text) == mentioned
