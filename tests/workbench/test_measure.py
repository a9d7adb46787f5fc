"""Measuring in a picture: cursors, statistics of every sample, records laid over each other, further columns."""

import csv
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.errors import UsageError
from bms_gateway.workbench.beside import Beside
from bms_gateway.workbench.desk import Desk
from tests.support.desk_steps import done, files
from tests.support.page_steps import FIT_S
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import come, faults
from tests.workbench.conftest import served

BEGAN = datetime(2026, 3, 7, 9, 30)
LATER = timedelta(minutes=10)
AXES = (
    "const a = [...document.querySelectorAll('#stage .plot')].filter(p => p.dataset.linked && !p.parentElement.hidden)"
    ".map(p => p._fullLayout.xaxis.range)"
)


def written(source: Path, to: Path, began: datetime, pressure: bool) -> Path:
    """A table with dates for its time and, where wanted, the pressure of the coolant, which no model takes."""
    with source.open(newline="") as file:
        head, *rows = list(csv.reader(file))
    with to.open("w", newline="") as file:
        write = csv.writer(file)
        write.writerow([*head, *(["Druck am Einlass [bar]", "Luefter"] if pressure else [])])
        for k, row in enumerate(rows):
            at = (began + timedelta(seconds=float(row[0]))).isoformat(sep=" ", timespec="milliseconds")
            write.writerow([at, *row[1:], *([f"{pressure_at(k):.4f}", k // 50 % 2] if pressure else [])])
    return to


def pressure_at(row):
    return 1.5 + 0.2 * np.sin(row / 40.0)


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"))


@pytest.fixture(scope="module")
def tables(pack):
    first = written(pack.hidden, pack.folder / "first.csv", BEGAN, pressure=True)
    return first, written(pack.clean, pack.folder / "second.csv", BEGAN + LATER, pressure=False)


@pytest.fixture(scope="module")
def desk(pack, tables):
    desk = Desk("test")
    desk.open({"tables": [*map(str, tables)], "model": str(pack.model), "config": "", "string": "", "columns": []})
    state = done(desk)
    assert state["error"] == ""
    yield desk
    desk.close()


def column(path, name):
    with path.open(newline="") as file:
        return np.array([float(row[name] or "nan") for row in csv.DictReader(file)])


def curve(curves, name):
    found = [c for c in curves if c["name"] == name]
    assert len(found) == 1, [c["name"] for c in curves]
    return found[0]


def test_statistics_are_those_of_every_sample_of_the_table(desk, pack, tables):
    t, y = column(pack.hidden, "time_s"), column(tables[0], "surface_3_C")
    inside = y[(t - t[0] >= 300.0) & (t - t[0] <= 540.0) & np.isfinite(y)]
    found = curve(desk.measures(["surface-0-3"], (5.0, 9.0), None), "cell 3: surface, measured")
    assert (found["unit"], found["count"]) == ("°C", len(inside))
    assert found["min"] == pytest.approx(inside.min(), abs=1e-4)
    assert found["max"] == pytest.approx(inside.max(), abs=1e-4)
    assert found["mean"] == pytest.approx(inside.mean(), abs=1e-4)
    assert found["rms"] == pytest.approx(np.sqrt(np.mean(inside**2)), abs=1e-4)
    assert found["a"] is found["b"] is None


def test_a_cursor_reads_a_curve_where_it_stands_and_the_residual_is_reading_minus_model(desk, pack, tables):
    t, y = column(pack.hidden, "time_s"), column(tables[0], "surface_3_C")
    k = int(np.flatnonzero((t - t[0] > 400.0) & np.isfinite(y))[0])
    at = (t[k] - t[0]) / 60.0
    curves = desk.measures(["surface-0-3"], None, (at, at + 2.0))
    read = curve(curves, "cell 3: surface, measured")
    assert read["a"] == pytest.approx(y[k], abs=2e-3)
    model, residual = curve(curves, "cell 3: surface, refitted"), curve(curves, "residual, refitted")
    assert (model["step"], residual["unit"]) == ("refitted", "K")
    assert residual["a"] == pytest.approx(y[k] - model["a"], abs=5e-3)


def test_a_core_has_as_many_samples_as_the_surface_and_lies_on_the_trajectory_of_the_fit(desk):
    # Bug: of 1,500 samples of a surface, its modelled core had every second one, and of ten hours one a minute.
    counted = {}
    for name in ("surface-0-3", "core-0-3"):
        (model,) = [
            c for c in desk.measures([name], None, None) if c["name"].endswith(", refitted") and c["unit"] == "°C"
        ]
        counted[name] = model["count"]
    assert counted["core-0-3"] >= counted["surface-0-3"] > 1200
    drawn = desk.figure("core-0-3", (5.0, 6.0))["steps"][-1]
    inside = [k for k, x in enumerate(drawn["model"]["x"]) if 5.0 <= x <= 6.0]
    assert len(inside) == 61
    for role in ("low", "high"):
        assert drawn[role]["x"] == drawn["model"]["x"]


def test_the_current_is_held_and_an_end_is_no_value(desk, pack):
    t, I = column(pack.hidden, "time_s"), column(pack.hidden, "current_A")  # noqa: E741
    k = int(np.argmax(np.abs(np.diff(I))))  # between two rows of a step it is the one or the other
    at = (t[k] - t[0] + 0.3 * (t[k + 1] - t[k])) / 60.0
    found = curve(desk.measures(["drive-0"], None, (at, 1e6)), "current")
    assert found["unit"] == "A"
    assert min(abs(found["a"] - I[k]), abs(found["a"] - I[k + 1])) < 1e-3
    assert found["b"] is None


def test_what_is_held_is_drawn_in_steps_and_the_inlet_is_not(desk):
    drawn = {d["name"]: d["line"].get("shape") for d in desk.figure("drive-0")["data"]}
    assert drawn.pop("inlet, °C") is None
    assert {"current, A", "SOC, %"} <= drawn.keys()
    assert set(drawn.values()) == {"hvh"}


def test_records_are_laid_over_each_other_by_start_and_by_wall_clock(desk, tables):
    own = desk.figure("surface-1-3")["data"][0]
    for by, shift in (("start", 0.0), ("clock", LATER.total_seconds() / 60.0)):
        laid = desk.figure("surface-0-3", None, Beside((1,), by))
        (other,) = laid["beside"]
        assert (other["source"], other["record"]) == (tables[1].name, 1)
        np.testing.assert_allclose(other["data"][0]["x"], np.array(own["x"]) + shift, atol=1e-3)
        np.testing.assert_allclose(other["data"][0]["y"], own["y"])
        assert laid["layout"]["xaxis"]["range"][1] == pytest.approx(25.0 + shift, abs=0.1)
        assert {s["name"] for s in other["steps"]} == {"from its file", "refitted"}
    # a window of the picture is one of the record that is shown
    part = desk.figure("surface-0-3", (20.0, 21.0), Beside((1,), "clock"))["beside"][0]["data"][0]
    assert 19.9 < part["x"][0] <= 20.0
    assert 21.0 <= part["x"][-1] < 21.1
    found = curve(
        desk.measures(["surface-0-3"], (20.0, 21.0), None, Beside((1,), "clock")),
        "second.csv: cell 3: surface, measured",
    )
    assert found["count"] == pytest.approx(len(part["x"]) - 2, abs=2)
    assert "beside" not in desk.figure("surface-0-3", None, None)


def test_what_does_not_go_together_is_refused_or_left_out(desk):
    for records, by in (("x", "start"), ("1", "moon"), ("-1", "start")):
        with pytest.raises(UsageError, match="figure: "):
            Beside.of(records, by)
    assert Beside.of("", "start") is None
    told = [(None, ""), (40.0, "day"), (1.8e9, "utc"), (1.8e9, "local"), (1.8e9 + 60.0, "local")]
    records = [{"began": began, "clock": clock} for began, clock in told]
    assert Beside((1,), "clock").shift_s(records, 0, 1) is None
    assert Beside((1,), "clock").shift_s(records, 1, 2) is None  # a time of the day and a date
    assert Beside((1,), "clock").shift_s(records, 2, 3) is None  # of a time zone that nobody knows
    assert Beside((1,), "clock").shift_s(records, 3, 4) == 60.0
    assert "beside" not in desk.figure("surface-0-3", None, Beside((7,)))


def test_any_column_of_a_table_is_a_track_of_its_own_with_its_unit(desk):
    others = desk.state()["opened"]["records"][0]["others"]
    assert {"name": "Druck am Einlass [bar]", "unit": "bar"} in others
    assert {"name": "surface_3_C", "unit": "°C"} in others
    assert "time_s" not in [c["name"] for c in others]
    desk.track(0, "Druck am Einlass [bar]")
    state = done(desk)
    assert state["error"] == ""
    (name,) = state["tracks"]
    shown = desk.figure(name, (5.0, 6.0))
    assert shown["layout"]["title"]["text"] == "Druck am Einlass, bar"
    wanted = [pressure_at(k) for k in range(1500)]
    found = curve(desk.measures([name], None, (5.0, 5.5)), "Druck am Einlass")
    assert found["unit"] == "bar"
    assert found["count"] in (1500, 1499)
    assert found["max"] == pytest.approx(max(wanted), abs=1e-3)
    desk.track(0, "Luefter")
    _, switch = done(desk)["tracks"]
    shapes = {n: desk.figure(n)["data"][0]["line"].get("shape") for n in (name, switch)}
    assert shapes == {name: None, switch: "hvh"}  # a fan is on or off, and never on its way
    found = curve(desk.measures([switch], None, (49.4 / 60.0, 49.6 / 60.0)), "Luefter")
    assert (found["a"], found["b"]) == (0.0, 1.0)
    with pytest.raises(UsageError, match="did you mean 'surface_3_C'"):
        desk.track(0, "surface_3")
    with pytest.raises(UsageError, match="no record 3"):
        desk.track(2, "soc")


@pytest.mark.slow
def test_where_readings_are_missing_for_long_lines_are_open(pack, tmp_path):
    """Of one surface nothing was recorded from 400 to 700 s: neither a reading nor a residual is drawn there."""
    head, *rows = pack.hidden.read_text().splitlines()
    at = head.split(",").index("surface_1_C")
    cells = [r.split(",") for r in rows]
    for c in cells[400:700]:
        c[at] = ""
    table = tmp_path / "gap.csv"
    table.write_text("\n".join([head, *(",".join(c) for c in cells)]) + "\n")
    desk = Desk("gap")
    try:
        desk.open({**files(pack), "tables": [str(table)]})
        assert done(desk)["error"] == ""
        names = ["surface-0-1", "surface-0-3"]
        found = desk.measures(names, None, (300.0 / 60.0, 550.0 / 60.0))
        there, missing = ({(f["name"], f["step"]) for f in found if f[k] is not None} for k in "ab")
        mine = {x for x in there if x[0].startswith("cell 1: ")}
        assert {step for _, step in mine} == {"", "from its file", "refitted"}
        assert not any(x[0].startswith("cell 1: ") for x in missing)
        assert {x for x in there if x[0].startswith("cell 3: ")} <= missing
        line = desk.figure("surface-0-1")["data"][0]
        inside = [y for x, y in zip(line["x"], line["y"], strict=True) if 400 / 60 < x < 700 / 60]
        assert inside == [None]
    finally:
        desk.close()


@pytest.mark.slow
def test_measuring_in_the_page_by_mouse_and_by_keyboard(window, pack, tables, axe):
    with served(pack.folder, *tables, "--model", pack.model) as url:
        page = window(url)
        page.wait(
            "return document.querySelector('#step-1') && document.querySelector('#plot-surface').dataset.traces",
            patience_s=FIT_S,
        )
        page.idle(FIT_S)
        page.click("#tab-compare")
        page.press("c")
        page.wait("return document.querySelectorAll('#measures tbody tr').length > 5")
        assert page.run("return document.activeElement.id") == "cursor-a"
        place = "return Number(document.querySelector('#cursor-a').value)"
        before = page.run(place)
        page.press("Right")
        after = page.run(place)
        assert after > before
        theme = "return document.documentElement.dataset.theme"
        was = page.run(theme)
        for shown in ({"light": "dark", "dark": "light"}[was], was):  # the other keys of the page work there too
            page.press("t")
            assert page.run(theme) == shown
        where = "return document.querySelector('#plot-core').layout.shapes.find(s => s.name === 'cursor a').x0"
        page.wait(f"{where} === arguments[0]", after)  # the line stands there in every figure
        page.wait("return document.querySelector('#measures').dataset.cursors.startsWith(arguments[0])", f"{after}")

        # typed, with a decimal comma; the difference is that of the table's own values
        for k, at in (("a", "5"), ("b", "7,5")):
            page.type(f"#cursor-{k}-at", at)
            page.press("Enter")
        page.wait("return document.querySelector('#measures').dataset.cursors === '5,7.5'")
        assert page.text("#cursor-apart") == "B − A: 2.5 min = 150 s"
        cell = page.run("return JSON.parse(sessionStorage.workbench).cell")
        rows = "return [...document.querySelectorAll('#measures tbody tr')].map(r => r.innerText.split('\\t'))"
        shown = next(r for r in page.run(rows) if r[0] == f"cell {cell}: surface, measured, °C")
        a, b, apart = (float(x.replace("−", "-")) for x in shown[1:4])
        t, y = column(pack.hidden, "time_s"), column(tables[0], f"surface_{cell}_C")
        kept = np.isfinite(y)
        wanted = np.interp([300.0, 450.0], t[kept] - t[0], y[kept])
        assert (a, b) == pytest.approx(wanted, abs=0.02)
        assert apart == pytest.approx(b - a, abs=2e-3)
        assert float(shown[4].replace("−", "-")) == pytest.approx(apart / 2.5, rel=2e-3, abs=1e-3)
        assert "slope per min" in page.text("#measures thead")

        # a line is dragged
        grab = (
            "const p = document.querySelector('#plot-drive'); p.scrollIntoView({block: 'center'});"
            "const b = p.getBoundingClientRect(), l = p._fullLayout, x = l.xaxis;"
            "return [b.left + l._size.l + x.d2p(arguments[0]), b.top + l._size.t + 40]"
        )
        x, y0 = page.run(grab, 5.0)
        to, _ = page.run(grab, 10.0)
        for kind, at, down in (
            ("mouseMoved", x, 0),
            ("mousePressed", x, 1),
            ("mouseMoved", to, 1),
            ("mouseReleased", to, 0),
        ):
            page.cdp(
                "Input.dispatchMouseEvent",
                type=kind,
                x=at,
                y=y0,
                button="left" if kind != "mouseMoved" or down else "none",
                buttons=down,
                clickCount=1,
            )
        page.wait("return Math.abs(Number(document.querySelector('#cursor-a-at').value) - 10) < 0.1")
        page.wait(f"{where.replace('return ', 'return Math.abs(-10 + ')}) < 0.1")

        # a zoom: the statistics are those of its window
        page.run("Plotly.relayout(document.querySelector('#plot-surface'), {'xaxis.range': [8, 9]})")
        page.wait("return document.querySelector('#measures').dataset.window === '8,9'")
        shown = next(r for r in page.run(rows) if r[0] == f"cell {cell}: surface, measured, °C")
        inside = y[kept & (t - t[0] >= 480.0) & (t - t[0] <= 540.0)]
        assert int(shown[9]) == len(inside)
        assert float(shown[7]) == pytest.approx(inside.mean(), rel=1e-4)
        page.click("#cursors-here")
        page.wait("return Math.abs(Number(document.querySelector('#cursor-a-at').value) - 8.333) < 0.01")

        # by keyboard: the arrows go through the columns, Enter takes one
        page.run("document.querySelector('#track-choice').focus()")
        page.press("Down")
        page.press("Down")
        assert not page.there("#tracks .plot")
        wanted = page.run("return document.querySelector('#track-choice').value")
        page.press("Enter")
        page.wait("return document.querySelector('#tracks .plot .main-svg')")
        assert wanted in page.run("return document.querySelector('#tracks .plot').dataset.column")
        page.idle()
        page.click("#tracks .away")
        come(lambda: not page.there("#tracks .plot"), "the track to go")

        # a further track, and the other record over it
        page.run(
            "const s = document.querySelector('#track-choice'); s.value = 'Druck am Einlass [bar]';"
            "s.dispatchEvent(new Event('change'))"
        )
        page.wait("return document.querySelector('#tracks .plot .main-svg')")
        page.wait("return document.querySelector('#measures').innerText.includes('Druck am Einlass, bar')")
        page.click("#beside-1")
        page.wait("return document.querySelector('#plot-surface').data.some(d => d.name === 'second.csv')")
        page.run(
            "const s = document.querySelector('#beside-by'); s.value = 'clock'; s.dispatchEvent(new Event('change'))"
        )
        page.run("Plotly.relayout(document.querySelector('#plot-surface'), {'xaxis.autorange': true})")
        first = "return document.querySelector('#plot-surface').data.find(d => d.name === 'second.csv').x[0]"
        page.wait(f"{first} >= 9.9 && document.querySelector('#measures').dataset.window.startsWith('0,')")
        page.idle()
        for by in ("start", "clock"):  # every plot has the time of all that is drawn, at once
            page.run(
                "const s = document.querySelector('#beside-by'); s.value = arguments[0];"
                "s.dispatchEvent(new Event('change'))",
                by,
            )
            longer = "Math.abs(a[0][1] - 35) < 1" if by == "clock" else "Math.abs(a[0][1] - 25) < 1"
            page.wait(f"{AXES}; return a.length > 2 && a.every(x => x.join() === a[0].join()) && {longer}")
        for width in (390, 1024, 1280, 1920):
            page.cdp("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
            page.wait("return document.documentElement.scrollWidth <= innerWidth", patience_s=10)
            # at 390 px the fields of the cursors stood out of their place
            assert page.run(
                "const box = document.querySelector('#measure').getBoundingClientRect();"
                "return [...document.querySelectorAll('#cursors input')].every(e => e.getBoundingClientRect().right"
                " <= box.right + 1)"
            ), width
            assert faults(page, axe) == [], width

        # it is all there again after a reload
        page.reload()
        page.wait("return document.querySelector('#tracks .plot .main-svg')", patience_s=FIT_S)
        page.wait("return document.querySelectorAll('#measures tbody tr').length > 5")
        page.click("#tracks .away")
        come(lambda: not page.there("#tracks .plot"), "the track to go")
        assert page.complaints() == []


@pytest.mark.slow
def test_that_a_column_waits_is_told_only_while_it_waits(window, pack, tables):
    with served(pack.folder, *tables, "--model", pack.model) as url:
        page = window(url)
        page.wait("return document.querySelector('#step-1')", patience_s=FIT_S)
        page.idle(FIT_S)
        page.click("#tab-diagnose")
        page.click("#diagnose")
        page.wait("return document.body.dataset.busy === 'diagnose'")
        page.run(
            "const s = document.querySelector('#track-choice'); s.value = [...s.options].find(o => o.value).value;"
            "s.dispatchEvent(new PointerEvent('pointerdown')); s.dispatchEvent(new Event('change'));"
        )
        page.wait("return document.querySelector('#error-text').textContent.includes('nothing else to do')")
        page.idle(FIT_S)
        page.wait("return document.querySelector('#tracks .plot .main-svg')", patience_s=FIT_S)
        page.idle(FIT_S)
        assert page.run("return document.querySelector('#error').hidden")
