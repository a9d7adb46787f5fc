"""A session goes its way again: from its file, and after the program was started anew."""

import json

import pytest

from bms_gateway.errors import UsageError
from bms_gateway.workbench.desk import Desk
from bms_gateway.workbench.session import LONGEST_NOTES, additions_of, notes_of, session_of
from bms_gateway.workbench.steps import Frame
from tests.support.desk_steps import done, files
from tests.support.doors import ask, serving
from tests.support.page_steps import FIT_S, seen_added, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import come
from tests.workbench.conftest import served

JSON = {"Content-Type": "application/json"}
LATE = "coolant arrives late (coolant_delay)"
WRITTEN = "Sensor 3 was glued anew <b>on Monday</b> <img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"))


def test_a_session_names_files_and_steps():
    named = {"tables": ["a.csv", "recent.csv"], "model": "m.toml", "config": "", "string": "", "columns": []}
    recent = {"last": "2h", "store": "", "table": "recent.csv"}
    frames = [Frame("", "refitted"), Frame("", "+ a", words=["a", "b:3"]), Frame("", "+ c", words=["c"], forced=True)]
    session = json.loads(json.dumps(session_of({**named, "recent": recent}, frames)))
    assert session["files"]["tables"] == ["a.csv"]
    assert session["files"]["recent"] == "2h"
    assert additions_of(session) == [(["a", "b:3"], False), (["c"], True)]
    assert session["notes"] == ""
    assert session_of({**named, "recent": recent}, frames, "Fühler 3\n<b>")["notes"] == "Fühler 3\n<b>"


@pytest.mark.parametrize("wrong", [None, 3, ["a"], "x" * (LONGEST_NOTES + 1), "half of a pair: \ud83d"])
def test_notes_are_a_text_of_bounded_size(wrong):
    with pytest.raises(UsageError, match="notes"):
        notes_of(wrong)
    assert notes_of("x" * LONGEST_NOTES) == "x" * LONGEST_NOTES


@pytest.mark.slow
def test_notes_come_and_go_over_the_wire_and_stay_what_they_were(pack):
    written = 'Fühler 3 <script>alert(1)</script> & "quoted"\n温度 😀'
    with serving() as server:
        _, body, _ = ask(server, "POST", "/api/desk", "{}", **JSON)
        where = f"?desk={json.loads(body)['desk']}"
        session = {"workbench_session": 1, "files": files(pack), "added": [], "notes": written}
        assert ask(server, "POST", f"/api/resume{where}", json.dumps(session), **JSON)[0] == 200
        desk = server.site.desk(where.removeprefix("?desk="))
        done(desk)
        taken = json.loads(ask(server, "GET", f"/api/take{where}&what=session")[1])
        assert taken["notes"] == written
        half = "the request is no JSON, has half a character"
        refused = [({"notes": x}, "notes: ") for x in (1, "x" * (LONGEST_NOTES + 1))]
        for wrong, why in [*refused, ({}, "notes: "), ({"notes": "\ud83d"}, half)]:
            status, told, _ = ask(server, "POST", f"/api/note{where}", json.dumps(wrong), **JSON)
            assert status == 400
            assert json.loads(told)["error"].startswith(why)
        assert desk.session()["notes"] == written
        assert ask(server, "POST", f"/api/note{where}", json.dumps({"notes": "other"}), **JSON)[0] == 200
        assert desk.session()["notes"] == "other"


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"workbench_session": 2, "files": {}},
        {"workbench_session": True, "files": {}},
        {"workbench_session": 1.0, "files": {}},
        {"workbench_session": 1, "files": []},
        {"workbench_session": 1, "files": {}, "added": [{"effects": "a"}]},
        {"workbench_session": 1, "files": {}, "added": [{"effects": []}]},
        {"workbench_session": 1, "files": {}, "added": "a"},
    ],
)
def test_what_is_no_session_is_one_line(wrong):
    with pytest.raises(UsageError, match="session"):
        additions_of(wrong)


def test_a_session_of_a_newer_version_is_said_to_be_so():
    with pytest.raises(UsageError, match=r"made by a newer version .* \(workbench_session = 2; this one reads 1\)"):
        additions_of({"workbench_session": 2, "files": {}, "added": []})


@pytest.mark.slow
def test_a_refusal_ends_the_way(pack):
    desk = Desk("resumes")
    try:
        desk.resume(files(pack), [(["coolant_delay"], False), (["current_offset"], True)])
        state = done(desk)
        assert state["refusal"]["names"] == LATE
        assert [s["name"] for s in state["steps"]] == ["from its file", "refitted"]
    finally:
        desk.close()


@pytest.mark.slow
def test_the_work_is_there_again(window, driver, pack, tmp_path):
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        seen_added(page)
        page.click("#tab-take")
        page.type("#notes-text", WRITTEN)
        kept = "return JSON.parse(sessionStorage.workbench).session?.notes"
        come(lambda: page.run(kept) == WRITTEN, "notes kept a moment after the last key")
        assert page.run("return document.activeElement.id") == "notes-text"  # who writes is not disturbed
        session = page.run("return fetch(document.querySelector('#take-session').href).then(r => r.text())")
        kept = page.run("return sessionStorage.workbench")
    (tmp_path / "session.json").write_text(session)
    with served(tmp_path) as url:
        page = window(url)  # another browser
        page.upload("#session-file", tmp_path / "session.json")
        page.wait("return document.querySelectorAll('#panel-add .way li').length === 3", patience_s=FIT_S)
        page.idle(FIT_S)
        assert "+ reversible (entropic) heat (entropic_heat)" in page.text("#what")
        page.click("#tab-open")
        assert page.text("#notes-told") == WRITTEN  # as text: nothing of it is run or drawn
        page.click("#tab-take")
        assert page.run("return document.querySelector('#notes-text').value") == WRITTEN
        other = window(url + "icon.svg")  # the same browser, of which the server knows nothing any more
        other.run("sessionStorage.workbench = arguments[0]", kept)  # while no script of the page can write there
        other.go(url)
        other.wait("return document.querySelectorAll('#panel-add .way li').length === 3", patience_s=FIT_S)
        assert other.text("#error-text") == ""
        assert other.run("return document.querySelector('#notes-text').value") == WRITTEN


@pytest.mark.slow
def test_a_duplicated_tab_is_its_own_desk(window, pack):
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        page.run("window.twin = window.open('/')")  # which brings a copy of the tab's storage along
        own = page.run("return JSON.parse(sessionStorage.workbench).desk")
        desk = "return twin.document.body?.dataset.version && JSON.parse(twin.sessionStorage.workbench).desk"
        assert page.wait(desk, patience_s=FIT_S) != own
        shown = "return twin.document.querySelectorAll('#variants .tick').length"
        page.wait(shown + " === 2", patience_s=FIT_S)
        assert page.run("return JSON.parse(sessionStorage.workbench).desk") == own
