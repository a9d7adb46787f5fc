"""A stretch of time has the unit of its length, on the axis, at the cursors and in the slopes."""

import csv

import numpy as np
import pytest

from tests.support.page_steps import FIT_S
from tests.truth.hidden import Scenario, make_log
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser, and fits

AXIS = """
const p = document.querySelector(`#plot-${arguments[0]}`), x = p._fullLayout.xaxis;
return [x.title.text, ...x.range, ...p.layout.shapes.filter(s => s.name?.startsWith('cursor')).map(s => s.x0)];
"""
PLOTS = "surface", "drive", "core", "map"
ROWS = "return [...document.querySelectorAll('#measures tbody tr')].map(r => r.innerText.split('\\t'))"
ZOOM = "return Plotly.relayout(document.querySelector('#plot-drive'), {'xaxis.range': arguments[0]})"
WINDOW = """
const w = document.querySelector('#measures').dataset.window?.split(',').map(Number) ?? [];
return w.length === 2 && w.every((x, i) => Math.abs(x - arguments[0][i]) < 1e-6);
"""


@pytest.fixture(scope="module")
def four_hours(tmp_path_factory):
    folder = tmp_path_factory.mktemp("long")
    log = make_log(Scenario(cells=2, sensors=(1, 2), noise=0.05, seconds=4 * 3600, seed=4, columns=()))
    t = log.table["time_s"]
    names = ["current_A", "coolant_inlet_C", "surface_1_C", "surface_2_C"]
    table = {k: log.table[k].copy() for k in names}
    table["coolant_inlet_C"] = 20.0 + 0.004 * (t - t[0])  # K/s: the slope that is to be read
    with (folder / "long.csv").open("w", newline="") as file:
        write = csv.writer(file)
        write.writerow(["time_s", *names])
        write.writerows(zip(t, *(table[k].round(5) for k in names), strict=True))
    (folder / "model.toml").write_text(log.model)
    return folder


def test_a_stretch_is_in_the_largest_unit_that_it_holds(window, four_hours, tmp_path):
    with served(four_hours, four_hours / "long.csv", "--model", four_hours / "model.toml") as url:
        page = window(url)
        page.wait("return document.querySelector('#plot-drive')?.dataset.linked", patience_s=FIT_S)
        page.idle(2.0 * FIT_S)
        page.click("#tab-compare")
        page.wait("return document.querySelector('#plot-map')?.dataset.linked")
        assert page.run(AXIS, "drive")[0] == "time, h"
        page.press("c")
        page.wait("return document.querySelectorAll('#measures tbody tr').length > 3")
        assert "slope per h" in page.text("#measures thead")
        shown = 3600.0, "h"
        for from_s, to_s, unit, seconds in (
            (7200, 7275, "min", 60.0),
            (7230, 7260, "s", 1.0),
            (3600, 9000, "h", 3600.0),
        ):
            page.run(ZOOM, [from_s / shown[0], to_s / shown[0]])  # as the plot has it that is zoomed
            page.wait(WINDOW, [from_s / 3600.0, to_s / 3600.0])
            page.idle()
            for plot in PLOTS:
                title, first, last, *cursors = page.run(AXIS, plot)
                assert title == f"time, {unit}", plot
                assert (first, last) == pytest.approx((from_s / seconds, to_s / seconds), rel=1e-6)
            page.click("#cursors-here")
            page.wait(
                "return document.querySelector('#cursor-a-at').value === arguments[0]",
                page.run("return (arguments[0]).toFixed(arguments[1])", (2 * from_s + to_s) / 3 / seconds,
                         max(0, 3 - int(np.floor(np.log10((to_s - from_s) / seconds))))),
            )  # fmt: skip
            page.idle()
            page.wait(f"return document.querySelector('#measures thead').innerText.includes('slope per {unit}')")
            inlet = next(r for r in page.run(ROWS) if "inlet" in r[0])
            assert float(inlet[4].replace("−", "-")) == pytest.approx(0.004 * seconds, rel=2e-2)
            assert f" {unit}" in page.text("#cursor-apart")
            cursors = page.run(AXIS, "drive")[3:]
            assert cursors == pytest.approx([(2 * from_s + to_s) / 3 / seconds, (from_s + 2 * to_s) / 3 / seconds])
            page.picture(tmp_path / f"{unit}.png")
            shown = seconds, unit
        page.type("#cursor-a-at", "1.5")
        page.press("Enter")
        page.wait("return Math.abs(JSON.parse(sessionStorage.workbench).cursors.a - 1.5) < 1e-9")
        page.run("return Plotly.relayout(document.querySelector('#plot-core'), {'xaxis.autorange': true})")
        page.wait("return document.querySelector('#stage').dataset.window === ''")
        page.idle()
        for plot in PLOTS:
            assert page.run(AXIS, plot)[0] == "time, h"
        assert page.complaints() == []
