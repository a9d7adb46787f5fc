"""What the records cannot tell from an added effect is kept with it; a number at its bound proves nothing."""

from dataclasses import replace
from functools import cache
from math import isnan

import numpy as np
import pytest

from bms_gateway.config.model_file import format_model, parse_model
from bms_gateway.diagnosis.adding import add_effects, cores_with_named, wanted
from bms_gateway.diagnosis.bounds import at_bound
from bms_gateway.diagnosis.compare import compare
from bms_gateway.diagnosis.core_known import known_core
from bms_gateway.diagnosis.diagnosis import diagnose, judged
from bms_gateway.diagnosis.ranking import ranking
from bms_gateway.diagnosis.verdict_words import missing
from bms_gateway.diagnosis.weighing import believed_share
from bms_gateway.errors import ConfigError
from bms_gateway.report.added import added_report
from bms_gateway.report.comparison_text import comparison_document, comparison_text
from bms_gateway.thermal import AddedEffect
from tests.diagnosis.decided import at_its_bound, by_first, pair
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import STRANGE, Scenario, make_log

TIED = "The records by which entropic_heat was added cannot tell it from hysteresis: it would explain them as well."


def tied_verdict():
    """A verdict whose first effect is tied with another one."""
    d = by_first()
    first, *rest = d.selected
    return replace(d, selected=(replace(first, tied_with=("hysteresis",)), *rest))


def added():
    d = tied_verdict()
    record, model = pair()
    wants = [wanted(s.candidate.key, model) for s in d.selected]
    return record, add_effects(model, [record], wants, ask=lambda *_, **__: d)


def test_an_added_effect_keeps_what_it_cannot_be_told_from():
    """The tie was told once, before `add`, and never again."""
    record, addition = added()
    assert TIED in addition.remark
    text = format_model(addition.model)
    assert 'tied_with = ["hysteresis"]' in text
    again = parse_model(text)
    assert next(e for e in again.effects if e.name == "entropic_heat").tied_with == ("hysteresis",)
    assert next(e for e in again.unfitted.effects if e.name == "entropic_heat").tied_with == ("hysteresis",)
    report = added_report(addition, [record], (), (), out="out.toml")
    assert TIED in report.remark
    c = compare(again, [record])
    assert any(TIED in text for text in c.refitted.findings)
    assert "cannot tell it from hysteresis" in " ".join(comparison_text(c, (), ()).split()).replace(
        "hysteresis losses", "hysteresis"
    )
    assert any(TIED in text for text in comparison_document(c, (), ())["refitted"]["findings"])


def test_a_tie_with_no_effect_is_refused():
    _, addition = added()
    text = format_model(addition.model).replace('tied_with = ["hysteresis"]', 'tied_with = ["hystersis"]')
    with pytest.raises(ConfigError, match=r"effect.entropic_heat.tied_with: .*hysteresis"):
        parse_model(text)


def test_a_number_at_its_bound_is_told_and_has_no_probability():
    """An effect whose number stood at its bound was shown with a probability of 100 %."""
    trial, found = at_its_bound()
    said = at_bound(trial.fit, trial.candidate)
    assert "ends at its bound" in said
    assert any(said.startswith(f"{p.description} ({p.name}) ") for p in trial.candidate.effect.parameters)  # in words
    assert not said.endswith(" 1")  # a number without a unit has none
    share, why = believed_share(trial)
    assert isnan(share)
    assert "no proof" in why
    d = judged(found)
    assert d.verdict != "missing_effect"
    first = next((s for s in d.selected if s.candidate is trial.candidate), None)
    if first is not None:
        assert "no proof" in missing(d.baseline, d.after, selected=d.selected, remains=False)
    assert all(isnan(r.share) for r in d.ranking if r.effect == trial.candidate.name)


def test_what_is_named_with_a_number_at_its_bound_is_ranked_without_a_probability():
    trial, found = at_its_bound()
    d = replace(by_first(), search=found)
    row = next(x for x in ranking(d) if x.effects == (trial.candidate.key,))
    assert isnan(row.share)
    assert "ends at its bound" in row.refused


def test_numbers_inside_their_bounds_keep_their_probability():
    d = by_first()
    for t in d.search.rounds[0]:
        if not at_bound(t.fit, t.candidate):
            assert believed_share(t) == (t.share, t.why)
    assert not any("no proof" in x.refused for x in ranking(d) if x.role == "named")


def tabs(t, size, rng):
    """Heat leaves the roll through its tabs, to surroundings at 25 °C."""
    t.sink = np.full(t.K, 25.0)
    t.core_G += 0.1 * size


@cache
def through_the_tabs():
    """A log of a cell that loses heat through its tabs, with its record and model."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(STRANGE, "foreign_sink", tabs)
        log = make_log(
            Scenario({"foreign_sink": ("medium", None)}, cells=1, sensors=(1,), seed=3, cycle="mixed", noise=0.05)
        )
    return (log, *record_of(log))


def error_and_band(core, log, record):
    """Error of the core (K,), K, and twice its sd."""
    band = core.bands[0]
    true = np.interp(band.time_s + record.instants[0], log.table["time_s"], log.core[:, 0])
    return np.abs(band.T_c[:, 0] - true), 2.0 * band.total_K[:, 0]


def test_heat_through_the_tabs_is_told_from_a_loss_at_the_surfaces():
    """It was called a loss of the surfaces, and a core 2.3 K off was proven with an sd of 0.6 K."""
    log, record, model = through_the_tabs()
    d = diagnose(model, [record])
    assert [s.candidate.key for s in d.selected] == ["core_loss"], d.sentence
    G = d.selected[0].parameters["G"]
    assert abs(G.value - 0.1) < 2.0 * G.sd
    assert G.sd < 0.01
    core = cores_with_named(model, [record], d)[-1]
    error, band = error_and_band(core, log, record)
    assert np.sqrt(np.mean(error**2)) < 0.2  # 2.3 K where it is taken for a loss at the surfaces
    assert np.mean(error <= band) > 0.9
    assert not core.proven
    assert any("leaves the casings" in why for why in core.why)


def test_a_loss_at_the_surfaces_proves_no_core_for_it_may_be_the_cores_own():
    log, record, model = through_the_tabs()
    core = known_core(
        replace(model, effects=(AddedEffect("ambient_loss", None, {"G": 0.06, "P": 0.0}, {"G": 0.2, "P": 2.0}),)),
        [record],
    )
    assert not core.proven
    assert any("through their tabs" in why for why in core.why)
    error, band = error_and_band(core, log, record)
    assert np.mean(error <= band) > 0.9
