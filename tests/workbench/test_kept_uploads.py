"""Uploaded files outlive a restart of the server and come along with a duplicated tab; what is too large is told."""

import json

import pytest

from tests.support.page_steps import ADDED, FIT_S, seen_added, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import faults
from tests.workbench.conftest import served

DESK = "return JSON.parse(sessionStorage.workbench).desk"
STEPS = "return document.querySelectorAll('#variants .tick').length"
ROWS = "return document.querySelectorAll('#mapping tbody tr').length === 7"
KEPT = """
const base = await new Promise((done, failed) => {
  const asked = indexedDB.open('uploads', 1);
  asked.onsuccess = () => done(asked.result);
  asked.onerror = () => failed(asked.error);
});
const old = arguments[0];
const found = await new Promise(done => {
  const change = base.transaction('files', 'readwrite'), store = change.objectStore('files'), asked = store.getAll();
  asked.onsuccess = () => { for (const f of asked.result) if (old) store.put({...f, used: f.used - 8 * 864e5}); };
  change.oncomplete = () => done(asked.result);
});
base.close();
return found.map(f => f.blob.size).sort();
"""


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"), seconds=600)


def chosen(page, pack):
    page.upload("#tables-file", pack.hidden)
    page.wait(ROWS)
    page.upload("#model-file", pack.model)
    page.wait("return document.querySelector('#model').value === 'pack.toml'")
    page.idle()


def port(url):
    return url.rstrip("/").rpartition(":")[2]


@pytest.mark.slow
def test_files_that_were_chosen_and_not_opened_are_there_after_a_restart(window, pack, tmp_path):
    with served(tmp_path) as url:
        page = window(url)
        chosen(page, pack)
        before = page.run(DESK)
    page.wait("return document.querySelector('#error-text').innerText.includes('does not answer')")
    with served(tmp_path, "--port", port(url)):
        page.wait("return JSON.parse(sessionStorage.workbench).desk !== arguments[0]", before)
        page.idle()
        page.wait(ROWS)
        assert page.run("return [tables.value, model.value]") == ["hidden.csv", "pack.toml"]
        page.click("#open")
        page.wait("return document.querySelector('#what').innerText.startsWith('hidden.csv · pack.toml')")
        assert page.text("#unkept") == ""


@pytest.mark.slow
def test_a_file_that_was_uploaded_anew_and_not_opened_takes_no_work_over_after_a_restart(window, pack, tmp_path):
    other = tmp_path / "other" / pack.hidden.name
    other.parent.mkdir()
    other.write_text("".join(pack.hidden.read_text().splitlines(keepends=True)[:400]))
    with served(tmp_path) as url:
        page = window(url)
        chosen(page, pack)
        page.click("#open")
        seen_compared(page)
        page.idle(FIT_S)
        page.upload("#tables-file", other)
        page.wait("return document.querySelector('#unkept').innerText.includes('uploaded again after it was opened')")
        before = page.run(DESK)
    page.wait("return document.querySelector('#error-text').innerText.includes('does not answer')")
    with served(tmp_path, "--port", port(url)):
        page.wait("return JSON.parse(sessionStorage.workbench).desk !== arguments[0]", before)
        page.idle()
        desk = page.run(DESK)
        assert page.run(f"return (await (await fetch('/api/state?desk={desk}')).json()).steps") == []
        page.click("#tab-open")
        assert page.text("#unkept").startswith("hidden.csv: uploaded again after it was opened. What is shown is of")
        page.click("#open")
        seen_compared(page)
        page.click("#tab-open")
        assert page.text("#unkept") == ""


def test_what_is_too_large_to_be_kept_is_told(window, axe, tmp_path):
    large = tmp_path / "large.dbc"
    with large.open("wb") as f:
        f.truncate(65 * 1024**2)
    small = tmp_path / "small.dbc"
    small.write_bytes(b"x" * 200_000)
    with served(tmp_path) as url:
        page = window(url)
        page.run("document.querySelector('#more').open = true")
        page.upload("#config-file", large)
        page.wait("return document.querySelector('#unkept').innerText")
        told = (
            "Not kept in this browser: large.dbc has 65 MiB, and one file may have 64 MiB. When the program is started"
        )
        assert page.text("#unkept").startswith(told)
        assert page.run("return (await indexedDB.databases()).length") == 0
        assert faults(page, axe) == []
        page.cdp("Storage.overrideQuotaForOrigin", origin=url.rstrip("/"), quotaSize=1000)
        page.upload("#config-file", small)
        page.wait(
            "return document.querySelector('#unkept').innerText.includes('small.dbc could not be written: the b')"
        )
        page.cdp("Storage.overrideQuotaForOrigin", origin=url.rstrip("/"))
        page.upload("#config-file", small)
        page.wait("return !document.querySelector('#unkept').innerText.includes('small.dbc')")
        assert page.run(KEPT, False) == [200_000]
        page.reload()
        page.wait("return document.querySelector('#unkept').innerText.includes('large.dbc has 65 MiB')")

        # what nobody used for a week goes when something else is kept
        page.run(KEPT, True)
        page.run("addEventListener('pagehide', () => sessionStorage.clear())")  # earlier, the page may write it again
        page.reload()
        page.wait("return document.body.dataset.version")
        page.upload("#config-file", tmp_path / "workbench.err")
        page.wait("return Object.keys(JSON.parse(sessionStorage.workbench).uploads).length === 1")
        assert page.run(KEPT, False) == [(tmp_path / "workbench.err").stat().st_size]


@pytest.mark.slow
def test_the_work_on_uploads_is_there_after_a_restart_and_in_a_duplicated_tab(window, pack, tmp_path):
    with served(tmp_path) as url:
        page = window(url)
        chosen(page, pack)
        page.click("#open")
        seen_compared(page)
        seen_added(page)

        # a duplicated tab has a desk of its own, with the same files
        page.run("window.twin = window.open('/')")  # which brings a copy of the tab's storage along
        own = page.run(DESK)
        twin = "return twin.document.body?.dataset.version && JSON.parse(twin.sessionStorage.workbench).desk"
        assert page.wait(twin, patience_s=FIT_S) != own
        page.wait("return twin.document.querySelectorAll('#variants .tick').length === 3", patience_s=FIT_S)
        assert page.run("return twin.document.querySelector('#what').innerText") == f"hidden.csv · pack.toml {ADDED}"
        assert page.run("return twin.document.querySelector('#error-text').innerText") == ""
        assert page.run(DESK) == own
        page.run("twin.close()")
    page.wait("return document.querySelector('#error-text').innerText.includes('does not answer')")
    with served(tmp_path, "--port", port(url)):
        page.wait("return JSON.parse(sessionStorage.workbench).desk !== arguments[0]", own, patience_s=FIT_S)
        page.idle(FIT_S)
        assert page.text("#error-text") == ""
        assert page.run(STEPS) == 3
        assert page.text("#what") == f"hidden.csv · pack.toml {ADDED}"
        kept = json.loads(page.run("return sessionStorage.workbench"))
        assert sorted(kept["uploads"]) == ["hidden.csv", "pack.toml"]
