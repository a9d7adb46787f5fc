"""A cell whose core is not known shows the last reading of its surface: "not known" alone hides a hot cell."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.bus.logfile import write_log
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Estimated, Judged
from bms_gateway.frames.quality import Quality
from tests.support.vehicle_traffic import traffic
from tests.workbench.browser import faults
from tests.workbench.conftest import served
from tests.workbench.held_pictures import CATCH, EXAMPLE, LIMIT_C, watched

STRING = 2
SILENT_S = 12.0
TILES = "return [...document.querySelectorAll('.live-cell')]"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "drive.log"
    write_log(path, [traffic(60.0)])
    return path


def test_the_picture_has_the_last_reading_and_its_age(log):
    watch, engine, said = watched(log)
    sensed = [k - 1 for k in engine.strings[STRING].plan.model.sensors]
    cell, blind = sensed[0], next(k for k in range(12) if k not in sensed)
    events, last = list(said), None
    end_ns = max(e.time_ns for e in events if isinstance(e, Judged))
    for e in events:
        if isinstance(e, Estimated):
            core, at = e.core.copy(), e.layout.parts[STRING].start
            core[[at + cell, at + blind]] = np.nan
            e = replace(e, core=core)
        elif isinstance(e, Judged):
            s = e.strings[STRING]
            if e.time_ns > end_ns - SILENT_S * 1e9:
                s = replace(s, surface=np.full(12, np.nan))
            elif np.isfinite(s.surface[cell]):
                last = float(s.surface[cell]), (end_ns - e.time_ns) * 1e-9 + float(s.age[cell])
            e = replace(e, strings=(*e.strings[:STRING], s, *e.strings[STRING + 1 :]))
        watch.take(e)
    watch.whole = True
    watch.steer("test", {"seek": 1e6, "play": False})
    shown = [s["read"] for s in json.loads(next(watch.stream("test")))["strings"]]
    assert last is not None
    assert last[1] > SILENT_S - 1.0
    assert 15.0 < last[0] < 60.0
    assert shown[STRING] == {str(cell): [pytest.approx(last[0], abs=0.006), pytest.approx(last[1], abs=0.2)]}
    assert not any(s for i, s in enumerate(shown) if i != STRING)


@pytest.mark.slow
def test_the_tile_shows_the_surface_and_its_colour(window, log, axe, tmp_path):
    with served(tmp_path, "--live", log, "--config", shipped(EXAMPLE)) as url:
        page = window("about:blank", (390, 900))
        page.cdp("Page.addScriptToEvaluateOnNewDocument", source=CATCH)
        page.go(url)
        page.wait("return document.querySelectorAll('.live-cell').length === 60")
        page.wait(
            "return window.last?.strings?.[0].core[0] !== null && !document.querySelector('#live-state').innerText"
        )
        page.run("window.held = true")
        dark = (
            "const p = structuredClone(last), s = p.strings[0];"
            "for (const k of [0, 1, 2, 3]) { for (const x of ['core', 'half', 'centre', 'centre_half']) s[x][k] = null;"
            "  s.quality[k] = arguments[1]; }"
            "s.read = {0: [33.41, 0.5], 1: [arguments[0] - 5, 25.2], 2: [arguments[0] + 1, 400]}; show(p);"
        )
        page.run(dark, LIMIT_C, int(Quality.NOT_AVAILABLE))
        tiles = page.run(f"{TILES}.slice(0, 4).map(c => c.innerText.split('\\n').slice(1).join(' '))")
        assert tiles == [
            "– not known surface 33.4",
            "– not known surface 75.0, 25 s ago",
            "– not known surface 81.0, 0:06:40 ago",
            "– not known",
        ]
        colors = page.run(f"{TILES}.slice(0, 4).map(c => getComputedStyle(c).backgroundColor)")
        assert colors == ["rgb(255, 255, 255)", "rgb(255, 152, 56)", "rgb(176, 0, 32)", "rgb(255, 255, 255)"]
        title = page.run("return document.querySelectorAll('.live-cell')[2].title")
        assert "surface read 81.0 °C, 0:06:40 ago, at or over its limit of 80 °C" in title
        title = page.run("return document.querySelector('#hottest-value').innerText")
        assert "not known" not in title
        alarmed = dark.replace(
            "show(p)", "p.alerts = [{level: 'alarm', code: 'core', string: arguments[2], cell: 4, text: ''}]; show(p)"
        )
        name = load_config(shipped(EXAMPLE)).plan.strings[0].name
        page.run(alarmed, LIMIT_C, int(Quality.NOT_AVAILABLE), name)
        assert page.run("return document.querySelector('#hottest-value').innerText") == "not known"
        line = page.run("return document.querySelector('#hottest-line').innerText")
        assert line.startswith(f"In alarm and not known: cell 4 of {name}; hottest of the others: ")
        assert page.run(f"{TILES}.slice(3, 4).map(c => getComputedStyle(c).backgroundColor)") == ["rgb(176, 0, 32)"]
        wide = "c.scrollWidth > c.clientWidth + 1 || c.scrollHeight > c.clientHeight + 1"
        cut = f"{TILES}.filter(c => {wide}).length"
        assert page.run(cut) == 0
        assert faults(page, axe) == []
