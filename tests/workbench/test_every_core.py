"""The core of every cell of a long string can be looked at, whether it has a sensor or not."""

import pytest

from tests.support.page_steps import FIT_S
from tests.truth.packs import pack as make_pack
from tests.workbench.conftest import served

CELLS, SENSORS = 30, (1, 15, 30)
NAMED = "return document.querySelector('#plot-core').dataset.name === arguments[0]"

IN_LEGEND = "return [...document.querySelectorAll('#plot-core .legendtext')].map(e => e.textContent).sort()"
DRAWN = "return [...new Set(document.querySelector('#plot-core').data.map(d => d.name))].sort()"


@pytest.mark.slow
def test_cores_without_a_sensor_have_pictures_in_long_strings_too(window, tmp_path):
    pack = make_pack(tmp_path, cells=CELLS, sensors=SENSORS, seconds=400)
    with served(tmp_path, *pack.words) as url:
        page = window(url, (1280, 900))
        page.wait("return Number(document.querySelector('#plot-core').dataset.traces) > 0", patience_s=60)
        page.idle(FIT_S)
        page.click("#tab-compare")
        for k in (2, 29):
            page.click(f"#cell-{k}")
            page.wait(NAMED, f"core-0-{k}")
            page.idle(FIT_S)
            assert page.there("#plot-core")
            assert not page.there("#plot-surface")  # it has no sensor
            bands = page.run("return document.querySelector('#plot-core').data.filter(d => d.fill === 'toself').length")
            assert bands == 2  # of both steps
            told = page.text("#cell-told")
            assert told.startswith(f"Cell {k}: no sensor; core up to ")
            highest = page.run(
                "const refitted = document.querySelector('#plot-core').data.filter(d => d.name === 'refitted');"
                "const model = refitted.find(d => d.fill !== 'toself');"
                "return Math.max(...model.y.filter(y => y !== null))"
            )
            assert highest == pytest.approx(float(told.split("core up to ")[1].split()[0]), abs=0.06)
            assert page.run(IN_LEGEND) == page.run(DRAWN)  # a step of which the core is not known too
        found = page.run("return [...document.querySelectorAll('#panel-compare .found li')].map(e => e.innerText)")
        assert found
        assert not [t for t in found if t[0].islower()]
        page.press("Right")  # by keys, from one cell to the next
        page.wait(NAMED, "core-0-30")
        page.wait("return document.querySelector('#plot-surface').dataset.name === 'surface-0-30'")
        assert page.complaints() == []
