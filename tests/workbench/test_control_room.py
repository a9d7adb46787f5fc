"""The live page as a control room: alerts with the limits of the config, events in groups, the past, export."""

import csv
import io
import json
import re
from dataclasses import replace
from itertools import pairwise
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log, write_log
from bms_gateway.config import load_config, shipped
from bms_gateway.config.model_file import read_model
from bms_gateway.engine import Engine, Estimated, Notice, drive
from bms_gateway.engine.events import Alerted, Level
from bms_gateway.errors import UsageError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.health.alerts import Change, Condition, Severity
from bms_gateway.report.table import read_table
from bms_gateway.workbench.incidents import Events
from bms_gateway.workbench.live_estimates import Watch
from bms_gateway.workbench.sources import Playback
from tests.frames.payloads import OWN, parsed
from tests.support.vehicle_traffic import traffic
from tests.workbench.browser import come, faults
from tests.workbench.conftest import served

SECOND = 1_000_000_000
BEGAN_NS = 1_700_000_000 * SECOND
"""Wall clock of the log's first frame."""
DEAD_S = 30
"""From which on the inlet of string 1 is not sent any more."""
CORE_MAX_C = 24.0
"""Below the cores of the log: every string is over."""
EXAMPLE = "deploy/example/gateway.toml"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A minute and a half of sixty cells whose first string loses its inlet."""
    frames = traffic(90.0)
    message = load_config(shipped(EXAMPLE)).database.message("string_1_coolant")
    lost = (frames.can_id == message.can_id) & (frames.time_ns > DEAD_S * SECOND)
    kept = frames[~lost]
    shifted = FrameBatch(kept.time_ns + BEGAN_NS, kept.can_id, kept.length, kept.data)
    path = tmp_path_factory.mktemp("log") / "drive.log"
    write_log(path, [shifted])
    return path


@pytest.fixture(scope="module")
def plan():
    plan = load_config(shipped(EXAMPLE)).plan
    return replace(plan, alerts=replace(plan.alerts, core_max_C=CORE_MAX_C))


def watched(plan, log):
    engine = Engine(plan, load_config(shipped(EXAMPLE)).database)
    source = Playback([log])
    watch = Watch(engine, "log", log.name, 500e3, source.traffic)
    source.start(engine, watch)
    come(lambda: watch.whole, "the end of the log")
    return watch


@pytest.fixture(scope="module")
def watch(plan, log):
    return watched(plan, log)


def at(watch, seconds, view="test"):
    watch.steer(view, {"play": False, "seek": seconds})
    return json.loads(next(watch.stream(view)))


def test_the_limit_of_the_config_raises_alarms(watch):
    assert watch.about()["limits"]["core_C"] == CORE_MAX_C
    shown = at(watch, 80)
    alerts = shown["alerts"]
    over = {a["string"] for a in alerts if a["level"] == "alarm" and "the limit is 24" in a["text"]}
    assert over == {f"string_{k}" for k in range(1, 6)}
    bands = 0
    for a in alerts:  # one band everywhere: 95 %, as the cells below the banner have it
        if found := re.match(r"hottest point of cell (\d+) is ([\d.]+) ± ([\d.]+) °C", a["text"]):
            of = shown["strings"][int(a["string"][-1]) - 1]
            cell, value, half = int(found[1]) - 1, float(found[2]), float(found[3])
            assert (value, half) == pytest.approx((of["centre"][cell], of["centre_half"][cell]), abs=0.06)
            bands += 1
    assert bands == 5
    assert at(watch, 1)["alerts"] == []  # of the past nothing is told that was raised later


def test_a_dead_inlet_is_a_warning_of_its_string_alone(log):
    watch = watched(load_config(shipped(EXAMPLE)).plan, log)
    assert at(watch, DEAD_S - 5)["alerts"] == []
    alerts = at(watch, 85)["alerts"]  # of all that the message carries
    assert {(a["string"], a["level"]) for a in alerts} == {("string_1", "warning")}
    assert any("coolant inlet not used" in a["text"] for a in alerts)


def test_events_are_grouped_and_none_is_of_the_future(watch):
    shown = at(watch, 85)
    keys = [(e["code"], e["part"], e["string"], bool(e["state"])) for e in shown["events"]]
    assert len(keys) == len(set(keys))
    assert all(e["at"] <= shown["at"] for e in shown["events"])
    assert [e["at"] for e in shown["events"]] == sorted((e["at"] for e in shown["events"]), reverse=True)
    assert {e["level"] for e in shown["events"] if e["state"]} >= {"alarm", "warning"}
    assert at(watch, 0)["events"] == []


def test_a_group_says_of_every_cell_what_was_said_last():
    """Sixteen thermocouples were good again, and one was named, as a warning to be acknowledged."""
    events = Events()

    def notice(second, level, cell, text):
        events.take(Notice(second * SECOND, level, "sensor", f"surface of cell {cell} {text}", "string_1", cell))

    for cell in (8, 9, 10):
        notice(cell, Level.WARNING, cell, "is not used")
    (group,) = events.grouped(20 * SECOND, 0)
    assert (group["level"], group["count"]) == ("warning", 3)
    assert group["text"] == "surface of cell 10 is not used; cells 8,9 too"
    notice(21, Level.NOTICE, 9, "is good again")
    (group,) = events.grouped(30 * SECOND, 0)
    assert group["level"] == "warning"
    assert group["text"] == "surface of cell 10 is not used; cell 8 too; before: surface of cell 9 is not used"
    for cell in (8, 10):
        notice(31 + cell, Level.NOTICE, cell, "is good again")
    (group,) = events.grouped(60 * SECOND, 0)
    assert (group["level"], group["count"]) == ("note", 6)
    now, before = group["text"].split("; before: ")
    assert now == "surface of cell 10 is good again; cells 8,9 too"
    assert before == "surface of cell 10 is not used; cells 8,9 too"
    assert group["worst"] == "warning"  # the filter of warnings still finds it


def test_a_row_names_every_cell_that_had_a_fault():
    """The fault of cell 2 was nowhere: the row had the words of cell 3, and one acknowledgement for both."""
    events = Events()
    for second, level, cell, text in (
        (1, Level.WARNING, 2, "is not used: out of range"),
        (2, Level.NOTICE, 2, "is good again"),
        (3, Level.WARNING, 3, "is not used: jumps"),
    ):
        events.take(Notice(second * SECOND, level, "sensor", f"surface of cell {cell} {text}", "string_1", cell))
    (group,) = events.grouped(4 * SECOND, 0)
    assert group["text"] == (
        "surface of cell 3 is not used: jumps; before: surface of cell 2 is not used: out of range"
    )


def test_what_an_alert_says_is_no_second_line():
    """The same sentence stood twice at the same moment; a dead inlet was told by its notice and by its alert."""
    events = Events()

    def notice(second, code, text, cell=None, part=""):
        events.take(Notice(second * SECOND, Level.WARNING, code, text, "string_1", cell, part))

    def alert(second, code, text, part="", raised=True):
        condition = Condition(code, Severity.WARNING, text, "string_1", part=part)
        events.take(Alerted(second * SECOND, Change(condition, raised)))

    def lines(second):
        return [(e["text"], e["count"]) for e in events.grouped(second * SECOND, 0)]

    notice(9, "sensor", "surface of cell 3 is not used", 3, "surface")
    notice(10, "sensor", "coolant inlet is not used", None, "coolant_inlet")
    assert lines(11) == [("coolant inlet is not used", 1), ("surface of cell 3 is not used", 1)]
    alert(13, "sensor", "coolant inlet not used: check its sender", "coolant_inlet")
    notice(20, "unproven", "cores not proven")
    alert(20, "unproven", "cores not proven")
    assert lines(30) == [
        ("cores not proven", 1),
        ("coolant inlet not used: check its sender", 1),
        ("surface of cell 3 is not used", 1),  # which no alert has said
    ]
    assert len(lines(12)) == 2  # nothing of the future
    proven = ("the model explains the surfaces: cores are proven again", 1)
    notice(40, "unproven", proven[0])
    assert lines(41)[:2] == [proven, ("cores not proven", 1)]


def test_the_time_of_day_is_that_of_the_frames(watch):
    shown = at(watch, 40)
    assert shown["wall_ms"] * 1_000_000 == pytest.approx(BEGAN_NS + 41 * SECOND, abs=2 * SECOND)


def sent_of(log, string, quantity):
    """Time since the log's beginning and value of one signal, as cantools decodes it."""
    channels = next(s for s in load_config(shipped(EXAMPLE)).plan.strings if s.name == string).channels
    channel = next(c for c in channels if c.quantity == quantity)
    message, signal = channel.signal.split(".")
    wanted = parsed(OWN).get_message_by_name(message)
    for f in read_log(log):
        for k in np.flatnonzero(f.can_id & 0x1FFF_FFFF == wanted.frame_id):
            at = (int(f.time_ns[k]) - BEGAN_NS) * 1e-9
            yield at, wanted.decode(bytes(f.data[k, : f.length[k]]), decode_choices=False)[signal]


