"""The program or the network goes away for a while, at any moment; a person clicks twice."""

from contextlib import contextmanager

import pytest

from tests.support.page_steps import FIT_S, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser, and fits
NETWORK = "Network.emulateNetworkConditions"
GONE = "The workbench does not answer: is the program still running?"


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"), seconds=900)


@contextmanager
def compared(window, pack):
    """The page with a model that has been compared, at rest."""
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        yield page


def test_what_was_asked_for_while_the_network_was_gone_is_shown_when_it_is_back(window, pack):
    """The page worked again, and said for ever that the program does not answer."""
    with compared(window, pack) as page:
        page.cdp("Network.enable")
        page.cdp(NETWORK, offline=True, latency=0, downloadThroughput=0, uploadThroughput=0)
        page.click("#cell-2")
        page.wait("return document.querySelector('#error-text').textContent === arguments[0]", GONE)
        page.cdp(NETWORK, offline=False, latency=0, downloadThroughput=-1, uploadThroughput=-1)
        page.wait("return document.querySelector('#error').hidden")
        page.wait("return document.querySelector('#plot-core').dataset.name === 'core-0-2'")
        page.idle()


def test_work_that_was_never_finished_begins_again_by_itself(window, pack, tmp_path):
    """A program that was killed before the first comparison was done forgot which files were open."""
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        begun = "return JSON.parse(sessionStorage.workbench ?? '{}').session && [document.body.dataset.busy]"
        (busy,) = page.wait(begun, patience_s=FIT_S)  # at once: a second question may come after the comparison
    with served(tmp_path, "--port", url.rstrip("/").rpartition(":")[2]):
        page.wait("return document.querySelector('#step-1')", patience_s=FIT_S)
        page.idle(FIT_S)
        assert busy  # else this test has come too late to test anything
        assert page.text("#error-text") == ""


def test_a_double_click_asks_once(window, pack):
    with compared(window, pack) as page:
        page.press("3")
        page.run("const b = document.querySelector('#diagnose'); b.click(); setTimeout(() => b.click(), 120)")
        page.wait("return document.querySelector('#panel-diagnose .verdict')", patience_s=FIT_S)
        page.idle(FIT_S)
        assert page.text("#error-text") == ""
        page.run("const b = document.querySelector('#add-named'); b.click(); b.click()")
        page.wait("return document.querySelectorAll('#panel-add .way li').length === 3", patience_s=FIT_S)
        page.idle(FIT_S)
        page.run("const b = document.querySelector('#undo'); b.click(); b.click()")
        page.wait("return document.querySelectorAll('#panel-add .way li').length === 2")
        assert page.text("#error-text") == ""  # the second click did not undo what is not there
