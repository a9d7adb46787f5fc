"""The table of columns by keyboard: Tab goes on from a field that was changed, although the table is drawn anew."""

import pytest

from tests.truth.packs import pack as make_pack
from tests.workbench.conftest import served
from tests.workbench.foreign import german

pytestmark = pytest.mark.slow  # a browser

FOCUSED = "return document.activeElement.id || document.activeElement.tagName"
CHOSEN = "return document.querySelector(arguments[0]).value"
FIELD = "const f = document.querySelector(arguments[0]); f.focus(); f.select()"


@pytest.fixture
def page(window, tmp_path):
    pack = make_pack(tmp_path, seconds=900)
    with served(tmp_path) as url:
        page = window(url)
        page.upload("#tables-file", german(pack.hidden, tmp_path / "Messung.csv"))
        page.wait("return document.querySelectorAll('#mapping tbody tr').length === 8")
        page.idle()
        yield page


def typed(page, field, text, key):
    """Type in a field, press a key at once, and wait until the page has looked at the table again."""
    page.run(FIELD, field)
    for letter in text:
        page.press(letter)
    page.press(key)
    page.idle()
    return page.run(FOCUSED)


def test_tab_goes_on_from_the_number_of_a_cell(page):
    assert typed(page, "#column-7-cell", "2", "Tab") == "column-7-unit"
    assert page.run(CHOSEN, "#column-7-cell") == "2"
    page.press("Tab")
    assert page.run(FOCUSED) == "column-7-flip"


def test_tab_goes_on_from_the_inlet_that_no_column_has(page):
    page.run("const s = document.querySelector('#column-3'); s.value = ''; s.dispatchEvent(new Event('change'))")
    page.wait("return document.querySelector('#inlet')")
    page.idle()
    assert typed(page, "#inlet", "22", "Tab") == "mapping-table"
    assert page.run(CHOSEN, "#inlet") == "22"
    page.press("Tab")
    assert page.run(FOCUSED) == "column-0"