def test_the_past_is_what_the_engine_said(watch, plan, log):
    database = load_config(shipped(EXAMPLE)).database
    said = [e for e in drive(Engine(plan, database), read_log(log)) if isinstance(e, Estimated)]
    at(watch, 80)
    past = watch.history("test", 2, 20.0)
    assert past["t"][0] == pytest.approx(60.0)
    assert past["t"][-1] == pytest.approx(80.0)
    first = said[0].time_ns
    for t, hottest, half, cell in zip(past["t"], past["hottest"], past["half"], past["cell"], strict=True):
        e = next(x for x in said if x.time_ns == first + round(t) * SECOND)
        mine = e.layout.parts[2]
        k = int(np.nanargmax(e.centre[mine]))
        assert (hottest, half) == pytest.approx((e.centre[mine][k], 1.96 * e.centre_sd[mine][k]), abs=2e-3)
        assert cell == k + 1
    assert all(x is not None for x in past["current"] + past["inlet"])
    nominal = next(s for s in plan.strings if s.name == "string_3").model.flow
    for quantity, per, tolerance in (("soc", 1.0, 5e-3), ("voltage", 1.0, 0.5), ("coolant_flow", nominal, 0.02)):
        sent = {t: x / per for t, x in sent_of(log, "string_3", quantity)}
        for t, shown in zip(past["t"], past[quantity.removeprefix("coolant_")], strict=True):
            assert shown == pytest.approx(sent[min(sent, key=lambda s: abs(s - t))], abs=tolerance), (quantity, t)
    whole = watch.history("test", 0, 0.0)
    assert whole["t"][0] == 0.0
    assert any(m["level"] == "warning" and m["at"] > DEAD_S for m in whole["marks"])


