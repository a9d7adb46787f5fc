"""A thermocouple in a core is never fitted to; one that contradicts the band speaks against the core everywhere."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.config.model_file import format_model, parse_model
from bms_gateway.diagnosis.compare import compare
from bms_gateway.diagnosis.core_band import UNPROVEN
from bms_gateway.diagnosis.core_check import CONTRADICTED, CoreCheck, contradiction, outside
from bms_gateway.diagnosis.core_known import judged_model, known_core
from bms_gateway.report.comparison_text import comparison_document, comparison_text
from bms_gateway.report.core_text import core_sentence
from bms_gateway.report.html import core_html
from bms_gateway.report.step_names import REFITTED
from bms_gateway.thermal import Share
from bms_gateway.workbench.documents import compared
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import Scenario, make_log

OFF_K = 14.0


@pytest.fixture(scope="module")
def cores():
    """Model, record and cores of a string with nothing hidden: without thermocouples in cores, with true ones, and with
    one in cell 2 that reads 14 K too much."""
    log = make_log(Scenario(cells=3, sensors=(1, 2, 3), seconds=3600, seed=5))
    wrong = log.core + OFF_K * (np.arange(3) == 1)
    records = [record_of(x, core=c)[0] for x, c in ((log, False), (log, True), (replace(log, core=wrong), True))]
    model = replace(record_of(log)[1], core_probe=Share(0.0, 0.0))  # these thermocouples read the mean of the roll
    return model, [(r, known_core(model, [r])) for r in records]


def test_true_thermocouples_leave_the_core_as_it_is(cores):
    _, ((_, without), (_, true), _) = cores
    assert without.proven
    assert true.proven
    assert true.half_width_K.tolist() == without.half_width_K.tolist()


def test_one_thermocouple_beyond_the_band_is_a_reason_against_the_core_and_never_fitted_to(cores):
    _, ((_, without), _, (_, wrong)) = cores
    assert not wrong.proven
    (why,) = wrong.why
    assert why.startswith(f"{CONTRADICTED}: cell 2, ")
    assert float(why.rpartition(", ")[2].split()[0]) == pytest.approx(OFF_K, abs=1.0)
    assert np.array_equal(wrong.identified.fit.theta, without.identified.fit.theta)
    assert all(b.share >= UNPROVEN for b in wrong.bands)
    assert (wrong.half_width_K > without.half_width_K).all()
    assert "nothing speaks against it" in core_sentence(without)
    assert core_sentence(wrong).startswith("Core not proven: ")


def test_terminal_json_report_and_page_say_so(cores):
    model, (_, _, (record, wrong)) = cores
    c = compare(model, [record])
    text, document = comparison_text(c, [], []), json.loads(json.dumps(comparison_document(c, [], [])))
    page = compared(c, REFITTED)["core"]
    report = core_html(c.core, c.refitted.core_checks)
    for said in (text, report, page["sentence"]):
        assert "Core not proven" in said
        assert "nothing speaks against" not in said
    assert wrong.why[0] in text
    assert wrong.why[0] in report
    assert document["core"]["proven"] is page["proven"] is False
    assert document["core"]["why"] == page["why"] == list(wrong.why)


def test_a_fitted_model_keeps_the_reason_and_says_it_once(cores):
    model, (_, _, (record, wrong)) = cores
    written, core = judged_model(wrong.identified, model, [record])
    assert core.why == wrong.why
    again = known_core(parse_model(format_model(written)), [record])
    assert again.why == wrong.why
    assert again.sd_K == core.sd_K


@pytest.mark.parametrize(("covered", "said"), [(0.9, False), (0.899, True), (0.0, True), (1.0, False)])
def test_more_than_a_tenth_of_the_readings_contradicts(covered, said):
    assert outside(covered) is said
    checks = [CoreCheck(0, k, 2.0 + k, 1.8, covered, np.arange(2.0), np.arange(2.0)) for k in (4, 5)]
    assert contradiction(checks) == (f"{CONTRADICTED}: cells 4, 5, up to 7 K off." if said else "")
