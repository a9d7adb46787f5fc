"""The page of a report: self-contained, well formed, with the numbers of its objects, and seen by a browser."""

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.config.model_file import parse_model
from bms_gateway.diagnosis.adding import Addition
from bms_gateway.diagnosis.adding_bench import all_used
from bms_gateway.diagnosis.checks import check_record
from bms_gateway.diagnosis.compare import compare
from bms_gateway.diagnosis.diagnosis import diagnose
from bms_gateway.diagnosis.filed import seen_on
from bms_gateway.diagnosis.latent import latent
from bms_gateway.diagnosis.ranking import ranking
from bms_gateway.diagnosis.record import HELD_OUT, make_record
from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.diagnosis.residuals import rmse
from bms_gateway.diagnosis.weighing import Settings
from bms_gateway.errors import MissingExtraError, UsageError
from bms_gateway.identify.map_fit import stacked
from bms_gateway.report.add_text import headline
from bms_gateway.report.diagnosis_text import Told
from bms_gateway.report.html import Aside, Details, write_addition, write_comparison, write_diagnosis
from bms_gateway.report.html_series import ALL_POINTS, points_each
from bms_gateway.report.page import amount, plotly_source
from tests.diagnosis.decided import by_second
from tests.report.additions import cores_of, replace_records, report_of
from tests.report.html_page import Page, unpacked
from tests.report.labels import bare
from tests.truth.hidden import Scenario, make_log

plotly = pytest.importorskip("plotly")
CHROMIUM = next((p for p in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if p), None)
COMMAND = "bms-gateway diagnose bench.csv --model string_1.toml --html report.html"
ZOOM = """
const all = [...document.querySelectorAll(".plot")];
const drawn = () => document.documentElement.dataset.drawn ? zoom() : setTimeout(drawn, 50);
const zoom = () => Plotly.relayout(all[0], {"xaxis.range": [5, 10]}).then(() => setTimeout(() => {
  document.body.insertAdjacentHTML("beforeend", all.map((p) => `<i>${p.layout.xaxis.range}</i>`).join(""));
}, 1000));
drawn();
"""


LIMIT = Finding("soc_span", "note", "The SOC moves by 7 % only: what depends on it looks constant.")


def measured_log():
    log = make_log(
        Scenario({"resistance_temperature": ("strong", None)}, cells=3, sensors=(1, 3), seconds=1500, seed=2)
    )
    model, t = parse_model(log.model), log.table
    record = make_record(
        Columns(
            time_s=t["time_s"],
            current_A=t["current_A"],
            coolant_inlet_C=t["coolant_inlet_C"],
            soc=t["soc"],
            surface_C={k: t[f"surface_{k}_C"] for k in model.sensors},
            core_C={3: log.core[: len(t["time_s"]), 2]},
            source="bench <1>.csv",
        ),
        model,
    )
    return model, record


@pytest.fixture(scope="module")
def road(tmp_path_factory):
    """One record on the whole road: model, record, comparison, diagnosis, and their pages."""
    folder = tmp_path_factory.mktemp("html")
    model, record = measured_log()
    found = diagnose(model, [record], Settings(refits=3, effects=1))
    comparison = compare(model, [record])
    told = Told(
        found,
        found.sentence,
        (record.source,),
        (*((record.source, f) for f in check_record(record, model)), (record.source, LIMIT)),
        (("bench <1>.csv", "a gap of 3 s was bridged"),),
        absorbed=("A gain of the current sensor goes into R_e.",),
        next_experiment="To tell it from a drift: drive the same cycle twice (60 min).",
        card=("These records could not show hysteresis at a usual size.",),
        ranking=ranking(found),
    )
    heat = latent(found.search.baseline)
    write_diagnosis(folder / "d.html", told, Details(comparison, heat), command=COMMAND)
    write_comparison(folder / "c.html", comparison, Aside(told.sources, told.findings, told.notes, COMMAND))
    cores = cores_of(comparison, 2.5, 0.5, fits=found.fits)
    addition = Addition(
        tuple(s.candidate for s in found.selected), found.search.final, 9.0, "", "", model=model, core=cores
    )
    write_addition(folder / "a.html", report_of(addition, told), addition)
    texts = {p.stem: p.read_text(encoding="utf-8") for p in folder.iterdir()}
    return folder, record, comparison, told, model, {k: (t, Page(t)) for k, t in texts.items()}