def test_the_exported_window_holds_every_cell_of_every_tick(watch):
    shown = at(watch, 80)
    rows = list(csv.DictReader(io.StringIO(b"".join(watch.table("test", 10.0)).decode())))
    assert len(rows) == 11 * 60
    last = rows[-60:]
    assert float(last[0]["time_s"]) == pytest.approx(shown["first_s"] + shown["at"])
    assert last[0]["wall_clock"].startswith("2023-11-14T22:1")
    cores = [x for s in shown["strings"] for x in s["core"]]
    np.testing.assert_allclose([float(r["core_C"]) for r in last], cores, atol=0.006)
    assert {r["string"] for r in rows} == {f"string_{k}" for k in range(1, 6)}


def test_what_was_acknowledged_is_new_again_when_it_comes_again(watch):
    shown = at(watch, 85)
    e = next(e for e in shown["events"] if e["level"] == "alarm")
    assert e["seen"] is None
    wish = {k: e[k] for k in ("code", "part", "string", "alert")}
    watch.acknowledge("test", {**wish, "reason": " pump  looked at "})
    seen = next(x for x in at(watch, 85)["events"] if [x[k] for k in wish] == list(wish.values()))["seen"]
    assert seen["reason"] == "pump looked at"
    rows = list(csv.DictReader(io.StringIO(watch.events_table().decode())))
    mine = [r for r in rows if (r["code"], r["string"], bool(r["state"])) == (e["code"], e["string"], e["alert"])]
    assert {r["reason"] for r in mine} == {"pump looked at"}
    assert all(r["acknowledged"].endswith("Z") for r in mine)
    assert "" in {r["reason"] for r in rows}  # the others were not
    again = [x for x in watch.events.all if x.group == tuple(wish.values())][-1]
    watch.events.all.append(replace(again, time_ns=watch.ticks.first_ns + 100 * SECOND))
    end = watch.ticks.first_ns + 200 * SECOND
    fresh = watch.events.grouped(end, watch.ticks.first_ns)
    watch.events.all.pop()
    assert next(x for x in fresh if [x[k] for k in wish] == list(wish.values()))["seen"] is None
    with pytest.raises(UsageError, match="nothing of the kind 'nonsense'"):
        watch.acknowledge("test", {"code": "nonsense", "string": "", "reason": "", "alert": True})


