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


def test_colours_and_axis_of_the_residual_follow_what_is_shown_or_stay(window, pack):
    with served(pack.folder, pack.clean, "--model", pack.model) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        page.click("#tab-compare")
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
