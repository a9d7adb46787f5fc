"""What a person does while the page still works is not lost, and the page says when it has come to rest."""

import pytest

from tests.support.page_steps import FIT_S, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import come
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser, and fits

SLOW = """
const at_once = window.fetch;
window.fetch = (...words) => String(words[0]).includes(arguments[0])
  ? new Promise(done => setTimeout(done, 400)).then(() => at_once(...words)) : at_once(...words);
"""
RANGES = """
return ['surface', 'drive', 'core', 'map'].map(p => document.querySelector('#plot-' + p)._fullLayout.xaxis.range.join())
"""
SAMPLES = "return document.querySelector('#plot-surface').data.at(-1).x.filter(x => x >= 7 && x <= 8).length"


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"))


@pytest.fixture(scope="module")
def url(pack):
    with served(pack.folder, *pack.words) as url:
        yield url


@pytest.fixture
def page(window, url):
    page = window(url)
    seen_compared(page)
    page.idle(FIT_S)
    return page


def zoom(page, *places):
    """Zoom in one plot after the other, the later ones while the page still draws for those before."""
    steps = [
        f"Plotly.relayout(document.querySelector('#plot-{p}'), {{'xaxis.range': {list(ends)}}});" for p, ends in places
    ]
    page.run("".join(steps))


def test_a_zoom_while_another_is_drawn_is_the_one_that_is_shown(page):
    page.run(SLOW, "/api/figure")
    zoom(page, ("surface", (2, 3)), ("core", (7, 8)))
    page.idle()
    assert set(page.run(RANGES)) == {"7,8"}
    assert page.run(SAMPLES) == 61
    zoom(page, ("drive", (4, 5)))
    page.run("return new Promise(done => setTimeout(done, 300))")  # the samples of that window are on their way
    zoom(page, ("surface", (7, 8)))
    page.idle()
    assert set(page.run(RANGES)) == {"7,8"}
    assert page.run("return document.querySelector('#stage').dataset.window") == "7,8"
    assert page.complaints() == []


def test_a_zoom_outlives_a_reload_and_ends_with_the_files_that_it_is_of(page, pack):
    zoom(page, ("surface", (7, 8)))
    page.reload()
    seen_compared(page)
    page.idle(FIT_S)
    assert set(page.run(RANGES)) == {"7,8"}
    assert page.run(SAMPLES) == 61
    page.click("#tab-open")
    page.type("#tables", pack.clean)
    page.click("#open")
    page.idle(FIT_S)
    assert not {"7,8"} & set(page.run(RANGES))


def test_the_page_rests_when_what_was_asked_for_is_drawn(page):
    page.run(SLOW, "/api/")
    page.click("#tab-compare")
    page.click("#cell-3")
    page.idle()
    assert page.run("return document.querySelector('#plot-core').dataset.name") == "core-0-3"
    page.press("c")
    page.idle()
    assert page.run("return document.querySelectorAll('#measures tbody tr').length") > 0
    page.run("document.querySelector('#cursor-a-at').focus()")
    page.type("#cursor-a-at", "4")
    page.press("Enter")
    page.idle()
    assert page.run("return document.querySelector('#measures').dataset.cursors").startswith("4,")


def written(page, text):
    page.run("document.querySelector('#tab-take').click()")
    page.run(
        "const box = document.querySelector('#notes-text'); box.value = arguments[0];"
        "box.dispatchEvent(new Event('input', {bubbles: true}))",
        text,
    )


NOTES = "return document.querySelector('#notes-text').value"
KEPT = "return JSON.parse(sessionStorage.workbench).session?.notes"


def test_notes_outlive_a_reload_at_once_even_if_nothing_is_left_of_them(page):
    for text in ("Seen on the bench at 14:05.", ""):
        written(page, text)
        page.reload()
        come(lambda wanted=text: page.run(KEPT) == wanted, "the notes in the session")
        page.idle(FIT_S)
        assert page.run(NOTES) == text
    page.reload()
    seen_compared(page)
    page.idle(FIT_S)
    assert page.run(NOTES) == ""


def test_notes_that_were_written_while_the_server_was_gone_are_sent_when_it_is_back(window, pack, tmp_path):
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
    page.wait("return document.querySelector('#error-text').innerText.includes('does not answer')")
    written(page, "written alone")
    page.run("return new Promise(done => setTimeout(done, 1000))")
    with served(tmp_path, "--port", url.rstrip("/").rpartition(":")[2]):
        come(lambda: page.run(KEPT) == "written alone", "the notes in the session", FIT_S)
        page.idle(FIT_S)
        assert page.run(NOTES) == "written alone"