def test_no_text_of_exported_events_is_a_formula(watch):
    shown = at(watch, 85)
    e = next(e for e in shown["events"] if e["level"] == "alarm" and e["string"] == "string_5")
    wish = {k: e[k] for k in ("code", "part", "string", "alert")}
    for reason in ("=cmd|'/C calc'!A0", "+1", "-1", "@SUM(A1)", " =1"):
        watch.acknowledge("test", {**wish, "reason": reason})
        rows = list(csv.DictReader(io.StringIO(watch.events_table().decode())))
        assert f"'{reason.strip()}" in {r["reason"] for r in rows}
        for row in rows:
            texts = [row[k] for k in ("code", "string", "state", "text", "reason")]
            assert not any(text.startswith(("=", "+", "-", "@")) for text in texts), row


def test_the_signals_of_a_window_are_those_of_the_bus(watch, log, tmp_path):
    shown = at(watch, 80)
    table = read_table(watch.signals.table(1, 30.0, watch.stretch_ns("test", 30.0, None)[1], tmp_path / "window.csv"))
    assert table.time_s[-1] - table.time_s[0] == pytest.approx(30.0, abs=1.1)
    end_ns = shown["wall_ms"] * 1_000_000
    messages = parsed(OWN)
    coolant = messages.get_message_by_name("string_2_coolant")
    said = [
        coolant.decode(bytes(f.data[k, : f.length[k]]), decode_choices=False)["coolant_inlet"]
        for f in read_log(log)
        for k in np.flatnonzero(f.can_id & 0x1FFF_FFFF == coolant.frame_id)
        if end_ns - 30 * SECOND <= f.time_ns[k] <= end_ns
    ]
    given = table.coolant_inlet_C[np.isfinite(table.coolant_inlet_C)]
    assert len(given) == pytest.approx(len(said), abs=12)
    assert (min(given), max(given)) == pytest.approx((min(said), max(said)), abs=0.05)
    model = read_model(watch.signals.model(1, tmp_path / "model.toml"))
    assert set(table.surface_C) == set(model.sensors)
    with pytest.raises(UsageError, match="valid are 0 to 4"):
        watch.signals.table(7, 30.0, None, tmp_path / "x.csv")


