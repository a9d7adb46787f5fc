"""Doubt stays in sight: a core not proven, something unknown that remains, a core thermocouple that disagrees."""

import csv

import pytest

from bms_gateway.workbench.steps import TABLES, Frame, doubt_lines, remains, steps_of
from tests.support.page_steps import FIT_S, seen_compared, seen_diagnosed
from tests.truth.packs import pack as make_pack
from tests.workbench.conftest import served

WRONG_K = 40.0
"""By which the thermocouple of the test reads too much: more than any band allows."""


def frame(label, *, proven=True, left=None, variants=()):
    core = {"proven": proven, "sentence": "Core not proven: so it is.", "why": ["Because."], "sd_K": 1.0}
    stair = {"trained_K": 0.1, "held_K": 0.1, "floor_K": 0.1, "core_K": 1.0}
    tables = dict.fromkeys(TABLES, "<table></table>")
    compared = {"core": core, "variants": {name: {"stair": stair} for name in variants or (label,)}, **tables}
    diagnosed = None if left is None else {"remains": left}
    return Frame("cells = 1\n", label, compared=compared, diagnosed=diagnosed)


def test_what_a_diagnosis_leaves_open_stays_until_a_later_one_says_otherwise():
    first = frame("refitted", left=True, variants=("from its file", "refitted"))
    second, third = frame("+ a"), frame("+ b")
    steps = steps_of([first, second, third])
    assert [s["name"] for s in steps] == ["from its file", "refitted", "+ a", "+ b"]
    assert all("Something unknown remains" in s["remains"] for s in steps)
    second.diagnosed = {"remains": False}
    assert [bool(s["remains"]) for s in steps_of([first, second, third])] == [True, True, False, False]
    assert remains([first, second, third]) == ""


def test_what_a_session_file_says_takes_no_doubt_away():
    # Bug: a file with `remains` changed to false was believed, and took away what an earlier diagnosis had left open.
    first = frame("refitted", left=True, variants=("from its file", "refitted"))
    second, third = frame("+ a"), frame("+ b")
    second.diagnosed = {"remains": False, "recalled": True}
    steps = steps_of([first, second, third])
    assert all(
        s["remains"].startswith("Something unknown remains: the diagnosis of the model “refitted”") for s in steps
    )
    first.diagnosed = {"remains": False, "recalled": True}
    said = remains([first, second, third])
    assert said.startswith("By the session file alone, nothing unknown remains: it says so of the model “+ a”")
    assert said.endswith("The diagnosis must be computed again here.")
    assert said in doubt_lines([first, second, third])
    third.compared["core"]["why"] = ["Something unknown remains beside what was added."]  # computed here
    assert remains([first, second, third]).startswith("Something unknown remains: the addition")
    first.diagnosed = {"remains": True, "recalled": True}  # doubt is taken from a file too
    assert remains([first, second]).startswith("Something unknown remains: the diagnosis")
    second.diagnosed = {"remains": False}  # made here
    assert remains([first, second]) == ""


def test_what_an_addition_left_open_is_said_by_those_who_open_its_file_later():
    first = frame("refitted", proven=False, variants=("from its file", "refitted"))
    first.compared["core"]["why"] = ["Something unknown remains beside what was added.", "Because."]
    assert all("Something unknown remains" in s["remains"] for s in steps_of([first]))
    first.diagnosed = {"remains": False}  # of this model, which was fitted with what was added
    second = frame("+ a")
    assert [bool(s["remains"]) for s in steps_of([first, second])] == [True, True, False]


def test_the_file_taken_away_says_what_is_to_be_doubted():
    lines = doubt_lines([frame("refitted", left=True), frame("+ a", proven=False)])
    assert lines[:2] == ["Core not proven: so it is.", "Because."]
    assert lines[2].startswith("Something unknown remains")
    assert doubt_lines([frame("refitted")]) == []


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    """With an effect that no catalogue knows, and a thermocouple in the core of cell 1 that reads far too much."""
    made = make_pack(tmp_path_factory.mktemp("pack"), effect="sun_load")
    with made.hidden.open(newline="") as f:
        rows = list(csv.DictReader(f))
    with made.hidden.open("w", newline="") as f:
        out = csv.DictWriter(f, [*rows[0], "core_1_C"])
        out.writeheader()
        out.writerows({**r, "core_1_C": float(r["surface_1_C"] or "nan") + WRONG_K} for r in rows)
    return made


@pytest.mark.slow
def test_doubt_is_said_on_every_step_in_the_bars_the_report_and_the_file(window, pack):
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        for step in ("open", "compare", "diagnose", "add", "take"):
            page.click(f"#tab-{step}")
            assert page.there("#doubt"), step
            assert "Core not proven" in page.text("#doubt")
        page.click("#tab-compare")
        said = page.text("#panel-compare .danger")
        assert "Thermocouple in the core of cell 1" in said
        assert "outside the 95 % band" in said
        red = page.run("return getComputedStyle(document.querySelector('#panel-compare .danger')).color")
        assert red == "rgb(176, 0, 32)"
        page.wait(
            "return document.querySelector('#plot-core').data.some(d => d.name === 'thermocouple outside the band')"
        )
        hatched = (
            "return document.querySelector('#plot-core').data.filter(d => d.fill === 'toself')"
            ".map(d => d.fillpattern?.shape)"
        )
        assert page.run(hatched) == ["/", "/"]  # the bands of both steps
        seen_diagnosed(page)
        page.idle()
        assert "Something unknown remains" in page.text("#doubt")
        desk = page.run("return JSON.parse(sessionStorage.workbench).desk")
        take = "return fetch(`/api/take?desk=${arguments[0]}&what=report`).then(r => r.text())"
        report = page.run(take, desk)  # of the diagnosis
        assert "Which effect is the model missing?" in report
        assert 'class="danger">Thermocouple in the core of cell 1' in report
        page.click("#tab-add")
        page.type("#effect-name", "coolant_delay")
        page.press("Enter")
        page.wait("return document.querySelector('#refusal')", patience_s=FIT_S)
        page.click("#force")
        page.wait("return document.querySelectorAll('#panel-add .way li').length === 3", patience_s=FIT_S)
        page.idle(FIT_S)
        assert "Something unknown remains" in page.text("#doubt")
        assert "Something unknown remains" in page.text("#panel-add .way li:last-child")
        assert page.run("return document.querySelectorAll('#panel-add .bar.unproven').length") >= 6
        assert "core is not proven" in page.text("#hatched")
        # and that it was added by force, wherever the step stands
        step = "+ coolant arrives late (coolant_delay), by force"
        for where in ("#what", "#variants", "#bar-names", "#panel-add .way li:last-child", "#legend"):
            assert step in page.run("return document.querySelector(arguments[0]).textContent", where), where
        legend = "[...document.querySelectorAll('#plot-surface .legendtext')].map(t => t.textContent).join(' ')"
        page.wait(f"return {legend}.includes('by force')")
        hatch = "return getComputedStyle(document.querySelector('#panel-add .bar.unproven i')).backgroundImage"
        assert "repeating-linear-gradient" in page.run(hatch)
        report = page.run(take, desk)
        assert 'class="alarm">Core not proven' in report
        assert "(coolant_delay), by force" in report
        assert 'class="alarm">Something unknown remains' in report
        assert 'class="danger">Thermocouple in the core of cell 1' in report
        page.click("#tab-take")
        model = page.run("return fetch(document.querySelector('#take-model').href).then(r => r.text())")
        assert model.startswith("# Core not proven")
        assert "\n# Something unknown remains" in model
        assert page.complaints() == []
