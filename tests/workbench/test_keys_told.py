"""A key that cannot do its work now says why, and the focus never falls off the page."""

import pytest

from tests.support.page_steps import FIT_S
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser

FOCUSED = "return document.activeElement.id || document.activeElement.tagName"
SAID = "return document.querySelector('#error').hidden ? '' : document.querySelector('#error-text').textContent"


@pytest.fixture
def page(window, tmp_path):
    with served(tmp_path) as url:
        page = window(url)
        page.wait("return document.querySelector('#start')?.hidden === false")
        yield page


def test_a_search_that_is_asked_for_too_early_is_answered(page):
    """Nothing happened, and nothing was said; the focus was on no element."""
    page.run("document.querySelector('#example').focus()")
    page.press("Enter")
    page.wait("return document.body.dataset.busy === 'compare'", patience_s=FIT_S)
    assert page.run(FOCUSED) == "tab-open"
    page.press("d")
    page.wait(f"return (() => {{ {SAID} }})().includes('comparing the model with the readings: wait for it')")
    page.idle(FIT_S)
    page.wait(f"return (() => {{ {SAID} }})() === ''")  # true only while that runs
    assert page.run("return document.querySelector('#panel-diagnose .verdict')") is None
    page.press("d")
    page.wait("return document.body.dataset.busy === 'diagnose'")
    page.press("Escape")
    page.idle(FIT_S)
    assert all("/api/diagnose" in c for c in page.complaints())  # the answer to the first key