def test_a_silent_bus_within_a_log_is_told(tmp_path):
    """The engine goes on for a while without frames, by the model alone; then it waits."""
    frames = traffic(140.0)
    kept = frames[(frames.time_ns <= DEAD_S * SECOND) | (frames.time_ns > 110 * SECOND)]
    path = tmp_path / "drive.log"
    write_log(path, [FrameBatch(kept.time_ns + BEGAN_NS, kept.can_id, kept.length, kept.data)])
    watch = watched(load_config(shipped(EXAMPLE)).plan, path)
    shown = [(s["state"], round(s["silent"])) for s in (at(watch, t) for t in (20, 32, 50, 80, 105, 120))]
    states, silent = zip(*shown, strict=True)
    assert states == ("now", "now", "stale", "stale", "parked", "now")
    assert silent == pytest.approx((0, 2, 20, 50, 75, 0), abs=1)


def test_what_is_old_is_told(watch, monkeypatch):
    shown = at(watch, 50)
    assert (shown["state"], shown["age"]) == ("now", 0.0)
    now = watch.kept_s + 12.0
    monkeypatch.setattr("bms_gateway.workbench.live_estimates.time.monotonic", lambda: now)
    watch.whole = False  # as a bus that may still send
    try:
        watch.steer("follows", {"follow": True})
        assert json.loads(next(watch.stream("follows")))["state"] == "stale"
        now += 100.0
        assert json.loads(next(watch.stream("follows")))["state"] == "parked"
    finally:
        watch.whole = True


GAP = """
window.ownFetch = window.fetch;
window.fetch = async (url, how) => {
  const answer = await ownFetch(url, how);
  if (!String(url).includes('/api/history')) return answer;
  const found = await answer.json();
  for (const k of [30, 31, 32]) found.hottest[k] = found.half[k] = null;
  return { json: async () => found };
};
"""
"""Three seconds of the past in which no hottest point is known."""
LONG_EVENT = """
const cells = document.querySelector('#events tbody tr').children;
['2026-03-01 14:08:40', '12 ×', 'warning over', 'string_5'].forEach((text, k) => { cells[k + 1].textContent = text; });
"""
"""An alert that came again and is over: its words in one line are wider than a phone."""


