"""Whoever waits for the page to come to rest waits for what was just clicked too."""

import pytest

from tests.support.page_steps import FIT_S
from tests.workbench.conftest import served

LATE = """
const own = window.fetch;
window.fetch = async (url, how) => {
  if (how?.method === 'POST') await new Promise((done) => setTimeout(done, 1500));
  return own(url, how);
};
"""
"""The network of a starved machine: every wish of the page takes a second and a half to go out."""


REFUSED = """
const own = window.fetch;
window.fetch = async (url, how) => (url.includes('/api/diagnose')
  ? new Response(JSON.stringify({error: 'not at this moment'}), {status: 409}) : own(url, how));
"""
NOTED = """
const { desk } = JSON.parse(sessionStorage.workbench);
await fetch(`/api/note?desk=${desk}`, {method: 'POST', headers: {'Content-Type': 'application/json'},
  body: JSON.stringify({notes: 'seen'})});
"""


@pytest.mark.slow
def test_a_page_is_at_rest_only_after_what_was_clicked_is_done_and_shown(window, tmp_path):
    with served(tmp_path) as url:
        page = window(url)
        page.idle()
        page.run(LATE)
        page.click("#example")
        page.idle(FIT_S)
        assert page.there("#step-1")
        assert page.there("#cell-1")


@pytest.mark.slow
def test_why_a_wish_was_refused_stays_when_something_else_happens(window, tmp_path):
    with served(tmp_path) as url:
        page = window(url)
        page.click("#example")
        page.idle(FIT_S)
        page.run(REFUSED)
        page.press("d")
        page.wait("return document.querySelector('#error-text').innerText === 'Not at this moment'")
        before = page.run("return document.body.dataset.version")
        page.run(NOTED)
        page.wait("return document.body.dataset.version !== arguments[0]", before)
        assert page.text("#error-text") == "Not at this moment"
