"""Views that have no results of a fit in them, at every width, light and dark: start, columns, files, live."""

import pytest

from bms_gateway.bus.logfile import write_log
from bms_gateway.config import shipped
from tests.support.page_steps import FIT_S
from tests.support.vehicle_traffic import traffic
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import faults
from tests.workbench.conftest import served
from tests.workbench.foreign import german

pytestmark = pytest.mark.slow  # a browser, and fits
WIDTHS = 390, 1024, 1280, 1920
THEMES = "light", "dark"
CUT = """
const found = [], all = document.querySelectorAll('button, .cell, .live-cell, td, th, p, li, label, h2, h3');
for (const e of all) {
  if (!e.getClientRects().length || e.closest('.hidden') || getComputedStyle(e).position === 'absolute') continue;
  if (e.closest('.scroll, table.heat, .modebar, [hidden], thead') || e.id === 'what') continue;
  const box = e.getBoundingClientRect(), told = `${e.tagName} ${e.id || e.className}: ${e.innerText?.slice(0, 40)}`;
  if (box.right > innerWidth + 1 || box.left < -1) found.push(`over the edge: ${told}`);
  if (e.scrollWidth > e.clientWidth + 2 && getComputedStyle(e).display !== 'inline') found.push(`cut off: ${told}`);
}
return found;
"""
TIGHT = ".cell { max-width: 40px } .cell small { white-space: nowrap }"


def whole(page, axe, view):
    """Nothing is cut off, the page is no wider than its window, and axe finds nothing; whatever width and theme."""
    for theme in THEMES:
        if page.run("return document.documentElement.dataset.theme") != theme:
            page.click("#theme")
        assert page.run("return document.documentElement.dataset.theme") == theme
        for width in WIDTHS:
            page.cdp("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False)
            page.wait("return document.documentElement.scrollWidth <= innerWidth", patience_s=20)
            assert page.run(CUT) == [], (view, theme, width)
            assert faults(page, axe) == [], (view, theme, width)


def test_start_columns_and_files(window, axe, tmp_path):
    pack = make_pack(tmp_path, cells=12, sensors=(1, 4, 12), seconds=900)
    table = german(pack.hidden, tmp_path / "Messung.csv")
    with served(tmp_path) as url:
        page = window(url)
        page.wait("return document.querySelector('#example')")
        assert page.there("#nothing ol")  # a person who sees the page for the first time reads what it does
        page.click("#describe summary")
        page.click("#more summary")
        whole(page, axe, "start")
        page.upload("#tables-file", table)
        page.upload("#model-file", pack.model)
        page.wait("return document.querySelectorAll('#mapping tbody tr').length > 5")
        assert not page.there("#nothing")
        whole(page, axe, "columns")
        page.click("#open")
        page.wait("return document.querySelector('#step-1')", patience_s=FIT_S)
        page.idle(FIT_S)
        assert page.run("return document.querySelectorAll('#drawing .cell').length") == 12
        whole(page, axe, "open")
        page.click("#tab-take")
        whole(page, axe, "take away")
        assert page.complaints() == []
        page.cdp("Emulation.setDeviceMetricsOverride", width=1024, height=800, deviceScaleFactor=1, mobile=False)
        page.run(
            "const s = document.createElement('style'); s.textContent = arguments[0]; document.head.append(s)", TIGHT
        )
        assert any(told.startswith("cut off: BUTTON") for told in page.run(CUT))  # the test sees it


def test_live(window, axe, tmp_path):
    write_log(tmp_path / "drive.log", [traffic(60.0)])
    text = shipped("deploy/example/gateway.toml").read_text()
    (tmp_path / "gateway.toml").write_text(text.replace("# [alerts]", "[alerts]\ncore_max_C = 24.0\n#", 1))
    model = shipped("deploy/example/string.toml").read_text()
    (tmp_path / "string.toml").write_text(model)
    with served(tmp_path, "--live", tmp_path / "drive.log", "--config", tmp_path / "gateway.toml") as url:
        page = window(url)
        page.wait("return document.querySelectorAll('.live-cell').length === 60")
        page.wait("return !document.querySelector('#live-state').innerText")
        page.click("#play")
        page.run("const t = document.querySelector('#time'); t.value = 55; t.dispatchEvent(new Event('input'))")
        page.wait(
            "return document.querySelector('#at').dataset.s === '55' && !document.querySelector('#banner').hidden"
        )
        page.click("#banner-list summary")
        page.click(".live-cell:nth-child(7)")
        whole(page, axe, "live")
        assert page.complaints() == []