def test_pages_are_well_formed_and_what_they_point_at_is_there(road):
    for text, page in road[-1].values():
        assert text.startswith("<!DOCTYPE html>")
        assert len(page.ids) == len(set(page.ids))
        for _, attrs in page.tags:
            assert attrs.get("aria-labelledby", page.ids[0]) in page.ids
        for tag, attrs in page.tags:
            if tag == "div" and attrs.get("class") == "plot":
                assert attrs["role"] == "group"  # it holds buttons
                assert len(attrs["aria-label"]) > 20


def test_pages_ask_for_nothing_from_anywhere(road):
    for text, page in road[-1].values():
        assert not [t for t, a in page.tags if t in ("link", "iframe", "img", "object") or "src" in a or "href" in a]
        policy = next(a["content"] for t, a in page.tags if a.get("http-equiv") == "Content-Security-Policy")
        assert "default-src 'none'" in policy
        assert "http" not in policy
        css = re.search("<style>(.*?)</style>", text, re.DOTALL)[1]
        assert "url(" not in css
        assert "@import" not in css
        own = text[text.rindex("<script>") :]
        assert not re.search(r"https?:|fetch|XMLHttp|import\(", own)


def test_every_section_is_there_and_none_is_empty(road):
    wanted = {
        "d": "missing where overlay regimes core latent ranking errors parameters correlations absorbed next card "
        "checks notes again",
        "c": "where overlay regimes core errors parameters correlations checks notes again",
        "a": "missing overlay regimes core errors parameters correlations checks notes again",
    }
    for name, (text, page) in road[-1].items():
        assert [a["id"] for t, a in page.tags if t == "section"] == wanted[name].split()
        assert all(len(s) > 100 for s in re.findall("<section.*?</section>", text, re.DOTALL))


def test_the_page_says_what_the_terminal_says(road):
    _, _, comparison, told, _, pages = road
    page = pages["d"][1]
    for sentence in (
        told.sentence,
        *told.absorbed,
        told.next_experiment,
        *told.card,
        COMMAND,
        *(f.sentence for _, f in told.findings),
        *(text for _, text in told.notes),
        *comparison.refitted.findings,
    ):
        assert bare(sentence) in bare(page.text)
    for sentence in (*comparison.filed.findings, *comparison.refitted.findings):
        assert bare(sentence) in bare(pages["c"][1].text)


def test_errors_are_those_of_the_readings(road):
    """Against root mean squares taken here from readings and model, not by the report."""
    rows = road[-1]["d"][1].tables["errors"][0]
    for column, fit in zip((2, 6), road[3].diagnosis.fits, strict=True):
        m = fit.problem.records[0]
        for j, (_, cell) in enumerate(m.channels):
            row = next(r for r in rows if r[0] == f"cell {cell}")
            for at, used in ((column, True), (column + 1, False)):
                mine = (m.channel == j) & (m.used == used)
                assert row[at] == amount(float(np.sqrt(np.mean((m.y - fit.y)[mine] ** 2))))
        total = next(r for r in rows if r[0] == "all")
        assert total[column] == amount(float(np.sqrt(np.mean((m.y - fit.y)[m.used] ** 2))))


def test_ranking_and_parameters_are_those_of_the_diagnosis(road):
    d = road[3].diagnosis
    page = road[-1]["d"][1]
    rows = [r for r in page.tables["ranking"][0][1:] if len(r) > 3]
    for row, r in zip(rows, road[3].ranking, strict=True):
        assert row[0].endswith(f"({r.name})")
        assert float(row[2].replace("−", "-")) == round(r.evidence, 1 if abs(r.evidence) < 1000 else 0)
        assert row[4] == amount(r.heldout_rmse_K)
        assert bare(row[7]) == r.refused
    groups = [r[0] for r in page.tables["ranking"][0][1:] if len(r) == 3]
    assert groups == ["Named", "In place of what is named"]
    against = [r[2] for r in page.tables["ranking"][0][1:] if len(r) == 3]
    assert against == ["Bars: log-odds against leaving it out.", "Bars: log-odds against the model as it is."]
    base = d.search.baseline
    assert rows[0][5] == amount(rmse(base, ~stacked(base.problem)[4]))
    B = next(r for r in page.tables["parameters"][0] if r[0].endswith(" (resistance_temperature.B)"))
    number = d.selected[0].parameters["B"]
    value, sd = (float(x) for x in B[1].split(" ± "))
    assert abs(value - number.value) < 0.1 * number.sd
    assert abs(sd / number.sd - 1.0) < 0.1