@pytest.mark.slow
def test_the_page_is_a_control_room(window, log, axe, tmp_path):
    text = shipped(EXAMPLE).read_text().replace("# [alerts]", f"[alerts]\ncore_max_C = {CORE_MAX_C}\n#", 1)
    (tmp_path / "gateway.toml").write_text(text)
    (tmp_path / "string.toml").write_text((shipped(EXAMPLE).parent / "string.toml").read_text())
    fleet = "https://grafana.example/fleet/?var-instance=truck_7:9105"
    words = ("--live", log, "--config", tmp_path / "gateway.toml", "--grafana", fleet)
    with served(tmp_path, *words) as url:
        page = window(url, (1280, 900))
        page.wait("return document.querySelectorAll('.live-cell').length === 60")
        page.wait("return !document.querySelector('#live-state').innerText")
        page.click("#play")
        seek = "const t = document.querySelector('#time'); t.value = arguments[0]; t.dispatchEvent(new Event('input'));"
        page.wait("return document.querySelector('#play').innerText === 'Play'")
        shown_at = "return document.querySelector('#at').dataset.s === '85'"
        page.run(seek, "85")
        page.wait(shown_at)
        assert "alarms" in page.text("#banner-title")
        assert "the limit is 24 °C" in page.text("#banner")
        page.click("#banner-list summary")
        assert "coolant inlet" in page.text("#banner")
        assert page.run("return document.querySelectorAll('.live-cell.over').length") == 60
        color = "return getComputedStyle(document.querySelector('.live-cell')).backgroundColor"
        assert page.run(color) == "rgb(176, 0, 32)"
        assert page.text(".live-cell:nth-child(7) small") == "7"
        page.wait("return Number(document.querySelector('#past').dataset.points) === 86")
        assert page.run("return document.querySelectorAll('#past .mark.alarm').length") > 0
        inside = (
            "const at = (css, name) => Number(document.querySelector(css).getAttribute(name));"
            "const y = at('#past .limit', 'y1') - at('#past rect', 'y');"
            "return y >= 0 && y <= at('#past rect', 'height')"
        )
        assert page.run(inside)  # the line of the limit, though every core of the log is over it
        listed = page.run("return [...document.querySelectorAll('#past-marks li')].map(li => li.innerText)")
        assert any("Alarm: " in text and "the limit is 24 °C" in text for text in listed)  # what the lines stand for
        # times are those of the frames, with the date where it is not today's; the axis has it once
        day = page.run("return new Date(arguments[0]).toLocaleDateString('sv-SE')", BEGAN_NS // 10**6)
        assert page.text("#at").startswith(day)
        assert page.text("#at").count(day) == 1
        first, *rest = page.run("return [...document.querySelectorAll('#past .time')].map(t => t.textContent)")
        assert first.startswith(day)
        assert [bool(re.match(r"\d+:\d\d:\d\d", t)) for t in rest] == [True, True]
        when = "return [...document.querySelectorAll(arguments[0])].map(b => b.innerText)"
        for told in ("#past-marks button", "#events tbody td:first-child"):
            assert all(t.startswith(day) for t in page.run(when, told)), told

        # the current is held from tick to tick: each piece of its line is level or upright
        points = page.run("return document.querySelector('#past .line-current').getAttribute('points')").split()
        at = np.array([[float(v) for v in p.split(",")] for p in points])
        assert np.all((np.diff(at, axis=0) == 0.0).any(axis=1))
        slow = page.run("return document.querySelector('#past .line-inlet').getAttribute('points')").split()
        assert len(points) > 1.5 * len(slow)

        # where nothing is known the band is open, as its line is
        page.run(GAP)
        page.run(seek, "84")
        page.wait("return document.querySelectorAll('#past polygon').length === 2")
        assert page.run("return document.querySelectorAll('#past polyline[stroke-width=\"2\"]').length") == 2
        page.run("window.fetch = window.ownFetch")
        # bug: a band of ± 40 K was drawn like one of ± 1 K, with its line, and set the scale of the picture
        page.run(GAP.replace("found.hottest[k] = found.half[k] = null", "found.half[k] = 40"))
        page.run(seek, "83")
        page.wait("return document.querySelectorAll('#past polygon.vague').length === 1")
        assert page.run("return document.querySelectorAll('#past polyline[stroke-width=\"2\"]').length") == 2
        scale = (
            "return [...document.querySelectorAll('#past text[text-anchor=end]')].slice(0, 2).map(t => t.textContent)"
        )
        high, low = (float(x.replace("−", "-")) for x in page.run(scale))
        assert high - low < 80.0  # the width of that band
        assert "not known" in page.run("return document.querySelector('#past .title').textContent")
        page.run("window.fetch = window.ownFetch")
        rows = "return document.querySelectorAll('#events tbody tr').length"
        page.click("#past-marks li:last-of-type button" if len(listed) < 9 else "#past-marks li:nth-child(8) button")
        page.wait("return Number(document.querySelector('#time').value) < 80")
        # so does a click anywhere on a row of the table of what happened, and its button by keyboard
        last = "return [...document.querySelectorAll('#events tbody tr')].at(-1)"
        for where in ("td:nth-child(6)", ".go"):
            page.run(seek, "85")
            page.wait(shown_at)
            row = page.run(f"{last}.innerText.split('\\t')[0]")
            page.run(f"{last}.querySelector(arguments[0]).click()", where)
            page.wait("return document.querySelector('#at').innerText.startsWith(arguments[0])", row.strip())
            page.wait("return Number(document.querySelector('#time').value) < 80")
            assert page.run(rows) >= 1  # of the events that had happened by then, this one is the newest
        page.run(seek, "85")
        page.wait(shown_at)
        until = "new URL(document.querySelector('#grafana').href).searchParams.get('to')"
        end_ms = BEGAN_NS // 1_000_000 + 85_000
        page.wait(f"return Math.abs(Number({until}) - arguments[0]) < 3000", end_ms)  # the past follows a moment later
        for panel in ("hottest point, °C", "current, A", "inlet, °C", "flow, l/min", "SOC, %", "voltage, V"):
            assert panel in page.run("return document.querySelector('#past').textContent"), panel
        texts = page.run("return [...document.querySelectorAll('#past text')].map(t => t.textContent)")
        at = texts.index("flow, l/min")
        sent_l_min = [6e4 * x for t, x in sent_of(log, "string_1", "coolant_flow") if t < 85]
        assert float(texts[at - 1]) - 1 <= min(sent_l_min) <= max(sent_l_min) <= float(texts[at - 2]) + 1

        # the same window and string of the fleet's dashboard; nothing is asked of it
        link = urlsplit(page.run("return document.querySelector('#grafana').href"))
        asked = {k: v[0] for k, v in parse_qs(link.query).items()}
        assert link._replace(query="").geturl() == "https://grafana.example/fleet/d/bms-gateway"
        assert (asked["var-instance"], asked["var-string"]) == ("truck_7:9105", "string_1")
        assert int(asked["from"]) * 1_000_000 == pytest.approx(BEGAN_NS, abs=2 * SECOND)
        elsewhere = "performance.getEntriesByType('resource').filter(r => !r.name.startsWith(location.origin)).length"
        assert page.run(f"return {elsewhere}") == 0
        every = page.run(rows)
        choose = (
            "const s = document.querySelector(arguments[0]);"
            "s.value = arguments[1]; s.dispatchEvent(new Event('change'));"
        )
        page.run(choose, "#event-level", "alarm")
        page.run(choose, "#event-string", "string_2")
        assert 0 < page.run(rows) < every
        got = page.run("return fetch(document.querySelector('#export').href).then(r => r.text())")
        assert got.count("\n") == 1 + 60 * 86
        page.run("window.prompt = () => 'looked at it'")
        new = page.run(rows)
        page.click("#events .acknowledge")
        page.wait("return document.querySelector('#events').innerText.includes('looked at it')")
        page.run(choose, "#event-seen", "new")
        page.wait("return document.querySelectorAll('#events .acknowledge').length === arguments[0]", new - 1)
        assert "looked at it" in page.run("return fetch('/api/happened').then(r => r.text())")
        signals = page.run("return fetch(document.querySelector('#export-signals').href).then(r => r.text())")
        assert signals.startswith("time_s,current_A,coolant_inlet_C,")
        page.run(LONG_EVENT)
        for dark in (False, True):
            for width in (390, 1024, 1280, 1920):
                page.cdp(
                    "Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False
                )
                page.wait("return document.documentElement.scrollWidth <= innerWidth")
                inside = "e => e.getBoundingClientRect().right <= innerWidth && e.getBoundingClientRect().left >= 0"
                assert page.run(f"return [...document.querySelectorAll('#events td')].every({inside})"), width
                page.wait(  # the past is drawn anew, as wide as it now is
                    "const s = document.querySelector('#past'), r = s.querySelector('rect');"
                    "return Math.abs(Number(r.getAttribute('width')) - s.clientWidth) < 80"
                )
                ends = page.run(
                    "return [...document.querySelectorAll('#past .time')].map(t => t.getBoundingClientRect())"
                    ".map(r => [r.left, r.right])"
                )
                assert all(one[1] < other[0] for one, other in pairwise(ends)), width
                assert faults(page, axe) == [], (dark, width)
            page.click("#theme")

        # the window goes on the road of this tab
        page.run(choose, "#past-string", "1")
        page.click("#diagnose-window")
        page.wait("return document.querySelector('#what').innerText.includes('window_of_string_2.csv')", patience_s=300)
        page.idle(300)
        assert page.there("#panel-compare")
        assert page.complaints() == []
