"""What a pointer that hovers would show is reached by a tap and by keys too, and each step has its own tables."""

import pytest

from tests.support.page_steps import ADDED, FIT_S, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import faults
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser, and fits

WHOLE = "const e = document.querySelector('#what'); return e.scrollWidth <= e.clientWidth"
TOLD = "return document.querySelector('#regimes .cell-told').innerText"
HEADS = "return [...document.querySelectorAll('#panel-compare summary')].map(s => s.innerText)"


def test_a_tap_and_the_keys_show_what_a_pointer_shows(window, axe, tmp_path):
    pack = make_pack(tmp_path)
    with served(pack.folder, *pack.words) as url:
        page = window(url, (390, 800))
        seen_compared(page)
        page.idle(FIT_S)
        page.click("#tab-compare")
        assert page.run(WHOLE)  # on a narrow page, untouched

        page.click("#cell-3")
        page.wait("return document.querySelector('#cell-3').getAttribute('aria-pressed') === 'true'")
        told = page.text("#cell-told")
        assert told.startswith("Cell 3: error ")
        assert "; core up to " in told
        assert told.endswith("(95 %, rms over the record)")
        assert told.lower() == page.run("return document.querySelector('#cell-3').title").lower()

        assert page.run(TOLD).startswith("Tap a value")
        page.click("#regimes tbody tr:first-child td:nth-child(2)")
        first = page.run(TOLD)
        assert first.startswith("cell 1, ")
        assert all(word in first for word in (" readings: ", " K, sd ", " K, RMSE "))
        page.press("Right")
        assert page.run(TOLD).startswith("cell 3, ")
        assert page.text("#cell-told") == told  # the arrows of the map choose no other cell of the string
        page.press("Down")
        assert page.run(TOLD).split(", ")[1] != first.split(", ")[1]
        stops = (
            "return [...document.querySelectorAll('#regimes table')].map(t => t.querySelectorAll('[tabindex]').length)"
        )
        assert set(page.run(stops)) == {1}  # for the tab key
        assert faults(page, axe) == []

        # tables are those of the step that is shown
        page.click("#tab-add")
        page.type("#effect-name", "entropic_heat")
        page.click("#add")
        page.wait("return document.querySelectorAll('#panel-add .way li').length === 3", patience_s=FIT_S)
        seen_compared(page)
        page.idle(FIT_S)
        page.click("#tab-compare")
        names = ("Errors by sensor", "Parameters", "Correlation of the parameters")
        assert page.run(HEADS) == [f"{name}: {ADDED}" for name in names]
        numbers = "return document.querySelector('#parameters table').textContent"
        new = page.run(numbers)
        assert "(entropic_heat.dUdT)" in new
        page.click("#step-2")
        page.wait("return document.querySelector('#parameters summary').innerText === 'Parameters: refitted'")
        assert "(entropic_heat.dUdT)" not in page.run(numbers)
        assert page.run(HEADS) == [f"{name}: refitted" for name in names]
        assert page.complaints() == []


def test_a_long_note_of_the_header_is_cut_and_a_tap_shows_it(window, tmp_path):
    pack = make_pack(tmp_path)
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        page.run(
            "document.querySelector('#what').style.width = '120px'; document.querySelector('#what').style.flex = 'none'"
        )
        assert not page.run(WHOLE)
        page.click("#what")
        assert page.run(WHOLE)
        page.click("#what")
        assert not page.run(WHOLE)
        assert page.complaints() == []
