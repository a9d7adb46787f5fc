"""What is said of a thermocouple in a core is what its readings are."""

from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.diagnosis.compare import compare
from bms_gateway.diagnosis.core_check import CoreCheck
from bms_gateway.diagnosis.core_known import known_core
from bms_gateway.report.core_text import core_document, core_sentence, core_text, thermocouple_sentence
from bms_gateway.report.html_evidence import evidence, summary
from bms_gateway.report.html_series import Shown
from bms_gateway.report.step_names import REFITTED
from bms_gateway.workbench.documents import compared as compared_document
from bms_gateway.workbench.documents import told_core
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import Scenario, make_log


def check(covered):
    return CoreCheck(0, 2, 6.0, 1.8, covered, np.arange(2.0), np.arange(2.0))


@pytest.mark.parametrize(
    ("covered", "end", "alarm"),
    [
        (1.0, "6.00 K off, within the 95 % band.", False),
        (0.96, "6.00 K off; 4 % of its readings lie outside the 95 % band, as up to 5 % may.", False),
        (0.91, "6.00 K off; 9 % of its readings lie outside the 95 % band.", False),
        (0.60, "6.00 K off; 40 % of its readings lie outside the 95 % band.", True),
    ],
)
def test_a_thermocouple_is_within_a_band_only_where_its_readings_are(covered, end, alarm) -> None:
    """Of one with 9 % of its readings 20 K above the band it was said that it lies within."""
    assert thermocouple_sentence(check(covered)) == f"Thermocouple in the core of cell 2, never fitted to: {end}"
    assert check(covered).outside is alarm


@pytest.mark.parametrize("proven", [True, False])
@pytest.mark.parametrize(("unseen", "said"), [((2, 4, 5), "Cells 2, 4, 5 have"), ((5,), "Cell 5 has"), ((), None)])
def test_a_band_of_a_cell_without_a_thermocouple_says_what_it_assumes(proven, unseen, said) -> None:
    """The band of such a cell, whose R_e was 70 % higher, held its core 1 % of the time, and nothing said why."""
    core = SimpleNamespace(
        half_width_K=np.array([1.0, 2.0, 1.0, 2.0, 5.35]),
        proven=proven,
        unseen=unseen,
        unlike=0.02,
        exchanged=None,
        carried="",
    )
    sentence = core_sentence(core)
    assert "cell 5, known least" in sentence
    if said is None:
        assert "thermocouple" not in sentence
    else:
        assert f"{said} no thermocouple" in sentence
        assert "R_e of all cells is the same to within 2 % (1 sd), as the model file says." in sentence


def test_reasons_against_a_core_have_labels_and_a_true_minus():
    """The page said "-1 1/h" and "resistance_drift.a ends 3.3 sd" where it said "−1 1/h" and "growth" elsewhere."""
    why = (
        "Added by force, though: growth (a) ends at its bound, -1 1/h: not believed.",
        "Added by force, though: evidence too weak (log-odds -5.7).",
        "resistance_drift.a ends 3.3 sd from what was known of it.",
        "cell_cooling:2.a ends at its bound.",
    )
    core = SimpleNamespace(
        half_width_K=np.ones(1),
        proven=False,
        unseen=(),
        unlike=0.0,
        sd_K=0.5,
        centre_sd_K=0.5,
        why=why,
        exchanged=None,
        carried="",
    )
    page = told_core(core)["why"]
    assert page[0].endswith("−1 1/h: not believed.")
    assert page[1].endswith("(log-odds −5.7).")
    assert page[2].endswith("growth (resistance_drift.a) ends 3.3 sd from what was known of it.")
    assert page[3].endswith("(cell_cooling:2.a) ends at its bound.")
    assert "growth (resistance_drift.a) ends 3.3 sd" in core_text(core)


def test_the_cells_that_no_record_of_a_string_has_are_told() -> None:
    log = make_log(Scenario(cells=4, sensors=(1, 4), seconds=1200, seed=3))
    record, model = record_of(log)
    core = known_core(model, [record])
    assert core.unseen == (2, 3)
    assert core.unlike == model.tolerances["cell_R_e"] > 0.0
    assert "Cells 2, 3 have no thermocouple on the surface: their bands hold only where" in core_sentence(core)


def test_each_place_that_shows_the_band_of_such_a_cell_says_so() -> None:
    """Findings, the JSON document, the cells of the page, and the cards and captions of a report."""
    record, model = record_of(make_log(Scenario(cells=4, sensors=(1, 4), seconds=1200, seed=3)))
    compared = compare(model, [record])
    core, now = compared.core, compared.refitted
    assert core_document(core)["rests_on"] in core_sentence(core)
    worst = int(np.argmax(core.half_width_K)) + 1
    assert worst in core.unseen
    assert f"Cell {worst} has no thermocouple on the surface: this holds only where" in now.findings[-1]
    percent = 100.0 * model.tolerances["cell_R_e"]
    shown = compared_document(compared, REFITTED)["variants"][REFITTED]["cells"]
    assert [c["assumed_percent"] for c in shown] == [None, percent, percent, None]
    models = [Shown.of(REFITTED, now, proven=core.proven)]
    assert f"cell {worst}, known least, without a thermocouple" in summary(models)
    assert "Cells 2, 3 have no thermocouple on the surface: their bands hold only where R_e" in "".join(
        evidence(models)
    )


def test_of_a_string_with_all_sensors_nothing_is_assumed() -> None:
    record, model = record_of(make_log(Scenario(cells=2, sensors=(1, 2), seconds=1200, seed=3)))
    compared = compare(model, [record])
    assert core_document(compared.core)["rests_on"] is None
    models = [Shown.of(REFITTED, compared.refitted, proven=compared.core.proven)]
    assert not any("thermocouple" in text for text in (*compared.refitted.findings, *evidence(models), summary(models)))