def test_overlays_hold_the_readings_and_shade_what_was_held_out(road):
    _, record, _, _, _, pages = road
    figures = pages["d"][1].figures(pages["d"][0])
    end = record.instants[-1] - record.instants[0]
    for j, cell in enumerate(record.cells):
        spec = figures[f"overlay-1-{cell}"]
        trace = spec["data"][0]
        mine = record.sensor == j
        assert np.allclose(trace["y"], record.y[mine], atol=5.1e-3)  # hundredths of a kelvin, beside a noise of 0.05 K
        assert np.allclose(np.array(trace["x"]) * 60, record.surface.at(record.instants)[mine], atol=0.01)
        shaded = [(s["x0"] * 60 / end, s["x1"] * 60 / end) for s in spec["layout"]["shapes"] if s["type"] == "rect"]
        assert np.allclose(shaded, HELD_OUT, atol=0.005)
        for title in ("yaxis", "yaxis2", "xaxis"):
            assert re.search("°C|K|min", spec["layout"][title]["title"]["text"])
        # of the 290 px of a report of many cells a telephone leaves 155 to both panels, and a letter takes 7
        for axis in (spec["layout"]["yaxis"], spec["layout"]["yaxis2"]):
            low, high = axis["domain"]
            assert 7.0 * len(axis["title"]["text"]) <= 155.0 * (high - low + 0.1)


def test_plotly_knows_every_figure(road):
    from plotly.graph_objects import Figure

    for text, page in road[-1].values():
        for spec in page.figures(text).values():
            Figure(spec)  # refuses what it does not know
            for t in spec["data"]:
                if t["type"] == "heatmap":  # a row for each cell, and in it a value for each time
                    assert [len(row) for row in t["z"]] == [len(t["x"])] * len(t["y"])
                else:
                    assert len(t["x"]) == len(t["y"])


def test_a_core_thermocouple_is_shown_beside_the_models(road):
    _, _, comparison, _, _, pages = road
    check = comparison.refitted.core_checks[0]
    row = next(r for r in pages["c"][1].tables["core"][1] if r[0] == "cell 3")
    assert row[4:] == [amount(check.rmse_K), amount(check.bias_K), f"{100 * check.covered:.0f} %"]
    names = [t.get("name") for t in pages["c"][1].figures(pages["c"][0])["core-1"]["data"]]
    assert "thermocouple in the core" in names


@pytest.mark.parametrize("core", [True, False])
def test_a_core_thermocouple_outside_the_band_is_said_in_red_on_every_page(road, tmp_path, core):
    """Whichever command wrote it, and in a diagnosis also where nothing is known of the core."""
    _, _, comparison, told, _, _ = road
    check = comparison.refitted.core_checks[0]
    known = comparison.core if core else None
    for covered, outside in ((0.4, True), (0.93, False)):
        now = replace(comparison.refitted, core_checks=(replace(check, covered=covered),))
        seen = replace(comparison, refitted=now)
        write_diagnosis(tmp_path / "d.html", replace(told, core=known), Details(seen))
        write_comparison(tmp_path / "c.html", seen, Aside(told.sources))
        for name in "dc":
            text = (tmp_path / f"{name}.html").read_text(encoding="utf-8")
            head = text[text.index("<h1") : text.index("<section")]
            said = re.findall('<p class="danger">(.*?)</p>', head)
            assert [s.partition(",")[0] for s in said] == (["Thermocouple in the core of cell 3"] if outside else [])
            assert [s.rpartition("; ")[2] for s in said] == (
                ["60 % of its readings lie outside the 95 % band."] if outside else []
            )


def test_models_are_called_as_on_the_page_of_the_workbench(road):
    """By what was done to them, labels before identifiers."""
    figures = [page.figures(text) for name in "da" for text, page in [road[-1][name]]]
    for found in figures:
        names = {t["name"] for t in found["overlay-1-1"]["data"] if t.get("showlegend", True)}
        assert {"refitted", "+ resistance falls as the cell warms (resistance_temperature)"} <= names
    text, page = road[-1]["a"]
    assert "model as it is" not in text
    assert not [r[0] for r in page.tables["parameters"][0][1:] if not r[0].endswith(")")]


