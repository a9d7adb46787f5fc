"""Work outlives a restart of the server and the seventh tab; reports fit any window and paper."""

import re

import pytest

from bms_gateway.workbench.site import MOST_AWAKE, Site
from tests.support.desk_steps import done, files
from tests.support.page_steps import ADDED, FIT_S, seen_added, seen_compared, seen_diagnosed
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import come, faults
from tests.workbench.conftest import served


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"))


@pytest.mark.slow
def test_more_tabs_take_nobodys_work(pack):
    site = Site()
    try:
        first = site.new_desk()
        first.open(files(pack))
        assert done(first)["opened"]
        others = [site.new_desk() for _ in range(MOST_AWAKE)]
        come(lambda: not first.awake, "the rest of the first")
        assert site.desk(first.name) is first
        state = first.state()
        assert state["opened"]["records"][0]["readings"] == 2996 or state["opened"]["records"]
        assert [s["name"] for s in state["steps"]] == ["from its file", "refitted"]
        assert first.figure("surface-0-1")["data"]
        first.add(["entropic_heat"])  # a process comes by itself
        assert done(first)["error"] == ""
        assert [s["name"] for s in first.state()["steps"]][-1] == ADDED
        assert all(site.desk(d.name) is d for d in others)
        assert sum(d.awake for d in site.desks.values()) <= MOST_AWAKE
    finally:
        site.close()


@pytest.mark.slow
def test_a_page_left_open_goes_on_when_the_server_is_back(window, pack, tmp_path):
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        seen_added(page)
    page.wait("return document.querySelector('#error-text').innerText.includes('does not answer')")
    assert page.text("#what").endswith(ADDED)  # still there to be read
    before = page.run("return JSON.parse(sessionStorage.workbench).desk")
    with served(tmp_path, "--port", url.rstrip("/").rpartition(":")[2]):
        page.wait("return JSON.parse(sessionStorage.workbench).desk !== arguments[0]", before, patience_s=FIT_S)
        page.idle(FIT_S)
        assert page.text("#error-text") == ""
        assert page.run("return document.querySelectorAll('#variants .tick').length") == 3
        seen_diagnosed(page)


@pytest.mark.slow
def test_a_page_that_is_loaded_again_in_mid_search_finds_the_search_and_then_its_verdict(window, tmp_path):
    pack = make_pack(tmp_path, cells=24, sensors=(1, 12, 24))  # a search that outlives a reload of the page
    verdict = "document.querySelector('#panel-diagnose .verdict')"
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        desk = page.run("return JSON.parse(sessionStorage.workbench).desk")
        page.click("#tab-diagnose")
        page.click("#diagnose")
        page.wait("return Number(document.querySelector('#job-share').value) > 0.02", patience_s=FIT_S)
        found = 0
        while found < 3 and not page.run(f"return Boolean({verdict})"):
            share = float(page.run("return document.querySelector('#job-share').value"))
            page.reload()
            page.wait(f"return document.body.dataset.busy === 'diagnose' || {verdict}")
            assert page.run("return JSON.parse(sessionStorage.workbench).desk") == desk
            shown = f"document.querySelector('#job-share').value >= arguments[0] || {verdict}"
            page.wait(f"return {shown}", share, patience_s=FIT_S)
            found += page.run("return document.body.dataset.busy === 'diagnose'")
        assert found  # the search itself was seen again, not only what came of it
        page.wait(f"return {verdict}", patience_s=FIT_S)
        page.idle(FIT_S)
        assert "entropic_heat" in page.text("#panel-diagnose")
        assert page.complaints() == []


@pytest.mark.slow
@pytest.mark.parametrize("of", ["comparison", "diagnosis"])
def test_a_report_fits_every_window_and_paper(window, pack, axe, tmp_path, of):
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        if of == "diagnosis":
            seen_diagnosed(page)
            page.idle(FIT_S)
        page.click("#tab-take")
        text = page.run(
            "const desk = JSON.parse(sessionStorage.workbench).desk;"
            "return fetch(`/api/take?desk=${desk}&what=report`).then(r => r.text())"
        )
    assert len(text.encode()) < 2e6
    (tmp_path / "report.html").write_text(text, encoding="utf-8")
    report = window(f"file://{tmp_path / 'report.html'}")
    report.wait("return document.documentElement.dataset.drawn")
    assert int(report.run("return document.querySelectorAll('.plot .main-svg').length")) > 3
    for width in (390, 1024, 1280, 1920):
        report.cdp("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
        report.wait("return document.documentElement.scrollWidth <= innerWidth", patience_s=10)
        assert faults(report, axe) == [], width
    report.cdp("Emulation.setDeviceMetricsOverride", width=390, height=900, deviceScaleFactor=1, mobile=False)
    report.reload()
    report.wait("return document.documentElement.dataset.drawn")
    assert report.run("return document.querySelectorAll('.modebar-btn').length") == 0  # they would lie on the legend
    report.click("table.heat td[title]")
    assert re.match(r"cell 1, .*: \d+ readings: .* K, sd .* K, RMSE .* K$", report.text(".cell-told"))
    report.cdp("Emulation.setDeviceMetricsOverride", width=690, height=1000, deviceScaleFactor=1, mobile=False)
    report.cdp("Emulation.setEmulatedMedia", media="print")
    report.run("dispatchEvent(new Event('beforeprint'))")
    report.wait(
        "return [...document.querySelectorAll('.plot .main-svg')].every(s => s.getBoundingClientRect().right <= 690)"
    )
    assert report.run("return document.documentElement.scrollWidth") <= 690
    assert report.complaints() == []


@pytest.mark.slow
def test_files_of_the_command_line_are_read_before_the_browser_comes(pack, tmp_path):
    model = tmp_path / "pack.toml"
    model.write_text(pack.model.read_text())
    given = {**files(pack), "model": str(model), "recent": None}
    for changed in (False, True):
        site = Site(given=given)
        try:
            site.warm(ahead=True)
            ahead = site.spare
            come(lambda desk=ahead: desk.state()["opened"], "the record", FIT_S)
            if changed:
                model.write_text(model.read_text() + "# seen once more\n")
            desk = site.new_desk()
            assert desk is ahead
            assert ((desk.state()["job"] or {}).get("kind") == "open") is changed
            assert done(desk)["opened"]
            assert desk.model().endswith("# seen once more\n") is changed
        finally:
            site.close()
