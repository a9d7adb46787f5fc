"""Scales of the residual: the same for all steps, or as small as the step that is shown."""

import pytest

from tests.support.page_steps import FIT_S, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser, and fits

COLORS = "const c = document.querySelector('#plot-map')?._fullLayout?.coloraxis; return c ? [c.cmin, c.cmax] : null"
SHOWN = "return document.querySelector('#map-title').textContent.split(': ').at(-1)"
AXIS = "return document.querySelector('#plot-surface')._fullLayout.yaxis2.range"
LINKED = "return document.querySelector('#plot-surface')?.dataset.linked && document.querySelector('#close-up').checked"
ENDS = f"{AXIS.replace('return', 'const r =')}; return Math.abs(r[1] - arguments[0]) < 1e-6"
MEANS = """
return document.querySelector('#plot-surface').data.filter(d => d.yaxis === 'y2' && d.line.width > 1.5)
  .flatMap(d => Array.from(d.y)).filter(y => y !== null && !Number.isNaN(y))
"""


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    """A pack whose numbers are not those of its file, and that hides nothing: refitted, the model errs no more."""
    return make_pack(tmp_path_factory.mktemp("pack"))


INSIDE = """
const p = document.querySelector('#plot-surface'), all = p._fullLayout;
const [from, to] = all.xaxis.range, [low, high] = all.yaxis.range;
const m = p.data.find(d => d.name === 'measured' && !d.yaxis);
const inside = Array.from(m.y).filter((_, i) => m.x[i] >= from && m.x[i] <= to);
const ys = inside.filter((y) => typeof y === 'number' && !Number.isNaN(y));
return ys.length > 20 && Math.min(...ys) > low && Math.max(...ys) < high && high - low < arguments[0];
"""


def at_compare(window, url):
    """The page of records that have been compared, at their pictures."""
    page = window(url)
    seen_compared(page)
    page.idle(FIT_S)
    page.click("#tab-compare")
    return page


def test_a_stretch_fills_the_picture_and_the_whole_record_comes_back(window, pack):
    with served(pack.folder, pack.clean, "--model", pack.model) as url:
        page = at_compare(window, url)
        page.wait("return document.querySelector('#plot-surface')?.dataset.linked")
        whole = page.run("return document.querySelector('#plot-surface')._fullLayout.yaxis.range")
        size = 0.5 * (whole[1] - whole[0])
        assert not page.run(INSIDE, size)
        page.run("return Plotly.relayout(document.querySelector('#plot-surface'), {'xaxis.range': [10, 11]})")
        page.wait(INSIDE, size)
        page.run("return Plotly.relayout(document.querySelector('#plot-surface'), {'xaxis.autorange': true})")
        page.wait("return document.querySelector('#plot-surface')._fullLayout.yaxis.range.join() === arguments[0]",
                  ",".join(map(str, whole)))  # fmt: skip


CORE = """
const p = document.querySelector('#plot-core'), all = p._fullLayout;
const [from, to] = all.xaxis.range, [low, high] = all.yaxis.range;
const across = (t) => Array.from(t.x).flatMap((x, i) => {
  const y = t.y[i], x0 = t.x[i - 1], y0 = t.y[i - 1];
  if (x === null || y === null || x0 === null || x0 === undefined || y0 === null) return [];
  const at = [from, to].filter((e) => Math.min(x, x0) <= e && e <= Math.max(x, x0) && x !== x0);
  return [...(x >= from && x <= to ? [y] : []), ...at.map((e) => y0 + (e - x0) / (x - x0) * (y - y0))];
});
const ys = p.data.flatMap(across);
if (Math.abs(to - from - arguments[0]) > 1e-6 * arguments[0] || !ys.length) return null;
return {inside: Math.min(...ys) > low && Math.max(...ys) < high, high: high - low,
  points: p.data.filter(d => d.name === 'refitted' && d.fill !== 'toself')
    .map(d => Array.from(d.x).filter(x => x >= from && x <= to).length)};
"""


def test_a_stretch_of_a_core_shows_every_step_of_the_fit_and_all_of_curve_and_band(window, pack):
    # Bug: a core had one point a minute of 10 h at any zoom, and its axis was that of the points in the window, 17 mK.
    with served(pack.folder, pack.clean, "--model", pack.model) as url:
        page = at_compare(window, url)
        page.wait("return document.querySelector('#plot-core')?.dataset.linked")
        for low, high, unit in (
            (10.0, 11.0, 1.0),
            (600.2 / 60.0, 600.8 / 60.0, 60.0),
        ):  # the second between two samples
            move = "return Plotly.relayout(document.querySelector('#plot-surface'), {'xaxis.range': arguments[0]})"
            page.run(move, [low, high])
            page.wait("return document.querySelector('#stage').dataset.window.split(',').length === 2")
            seen = page.wait(CORE, (high - low) * unit)
            assert seen["inside"]
            assert seen["high"] > 0.5  # of K, the least band of a core here
            if unit == 1.0:
                assert seen["points"] == [61]


def test_colours_and_axis_of_the_residual_follow_what_is_shown_or_stay(window, pack):
    with served(pack.folder, pack.clean, "--model", pack.model) as url:
        page = at_compare(window, url)
        page.wait("return document.querySelector('#plot-map').dataset.traces === '1'")

        # the map: colours of the step that is in it, until they are to be those of all steps
        assert page.run(SHOWN) == "refitted"
        refitted = page.run(COLORS)
        page.click("#same-colors")
        page.wait(
            "const c = document.querySelector('#plot-map')._fullLayout.coloraxis; return c.cmax !== arguments[0]",
            refitted[1],
        )
        both = page.run(COLORS)
        assert both[1] > 2.0 * refitted[1]
        page.click("#same-colors")
        page.wait(
            "const c = document.querySelector('#plot-map')._fullLayout.coloraxis; return c.cmax === arguments[0]",
            refitted[1],
        )

        # the axis: that of all steps, until it is to be as small as what is ticked
        wide = page.run(AXIS)
        page.click("#close-up")
        page.click("#step-0")
        span = f"{AXIS.replace('return', 'const r =')}; return r[1] - r[0] < arguments[0]"
        page.wait(span, 0.7 * (wide[1] - wide[0]))
        near, left = page.run(AXIS), page.run(MEANS)
        assert near[0] < min(left)
        assert max(left) < near[1]

        page.reload()
        page.wait(
            LINKED,
            patience_s=FIT_S,
        )
        page.idle(FIT_S)
        page.wait(
            ENDS,
            near[1],
        )
        page.click("#close-up")
        page.wait(
            ENDS,
            wide[1],
        )
        assert page.complaints() == []
