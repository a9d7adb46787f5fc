"""A diagnosis says the same to people and to programs, and nothing that JSON cannot hold."""

import json
import re
from dataclasses import replace

import pytest

from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.detect import Card, Detectable
from bms_gateway.diagnosis.diagnosis import Diagnosis
from bms_gateway.diagnosis.ranking import Standing
from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.diagnosis.residuals import Structure
from bms_gateway.diagnosis.verdict_parts import Errors, Number, Selected
from bms_gateway.report.diagnosis_text import Told, diagnosis_document, diagnosis_text, parts_of, reach, with_sd
from bms_gateway.report.html_ranking import detectability_table, ranking_table
from bms_gateway.thermal.effects import effect_named

NAN = float("nan")
NUMBERS = {"B": Number(3100.0, 210.0, "K")}


def ranked(*effects, evidence, role="instead", refused="", heldout=0.1, without=NAN):
    tied = ("charge_transfer",)
    return Standing(effects, role, evidence, 0.5, heldout, heldout, without, NUMBERS, tied, refused)


def told(*ranks, verdict="missing_effect", selected=("resistance_temperature",), **more):
    structure = Structure(0.04, 12.0, 1.5)
    base, after = Errors(0.2, 0.3, 0.1, structure), Errors(0.1, NAN, 0.1, structure)
    chosen = tuple(Selected(Candidate(effect_named(s)), ("charge_transfer",), NUMBERS, 40.0) for s in selected)
    d = Diagnosis(verdict, False, lambda *_: "The sentence.", chosen, (), (), base, after, None)
    return Told(d, d.sentence, ("a.csv",), ranking=ranks, **more)


def test_a_document_holds_no_number_that_json_does_not_have():
    r = ranked("resistance_temperature", evidence=float("inf"), heldout=NAN)
    text = json.dumps(diagnosis_document(told(r)), allow_nan=False)
    d = json.loads(text)
    assert d["after"]["heldout_rmse_K"] is None
    assert d["ranking"][0]["evidence"] is None


def test_a_ranking_of_programs_holds_single_effects_and_hypotheses_the_others():
    d = diagnosis_document(
        told(
            ranked("resistance_temperature", evidence=40.0, role="named", without=0.3),
            ranked("cell_cooling:2", evidence=-1.0, role="next", refused="evidence too weak"),
            ranked("charge_transfer", "entropic_heat", evidence=-8.0),
        )
    )
    first, second = d["ranking"]
    assert (first["effect"], first["cell"], first["role"], first["error_without_K"]) == (
        "resistance_temperature", None, "named", 0.3,
    )  # fmt: skip
    assert (second["effect"], second["cell"], second["role"]) == ("cell_cooling", 2, "next")
    assert second["error_without_K"] is None
    assert [h["effects"] for h in d["hypotheses"]] == [["charge_transfer", "entropic_heat"]]


def of_effects(text, roles):
    """Lines of a ranking by the identifier, which stands in brackets behind the label."""
    return {re.search(r"\(([a-z_]+(?::\d+)?)\)", line)[1]: line for line in text.splitlines() if line.startswith(roles)}


def test_an_effect_has_its_label_before_its_identifier():
    text = diagnosis_text(
        told(
            ranked("ambient_loss", evidence=40.0, role="named"),
            ranked("phase_change:2", evidence=-3.0, role="next", refused="the bound of end_plate (cell 1)"),
            card=("ambient_loss and cell_cooling (cell 3) look alike here.",),
        )
    )
    lines = of_effects(text, ("named ", "next "))
    assert "second heat path to the surroundings (ambient_loss)" in lines["ambient_loss"]
    assert "latent heat at the surface (phase_change:2)" in lines["phase_change:2"]
    assert "the bound of end plates cool or warm the end cells (end_plate, cell 1)" in text
    assert (
        "second heat path to the surroundings (ambient_loss) and one cell's cooling differs (cell_cooling, cell 3) "
        "look alike here."
    ) in text


def test_bars_are_as_long_as_the_evidence():
    text = diagnosis_text(
        told(
            ranked("resistance_temperature", evidence=40.0, role="named"),
            ranked("hysteresis", evidence=30.0),
            ranked("charge_transfer", evidence=15.0, refused="worse on the held-out blocks"),
            ranked("cell_cooling:3", evidence=-2.0),
        )
    )
    lines = of_effects(text, ("named ", "instead "))
    assert lines["hysteresis"].count("█") == 2 * lines["charge_transfer"].count("█") > 0
    assert "█" not in lines["cell_cooling:3"]
    assert "worse on the held-out blocks" in lines["charge_transfer"]


def test_bars_of_great_evidence_leave_small_ones_to_be_seen():
    text = diagnosis_text(
        told(
            ranked("resistance_temperature", evidence=9e4, role="named"),
            ranked("charge_transfer", evidence=9.0, role="next"),
        )
    )
    lines = of_effects(text, ("named ", "next "))
    assert lines["resistance_temperature"].count("█") > lines["charge_transfer"].count("█") > 1


