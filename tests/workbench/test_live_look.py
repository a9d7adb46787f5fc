"""What the live page looks like: old, doubtful and hot cells; forecast, and heat that no current makes."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.bus.logfile import write_log
from bms_gateway.config import shipped
from bms_gateway.engine import Estimated
from bms_gateway.engine.forecast_result import TOLD_S
from bms_gateway.frames.quality import Quality
from tests.support.vehicle_traffic import traffic
from tests.workbench.browser import faults
from tests.workbench.conftest import served
from tests.workbench.held_pictures import CATCH, EXAMPLE, LIMIT_C, watched

CIVIDIS = ((0, 34, 78), (53, 69, 108), (102, 105, 112), (148, 142, 119), (200, 184, 102), (254, 232, 56))


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "drive.log"
    write_log(path, [traffic(40.0)])
    return path


def newest(watch):
    return json.loads(next(watch.stream("test")))


def test_the_forecast_is_that_of_the_engine(log):
    watch, engine, events = watched(log)
    for event in events:
        watch.take(event)
    assert list(TOLD_S.values()) == ["60", "300", "600"]  # places 1 to 3 are one, five and ten minutes
    for shown, s in zip(newest(watch)["strings"], engine.strings, strict=True):
        R_e = next(e for e in s.estimates if e.name == "R_e")
        assert shown["R_e"][:2] == pytest.approx([1e3 * R_e.value, 1.96e3 * R_e.sd], abs=1e-3)  # ± 95 %
        assert shown["trend"][-1][1:] == shown["R_e"][:2]
        f, ahead = s.forecast, shown["ahead"]
        k = f.hottest
        assert ahead["cell"] == k + 1
        assert ahead["load_A"] == pytest.approx(f.load, abs=0.06)
        assert ahead["point"] == pytest.approx([float(f.centre[h, k]) for h in (1, 2, 3)], abs=0.006)
        assert ahead["half"] == pytest.approx([1.96 * float(f.centre_sd[h, k]) for h in (1, 2, 3)], abs=0.006)
        assert ahead["limit_s"] is None  # at 33 °C


@pytest.mark.parametrize(("heat_W", "sd_W", "told"), [(2.0, 0.3, [4, 2.0, 0.59]), (0.5, 0.3, None)])
def test_heat_that_no_current_makes_is_told_where_it_is_sure(log, heat_W, sd_W, told):
    watch, engine, events = watched(log)
    for event in events:
        if isinstance(event, Estimated):
            heat, sd = np.array(event.heat), np.array(event.heat_sd)
            heat[:], sd[:] = 0.0, 1.0
            mine = event.layout.parts[2]
            heat[mine.start + 3], sd[mine.start + 3] = heat_W, sd_W
            watch.take(replace(event, heat=heat, heat_sd=sd))
        else:
            watch.take(event)
    assert len(engine.strings) == 5
    assert [s["heat"] for s in newest(watch)["strings"]] == [None, None, told, None, None]


def scale(core_C):
    """Colour of a cell well below the limit: dark at 50 K below it, light at 10 K."""
    share = min(max((core_C - LIMIT_C + 50.0) / 40.0, 0.0), 1.0)
    return [float(np.interp(share, np.linspace(0.0, 1.0, 6), [c[i] for c in CIVIDIS])) for i in range(3)]


@pytest.mark.slow
def test_old_doubtful_and_hot_cells_look_different(window, log, axe, tmp_path):
    with served(tmp_path, "--live", log, "--config", shipped(EXAMPLE)) as url:
        page = window("about:blank", (1280, 900))
        page.cdp("Page.addScriptToEvaluateOnNewDocument", source=CATCH)
        page.go(url)
        page.wait("return document.querySelectorAll('.live-cell').length === 60")
        page.wait(
            "return !document.querySelector('#live-state').innerText && window.last?.strings?.[0].core[0] !== null"
        )
        page.run("window.held = true")
        color = (
            "return getComputedStyle(document.querySelectorAll('.live-cell')[arguments[0]])"
            ".backgroundColor.match(/\\d+/g).map(Number)"
        )
        # a cell has the colour of its hottest point
        cores = page.run("return last.strings.flatMap(s => s.core.map((x, k) => Math.max(x, s.centre[k] ?? x)))")
        page.run("show(last)")
        for k in (0, 30, 59):
            assert page.run(color, k) == pytest.approx(scale(cores[k]), abs=1.0)

        # the colour is that of the hottest point, as key and tooltip say, and never that of a colder core
        page.run(
            "const p = structuredClone(last), s = p.strings[0];"
            "[[-30, -14], [-5, 1]].forEach(([core, centre], k) => {"
            "  s.core[k] = arguments[0] + core; s.centre[k] = arguments[0] + centre; });"
            "show(p);",
            LIMIT_C,
        )
        tip = page.run("return document.querySelectorAll('.live-cell')[1].title")
        assert "hottest point 81.0" in tip
        assert "the colour is that of the hottest point" in tip
        assert page.run(color, 0) == pytest.approx(scale(LIMIT_C - 14), abs=1.0)
        assert page.run(color, 1) == [176, 0, 32]
        assert "Colour: the hottest point inside the cell, 30 °C" in page.text("#live-key")  # 50 K below the limit
        page.run("const p = structuredClone(last); p.bus.refused = {}; show(p);")
        assert page.text("#refused-line") == "All that came are used."  # of a sensor that is silent, nothing comes

        # the scale is fixed: other cells get hot, and this one keeps its colour
        hot = (
            "const p = structuredClone(last), s = p.strings[0];"
            "[-5, 1, -10.5].forEach((x, k) => { s.core[k] = s.centre[k] = arguments[0] + x; });"
            "show(p);"
        )
        page.run(hot, LIMIT_C)
        assert page.run(color, 0) == [255, 152, 56]
        assert page.run(color, 1) == [176, 0, 32]
        assert page.run(color, 2) == pytest.approx(scale(LIMIT_C - 10.5), abs=1.0)
        assert page.run(color, 59) == pytest.approx(scale(cores[59]), abs=1.0)
        assert page.run("return [...document.querySelectorAll('.live-cell.over')].length") == 1
        # the cell of a thermocouple that was lost stays red over its limit
        image = "return getComputedStyle(document.querySelectorAll('.live-cell')[arguments[0]]).backgroundImage"
        for lost in (Quality.STALE, Quality.NEVER):
            page.run(
                hot.replace("show(p);", "s.quality[1] = s.quality[2] = arguments[1]; show(p);"), LIMIT_C, int(lost)
            )
            assert "rgb(176, 0, 32)" in page.run(image, 1)
            assert "rgb(176, 0, 32)" not in page.run(image, 2)

        # a core that is not proven: dotted, with a question mark, and in words
        page.run(
            "const p = structuredClone(last); p.strings[1].quality[0] = arguments[0]; show(p);", int(Quality.DOUBTFUL)
        )
        style = "return getComputedStyle(document.querySelectorAll('.live-cell')[arguments[0]])[arguments[1]]"
        assert page.run(style, 12, "borderTopStyle") == "dotted"
        mark = "return getComputedStyle(document.querySelectorAll('.live-cell b')[arguments[0]], '::after').content"
        assert page.run(mark, 12) == '"?"'
        assert page.run(mark, 13) in ("none", "normal")
        words = "return document.querySelectorAll('.live-string')[arguments[0]].innerText"
        assert "core not proven" in page.run(words, 1)
        assert "core not proven" not in page.run(words, 2)

        # stale and parked: said above, faded below, and not alike
        look = (
            "const s = getComputedStyle(document.querySelector('.live-string .live-cells'));"
            "return [s.filter, s.outlineStyle]"
        )
        looks, said = {}, {}
        for state, age in (("now", 0), ("stale", 12), ("parked", 4000)):
            page.run("show({...structuredClone(last), state: arguments[0], silent: arguments[1]})", state, age)
            looks[state], said[state] = tuple(page.run(look)), page.text("#live-state")
            assert faults(page, axe) == [], state
        assert looks == {
            "now": ("none", "none"),
            "stale": ("saturate(0.4)", "dashed"),
            "parked": ("grayscale(1)", "solid"),
        }
        assert said == {
            "now": "",
            "stale": "Stale: nothing new for 12 s.",
            "parked": "Parked: the bus has been silent for 1:06:40; the last estimates are shown.",
        }

        # what comes, and heat that no current makes, in words
        page.run(
            "const p = structuredClone(last), s = p.strings[0]; s.heat = [4, 2.0, 0.59];"
            "s.ahead = {cell: 3, load_A: -40, point: [40, 42, 44], half: [0.5, 1, 2], limit_s: [5, 480],"
            " discharge: [1, 2, 90], charge: [1, 2, 45], limiting: 2}; show(p);"
        )
        told = page.run(words, 0)
        assert "heat that no current makes: 2.00 ± 0.59 w in cell 4" in told.lower()
        ahead = (
            "forecast at 40 A charging: hottest point in 1, 5, 10 min 40.0 ± 0.5, 42.0 ± 1.0, 44.0 ± 2.0 °C (cell 3); "
            "cell 5 reaches its limit in 480 s; 90 A discharging or 45 A charging can be held for 10 min, "
            "limited by cell 2"
        )
        assert ahead.lower() in told.lower()

        # where no current is permitted, the cell that forbids it is named, though another one is the hottest
        page.run(
            "const p = structuredClone(last), s = p.strings[0]; s.centre[0] = 37; s.centre_half[0] = 8.3;"
            "s.ahead = {cell: 4, load_A: 37, point: [37.3, 36.9, 36.2], half: [5.6, 5.5, 6.1], limit_s: null,"
            " discharge: [0, 0, 0], charge: [0, 0, 0], limiting: 1}; show(p);"
        )
        assert (
            "37.3 ± 5.6, 36.9 ± 5.5, 36.2 ± 6.1 °c (cell 4); no current keeps every hottest point, with its band, "
            "below the limit of 80 °c for 10 min: cell 1, now 37.0 ± 8.3 °c, may be over it without a load"
        ) in page.run(words, 0).lower()

        page.run(
            "const p = structuredClone(last), s = p.strings[0]; s.centre[0] = 83; s.centre_half[0] = 8.3;"
            "s.ahead = {cell: 4, load_A: 37, point: [37, 36, 35], half: [5, 5, 5], limit_s: [1, 0],"
            " discharge: [0, 0, 0], charge: [0, 0, 0], limiting: 1}; show(p);"
        )
        assert "for 10 min: cell 1, now 83.0 ± 8.3 °c, is over it" in page.run(words, 0).lower()

        # a hottest point that is not known to 12 K (1 sd) has no number with a band, as in the alarms
        for half, said in (
            (23.5, "70.6 ± 23.5 °C"),
            (25.6, "about 71 °C, not known to 12 K"),
            (48, "not known to 24 K"),
        ):
            page.run(
                "const p = structuredClone(last), s = p.strings[0]; s.hottest = 0; s.core[0] = 65; s.half[0] = 20;"
                "s.centre[0] = 70.6; s.centre_half[0] = arguments[0]; p.strings = p.strings.map((x, i) => (i ? "
                "{...x, hottest: null} : x)); show(p);",
                half,
            )
            assert f"hottest point {said}".lower() in page.run(words, 0).lower()
            assert f"hottest point {said}" in page.run("return document.querySelector('.live-cell').title")
            assert page.text("#hottest-value") == said

        # bug: healthy sensors were called not available where it was the core that was not known
        page.run(
            "const p = structuredClone(last), s = p.strings[0]; s.core[0] = s.half[0] = s.centre[0] = null;"
            "s.quality[0] = 3; show(p);"
        )
        assert "core of cell 1 not known" in page.run(words, 0).lower()
        assert "sensor 1 is not available" not in page.run(words, 0).lower()
        assert "bad" not in page.run("return document.querySelector('.live-cell').className")
        assert "internal resistance (r_e)" in told.lower()
        assert page.complaints() == []


def test_what_a_dead_program_showed_last_looks_old(window, log, tmp_path):
    """The cells kept their colours, and the clock of the log its time."""
    with served(tmp_path, "--live", log, "--config", shipped(EXAMPLE)) as url:
        page = window(url)
        page.wait("return document.querySelectorAll('.live-cell').length === 60")
        page.wait("return document.querySelector('#panel-live').dataset.pictures > 2")
    page.wait("return document.querySelector('#live-state').innerText.includes('may be long past')")
    look = "return [...document.querySelectorAll('.live-string')].map(s => s.className)"
    assert set(page.run(look)) == {"live-string parked"}