def test_half_widths_of_cores_that_are_given_are_those_shown(road):
    text, page = road[-1]["a"]
    spec = page.figures(text)["core-1"]["data"]
    for low, high, half in ((0, 1, 2.5), (2, 3, 0.5)):
        own = (np.array(spec[high]["y"]) - np.array(spec[low]["y"])) / 2
        assert np.sqrt(np.mean(own**2)) == pytest.approx(half, rel=0.01)


def test_a_core_that_is_not_known_has_no_number_and_no_curve_and_an_unproven_one_is_hatched(road, tmp_path):
    """The page of the workbench and the gateway give no such core; a report gave 53.55 °C for one known to ± 34 K."""
    d = road[3].diagnosis
    wide, narrow = cores_of(road[2], 34.4, 0.5, fits=d.fits)
    cores = (replace(wide, why=("No.",)), replace(narrow, why=()))
    assert [c.proven for c in cores] == [False, True]
    addition = Addition((d.selected[0].candidate,), d.search.final, 9.0, "", "", model=road[-2], core=cores)
    write_addition(tmp_path / "x.html", report_of(addition), addition)
    text = (tmp_path / "x.html").read_text(encoding="utf-8")
    page = Page(text)
    row = next(r for r in page.tables["core"][0] if r[0] == "cell 1")
    assert bare(row[1]) == "not known"
    assert row[2:4] == ["34", "34"]
    assert float(row[4]) > 0.0
    assert row[5:7] == ["0.50", "0.50"]
    data = page.figures(text)["core-1"]["data"]
    after = data[-1]["name"] if data[-1]["name"] != "thermocouple in the core" else data[-2]["name"]
    assert [t["name"] for t in data if t.get("line", {}).get("width") == 2] == [after]
    assert [(t["name"], "fillpattern" in t) for t in data if "fill" in t] == [("refitted", True), (after, False)]
    assert "Hatched: core not proven. Without a line, because the core is not known: refitted." in page.text


@pytest.mark.parametrize(("force", "tag"), [(False, "Not added"), (True, "Added by force")])
def test_the_page_of_an_addition_says_what_speaks_against_it(road, tmp_path, force, tag):
    d = road[3].diagnosis
    cores = cores_of(road[2], 1.0, 1.0, fits=d.fits)
    why = "worse on the held-out blocks"
    one = (d.selected[0].candidate,)
    addition = Addition(one, d.search.final, 1.0, why, "It is only a try.", model=road[-2], core=cores)
    report = report_of(addition, force=force)
    write_addition(tmp_path / "x.html", report, addition, "bms-gateway add x")
    text = Page((tmp_path / "x.html").read_text(encoding="utf-8")).text
    for words in (tag, why, "It is only a try.", "bms-gateway add x"):
        assert words in text
    assert f" ({one[0].key}) the held-out error" in text
    text = bare(text)
    assert text.index(bare(headline(report))) < text.index(why) < text.index("Error where fitted")


def test_where_nothing_was_held_out_the_page_claims_no_held_out_error(road, tmp_path):
    d = road[3].diagnosis
    fits = tuple(
        replace(f, problem=replace_records(f, [replace(m, used=np.ones_like(m.used)) for m in f.problem.records]))
        for f in d.fits
    )
    one, cores = (d.selected[0].candidate,), cores_of(road[2], 1.0, 1.0, fits=fits)
    addition = Addition(one, d.search.final, 9.0, "", "", model=road[-2], core=cores)
    write_addition(tmp_path / "x.html", report_of(addition), addition)
    text = (tmp_path / "x.html").read_text(encoding="utf-8")
    page = Page(text)
    assert "Error where fitted" in page.text
    assert "Error on held-out blocks" not in page.text
    shapes = [s for f in page.figures(text).values() for s in f["layout"].get("shapes", ())]
    assert not [s for s in shapes if s["type"] == "rect"]


