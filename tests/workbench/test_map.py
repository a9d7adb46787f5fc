"""The map of the residual of all sensors over time: where and when a reading is wrong, whole and zoomed."""

import csv
from itertools import cycle

import numpy as np
import pytest

from bms_gateway.workbench.desk import Desk
from bms_gateway.workbench.series import COLUMNS, columns
from tests.support.desk_steps import done, files
from tests.support.page_steps import FIT_S, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import come
from tests.workbench.conftest import served

FROM_S, TO_S, BY_K = 600, 606, 5.0
"""When the sensor of cell 3 reads so much too much; within a column of the whole map, and over six of a narrow one."""


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    """A pack without any hidden effect, and one sensor that jumps for six seconds."""
    made = make_pack(tmp_path_factory.mktemp("pack"))
    with made.clean.open(newline="") as f:
        rows = list(csv.DictReader(f))
    with made.hidden.open("w", newline="") as f:
        out = csv.DictWriter(f, rows[0])
        out.writeheader()
        for r in rows:
            wrong = BY_K if FROM_S <= float(r["time_s"]) < TO_S else 0.0
            out.writerow({**r, "surface_3_C": float(r["surface_3_C"]) + wrong})
    return made


@pytest.fixture(scope="module")
def desk(pack):
    desk = Desk("test")
    desk.open(files(pack))
    done(desk)
    yield desk
    desk.close()


def test_a_map_says_where_and_when(desk):
    figure = desk.figure("map-0")
    assert figure["layout"]["coloraxis"]["range"][0] == -figure["layout"]["coloraxis"]["range"][1]
    shown = figure["steps"][1]["map"]
    assert shown["y"] == ["1", "3"]
    assert len(shown["x"]) == COLUMNS
    z = np.array(shown["z"], float)
    assert not np.isnan(z).any()
    column = int(np.argmax(z[1]))
    assert FROM_S <= 60.0 * shown["x"][column] <= TO_S + 5.0
    # six samples of the eight and a third seconds of a column, at most, and no reading of the other sensor
    assert z[1].max() == pytest.approx(BY_K * 6 / 8.3, rel=0.25)
    assert np.abs(z[0, column] - z[0, [column - 1, column + 1]]).max() < 0.1


def test_a_map_follows_the_window(desk):
    window = (FROM_S - 6.0) / 60.0, (TO_S + 6.0) / 60.0
    shown = desk.figure("map-0", window)["steps"][1]["map"]
    t, z = 60.0 * np.array(shown["x"]), np.array(shown["z"], float)
    np.testing.assert_allclose(t, np.arange(FROM_S - 6.0, TO_S + 7.0), atol=1e-3)  # one column for each row of the file
    wrong = (t > FROM_S - 0.5) & (t < TO_S - 0.5)
    np.testing.assert_allclose(z[1][wrong], BY_K, atol=0.5)
    assert np.abs(z[1][~wrong]).max() < 0.5
    ends = "coloraxis"
    assert desk.figure("map-0", window)["layout"][ends]["range"] == desk.figure("map-0")["layout"][ends]["range"]


def test_columns_are_means_and_a_gap_stays_a_gap():
    t = np.arange(0.0, 36000.0)
    y = np.sin(t / 1000.0)
    y[12000:13000] = np.nan
    at, (means,) = columns([(t, y)], None)
    assert len(at) == COLUMNS
    np.testing.assert_allclose(np.diff(at), 200.0)
    for a, mean in zip(at, means, strict=True):
        mine = (np.abs(t - a) <= 100.0) & np.isfinite(y)
        if mine.any():
            assert mean == pytest.approx(np.mean(y[mine]), abs=0.01)
        else:
            assert np.isnan(mean)
    assert 4 <= np.isnan(means).sum() <= 5
    assert len(columns([(t, y)], (12100.0, 12200.0))[0]) == 0


PIXEL = """
const node = document.querySelector('#plot-map'), box = node.getBoundingClientRect(), l = node._fullLayout;
return [box.left + l._size.l + l.xaxis.d2p(arguments[0]), box.top + l._size.t + l.yaxis.l2p(arguments[1])];
"""


