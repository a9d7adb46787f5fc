"""The report that took longer than a browser remembers a click is a link, and holds what the page shows."""

import re

import pytest

from tests.report.html_page import Page
from tests.support.page_steps import ADDED, FIT_S, seen_added, seen_compared, seen_diagnosed
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import come
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser, and fits
LATE = "Object.defineProperty(navigator, 'userActivation', { value: { isActive: false }, configurable: true })"
LINK = "const a = document.querySelector('#report-ready a'); return a && [a.textContent, a.download]"
CARDS = "return [...document.querySelectorAll('#panel-compare .cards dd.value')].map(d => d.textContent)"


def made(page, folder):
    """The report behind the link, as it is saved."""
    folder.mkdir()
    page.cdp("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(folder))
    page.click("#tab-take")
    page.run(LATE)
    page.click("#take-report")
    page.wait(LINK, patience_s=FIT_S)
    assert page.run(LINK) == ["It is made: save report.html", "report.html"]
    page.click("#report-ready a")
    come(lambda: (folder / "report.html").exists(), "the report")
    return (folder / "report.html").read_text(encoding="utf-8")


def drawn(text):
    """Models in a figure of the report, in their order."""
    names = [d["name"] for d in Page(text).figures(text)["overlay-1-1"]["data"]]
    return [n for n in dict.fromkeys(names) if n != "measured"]


def test_the_link_opens_a_report_of_what_is_shown(window, tmp_path):
    pack = make_pack(tmp_path, seconds=800)
    with served(tmp_path, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        page.click("#tab-compare")
        findings = page.run("return [...document.querySelectorAll('#panel-compare li')].map(li => li.textContent)")
        shown = page.run(CARDS)
        assert findings
        assert shown
        text = made(page, tmp_path / "first")
        report = Page(text)
        assert "Model against measurement" in report.text
        for sentence in findings:
            assert sentence in report.text
        # the page shows the newest step, the report both
        for value in shown:
            assert value.rpartition("→")[2].strip().removeprefix("±").strip() in report.text, value
        assert {"overlay-1-1", "overlay-1-3", "map-1", "drive-1", "core-1"} <= set(report.figures(text))
        # after an addition it is another report, and the link before it is gone
        page.click("#tab-add")
        seen_added(page)
        text = made(page, tmp_path / "second")
        assert "Model with an effect added" in Page(text).text
        assert ADDED in Page(text).text
        assert drawn(text) == ["from its file", "refitted", ADDED]  # the steps that are ticked
        assert re.search(r"the held-out error falls from [0-9.]+ to [0-9.]+ K", Page(text).text)
        page.click("#step-0")
        page.idle(FIT_S)
        assert drawn(made(page, tmp_path / "third")) == ["refitted", ADDED]
        page.click("#step-0")
        seen_diagnosed(page)
        page.idle(FIT_S)
        text = made(page, tmp_path / "fourth")
        assert "Which effect is the model missing?" in Page(text).text
        assert drawn(text)[:3] == ["from its file", "refitted", ADDED]
        assert page.complaints() == []
