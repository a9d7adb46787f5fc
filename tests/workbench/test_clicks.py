"""From a German Excel table with other names to the error that falls: clicks, and seconds beside the search."""

import json
import time

import pytest

from tests.truth.packs import pack as make_pack
from tests.workbench.conftest import served
from tests.workbench.foreign import german

MOST_CLICKS = 5
MOST_S = 15.0
"""Beside the search and the fit of the addition; for twelve cells and one hour."""
PATIENCE_S = 580.0


@pytest.mark.parametrize(
    ("cells", "seconds"), [(1, 1500), pytest.param(12, 3600, marks=pytest.mark.slow)], ids=["short", "as in the README"]
)
def test_five_clicks_from_a_foreign_table_to_an_error_that_falls(window, tmp_path, record_property, cells, seconds):
    pack = make_pack(tmp_path, cells=cells, sensors=tuple(range(1, cells + 1)), seconds=seconds)
    table = german(pack.hidden, tmp_path / "Messung.csv")
    clicks, waited = 0, 0.0
    with served(tmp_path) as url:
        page = window(url)
        page.wait("return document.querySelector('#tables-file')")
        time.sleep(2.0 if cells > 1 else 0.0)  # a person looks at the page first

        def click(css, seen, search=False):
            nonlocal clicks, waited
            clicks, began = clicks + 1, time.monotonic()
            page.click(css)
            page.wait(seen, patience_s=PATIENCE_S)
            page.idle(PATIENCE_S)
            waited += 0.0 if search else time.monotonic() - began

        began, clicks = time.monotonic(), 2  # both files are chosen, or dropped, in the file dialogs
        page.upload("#tables-file", table)
        page.upload("#model-file", pack.model)
        page.wait("return document.querySelectorAll('#mapping tbody tr').length === arguments[0]", 6 + cells)
        page.wait("return document.querySelector('#model').value === 'pack.toml'")
        waited += time.monotonic() - began
        click("#open", "return document.querySelector('#step-1')")
        click("#onward", "return document.querySelector('#panel-diagnose .verdict')", search=True)
        click("#add-named", "return document.querySelectorAll('#panel-add .way li').length === 3", search=True)
        bars = page.run("return document.querySelectorAll('.bars')[1].getAttribute('aria-label')")
        before, after = (float(part.split()[-2]) for part in bars.split(": ")[1].split(";")[0].split(", ")[1:])
        figures = {"clicks": clicks, "seconds": round(waited, 1), "held_K": [before, after]}
        record_property("clicks", json.dumps(figures))
        print(figures)
        assert after < 0.5 * before
        assert clicks <= MOST_CLICKS
        assert (
            cells == 1 or waited < 4.0 * MOST_S
        )  # on a machine that others use too; the README has the time of one that is free