@pytest.mark.slow
def test_the_map_zooms_with_the_other_pictures_and_a_click_shows_a_cell(window, pack):
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        page.click("#tab-compare")
        page.wait("return document.querySelector('#plot-map').dataset.traces === '1'")
        count = "return document.querySelector('#plot-map').data[0].x.length"
        assert page.run(count) == COLUMNS
        ends = [(FROM_S - 6.0) / 60.0, (TO_S + 6.0) / 60.0]
        zoom = "Plotly.relayout(document.querySelector('#plot-surface'), {'xaxis.range': arguments[0]})"
        page.run(zoom, ends)
        come(lambda: page.run(count) == TO_S - FROM_S + 13, "the map of the window")
        found = page.run("const d = document.querySelector('#plot-map').data[0]; return [d.x, d.z[1]]")
        assert page.run("return document.querySelector('#plot-map').layout.xaxis.title.text") == "time, s"
        wrong = [x for x, z in zip(*found, strict=True) if z > BY_K / 2]
        np.testing.assert_allclose(wrong, np.arange(FROM_S, TO_S), atol=1e-3)
        page.run("Plotly.relayout(document.querySelector('#plot-map'), {'xaxis.autorange': true})")
        come(lambda: page.run(count) == COLUMNS, "the whole map again")
        page.click("#cell-1")
        page.wait("return document.querySelector('#plot-surface').dataset.name === 'surface-0-1'")
        page.wait("return document.querySelector('#plot-core').dataset.name === 'core-0-1'")
        page.idle(FIT_S)
        page.run("document.querySelector('#plot-map').scrollIntoView({block: 'center'})")

        def point(kind, aside=0.0):
            x, y = page.run(PIXEL, 10.0, 1)  # the second row
            page.cdp("Input.dispatchMouseEvent", type=kind, x=x + aside, y=y, button="left", clickCount=1)

        asides = cycle(range(5))

        def clicked():
            """Click where the pointer is; a map that is drawn anew under it misses a click, as it misses a person's."""
            point("mouseMoved", next(asides))
            if page.run("return Boolean(document.querySelector('#plot-map')._hoverdata?.length)"):
                point("mousePressed")
                point("mouseReleased")
            return page.run("return document.querySelector('#plot-surface').dataset.name === 'surface-0-3'")

        come(clicked, "the cell of the row that was clicked")


OVERLAPS = """
const node = document.querySelector('#plot-map'), box = (e) => e.getBoundingClientRect();
const title = box(node.querySelector('.xtitle')), scale = [...node.querySelectorAll('.cbaxis text, .cbtitle text')];
const numbers = [...node.querySelectorAll('.xtick text')];
const beside = (a, b) => a.left >= b.right - 1 || a.top >= b.bottom - 1;
const over = (a, b) => !beside(a, b) && !beside(b, a), names = (a, b) => `${a.textContent} over ${b.textContent}`;
const after = (all, a, k) => all.slice(k + 1).filter((b) => over(box(a), box(b))).map((b) => names(a, b));
const pairs = (all) => all.flatMap((a, k) => after(all, a, k));
const found = numbers.filter((n) => over(box(n), title)).map((n) => `the title over ${n.textContent}`);
const rotated = (t) => /rotate\\((?!0[, )])/.test(t.getAttribute('transform') ?? '');
const turned = scale.filter(rotated).map((t) => `${t.textContent} is turned`);
if (title.top < box(node.querySelector('.xtick text')).bottom - 3) found.push('the title beside the numbers');
if (title.bottom > box(node).bottom + 1) found.push('the title below the picture');
return [...found, ...turned, ...pairs([...scale, ...numbers])];
"""
APART = f"return (() => {{{OVERLAPS}}})().length === 0;"


@pytest.mark.slow
def test_the_words_of_the_map_stand_apart_at_every_width(window, pack):
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        for width in (1280, 390, 1024, 1920):
            page.cdp("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False)
            page.reload()
            page.wait("return document.querySelectorAll('#plot-map .cbaxis text').length > 1")
            page.idle(FIT_S)
            page.wait(APART, patience_s=10.0)
