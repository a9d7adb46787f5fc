"""Names of a hundred letters: nothing is cut, nothing widens the page, and no label lies on a curve."""

import pytest

from bms_gateway.bus.logfile import write_log
from bms_gateway.config import shipped
from tests.support.page_steps import FIT_S, seen_compared
from tests.support.vehicle_traffic import traffic
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import faults
from tests.workbench.conftest import served
from tests.workbench.foreign import german

pytestmark = pytest.mark.slow  # a browser, and fits

WIDTHS = (390, 1024)
OVER = """
const whole = document.documentElement.scrollWidth, found = whole > innerWidth ? [`page: ${whole}`] : [];
for (const e of document.querySelectorAll('body *')) {
  if (!e.getClientRects().length || e.closest('svg, .scroll, .hidden')) continue;
  if (e.getBoundingClientRect().right > innerWidth + 1) found.push(`${e.tagName} ${e.id || e.className}`);
}
return found;
"""
CUT = """
const found = [];
for (const t of document.querySelectorAll('.plot text')) {
  const svg = t.closest('svg');
  if (!svg || !t.getClientRects().length) continue;
  const a = t.getBoundingClientRect(), b = svg.getBoundingClientRect();
  if (a.right > b.right + 1 || a.left < b.left - 1 || a.top < b.top - 1) found.push(t.textContent);
}
return found;
"""
HEIGHTS = """
const axis = document.querySelector('#plot-surface')._fullLayout.yaxis;
return axis._length;
"""
MAPPING = """
const box = document.querySelector('#mapping .scroll');
return [box.scrollWidth - box.clientWidth, ...[...box.querySelectorAll('select, input')]
  .filter(e => { const r = e.getBoundingClientRect(); return r.right > innerWidth || r.left < 0; }).map(e => e.id)];
"""
TITLES = """
const boxes = [...document.querySelectorAll('#past rect')].map(r => r.getBoundingClientRect());
const titles = [...document.querySelectorAll('#past text.title')].map(t => t.getBoundingClientRect());
return titles.map(t => boxes.some(b => t.bottom > b.top + 1 && t.top < b.bottom - 1));
"""


def sized(page, width):
    page.cdp("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False)
    page.wait("return document.querySelector('#plot-surface')?._fullLayout?.width <= innerWidth")
    page.idle(FIT_S)


def test_long_names_of_files_and_steps_are_whole(window, axe, tmp_path):
    pack = make_pack(tmp_path)
    tables = [tmp_path / f"{letter}{'x' * 95}.csv" for letter in "ab"]
    for to, source in zip(tables, (pack.hidden, pack.clean), strict=True):
        to.write_bytes(source.read_bytes())
    with served(tmp_path, *tables, "--model", pack.model) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        alone = page.run(HEIGHTS)
        page.click("#tab-add")
        page.type("#effect-name", "entropic_heat thermocouple_lag")
        page.press("Enter")
        page.idle(FIT_S)
        if page.there("#force"):
            page.click("#force")
            page.idle(FIT_S)
        page.click("#beside-1")
        page.wait("return document.querySelector('#plot-surface').data.some(t => t.name.startsWith('bxxx'))")
        page.run("document.querySelector('#pairs').open = true")
        for width in WIDTHS:
            sized(page, width)
            page.wait("return document.querySelector('#plot-pair').data?.length > 2")
            for step in ("open", "compare", "add", "take"):
                page.click(f"#tab-{step}")
                page.idle(FIT_S)
                assert page.run(OVER) == [], (width, step)
            page.wait(f"{CUT.replace('return found', 'return !found.length')}")
            legend = "return document.querySelector('#plot-surface .legend').textContent.replaceAll(/\\s+/g, '')"
            assert "thermocouplesanswerlate(thermocouple_lag)" in page.run(legend), width
            assert page.run(HEIGHTS) > 0.7 * alone, width  # the legend takes no room from the curves
            assert page.run("return document.querySelector('#map-title').innerText").endswith(
                "(thermocouple_lag), by force"
            )
            assert faults(page, axe) == [], width


@pytest.mark.parametrize("width", WIDTHS)
def test_the_columns_of_a_foreign_table_are_mapped_on_any_screen(window, axe, tmp_path, width):
    pack = make_pack(tmp_path, seconds=600)
    table = german(pack.hidden, tmp_path / f"{'y' * 95}.csv")
    with served(tmp_path) as url:
        page = window(url, (width, 800))
        page.idle()
        page.upload("#tables-file", table)
        page.wait("return document.querySelectorAll('#mapping tbody tr').length === 8")
        assert page.run(OVER) == []
        assert page.run(MAPPING) == [0]
        assert faults(page, axe) == []
        heads = page.run("return [...document.querySelectorAll('table.columns thead th')].map(t => t.textContent)")
        assert heads[-1] == "Read as"
        assert page.run("return document.querySelector('#mapping').innerText.includes('0 to 599 s')")
        assert "-0" not in page.text("#mapping").split()


def test_no_label_of_the_past_lies_on_a_curve(window, tmp_path):
    log = tmp_path / f"{'z' * 95}.log"
    write_log(log, [traffic(120.0)])
    with served(tmp_path, "--live", log, "--config", shipped("deploy/example/gateway.toml")) as url:
        page = window(url, (1024, 800))
        page.wait("return document.querySelector('#play') && !document.querySelector('#live-state').innerText")
        page.run("const t = document.querySelector('#time'); t.value = 110; t.dispatchEvent(new Event('input'))")
        page.wait("return document.querySelectorAll('#past text.title').length === 6")
        for width in WIDTHS:
            page.cdp("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False)
            page.wait("return document.documentElement.scrollWidth <= innerWidth")
            assert page.run(TITLES) == [False] * 6, width
            assert page.run(OVER) == [], width
