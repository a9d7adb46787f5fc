"""A report of the page has its verdict, ranking, steps and notes, and is the same whatever became of the program."""

import json
from html import escape

import pytest

from bms_gateway.cli.main import main
from bms_gateway.workbench.desk import Desk
from bms_gateway.workbench.session import additions_of, diagnoses_of
from tests.report.html_page import Page
from tests.support.desk_steps import done, files
from tests.support.page_steps import ADDED
from tests.truth.packs import pack as make_pack

NOTES = "Sensor 3 was glued anew <b>on Monday</b>\nand again on Tuesday"


def taken(desk, ticked=None):
    path = desk.report(ticked)
    text = path.read_text(encoding="utf-8")
    path.unlink()
    return text


def three_digits(x):
    """A number below 1000 and not below 0.0001 with three significant digits, written without the package."""
    size = int(f"{x:.2e}".partition("e")[2])
    return f"{x:.{max(2 - size, 0)}f}"


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"), seconds=700)


@pytest.fixture(scope="module")
def road(pack):
    """Reports of a diagnosis and of the addition after it, what the page showed, and the session."""
    desk = Desk("road")
    try:
        desk.open(files(pack))
        done(desk)
        desk.note(NOTES)
        desk.diagnose()
        state = done(desk)
        of_diagnosis, first = taken(desk), desk.session()
        desk.add(["entropic_heat"])
        done(desk)
        of_addition, session = taken(desk), desk.session()
        desk.rest()  # its process ends, and what this kept of the fits
        assert not desk.awake
        again = taken(desk)
        return state, of_diagnosis, of_addition, again, json.dumps(first), json.dumps(session)
    finally:
        desk.close()


def resumed(pack, text):
    """Report of a desk that knows nothing but a session."""
    session = json.loads(text)
    desk = Desk("anew")
    try:
        desk.resume(files(pack), additions_of(session), session["notes"], diagnoses_of(session))
        state = done(desk)
        assert state["diagnosed"]["recalled"] is True
        text = taken(desk)
        return text, desk.state()
    finally:
        desk.close()


@pytest.mark.slow
def test_the_report_of_an_addition_has_verdict_ranking_steps_and_notes(road, pack, tmp_path):
    state, _, text, *_ = road
    page = Page(text)
    said, seen = page.text.replace("\N{NO-BREAK SPACE}", " "), state["diagnosed"]
    assert f"{seen['tag']} Diagnosis of the model “refitted”: {seen['sentence']}" in said
    assert f'class="notes">{escape(NOTES)}</p>' in text
    way = text[text.index('<ol class="way">') : text.index("</ol>")]
    names = [part.partition("</b>")[0] for part in way.split("<li><b>")[1:]]
    assert [n.replace("\N{NO-BREAK SPACE}", " ") for n in names] == ["from its file", "refitted", ADDED]
    # the ranking: its held-out errors are those of the page, and of the command, to the last digit
    rows = [r for r in page.tables["ranking"][0] if len(r) == 8 and r[0] != "effect"]
    column = page.tables["ranking"][0][0].index("held-out, K")
    shown = [r[column] for r in rows]
    assert shown == [three_digits(r["error_K"]) for r in seen["ranking"]]
    out = tmp_path / "d.json"
    assert main(["diagnose", *pack.words, "--json", str(out)]) == 0
    told = json.loads(out.read_text())
    alone = {r["effect"]: r["error_K"] for r in told["ranking"]}
    on_page = {r["name"]: r["error_K"] for r in seen["ranking"] if r["name"] in alone}
    assert on_page["entropic_heat"] == pytest.approx(alone["entropic_heat"], rel=1e-12)
    assert on_page == pytest.approx({k: alone[k] for k in on_page}, rel=1e-12)
    before, after = told["baseline"]["heldout_rmse_K"], told["after"]["heldout_rmse_K"]
    cards = said[said.index("Error on held-out blocks") :][:120]
    assert f"{three_digits(before)} → " in cards
    assert after < before


@pytest.mark.slow
def test_it_is_the_same_after_its_process_was_started_anew(road):
    """It became a plain comparison, without what the addition had said."""
    _, _, before, again, *_ = road
    assert again == before


@pytest.mark.slow
def test_it_is_the_same_after_the_program_was_started_anew_and_the_session_opened(road, pack):
    _, of_diagnosis, of_addition, _, first, session = road
    text, state = resumed(pack, session)
    assert text == of_addition
    assert "recalled" not in state["diagnosed"]  # the page has it computed now too
    assert not any("session file" in s["remains"] for s in state["steps"])
    assert resumed(pack, first)[0] == of_diagnosis


@pytest.mark.slow
def test_nothing_that_a_changed_session_file_says_of_a_diagnosis_is_in_the_report(road, pack):
    _, of_diagnosis, *_, first, _ = road
    session = json.loads(first)
    said = session["diagnosed"][0]["said"]
    said["sentence"], said["tag"], said["ranking"] = "All is well.", "Forged", said["ranking"][:1]
    text, state = resumed(pack, json.dumps(session))
    assert text == of_diagnosis
    assert "All is well." not in json.dumps(state)