@pytest.mark.slow
def test_the_page_of_the_second_search_tells_the_numbers_of_both_models_and_ranks_by_the_closest_fits(tmp_path):
    """It weighs effects by fits of every reading; what is stated of a model was fitted without the held-out blocks."""
    d = by_second()
    assert d.decided_by_second
    told = Told(d, d.sentence, ("cell.csv",), ranking=ranking(d))
    write_diagnosis(tmp_path / "x.html", told)
    text = (tmp_path / "x.html").read_text(encoding="utf-8")
    page = Page(text)
    assert "something unknown remains" in page.text
    gap = "\N{NO-BREAK SPACE}"  # a unit stays with its number, an arrow with what it comes from
    assert 1.0 < d.baseline.heldout_rmse_K < 10.0  # three digits have two decimals
    assert f"{d.baseline.heldout_rmse_K:.2f}{gap}→ {d.after.heldout_rmse_K:.3f}{gap}K" in page.text
    shapes = [s for f in page.figures(text).values() for s in f["layout"].get("shapes", ())]
    assert [s for s in shapes if s["type"] == "rect"]
    head, *rows = page.tables["ranking"][0]
    assert head[4:6] == ["error, K", "without it, K"]
    first = next(r for r in rows if len(r) > 3)
    closest = seen_on(d.second.best, all_used(d.search.baseline.problem.records))
    assert first[4] == amount(rmse(closest, np.ones(len(closest.y), np.bool_)))
    assert next(r[0] for r in rows if len(r) == 3) == "Named"


def test_pages_stay_small(road):
    assert all(f.stat().st_size < 1_700_000 for f in road[0].iterdir())
    assert all(points_each(n) * n <= max(ALL_POINTS, 400 * n) for n in range(1, 200))


def test_without_a_diagnosis_the_page_says_what_the_data_lack(tmp_path):
    stop = Finding("too_short", "stop", "The record lasts 20 s; 300 s are the least.")
    told = Told(None, f"Nothing can be said. {stop.sentence}", ("a.csv", "b.csv"), (("a.csv", stop),))
    write_diagnosis(tmp_path / "x.html", told, title="<b>&")
    text = (tmp_path / "x.html").read_text(encoding="utf-8")
    page = Page(text)
    assert [a["id"] for t, a in page.tags if t == "section"] == ["again"]
    assert "Look at the data first" in text
    assert "Insufficient data" in page.text
    assert "a.csv: The record lasts" in page.text
    assert "<b>&" in page.text
    assert "<title>&lt;b&gt;&amp;</title>" in text


def test_what_is_refused_is_hatched_and_what_is_tied_stands_out(road, tmp_path):
    told = road[3]
    d = told.diagnosis
    first, second, *_ = told.ranking
    rank = (
        first,
        replace(second, effects=("charge_transfer",), role="tied", refused=""),
        replace(second, effects=("end_plate", "hysteresis"), refused="bound"),
    )
    selected = (replace(d.selected[0], tied_with=("charge_transfer",)),)
    write_diagnosis(tmp_path / "x.html", replace(told, diagnosis=replace(d, selected=selected), ranking=rank))
    text = (tmp_path / "x.html").read_text(encoding="utf-8")
    rows = re.findall('<tr class="(chosen|tied|)">(.*?)</tr>', text, re.DOTALL)
    assert [kind for kind, _ in rows] == ["chosen", "tied", ""]
    assert ["url(#hatch)" in row for _, row in rows] == [False, False, True]
    assert "cannot tell it from charge-transfer losses (Butler-Volmer) (charge_transfer)" in text
    assert "(end_plate + hysteresis)" in text


def test_what_casts_doubt_on_the_data_comes_before_the_cards(road, tmp_path):
    told = replace(road[3], findings=(("x.csv", Finding("stuck", "warn", "The surface of cell 2 reads 21 °C.")),))
    write_diagnosis(tmp_path / "x.html", told)
    text = bare(Page((tmp_path / "x.html").read_text(encoding="utf-8")).text)
    assert text.count("cell 2 reads 21 °C") == 1
    assert text.index(bare(told.sentence)) < text.index("cell 2 reads 21 °C") < text.index("Error where fitted")


def test_thermocouples_find_their_record_where_others_were_left_out(road, tmp_path):
    _, _, comparison, told, _, pages = road
    check = comparison.refitted.core_checks[0]
    shifted = replace(comparison.refitted, core_checks=(replace(check, record=1), replace(check, record=0)))
    other = replace(comparison, sources=("left out.csv", *comparison.sources), refitted=shifted)
    write_diagnosis(tmp_path / "x.html", told, Details(other))
    page = Page((tmp_path / "x.html").read_text(encoding="utf-8"))
    assert page.tables["core"][1] == pages["d"][1].tables["core"][1]


