"""A cell without a thermocouple: on what its band rests stands where the band stands, whole on a phone too."""

import pytest

from tests.support.page_steps import FIT_S, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import come, faults
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser, and fits

RESTS = "its R_e is that of the other cells to within 2 % (1 sd)"
NOTE = "return [...document.querySelectorAll('#plot-core .annotation text')].map(e => e.textContent).join(' ')"
WHOLE = """
const box = document.querySelector('#plot-core .annotation').getBoundingClientRect();
return box.width > 50 && box.left >= 0 && box.right <= innerWidth
"""


@pytest.mark.parametrize(("size", "dark"), [((1280, 720), False), ((390, 800), True)])
def test_what_the_band_of_a_cell_without_a_thermocouple_assumes(window, tmp_path, axe, size, dark):
    pack = make_pack(tmp_path)  # sensors on cells 1 and 3 of three
    with served(pack.folder, pack.clean, "--model", pack.model) as url:
        page = window(url, size, dark)
        seen_compared(page)
        page.idle(FIT_S)
        page.click("#tab-compare")
        page.click("#cell-2")
        page.wait("return document.querySelector('#plot-core').dataset.name === 'core-0-2'")
        page.idle(FIT_S)
        words = RESTS.replace(" ", "")  # a narrow picture has them in several lines, without blanks between
        come(lambda: words in page.run(NOTE).replace(" ", ""), lambda: page.run(NOTE))
        assert page.run(WHOLE)
        assert RESTS in page.text("#cell-told")
        assert faults(page, axe) == []
        page.click("#cell-1")
        page.wait("return document.querySelector('#plot-core').dataset.name === 'core-0-1'")
        page.wait("return !document.querySelector('#plot-core .annotation')")
        assert RESTS not in page.text("#cell-told")
        assert page.complaints() == []
