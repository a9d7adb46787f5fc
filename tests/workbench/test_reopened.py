"""A reopened session says what its diagnosis said, that it must be computed again, and offers to do so."""

import json

import pytest

from tests.support.page_steps import FIT_S, seen_compared, seen_diagnosed
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import come
from tests.workbench.conftest import served

SAID = "By the session file alone, nothing unknown remains."


@pytest.mark.slow
def test_of_a_model_that_lacked_nothing_it_is_not_said_that_something_may_remain(window, tmp_path):
    # Bug: after a restart the page said "Something unknown may remain", where the verdict had been "Adequate".
    pack = make_pack(tmp_path, seconds=1500)
    words = (str(pack.clean), "--model", str(pack.model))
    with served(tmp_path, *words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        seen_diagnosed(page)
        page.idle(FIT_S)
        tag, sentence = page.text("#panel-diagnose .tag"), page.text("#panel-diagnose .verdict")
        assert "Adequate" in tag
        assert "unknown" not in page.text("#doubt")
        page.click("#tab-take")
        page.type("#notes-text", "All is well here.")
        kept = "return sessionStorage.workbench"
        come(lambda: "All is well" in json.loads(page.run(kept))["session"]["notes"], "notes kept")
        session = page.run(kept)
    with served(tmp_path) as url:  # the program is started anew
        other = window(url + "icon.svg")
        other.run("sessionStorage.workbench = arguments[0]", session)
        other.go(url)
        other.wait("return document.querySelector('#panel-diagnose .verdict')", patience_s=FIT_S)
        other.idle(FIT_S)
        other.click("#tab-diagnose")
        assert other.text("#panel-diagnose .tag") == f"{tag}, by the session file"
        assert other.text("#panel-diagnose .verdict") == sentence
        doubt = other.text("#doubt")
        assert SAID in doubt
        assert "may remain" not in other.run("return document.body.textContent")
        other.click("#tab-take")
        assert other.there("#report-computes")
        other.picture(tmp_path / "reopened.png")
        other.click("#confirm-head")
        other.wait("return !document.querySelector('#confirm-head')", patience_s=FIT_S)
        other.idle(FIT_S)
        other.click("#tab-diagnose")
        assert other.text("#panel-diagnose .tag") == tag
        assert other.text("#panel-diagnose .verdict") == sentence
        assert not other.there("#recalled")
        assert "unknown" not in other.text("#doubt")
