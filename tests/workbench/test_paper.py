"""A report on paper: nothing is cut at an edge, runs over its frame, or breaks inside a word; and it holds the map."""

import base64

import pytest

from bms_gateway.cli.main import main
from bms_gateway.workbench.desk import Desk
from tests.report.html_page import Page
from tests.support.desk_steps import done, files
from tests.truth.packs import pack as make_pack

pytestmark = pytest.mark.slow  # a browser, and fits
PAPER = (690, 1000)
"""Width between the margins of an upright page, px."""
CUT = """
dispatchEvent(new Event('beforeprint'));
await new Promise(done => setTimeout(done, 1500));
const over = [];
for (const plot of document.querySelectorAll('.plot')) {
  const edge = plot.getBoundingClientRect().right;
  for (const t of plot.querySelectorAll('.legendtext, .annotation'))
    if (t.getBoundingClientRect().right > edge + 1) over.push(plot.id + ': ' + t.textContent);
}
for (const card of document.querySelectorAll('.card'))
  for (const dd of card.children) if (dd.scrollWidth > dd.clientWidth + 1) over.push('card: ' + dd.textContent);
for (const th of document.querySelectorAll('table.grouped tbody th')) {
  const tall = th.offsetHeight > 1.9 * parseFloat(getComputedStyle(th).lineHeight);
  if (tall) over.push('row: ' + th.textContent);
}
return over;
"""
BROKEN = """
const found = [];
const walk = document.createTreeWalker(document.querySelector('table.ranking') ?? document.body, NodeFilter.SHOW_TEXT);
while (walk.nextNode()) {
  for (const word of walk.currentNode.textContent.matchAll(/[a-z]+_[a-z_]+/g)) {
    const range = document.createRange();
    range.setStart(walk.currentNode, word.index);
    range.setEnd(walk.currentNode, word.index + word[0].length);
    if (new Set([...range.getClientRects()].map(r => Math.round(r.top))).size > 1) found.push(word[0]);
  }
}
return found;
"""


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"), seconds=800)


def printed(window, page):
    shown = window(f"file://{page}", PAPER)
    shown.cdp("Emulation.setEmulatedMedia", media="print")
    shown.wait("return document.documentElement.dataset.drawn")
    return shown


def test_a_report_with_long_names_fits_on_paper(window, pack, tmp_path):
    """Names of steps were cut at the right edge of each figure, and cards ran over their frames."""
    page = tmp_path / "a.html"
    effects = ["ambient_loss", "inlet_offset", "resistance_drift"]
    words = ["add", *effects, "--force", "--model", pack.model, "--data", pack.hidden, "--out", tmp_path / "x.toml"]
    assert main([*map(str, words), "--html", str(page)]) == 0
    shown = printed(window, page)
    assert shown.run(CUT) == []
    names = "return [...document.querySelectorAll('#overlay-1-1 .legendtext')].map(t => t.textContent).join(' ')"
    for key in effects:
        assert f"({key})" in shown.run(names)
    # what is measured here is what is printed
    pdf = base64.b64decode(shown.cdp("Page.printToPDF", printBackground=True)["data"])
    assert pdf[:5] == b"%PDF-"
    assert shown.complaints() == []


WIDE = """
dispatchEvent(new Event('beforeprint'));
await new Promise(done => setTimeout(done, 1500));
const edge = document.documentElement.clientWidth + 1;
const names = '#written, #steps, #steps li, #diagnosed, .notes, #ranking table, #ranking td, #ranking th';
const parts = document.querySelectorAll(names);
return [...parts].filter(e => e.getBoundingClientRect().right > edge || e.scrollWidth > e.clientWidth + 2)
  .map(e => `${e.tagName} ${e.id || e.className}: ${e.textContent.slice(0, 60)}`);
"""


def test_notes_steps_and_the_ranking_of_a_report_of_the_page_fit_on_paper(window, pack, tmp_path):
    page, desk = tmp_path / "road.html", Desk("paper")
    try:
        desk.open(files(pack))
        done(desk)
        desk.note(f"Sensor 3 <b>glued anew</b>\n{'x' * 400}\n{'word ' * 200}")
        desk.diagnose()
        done(desk)
        desk.add(["ambient_loss", "inlet_offset", "resistance_drift"], force=True)
        done(desk)
        page.write_bytes(desk.report().read_bytes())
    finally:
        desk.close()
    shown = printed(window, page)
    assert shown.run("return document.querySelectorAll('#steps li').length") == 3
    assert "<b>glued anew</b>" in shown.run("return document.querySelector('.notes').textContent")
    assert shown.run(WIDE) == []
    assert shown.run(CUT) == []
    assert shown.run(BROKEN) == []
    shown.picture(tmp_path / "paper.png")
    shown.cdp("Emulation.setEmulatedMedia", media="screen")
    shown.run("dispatchEvent(new Event('afterprint'))")
    for width in (390, 1024, 1280, 1920):  # and on screens
        shown.cdp("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
        shown.wait("return document.documentElement.scrollWidth <= innerWidth", patience_s=20)
        shown.picture(tmp_path / f"screen-{width}.png")
    assert shown.complaints() == []


ROOM = """
dispatchEvent(new Event('beforeprint'));
await new Promise(done => setTimeout(done, 1500));
const box = (e) => e.getBoundingClientRect();
const figures = [...document.querySelectorAll('figure:has([id^=overlay-])')].map(f => box(f).height);
const maps = [...document.querySelectorAll('.beside .map')].map(m => [box(m).left, box(m).top]);
const told = [...document.querySelectorAll('.cell-told')].filter(p => p.offsetHeight > 0).length;
const high = (p) => p.querySelector('svg').clientHeight;
const cut = [...document.querySelectorAll('.plot')].filter(p => high(p) > p.clientHeight + 1).length;
dispatchEvent(new Event('afterprint'));
await new Promise(done => setTimeout(done, 1500));
return [figures, maps, told, cut, document.querySelector('.plot').clientHeight];
"""


def test_figures_and_maps_leave_no_half_of_a_page_empty(window, tmp_path):
    """Two figures and a third of a page of nothing; maps of one cell one below the other, each half as wide."""
    pack, page = make_pack(tmp_path, cells=1, sensors=(1,), seconds=900), tmp_path / "one.html"
    assert main(["compare", str(pack.hidden), "--model", str(pack.model), "--html", str(page)]) == 0
    shown = printed(window, page)
    tall = shown.run("return document.querySelector('.plot').clientHeight")
    figures, maps, told, cut, after = shown.run(ROOM)
    assert all(3 * height < PAPER[1] for height in figures)
    assert len(maps) == 2
    assert maps[0][0] < maps[1][0]
    assert maps[0][1] == pytest.approx(maps[1][1], abs=2.0)
    assert told == 0  # nobody taps on paper
    assert cut == 0
    assert after == tall
    assert shown.complaints() == []


def test_the_ranking_breaks_no_identifier_and_the_map_is_there(window, pack, tmp_path):
    page = tmp_path / "d.html"
    assert main(["diagnose", str(pack.hidden), "--model", str(pack.model), "--html", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    (drawn,) = Page(text).figures(text)["map-1"]["data"]
    assert drawn["type"] == "heatmap"
    assert drawn["y"] == ["1", "3"]
    assert {len(row) for row in drawn["z"]} == {len(drawn["x"]) if isinstance(drawn["x"], list) else 150}
    shown = printed(window, page)
    assert shown.run(CUT) == []
    assert shown.run(BROKEN) == []
    assert shown.complaints() == []
