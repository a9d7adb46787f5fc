"""An effect that records ask for is told by its label, its identifier in brackets."""

from types import SimpleNamespace

from bms_gateway.diagnosis.core_known import _lacking
from bms_gateway.report.words import in_words
from bms_gateway.thermal.effects import effect_named


def test_the_effect_that_records_ask_for_has_its_label():
    effect = effect_named("surface_joule")
    asked = SimpleNamespace(passed=True, candidate=SimpleNamespace(key="surface_joule", effect=effect))
    told = _lacking([[SimpleNamespace(passed=False), asked]])
    assert told == f"These records ask for {effect.title} (surface_joule), which the model lacks."
    assert in_words(told).count(effect.title) == 1