def test_what_is_named_stands_with_what_the_error_is_without_it():
    text = diagnosis_text(
        told(
            ranked("entropic_heat", evidence=40.0, role="named", without=0.4789),
            ranked("cell_cooling:3", evidence=30.0, role="named", without=0.1724),
            ranked("charge_transfer", evidence=9.0, role="tied"),
            ranked("phase_change", evidence=-3.0, role="next", refused="evidence too weak"),
        )
    )
    order = ["0.479", "0.172", "charge_transfer", "phase_change", "log-odds against leaving it out"]
    assert [text.index(x) for x in order] == sorted(text.index(x) for x in order)
    assert "or: cannot be told from what is named" in " ".join(text.split())


def test_people_are_told_the_verdict_first_then_all_the_rest():
    text = diagnosis_text(
        told(
            ranked("resistance_temperature", evidence=40.0, role="named"),
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
        "activation temperature (B) = 3100 ± 210 K",
        "evidence",
        "noise alone",
        "A gain goes into R_e.",
        "Next: Warm the inlet by 10 K.",
        "could not show latent heat at the surface (phase_change)",
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


def test_numbers_have_their_labels_their_units_and_what_stands_behind_their_plus_minus():
    number = {"R_1": Number(0.25, 0.01, "mOhm")}
    chosen = replace(told().diagnosis.selected[0], candidate=Candidate(effect_named("polarization")), parameters=number)
    one = ranked("polarization", evidence=40.0, role="named")
    one = replace(one, parameters=number)
    text = diagnosis_text(replace(told(one), diagnosis=replace(told().diagnosis, selected=(chosen,))))
    assert "its numbers, ± 1 sd:\n    resistance of the slow part (R_1) = 0.250 ± 0.010 mOhm" in text
    html = ranking_table([one])
    assert "its numbers, ± 1 sd</th>" in html
    assert "resistance of the slow part (R_1) = 0.250 ± 0.010 mΩ<" in html


def test_what_the_data_could_show_has_labels():
    size = Detectable("polarization", "polarization", None, "R_1", "mOhm", 0.1, 0.6, visible=True)
    html = detectability_table(Card((size,), (), (), ()))
    assert "(polarization)<" in html
    assert ">resistance of the slow part (R_1)<" in html
    assert ">mΩ<" in html


PAIR = ("entropic_heat", "ambient_loss")
RANKS = (
    ranked("entropic_heat", evidence=400.0, role="named"),
    ranked("ambient_loss", evidence=20.0, role="named"),
    ranked("charge_transfer", evidence=300.0, role="tied"),
    replace(ranked("end_plate", evidence=15.0, role="tied"), beside=("entropic_heat",)),
    replace(ranked("current_offset", evidence=2.0, role="next"), beside=PAIR),
    ranked("hysteresis", evidence=90.0, role="instead"),
)
AGAINST = [
    "log-odds against leaving it out",
    "log-odds against the model as it is",
    "log-odds against the model with reversible (entropic) heat (entropic_heat)",
    "log-odds against what is named",
    "log-odds against the model as it is",
]


def test_bars_that_are_weighed_against_different_models_have_scales_of_their_own():
    parts = parts_of(RANKS)
    assert [p.against for p in parts] == AGAINST
    assert [p.top for p in parts] == [400.0, 300.0, 15.0, 10.0, 90.0]
    html = ranking_table(RANKS)
    assert re.findall(r"Bars: (.*?)\.</td>", html) == AGAINST
    assert "a model that lacks nothing" not in html
    need = [float(x) for x in re.findall(r'<line x1="([\d.]+)"', html)]
    assert len(set(need[:2])) == 1  # of one part
    assert len(set(need)) == 5


def test_the_terminal_says_what_each_part_is_weighed_against():
    text = " ".join(diagnosis_text(told(*RANKS)).split())
    assert f"or: cannot be told from what is named, {AGAINST[1]}, or {AGAINST[2]};" in text
    assert f"next: one more beside what is named, {AGAINST[3]};" in text
    assert f"instead: in place of what is named, {AGAINST[4]};" in text
    assert "bars of each kind have a scale of their own" in text


def test_bars_that_are_not_in_proportion_are_said_to_be_logarithmic():
    """A bar of 325 was half as long as one of 3700, and nothing said why."""
    said = ". Bars are as long as the logarithm of their log-odds"
    parts = parts_of(RANKS)
    for p in parts:
        lengths = [reach(e, p.top) for e in (0.1 * p.top, 0.2 * p.top)]
        linear = lengths[1] == pytest.approx(2.0 * lengths[0])
        assert p.bars == (p.against if linear else p.against + said)
    assert [p.bars.endswith(said) for p in parts] == [True, True, False, False, False]
    text = " ".join(diagnosis_text(told(*RANKS)).split())
    assert "bars are as long as the logarithm of their log-odds in a kind that has more than 100" in text
    assert "logarithm" not in " ".join(diagnosis_text(told(ranked("hysteresis", evidence=90.0, role=""))).split())


def test_nothing_named_is_weighed_against_the_model_as_it_is():
    (part,) = parts_of([ranked("hysteresis", evidence=1.0, role="")])
    assert (part.title, part.against, part.top) == ("Weighed", "log-odds against the model as it is", 10.0)
