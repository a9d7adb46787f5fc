"""The page in a real browser: the road on a record with a hidden effect, bad files, cancelling, two tabs, habits."""

import json
import subprocess
import sys

import pytest

from bms_gateway.config.model_file import read_model
from tests.store.ring import drove
from tests.support.page_steps import ADDED, FIT_S, seen_compared, seen_diagnosed
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import come, faults
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser, and fits


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"))


@pytest.fixture(scope="module")
def url(pack):
    with served(pack.folder, *pack.words) as url:
        yield url


LEGIBLE = (390, 1280)
"""Widths at which legibility is judged in dark too: a theme changes colours and no sizes, and these widths have all
that is shown anywhere, one column and several."""
WATCH_BARS = """
window.seen = [];
new MutationObserver(() => {
  const bar = document.querySelectorAll('#panel-add .bar.fitting b')[1];
  if (bar && seen.at(-1) !== Number(bar.textContent)) seen.push(Number(bar.textContent));
}).observe(document.querySelector('#panel-add'), {subtree: true, childList: true, characterData: true});
window.left = [];
document.querySelector('#plot-surface').on('plotly_afterplot', () => {
  const curves = document.querySelector('#plot-surface').data.filter(d => d.name.endsWith('being fitted'));
  const curve = curves.find(d => d.yaxis === 'y2');
  if (!curve) return;
  const rms = Math.sqrt(curve.y.reduce((a, y) => a + y * y, 0) / curve.y.length);
  if (left.at(-1) !== rms) left.push(rms);
});
"""