def test_records_have_figures_of_their_own_that_zoom_apart(road, tmp_path):
    model, record = measured_log()
    both = compare(model, [record, replace(record, source="second.csv")])
    write_comparison(tmp_path / "x.html", both, Aside(both.sources))
    text = (tmp_path / "x.html").read_text(encoding="utf-8")
    page = Page(text)
    figures = {a["id"]: a["data-time"] for t, a in page.tags if a.get("class") == "plot"}
    assert figures["overlay-1-1"] == figures["core-1"] != figures["overlay-2-1"] == figures["core-2"]
    assert "Record 2: second.csv" in page.text
    assert any("R_u (record 2)" in r[0] or "record 2" in r[0] for r in page.tables["parameters"][0])


def test_without_plotly_the_extra_is_named(monkeypatch, tmp_path):
    plotly_source.cache_clear()
    monkeypatch.setattr("bms_gateway.report.page.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"pip install 'bms-gateway\[report\]'"):
        write_diagnosis(tmp_path / "x.html", Told(None, "Nothing.", ()))
    assert not list(tmp_path.iterdir())


def test_a_page_holds_plotly_packed(road):
    plain = (Path(plotly.__file__).parent / "package_data" / "plotly.min.js").read_bytes()
    for text, _ in road[-1].values():
        assert unpacked(text, "plotly") == plain
        assert len(text.encode()) < 0.36 * len(plain)


def test_a_page_that_cannot_be_written_is_the_callers_fault(tmp_path):
    with pytest.raises(UsageError, match="none"):
        write_diagnosis(tmp_path / "none" / "x.html", Told(None, "Nothing.", ()))


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here to look at the page with")
def test_a_browser_draws_every_figure_without_a_complaint(road, tmp_path):
    call = [
        CHROMIUM,
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--enable-logging=stderr",
        "--window-size=1280,900",
    ]
    call += [
        f"--user-data-dir={tmp_path / 'profile'}",
        "--virtual-time-budget=10000",
        "--host-resolver-rules=MAP * ~NOTFOUND",
    ]
    text = road[-1]["d"][0].replace("</body>", f"<script>{ZOOM}</script></body>")
    (tmp_path / "zoomed.html").write_text(text, encoding="utf-8")
    page, picture = f"file://{tmp_path / 'zoomed.html'}", tmp_path / "page.png"
    seen = subprocess.run([*call, "--dump-dom", page], capture_output=True, text=True, timeout=120, check=True)
    assert "CONSOLE" not in seen.stderr  # neither errors nor requests that the page forbids itself
    plots = len(road[-1]["d"][1].figures(road[-1]["d"][0]))
    assert len(re.findall(r'class="plot js-plotly-plot"', seen.stdout)) == plots >= 4
    assert len(re.findall(r'class="[xy]2?title"', seen.stdout)) >= 2 * plots
    assert set(re.findall(r"<i>([\d,.-]*)</i>", seen.stdout)) == {"5,10"}, "figures of one record zoom together"
    subprocess.run([*call, f"--screenshot={picture}", page], capture_output=True, timeout=120, check=True)
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert picture.stat().st_size > 20_000


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here to look at the page with")
@pytest.mark.parametrize("what", ["plotly", "figures"])
@pytest.mark.parametrize("how", ["cut", "flipped", "no digit"])
@pytest.mark.plain_cases(2)
def test_a_damaged_page_says_so_and_keeps_its_tables(road, tmp_path, what, how):
    text = road[-1]["c"][0]
    packed = re.search(f'id="{what}" data-length="[0-9]+">(.*?)</script>', text)[1]
    middle = len(packed) // 10 * 5
    other = "AAAAA" if packed[middle : middle + 5] != "AAAAA" else "BBBBB"
    damaged = {
        "cut": packed[:middle],
        "flipped": packed[:middle] + other + packed[middle + 5 :],
        "no digit": packed[:middle] + "." + packed[middle + 1 :],
    }[how]
    (tmp_path / "x.html").write_text(text.replace(packed, damaged), encoding="utf-8")
    call = [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    call += ["--virtual-time-budget=10000", "--dump-dom", f"file://{tmp_path / 'x.html'}"]
    seen = subprocess.run(call, capture_output=True, text=True, timeout=120, check=True).stdout
    assert '<p id="damaged" class="alarm" role="alert">' in seen
    assert "<table" in seen
