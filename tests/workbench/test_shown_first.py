"""Which cell the page shows when a record is opened."""

import pytest

from tests.support.page_steps import FIT_S, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser, and fits


def test_the_cell_that_fails_most_is_shown_first(window, tmp_path):
    pack, table = make_pack(tmp_path), tmp_path / "offset.csv"
    head, *rows = pack.clean.read_text().splitlines()
    at = head.split(",").index("surface_3_C")
    cells = [r.split(",") for r in rows]
    for k, c in enumerate(cells):
        c[at] = f"{float(c[at]) + 2.0 * (k > 700):.4f}" if c[at] else ""
    table.write_text("\n".join([head, *(",".join(c) for c in cells)]) + "\n")
    with served(tmp_path, table, "--model", pack.model) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        page.wait("return document.querySelector('#plot-surface').dataset.name === 'surface-0-3'")
        assert page.run("return document.querySelector('#cell-3').getAttribute('aria-pressed')") == "true"
        page.click("#cell-1")  # whoever chooses another keeps it
        page.wait("return document.querySelector('#plot-surface').dataset.name === 'surface-0-1'")
        page.reload()
        seen_compared(page)
        page.idle(FIT_S)
        assert page.run("return document.querySelector('#plot-surface').dataset.name") == "surface-0-1"