def test_the_road_from_a_table_to_a_better_model(window, url, axe, pack, tmp_path):
    page = window(url)
    page.wait("return document.documentElement.dataset.firstPlot")
    first, plot = (int(page.run(f"return document.documentElement.dataset.{x}")) for x in ("firstPicture", "firstPlot"))
    assert first <= plot  # what was measured is seen before the plots' script has been run
    assert "Records" in page.text("#panel-open")
    seen_compared(page)

    page.click("#tab-compare")
    assert "held-out" in page.text("#panel-compare")
    assert page.there("#regimes table.heat td")
    assert "no sensor" in page.text("#cell-2")
    page.click("#cell-3")
    page.wait("return document.querySelector('#plot-surface').dataset.name === 'surface-0-3'")
    assert faults(page, axe) == []

    # zooming one figure zooms the others of the record
    page.run("Plotly.relayout(document.querySelector('#plot-surface'), {'xaxis.range': [5, 10]})")
    page.wait(
        "return ['drive', 'core'].every(p => {"
        "const r = document.querySelector('#plot-' + p).layout.xaxis.range; return r[0] === 5 && r[1] === 10; })"
    )

    seen_diagnosed(page)
    assert page.text("#panel-diagnose .verdict").startswith("Missing: reversible (entropic) heat (entropic_heat)")
    assert page.text("#panel-diagnose .effects").startswith("Named\n\nBars: log-odds against leaving it out.")
    assert page.text("#add-named") == "Add reversible (entropic) heat (entropic_heat)"
    before = int(page.run("return document.querySelector('#plot-surface').dataset.traces"))
    page.point("#effect-0")
    page.wait("return Number(document.querySelector('#plot-surface').dataset.traces) === arguments[0] + 2", before)
    laid = "return document.querySelector('#plot-surface').data.find(d => d.name.startsWith('with ')).name"
    assert page.run(laid) == "with reversible (entropic) heat (entropic_heat)"
    page.point("h1")
    page.wait("return Number(document.querySelector('#plot-surface').dataset.traces) === arguments[0]", before)
    page.click("#effect-0")
    assert "dU/dT" in page.text(".told pre")
    assert faults(page, axe) == []

    page.run(WATCH_BARS)
    page.click(".told button")
    page.wait("return document.querySelectorAll('#panel-add .way li').length === 3", patience_s=FIT_S)
    fell = page.run("return window.seen")  # the held-out error, as the bar had it while the fit went on
    assert len(fell) > 1
    assert fell == sorted(fell, reverse=True)
    left = page.run("return window.left")  # and the residual, in the plot
    assert len(left) > 1
    assert left == sorted(left, reverse=True)
    assert left[-1] < 0.3 * left[0]
    gone = "return !document.querySelector('#plot-surface').data.some(d => d.name.endsWith('being fitted'))"
    page.wait(gone, patience_s=FIT_S)
    seen_compared(page)
    assert "by force" not in page.text("#panel-add")
    # each bar has a number, and its name stands below: nothing has to be pointed at
    assert page.text("#bar-names").replace(" (core not proven)", "") == f"1 from its file · 2 refitted · 3 {ADDED}"
    assert page.run(
        "return [...document.querySelectorAll('.bars')[0].querySelectorAll('small')].map(b => b.innerText)"
    ) == [
        "1",
        "2",
        "3",
    ]
    held = page.run("return document.querySelectorAll('.bars')[1].getAttribute('aria-label')")
    _, first, second = (float(part.split()[-2]) for part in held.split(": ")[1].split(";")[0].split(", "))
    assert second < 0.5 * first
    assert fell[-1] == pytest.approx(second, rel=0.1)
    # the old verdict begins with the model that it is of
    told = page.run("return document.querySelector('#panel-diagnose').textContent")
    assert told.startswith("DiagnoseFound for “refitted”, before what has been added since:")
    assert faults(page, axe) == []

    hatched = (
        "return document.querySelector('#plot-core').data.filter(d => d.fill === 'toself')"
        ".map(d => [d.name, d.fillpattern?.shape ?? ''])"
    )
    come(lambda: dict(page.run(hatched)) == {"from its file": "/", "refitted": "/", ADDED: ""}, "bands of the cores")

    # every step of the road in one picture, on axes that do not move
    assert page.text("#variants").split("\n")[1:] == ["from its file", "refitted", ADDED]
    names = "return [...new Set(document.querySelector('#plot-surface').data.map(d => d.name))].sort()"
    ranges = "return ['yaxis', 'yaxis2'].map(a => document.querySelector('#plot-surface').layout[a].range.join())"
    page.idle(FIT_S)
    come(lambda: page.run(names) == [ADDED, "from its file", "measured", "refitted"], "all steps")
    axes = page.run(ranges)
    page.click("#step-0")
    page.wait("return !document.querySelector('#plot-surface').data.some(d => d.name === 'from its file')")
    assert page.run(ranges) == axes
    page.click("#step-0")
    page.click("#leftover summary")
    page.wait("return Number(document.querySelector('#plot-inlet').dataset.traces) > 3")
    acf = (  # long names take several lines in a small picture
        "const named = x => x.name.replaceAll('<br>', ' ') === arguments[0];"
        "return document.querySelector('#plot-auto').data.find(named).y.slice(1)"
    )
    bound = page.run("return document.querySelector('#plot-auto').data[0].y[0]")
    outside = [sum(abs(y) > bound for y in ys) / len(ys) for ys in (page.run(acf, n) for n in ("refitted", ADDED))]
    assert outside[0] > 0.5 > 0.1 > outside[1]

    # a zoom asks for the samples of the window, all of them
    zoom = "Plotly.relayout(document.querySelector('#plot-surface'), {'xaxis.range': arguments[0]})"
    inside = (
        "const [a, b] = arguments[0];"
        "return document.querySelector('#plot-surface').data.at(-1).x.filter(x => x >= a && x <= b).length"
    )
    for k in range(6):
        page.run(zoom, [5 + k, 6 + k])
        page.wait("return document.querySelector('#stage').dataset.window === arguments[0]", f"{5 + k},{6 + k}")
        assert page.run(inside, [5 + k, 6 + k]) == 61

    page.click("#tab-take")
    assert "bms-gateway add entropic_heat" in page.text("#commands")
    assert faults(page, axe) == []
    model = page.run("return fetch(document.querySelector('#take-model').href).then(r => r.text())")
    (tmp_path / "taken.toml").write_text(model)
    assert [e.key for e in read_model(tmp_path / "taken.toml").effects] == ["entropic_heat"]
    assert "pack_with_1.toml" in page.text("#config-lines")

    # a reload keeps all of it
    page.reload()
    page.wait("return document.querySelectorAll('#panel-add .way li').length === 3")
    assert page.there("#panel-take")
    page.click("#tab-add")
    page.click("#undo")
    page.wait("return document.querySelectorAll('#panel-add .way li').length === 2")
    assert page.complaints() == []


