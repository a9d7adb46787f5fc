"""Where a cell is not known, the hottest point of all is not known: the curve of the past says so, as its tile does."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.bus.logfile import write_log
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Alerted, Estimated
from bms_gateway.health.alerts import Change, Condition, Severity
from tests.support.vehicle_traffic import traffic
from tests.workbench.browser import faults
from tests.workbench.conftest import served
from tests.workbench.held_pictures import EXAMPLE, watched

STRING = 1
DARK = range(15, 25)
"""Ticks in which cell 3 is not known."""
ALARMED = range(20, 25)
"""Of these, those in which it has an alarm."""


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "drive.log"
    write_log(path, [traffic(40.0)])
    return path


def lost(watch, engine, events, monkeypatch, dark=DARK, alarmed=ALARMED):
    """Hear a log in which cell 3 of a string becomes unknown, and has an alarm for a part of that time."""
    name, tick = engine.strings[STRING].plan.name, 0
    hot = Condition("core", Severity.ALARM, "hot", name, 3, settled=True, urgent=True)
    for e in events:
        if isinstance(e, Estimated):
            at = e.layout.parts[STRING].start + 2
            numbers = {k: np.array(getattr(e, k)) for k in ("core", "centre")}
            for x in numbers.values() if tick in dark else ():
                x[at] = np.nan
            e = replace(e, **numbers)
            monkeypatch.setattr(type(engine.alerts), "raised", [hot] if tick in alarmed else [])
            tick += 1
        elif isinstance(e, Alerted):
            continue
        watch.take(e)
    assert tick > max(dark)
    return Change(hot, raised=True)


def test_the_past_tells_which_cells_were_not_known_and_when(log, monkeypatch):
    # Bug: the curve went on with the hottest of the other cells, as if nothing was missing.
    watch, engine, events = watched(log)
    lost(watch, engine, events, monkeypatch)
    watch.steer("test", {"seek": 1e6})
    past = watch.history("test", STRING, 0.0)
    assert [k for k, n in enumerate(past["unknown"]) if n] == list(DARK)
    assert [k for k, n in enumerate(past["hidden"]) if n] == list(ALARMED)
    assert (past["dark"], past["burning"]) == ([3], [3])
    assert past["share"] == pytest.approx(len(DARK) / len(past["t"]))
    assert all(past["hottest"][k] is not None for k in DARK)  # of the others
    for other in (0, 2):
        past = watch.history("test", other, 0.0)
        assert (past["dark"], past["burning"], past["share"]) == ([], [], 0.0)


def test_a_moment_in_which_a_cell_was_not_known_is_in_the_thinned_past_too(log, monkeypatch):
    watch, engine, events = watched(log)
    monkeypatch.setattr("bms_gateway.workbench.history.POINTS", 8)  # four stretches of ten ticks
    lost(watch, engine, events, monkeypatch, dark=range(17, 18), alarmed=range(17, 18))
    watch.steer("test", {"seek": 1e6})
    past = watch.history("test", STRING, 0.0)
    assert len(past["t"]) < 12
    t = np.array(past["t"])
    marked = t[np.array(past["unknown"]) > 0]
    assert len(marked) >= 1
    assert np.abs(marked - 17.0).min() <= 10.0
    assert np.array_equal(np.array(past["unknown"]) > 0, np.array(past["hidden"]) > 0)


LIE = """
const own = window.fetch;
const told = { dark: { dark: [3] }, burning: { dark: [3, 5], burning: [3] } };
window.fetch = async (...words) => {
  const answer = await own(...words);
  if (!String(words[0]).includes('/api/history') || !window.change) return answer;
  const found = await answer.json(), n = found.t.length;
  const part = (a, b) => found.t.map((_, i) => (i >= a * n && i < b * n ? 1 : 0));
  const hidden = window.change === 'burning' ? { hidden: part(0.5, 0.6) } : {};
  const all = { ...found, ...told[window.change], ...hidden, unknown: part(0.4, 0.6), share: 0.2 };
  return new Response(JSON.stringify(all));
};
"""
PLACES = (
    "return [...document.querySelectorAll('#past .line-hottest, #past .line-others')]"
    ".map(l => l.getBBox()).map(b => [b.x, b.x + b.width])"
)


@pytest.mark.slow
def test_it_is_seen_in_the_curve_and_read_in_a_sentence(window, axe, log, tmp_path):
    name = load_config(shipped(EXAMPLE)).plan.strings[0].name
    with served(tmp_path, "--live", log, "--config", shipped(EXAMPLE)) as url:
        page = window("about:blank", (1280, 1000))
        page.cdp("Page.addScriptToEvaluateOnNewDocument", source=LIE)
        page.go(url)
        page.wait("return Number(document.querySelector('#past')?.dataset.points) > 20", patience_s=60)
        assert not page.there("#past-unknown")
        assert page.run("return document.querySelectorAll('#past .unknown').length") == 0
        for change, told, sort in (
            ("dark", "because cell 3 was not known at some time; the dashed curve is the hottest of those", "alarm"),
            ("burning", "Red: cell 3 was in alarm and not known, so there is no curve.", "danger"),
        ):
            page.run("window.change = arguments[0]", change)
            page.run("document.querySelector('#past-span').dispatchEvent(new Event('change'))")
            page.wait(f"return document.querySelector('#past-unknown').innerText.includes({told!r})", patience_s=20)
            assert page.run("return document.querySelector('#past-unknown').className") == sort
            assert "in 20 % of this stretch the hottest point of all is not known" in page.text("#past-unknown")
            assert told in page.run("return document.querySelector('#past').getAttribute('aria-label')")
            assert name in page.run("return document.querySelector('#past').getAttribute('aria-label')")
            shapes = "return document.querySelectorAll(arguments[0]).length"
            assert page.run(shapes, "#past rect.unknown") == (1 if change == "dark" else 2)
            assert page.run(shapes, "#past rect.burning") == (0 if change == "dark" else 1)
            assert page.run(shapes, "#past .line-others") == 1
            # the curve of all cells stands before and after, and none where a cell in alarm is not known
            at = "const b = document.querySelector('#past rect.burning').getBBox(); return [b.x, b.x + b.width]"
            if change == "burning":
                left, right = page.run(at)
                assert all(b <= left + 1 or a >= right - 1 for a, b in page.run(PLACES))
            for width in (390, 1280):
                page.cdp(
                    "Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False
                )
                page.wait("return document.documentElement.scrollWidth <= innerWidth", patience_s=20)
                for theme in ("dark", "light"):
                    page.click("#theme")
                    assert faults(page, axe) == []
                    page.run("document.querySelector('#past').scrollIntoView({block: 'center'})")
                    page.picture(tmp_path / f"past-{change}-{width}-{theme}.png")
        assert page.complaints() == []
