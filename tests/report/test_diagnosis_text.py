"""A diagnosis says the same to people and to programs, and nothing that JSON cannot hold."""

import json

import pytest

from bms_gateway.diagnose.candidates import Candidate
from bms_gateway.diagnose.checks import Finding
from bms_gateway.diagnose.diagnosis import Diagnosis, Errors, Number, Ranked, Selected
from bms_gateway.diagnose.residuals import Structure
from bms_gateway.report.diagnosis_text import Told, diagnosis_document, diagnosis_text, ranking, with_sd
from bms_gateway.thermal.effects import effect_named

NAN = float("nan")
NUMBERS = {"B": Number(3100.0, 210.0, "K")}


def ranked(effect, evidence, *, cell=None, refused="", heldout=0.1):
    return Ranked(effect, cell, heldout, evidence, 0.5, NUMBERS, ("charge_transfer",), refused)


def told(*ranks, verdict="missing_effect", selected=("resistance_temperature",), **more):
    structure = Structure(0.04, 12.0, 1.5)
    base, after = Errors(0.2, 0.3, 0.1, structure), Errors(0.1, NAN, 0.1, structure)
    chosen = tuple(Selected(Candidate(effect_named(s)), ("charge_transfer",), NUMBERS, 40.0) for s in selected)
    d = Diagnosis(verdict, False, "The sentence.", chosen, (), ranks, base, after, None)
    return Told(d, d.sentence, ("a.csv",), **more)


def test_a_document_holds_no_number_that_json_does_not_have():
    r = ranked("resistance_temperature", float("inf"), heldout=NAN)
    text = json.dumps(diagnosis_document(told(r)), allow_nan=False)
    d = json.loads(text)
    assert d["after"]["heldout_rmse_K"] is None
    assert d["ranking"][0]["evidence"] is None


def test_an_effect_with_several_starts_is_ranked_once():
    a, b, c = ranked("phase_change", 9.0), ranked("phase_change", 7.0), ranked("cell_cooling", 5.0, cell=2)
    assert ranking(told(a, b, c).diagnosis) == (a, c)


def test_bars_are_as_long_as_the_evidence():
    text = diagnosis_text(
        told(
            ranked("resistance_temperature", 40.0),
            ranked("charge_transfer", 20.0, refused="worse on the held-out blocks"),
            ranked("cell_cooling", -2.0, cell=3),
        )
    )
    lines = {line.split()[0]: line for line in text.splitlines() if line.strip()}
    assert lines["resistance_temperature"].count("█") == 2 * lines["charge_transfer"].count("█") > 0
    assert "█" not in lines["cell_cooling:3"]
    assert "worse on the held-out blocks" in lines["charge_transfer"]


def test_people_are_told_the_verdict_first_then_all_the_rest():
    text = diagnosis_text(
        told(
            ranked("resistance_temperature", 40.0),
            findings=(
                ("a.csv", Finding("stuck_sensor", "warn", "Is its sensor stuck?")),
                ("a.csv", Finding("soc_span", "note", "The charge hardly moves.")),
            ),
            notes=(("a.csv", "A gap of 3 s was bridged."),),
            absorbed=("A gain goes into R_e.",),
            next_experiment="Warm the inlet by 10 K.",
            card=("These records could not show phase_change.",),
        )
    )
    order = [
        "The sentence.",
        "Is its sensor stuck?",
        "B = 3100 ± 210 K",
        "evidence",
        "noise alone",
        "A gain goes into R_e.",
        "Next: Warm the inlet by 10 K.",
        "could not show phase_change",
        "The charge hardly moves.",
        "A gap of 3 s was bridged.",
    ]
    places = [text.index(part) for part in order]
    assert places == sorted(places)
    assert "a.csv" not in text  # one record needs no name


def test_several_records_are_named():
    text = diagnosis_text(Told(None, "Nothing can be said.", ("a.csv", "b.csv"), notes=(("b.csv", "A gap."),)))
    assert text.startswith("Nothing can be said.")
    assert "b.csv: A gap." in text


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [(0.0, 0.25, "0.00 ± 0.25"), (-0.0041, 0.0002, "-0.00410 ± 0.00020"), (7.0, 0.0, "7"), (7.0, NAN, "7")],
)
def test_numbers_have_as_many_digits_as_are_known(value, sd, text):
    assert with_sd(value, sd) == text