def test_refused_by_the_gates_says_why_and_is_forced_only_when_told(window, url):
    page = window(url)
    seen_compared(page)
    page.click("#tab-add")
    page.type("#effect-name", "entropic_hat")
    page.click("#add")
    page.wait("return document.querySelector('#error').innerText.includes(\"did you mean 'entropic_heat'?\")")
    page.type("#effect-name", "coolant_delay")
    page.press("Enter")
    page.wait("return document.querySelector('#refusal')", patience_s=FIT_S)
    assert "Not added" in page.text("#refusal")
    page.click("#force")
    page.wait("return document.querySelectorAll('#panel-add .way li').length === 3", patience_s=FIT_S)
    assert "by force" in page.text("#panel-add")


def test_cancel_ends_the_search_and_the_page_goes_on(window, pack, tmp_path):
    with served(tmp_path, *pack.words) as url:  # anew: what was found before is not searched again
        page = window(url)
        seen_compared(page)
        page.press("d")  # by key
        page.wait("return !document.querySelector('#job').hidden && document.querySelector('#job-text').innerText")
        page.press("Escape")
        page.idle()
        assert page.text("#panel-diagnose .verdict") == ""
        assert page.there("#diagnose")
        page.press("2")
        assert page.there("#panel-compare")


def test_two_tabs_are_two_desks(window, url, pack):
    one, two = window(url), window(url)
    seen_compared(one)
    seen_compared(two)
    two.click("#tab-open")
    two.type("#tables", str(pack.clean))
    two.click("#open")
    two.wait("return document.querySelector('#what').innerText.includes('clean.csv')", patience_s=FIT_S)
    seen_compared(two)
    assert "hidden.csv" in one.text("#what")
    assert one.run("return sessionStorage.workbench") != two.run("return sessionStorage.workbench")


def test_bad_files_are_one_line_and_good_ones_can_be_uploaded(window, driver, tmp_path, pack):
    with served(tmp_path) as url:
        page = window(url)
        page.wait("return document.querySelector('#panel-open').getClientRects().length")
        page.click("#open")
        come(lambda: "choose a table" in page.text("#error"), lambda: page.text("#error"))
        bad = tmp_path / "bad.csv"
        for content, word in (
            (b"\x00\x01\x02", "bad.csv"),
            (b"time_s,current_A\n0,1\n1,2\n", "coolant_inlet_C"),
            (b"", "bad.csv"),
        ):
            bad.write_bytes(content)
            page.run("document.querySelector('#tables').value = ''")
            page.upload("#tables-file", bad)
            page.wait("return document.querySelector('#tables').value.includes('bad.csv')")
            page.upload("#model-file", pack.model)
            page.wait("return document.querySelector('#model').value === 'pack.toml'")
            page.click("#open")
            come(lambda word=word: word in page.text("#error-text"), lambda: page.text("#error"))
            assert "\n" not in page.text("#error-text")
            page.click("#dismiss")
        page.run("document.querySelector('#tables').value = ''")
        page.upload("#tables-file", pack.hidden)
        page.wait("return document.querySelector('#tables').value.includes('hidden.csv')")
        page.click("#open")
        seen_compared(page)


