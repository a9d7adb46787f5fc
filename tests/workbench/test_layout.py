"""The panels with results in them: nothing is cut off at any width, and a wide window is used."""

import pytest

from tests.support.page_steps import FIT_S, seen_added, seen_compared, seen_diagnosed
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import faults
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser, and fits
CUT = """
const panels = document.querySelector('#panels'), found = [];
const right = panels.getBoundingClientRect().left + panels.clientLeft + panels.clientWidth;
if (panels.scrollWidth > panels.clientWidth) found.push(`panels: ${panels.scrollWidth} in ${panels.clientWidth}`);
for (const e of panels.querySelectorAll('*')) {
  if (!e.getClientRects().length || e.closest('.scroll, .hidden, .aloud') || e.matches('input[type=file]')) continue;
  const told = `${e.tagName} ${e.id || e.className}: ${e.innerText?.slice(0, 40)}`;
  if (e.getBoundingClientRect().right > right + 1) found.push(`over the edge: ${told}`);
  const hides = !e.matches('input, textarea') && ['hidden', 'clip'].includes(getComputedStyle(e).overflowX);
  if (hides && e.scrollWidth > e.clientWidth + 1) found.push(`cut off: ${told}`);
}
return found;
"""

SCROLLED = """
return ['#regimes .scroll', '#measures'].map(css => document.querySelector(css))
  .filter(e => e.scrollWidth > e.clientWidth).map(e => `${e.ariaLabel}: ${e.scrollWidth} in ${e.clientWidth}`);
"""

TABLES = """
for (const d of document.querySelectorAll('#panels details')) d.open = true;
return [...document.querySelectorAll('#panels .scroll')].filter(e => e.getClientRects().length)
  .filter(e => e.scrollWidth > e.clientWidth).map(e => `${e.ariaLabel}: ${e.scrollWidth} in ${e.clientWidth}`);
"""
"""Of the panels, all of them opened: errors, parameters, correlations, numbers of an addition."""

BROKEN = """
const found = [], range = new Range();
for (const name of document.querySelectorAll('.effect .name')) for (const text of name.childNodes) {
  for (const word of (text.data ?? '').matchAll(/[^\\s_.-]{2,}/g)) {
    range.setStart(text, word.index);
    range.setEnd(text, word.index + word[0].length);
    if (range.getClientRects().length > 1) found.push(word[0]);
  }
}
return found;
"""
"""Words of names of effects that stand in two lines."""

LONG = """
const p = document.createElement('p');
p.innerText = 'x'.repeat(400);
p.style.overflowWrap = 'normal';
document.querySelector('#panel-add').append(p);
"""


def test_results_are_whole_at_every_width(window, axe, tmp_path):
    pack = make_pack(tmp_path)
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        seen_diagnosed(page)
        seen_added(page)
        page.click("#tab-diagnose")
        page.click("#effect-0")
        widths = {}
        for width in (390, 1024, 1280, 1920):
            page.cdp("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False)
            for step in ("open", "compare", "diagnose", "add", "take"):
                page.click(f"#tab-{step}")
                page.wait("return document.documentElement.scrollWidth <= innerWidth", patience_s=20)
                assert page.run(CUT) == [], (width, step)
                assert page.run(BROKEN) == [], (width, step)
            widths[width] = page.run("return document.querySelector('#panels').clientWidth")
        assert widths[1024] < widths[1920]  # the panel uses the width that there is
        assert widths[1920] > 0.25 * 1920
        assert widths[390] > 0.85 * 390
        for width in (1024, 1280, 1920):
            page.cdp("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False)
            for step, tables in (("compare", 3), ("add", 1)):
                page.click(f"#tab-{step}")
                assert page.run(TABLES) == [], (width, step)
                assert (
                    page.run("return document.querySelectorAll(arguments[0]).length", f"#panel-{step} table") >= tables
                )
        for theme in ("dark", "light"):
            page.click("#theme")
            assert page.run("return document.documentElement.dataset.theme") == theme
            for width in (390, 1024, 1280, 1920):
                page.cdp(
                    "Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False
                )
                for step in ("compare", "diagnose", "add"):
                    page.click(f"#tab-{step}")
                    assert faults(page, axe) == [], (theme, width, step)

        # the test sees what is cut off
        page.run(LONG)
        assert any("panels: " in told for told in page.run(CUT))


def test_tables_of_twelve_cells_are_seen_whole(window, tmp_path):
    pack = make_pack(tmp_path, cells=12, sensors=tuple(range(1, 13)))
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        page.click("#tab-compare")
        page.press("c")
        page.wait("return document.querySelectorAll('#measures tbody tr').length > 5")
        assert page.run("return document.querySelectorAll('#regimes thead th').length") == 1 + 12
        for width in (1024, 1280, 1920):
            page.cdp("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False)
            page.idle()
            assert page.run(SCROLLED) == [], width
            assert page.run(TABLES) == [], width

        # its report fits between the margins of a page of A4, so that a printer does not shrink it
        report = page.run(
            "const desk = JSON.parse(sessionStorage.workbench).desk;"
            "return fetch(`/api/take?desk=${desk}&what=report`).then(r => r.text())"
        )
        (tmp_path / "report.html").write_text(report, encoding="utf-8")
        paper = window(f"file://{tmp_path / 'report.html'}")
        paper.wait("return document.documentElement.dataset.drawn")
        paper.cdp("Emulation.setDeviceMetricsOverride", width=710, height=1000, deviceScaleFactor=1, mobile=False)
        paper.cdp("Emulation.setEmulatedMedia", media="print")
        paper.run("dispatchEvent(new Event('beforeprint'))")
        paper.wait("return [...document.querySelectorAll('.plot .main-svg')].every(s => s.clientWidth <= 690)")
        wide = "return [...document.querySelectorAll('table')].map(t => t.getBoundingClientRect().right)"
        assert max(paper.run(wide)) <= 710


def test_a_report_of_uploads_names_them_as_a_person_does(window, tmp_path):
    pack = make_pack(tmp_path)
    with served(pack.folder) as url:
        page = window(url)
        page.upload("#tables-file", pack.hidden)
        page.wait("return document.querySelectorAll('#mapping tbody tr').length === 7")
        page.upload("#model-file", pack.model)
        page.wait("return document.querySelector('#model').value")
        page.click("#open")
        seen_compared(page)
        page.idle(FIT_S)
        report = page.run(
            "const desk = JSON.parse(sessionStorage.workbench).desk;"
            "return fetch(`/api/take?desk=${desk}&what=report`).then(r => r.text())"
        )
        assert "<li>hidden.csv" in report
        assert "bms-gateway-workbench-" not in report


def test_small_errors_fade_into_a_dark_page_too(window, tmp_path):
    pack = make_pack(tmp_path, seconds=600)
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        look = "return getComputedStyle(document.querySelector('#regimes table.heat td')).filter"
        theme = "document.documentElement.dataset.theme = arguments[0];"
        assert page.run(theme + look, "light") == "none"
        assert page.run(theme + look, "dark") == "invert(1) hue-rotate(180deg)"
