"""What a verdict offers to add is what adding accepts: both are decided by the same gate."""

from dataclasses import replace

import pytest

from bms_gateway.diagnosis import adding
from bms_gateway.diagnosis.adding import add_effects, wanted, weighed_step
from bms_gateway.diagnosis.diagnosis import judged
from bms_gateway.diagnosis.offer import Offer, offer
from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.report.diagnosis_text import Told, diagnosis_document, diagnosis_text
from bms_gateway.report.examine import offer_of
from bms_gateway.workbench.documents import diagnosed
from tests.diagnosis.decided import at_its_bound, by_first, pair


def with_a_bound():
    """A verdict of two effects, of which the first ends with a number at its bound."""
    return replace(judged(at_its_bound()[1]), identified=by_first().identified)


def gate(d, keys):
    record, model = pair()
    return add_effects(model, [record], [wanted(k, model) for k in keys], ask=lambda *_, **__: d)


def test_what_is_offered_is_added():
    d = by_first()
    record, _ = pair()
    made = offer(d, [record])
    assert made == Offer(tuple(s.candidate.key for s in d.selected))
    assert made.sentence == ""
    assert gate(d, made.effects).refused == ""


def test_an_effect_that_adding_refuses_is_not_offered():
    """The main button added all named effects; the gate then refused a number at its bound, which the verdict told."""
    d = with_a_bound()
    record, _ = pair()
    keys = [s.candidate.key for s in d.selected]
    assert keys[0] == "entropic_heat"
    assert "ends at its bound" in gate(d, keys).refused  # as it was offered
    made = offer(d, [record])
    assert made.effects == tuple(keys[1:])
    assert made.left_out == ("entropic_heat",)
    assert gate(d, made.effects).refused == ""
    assert f"{keys[1]} can be added without entropic_heat" in made.sentence
    assert "ends at its bound" in made.sentence


def test_where_nothing_can_be_added_words_say_what_to_do():
    d = with_a_bound()
    record, _ = pair()
    alone = replace(d, selected=d.selected[:1], search=replace(d.search, chosen=d.search.chosen[:1]))
    made = offer(alone, [record])
    assert made.effects == ()
    assert made.sentence.startswith("Nothing of this can be added without force: ")
    assert "diagnose both records together" in made.sentence
    told = Told(alone, alone.sentence, ("a.csv",), offer=made)
    assert "can be added without force" in " ".join(diagnosis_text(told).split())
    assert diagnosis_document(told)["offer"] == {"effects": [], "refused": made.refused}
    page, _ = diagnosed(told)
    assert page["offer"] == []
    assert "−1.5 mV/K" in page["not_offered"]


def test_a_part_is_not_sent_to_a_whole_that_is_refused_too(monkeypatch):
    """Alone it was refused with the advice to add all at once, which was refused as well."""
    d = with_a_bound()
    _, model = pair()
    for refused, said in (
        (lambda *_: "so it is", False),
        (lambda f, _: "" if f is d.search.final else "so it is", True),
    ):
        monkeypatch.setattr(adding, "unbelievable", refused)
        step = weighed_step(d, [wanted("entropic_heat", model)])
        assert step.refused.startswith("alone, so it is; these records ask for resistance_temperature as well")
        assert step.refused.endswith(": add entropic_heat and resistance_temperature at once") == said


@pytest.mark.parametrize("severity", ["stop", "warn"])
def test_a_record_that_adding_refuses_takes_the_offer_back(severity):
    d = by_first()
    record, _ = pair()
    found = [("b.csv", Finding("too_short", severity, "It lasts 20 s."))]
    made = offer_of(d, [record], found)
    assert bool(made.effects) == (severity == "warn")
    assert ("b.csv: It lasts 20 s" in made.sentence) == (severity == "stop")