def test_habits(window, url, axe):
    """Nothing is wider than the window, in dark all is as legible, keys reach all, nothing comes from elsewhere."""
    page = window(url)
    seen_compared(page)
    for theme in ("dark", "light"):
        page.click("#theme")
        assert page.run("return document.documentElement.dataset.theme") == theme
        for width in (1280, 390, 800, 1024, 1920):
            page.cdp("Emulation.setDeviceMetricsOverride", width=width, height=720, deviceScaleFactor=1, mobile=False)
            for step in ("open", "compare", "diagnose", "add", "take"):
                page.click(f"#tab-{step}")
                # plots follow a window that changes its size a moment later
                page.wait("return document.documentElement.scrollWidth <= innerWidth", patience_s=20)
                if theme == "light" or width in LEGIBLE:
                    assert faults(page, axe) == [], (theme, width, step)
    page.press("2")
    reached = set()
    for _ in range(60):
        page.press("Tab")
        reached.add(page.run("return document.activeElement.id || document.activeElement.className"))
    assert {"cell-1", "cell-2", "step-1", "theme", "keys", "tab-compare"} <= reached
    page.click("#cell-1")
    page.press("Right")
    page.wait("return document.querySelector('#cell-2').getAttribute('aria-pressed') === 'true'")
    origins = page.run("return [...new Set(performance.getEntriesByType('resource').map(r => new URL(r.name).origin))]")
    assert json.dumps(origins) == json.dumps([url.rstrip("/")])


def test_the_gateways_recent_window_is_opened_from_the_page(window, tmp_path):
    drove(tmp_path, 130)
    with served(tmp_path) as url:
        page = window(url)
        page.wait("return document.querySelector('#panel-open').getClientRects().length")
        page.type("#model", tmp_path / "string.toml")
        page.type("#recent", "2 hours")
        page.click("#more summary")
        page.type("#store", tmp_path / "lib")
        page.type("#string", "string_1")
        page.click("#open")
        come(lambda: "did you mean 2h" in page.text("#error-text"), lambda: page.text("#error"))
        page.type("#recent", "100s")
        page.click("#open")
        page.wait("return document.querySelector('#tables').value === 'recent.csv'")
        page.wait("return document.documentElement.dataset.firstPlot")
        page.click("#tab-take")
        assert "bms-gateway export --last 100s --out recent.csv" in page.text("#commands")


def test_the_live_page_plays_a_log(window, tmp_path, axe):
    from bms_gateway.config import shipped

    config = shipped("deploy/example/gateway.toml")
    command = [sys.executable, "-m", "bms_gateway", "simulate", "--config", config, "--out", tmp_path / "drive.log"]
    subprocess.run([*command, "--duration", "300"], check=True, capture_output=True)
    with served(tmp_path, "--live", tmp_path / "drive.log", "--config", config) as url:
        page = window(url)
        page.wait("return document.querySelectorAll('.live-cell').length === 60")
        page.wait("return document.querySelector('#hottest-value').innerText.includes('°C')")
        page.wait("return !document.querySelector('#live-state').innerText")
        page.run("const s = document.querySelector('#speed'); s.value = '100'; s.dispatchEvent(new Event('change'));")
        page.wait("return Number(document.querySelector('#time').value) > 200")
        page.click("#play")
        page.wait("return document.querySelector('#play').innerText === 'Play'")
        page.run("const t = document.querySelector('#time'); t.value = '42'; t.dispatchEvent(new Event('input'));")
        page.wait("return document.querySelector('#at').dataset.s === '42'")
        page.click("#play")
        page.wait("return document.querySelector('#play').innerText === 'Play again'")  # at its end
        page.click("#play")
        page.wait("return document.querySelector('#play').innerText === 'Pause'")
        page.click("#play")
        page.wait("return document.querySelector('#play').innerText === 'Play'")
        assert "no health flag" in page.text("#panel-live").lower()
        assert page.run("return document.documentElement.scrollWidth - innerWidth") <= 0
        assert faults(page, axe) == []
        page.click("#theme")
        assert faults(page, axe) == []
        page.click("#theme")
        assert page.complaints() == []
