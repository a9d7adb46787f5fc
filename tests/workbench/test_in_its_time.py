"""What is pressed too early, said for too long, or written too long; and what is cut off before the first picture."""

import json

import pytest

from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser
SLOW = """
const own = window.fetch;
window.asked = [];
window.fetch = async (url, how) => {
  if (how?.method === 'POST') asked.push(url.split('?')[0]);
  if (url.startsWith('/api/upload')) await new Promise(done => setTimeout(done, 1500));
  return own(url, how);
};
"""
"""Uploads take their time, as on a machine that is busy."""
TABLE = "Datum;Strom_A;Kuehlwasser_C;T1_C;T2_C\n" + "".join(
    f"13/11/2026 08:00:{k:02d};{20 + k % 3};25,0;{26 + k * 0.01:.2f};{27 + k * 0.01:.2f}\n".replace(".", ",")
    for k in range(60)
)
CUT = """
const of = document.createElement('canvas').getContext('2d');
return [...document.querySelectorAll('#mapping td:nth-child(3) > select')].filter(s => {
  const style = getComputedStyle(s);
  of.font = style.font;
  const room = s.clientWidth - parseFloat(style.paddingLeft) - parseFloat(style.paddingRight) - 16;
  return of.measureText(s.selectedOptions[0].innerText).width > room;
}).map(s => `${s.selectedOptions[0].innerText}: ${s.clientWidth}`);
"""
"""Roles whose words have no room beside the arrow of their list."""


def test_open_waits_for_the_files_and_their_columns(window, tmp_path):
    """Pressed while the table was looked at, it asked for --columns, though the page guessed them a moment later."""
    table = tmp_path / "rig.csv"
    table.write_text(TABLE)
    with served(tmp_path) as url:
        page = window(url)
        page.wait("return JSON.parse(sessionStorage.workbench ?? '{}').desk")
        page.run(SLOW)
        page.run("document.querySelector('#describe').open = true")
        page.type("#form-cell", "a123_32157")
        page.upload("#tables-file", table)
        page.run("document.querySelector('#open').click(); document.querySelector('#open').click()")
        page.wait("return asked.includes('/api/open')")
        asked = page.run("return asked")
        assert asked.index("/api/upload") < asked.index("/api/look") < asked.index("/api/open")
        assert asked.count("/api/open") == 1
        page.wait("return document.querySelectorAll('#mapping tbody tr').length === 5")
        told = page.text("#error-text")
        assert "--columns" not in told
        assert "choose a table" not in told

        # the times of the first rows differ in what is shown, and the roles are whole
        values = page.text("#mapping tbody td:nth-child(2)")
        assert "13/11/2026 08:00:00" in values
        assert "…08:00:01" in values
        assert page.run("return innerWidth") == 1280
        assert page.run(CUT) == []
        page.run("for (const s of document.querySelectorAll('#mapping select')) s.style.maxWidth = '100px'")
        assert page.run(CUT) != []  # the test sees what is cut off


def test_what_was_refused_while_something_ran_is_not_said_when_it_has_ended(window, tmp_path):
    with served(tmp_path) as url:
        page = window(url)
        page.wait("return document.body.dataset.version")
        shown = page.run(
            "const { complain, runs } = await import('/page/util.js');"
            "const text = () => document.querySelector('#error-text').innerText;"
            "complain('still reading the files: wait for it or cancel it', 'reading the files');"
            "const seen = [];"
            "for (const title of ['reading the files', 'comparing']) { runs(title); seen.push(text()); }"
            "complain('choose a table'); runs(undefined); seen.push(text());"
            "return seen"
        )
        assert shown == ["Still reading the files: wait for it or cancel it", "", "Choose a table"]


def test_notes_that_are_too_long_are_told_and_stay(window, tmp_path):
    """They were refused as too many bytes, and a reload lost them."""
    with served(tmp_path) as url:
        page = window(url)
        page.wait("return JSON.parse(sessionStorage.workbench ?? '{}').desk")
        shown = (
            "const { noteBox } = await import('/page/notes.js');"
            "document.querySelector('#panel-open').append(noteBox); const box = noteBox.querySelector('textarea');"
            "if (arguments[0]) { box.value = 'é'.repeat(arguments[0]); box.dispatchEvent(new Event('change')); }"
            "await new Promise(done => setTimeout(done, 300));"
            "return [box.value.length, document.querySelector('#notes-long').innerText]"
        )
        long = "Notes: at most 10000 characters are kept, these are 200000."
        for words in (200_000, 0):
            length, told = page.run(shown, words)
            assert length == 200_000
            assert told.startswith(long)
            page.reload()
            page.wait("return document.body.dataset.version")
        assert page.run(shown, 10_000) == [10_000, ""]
        # the program itself says so too
        error = page.run(
            "const { desk } = JSON.parse(sessionStorage.workbench);"
            "return fetch(`/api/note?desk=${desk}`, {method: 'POST', headers: {'Content-Type': 'application/json'},"
            "body: JSON.stringify({notes: 'é'.repeat(200000)})}).then(r => r.json()).then(d => d.error)"
        )
        assert error == "notes: at most 10000 characters are kept, these are 200000"


def test_what_is_no_session_is_told_as_such(window, tmp_path):
    with served(tmp_path) as url:
        page = window(url)
        page.wait("return document.body.dataset.version")
        for k, document in enumerate(([], None, 7)):
            (tmp_path / f"{k}.json").write_text(json.dumps(document))
            page.upload("#session-file", tmp_path / f"{k}.json")
            page.wait("return document.querySelector('#error-text').innerText.startsWith(arguments[0])", f"{k}.json")
            assert page.text("#error-text") == f"{k}.json: no session file of the workbench"


def test_the_steps_of_the_model_are_whole_in_a_narrow_head(window, tmp_path):
    with served(tmp_path) as url:
        page = window(url, (390, 800))
        page.wait("return document.body.dataset.version")
        cut = page.run(
            "const e = document.querySelector('#what'); e.hidden = false;"
            "e.textContent = 'a long name of a record.csv · model.toml + reversible (entropic) heat (entropic_heat)';"
            "return [e.scrollWidth > e.clientWidth, document.documentElement.scrollWidth > innerWidth]"
        )
        assert cut == [False, False]
