"""What the second search may name: no special cause beside an error of the model itself, nothing improbable as sure."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.diagnosis.adding import Wanted, add_effects, weighed_step
from bms_gateway.diagnosis.compare import compare
from bms_gateway.diagnosis.diagnosis import judged, judged_again
from bms_gateway.diagnosis.error_words import course
from bms_gateway.diagnosis.hypotheses import UNCLEAN, Board, Hypothesis
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.search import search
from bms_gateway.diagnosis.second_search import SecondSearch, probability
from bms_gateway.diagnosis.weighing import Settings
from tests.diagnosis.decided import by_first, by_second, pair
from tests.diagnosis.hidden_record import hidden, named


def board(**scores):
    """Hypotheses by the names of their effects, joined by `__`, with their scores."""
    made = Board.__new__(Board)
    found = [
        Hypothesis(tuple(named(n) for n in key.split("__") if n), SimpleNamespace(), score)
        for key, score in scores.items()
    ]
    made.found = {h.key: h for h in found}
    return made


def test_the_probability_of_an_effect_is_that_of_all_hypotheses_that_have_it():
    b = board(
        resistance_temperature=np.log(0.11),
        resistance_temperature__entropic_heat=np.log(0.6),
        surface_joule=np.log(0.29),
    )
    assert probability(b, "resistance_temperature") == pytest.approx(0.71)
    assert probability(b, "entropic_heat") == pytest.approx(0.6)
    b = board(resistance_temperature=np.log(0.11), entropic_heat=np.log(0.6), resistance_soc=np.log(0.29))
    assert probability(b, "resistance_temperature") == pytest.approx(0.11)


def test_special_causes_are_not_believed_once_the_model_itself_errs():
    b = board(phase_change=9.0, entropic_heat__current_offset=8.0, entropic_heat=5.0, resistance_soc=4.0)
    assert b.accepted()[0].names == ("phase_change",)
    b.refuse_special()
    assert [h.names for h in b.accepted()] == [("entropic_heat",), ("resistance_soc",)]
    assert {h.refused for h in b.found.values() if h.special} == {UNCLEAN}


@pytest.mark.slow
def test_an_effect_that_is_likelier_to_be_another_is_said_to_be_one_of_several():
    d = by_second()
    key = d.selected[0].candidate.key
    sure = replace(d.second, probability={s.candidate.key: 0.9 for s in d.selected}, verdict="missing_effect")
    assert judged_again(judged(d.search), sure).verdict == "missing_effect"
    doubted = replace(sure, probability={**sure.probability, key: 0.11})
    said = judged_again(judged(d.search), doubted)
    assert said.verdict == "undecidable"
    assert said.sentence.startswith("Something is missing, and these readings do not decide what. The likeliest: ")
    assert "Missing:" not in said.sentence
    assert f"{key} is one of several: its probability is 11 %" in said.sentence
    assert next(r.share for r in said.ranking if r.effect == key) == 0.11


@pytest.mark.parametrize(
    ("held", "says"),
    [
        ((0.4, 0.3), "it explains a part only: closely fitted, the error falls from 0.4 to 0.3 K"),
        ((0.4, 0.6), "it makes it worse: closely fitted, the error rises from 0.4 to 0.6 K"),
        ((0.4, 0.4), "it changes nothing: closely fitted, the error stays at 0.4 K"),
    ],
)
def test_what_is_refused_is_told_by_what_it_does(held, says, monkeypatch):
    d = by_second()
    monkeypatch.setattr(SecondSearch, "held_K", held)
    unknown = replace(d.second, verdict="unknown_effect")
    said = judged_again(judged(d.search), unknown)
    assert said.verdict == "unknown_effect"
    assert {r.refused for r in said.ranking} == {says}
    assert f"{held[0]:.2g} K on held-out blocks, noise" in said.sentence


def test_before_and_after_are_told_by_the_yardstick_of_compare():
    d = by_second()
    record, model = pair()
    seen = compare(model, [record]).refitted
    assert (d.baseline.train_rmse_K, d.baseline.heldout_rmse_K) == (seen.trained.rmse_K, seen.held.rmse_K)
    assert course(d.baseline.heldout_rmse_K, d.after.heldout_rmse_K) in d.sentence
    assert f"Fitted to the first 60 %, the error in the last 40 % {course(*d.second.tail)}." in d.sentence
    wants = [Wanted(s.candidate.effect, s.candidate.cell) for s in d.selected]
    after = compare(add_effects(model, [record], wants, ask=lambda *_, **__: d).model, [record]).refitted
    assert (d.after.train_rmse_K, d.after.heldout_rmse_K) == (after.trained.rmse_K, after.held.rmse_K)


def test_add_tells_a_refused_effect_by_what_it_does_to_the_readings():
    d = by_second()
    unknown = replace(d.second, verdict="unknown_effect")
    keys = [Wanted(c.candidate.effect, c.candidate.cell) for c in d.second.chosen]
    step = weighed_step(replace(d, selected=(), verdict="unknown_effect", second=unknown), keys)
    assert step.refused.startswith("it explains a part only: closely fitted, the error falls from ")
    assert step.refused.endswith("these records lack something that is in no catalogue")


@pytest.mark.slow
def test_with_a_voltage_the_answer_stays_in_physical_effects():
    """Heat by the voltage would explain anything that makes heat: it is offered when nothing physical explains it."""
    _, record, model = hidden(
        "resistance_temperature",
        "strong",
        cells=1,
        sensors=(1,),
        seconds=1200,
        seed=11,
        columns=("soc", "voltage"),
    )
    ready = [measured(record, model)]
    few = Settings(refits=1, effects=1)
    names = {t.candidate.name for r in search(model, ready, few).rounds for t in r}
    assert "voltage_heat" not in names
    found = search(model, ready, replace(few, voltage=True))
    assert "voltage_heat" in {g.candidate.name for g in found.gains}
    assert by_first().search.asked is by_first().search.rounds
