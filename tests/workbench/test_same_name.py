"""Two uploads of one name: those that come together are both kept, and one that takes another's place is told."""

import io

import pytest

from bms_gateway.workbench.uploads import Uploads
from tests.workbench.browser import faults
from tests.workbench.conftest import served


def test_an_upload_tells_that_it_took_another_ones_place():
    here = Uploads()
    try:
        assert [here.receive(io.BytesIO(x), 3, "a.csv") for x in (b"one", b"one", b"two")] == [False, False, True]
        assert (here.folder / "a.csv").read_bytes() == b"two"
    finally:
        here.close()


DROP = """
const files = arguments[0].map(([name, text]) => new File([text], name));
const data = new DataTransfer();
for (const f of files) data.items.add(f);
dispatchEvent(new DragEvent('drop', {dataTransfer: data, bubbles: true, cancelable: true}));
"""
HELD = """
const { desk } = JSON.parse(sessionStorage.workbench);
return fetch(`/api/take?${new URLSearchParams({desk, what: 'file', name: arguments[0]})}`).then(r => r.text());
"""
HEAD = "time_s,current_A,coolant_inlet_C,surface_1_C\n"


@pytest.mark.slow  # a browser
def test_files_of_one_name_are_kept_apart_or_told(window, axe, tmp_path):
    """The second replaced the first, and nothing was said."""
    first, second, third = (f"{HEAD}0,1,20,2{k}\n1,1,20,2{k}\n" for k in range(3))
    with served(tmp_path) as url:
        page = window(url)
        page.idle()
        page.run(DROP, [["drive.csv", first], ["drive.csv", second]])
        page.wait("return document.querySelector('#tables').value === 'drive.csv\\ndrive (2).csv'")
        page.idle()
        assert [page.run(HELD, name) for name in ("drive.csv", "drive (2).csv")] == [first, second]
        assert not page.there("#unkept")
        page.run(DROP, [["drive.csv", first]])  # the same again
        page.idle()
        assert not page.there("#unkept")
        page.run(DROP, [["drive.csv", third]])
        page.wait("return !document.querySelector('#unkept').hidden")
        page.idle()
        told = page.text("#unkept")
        assert told.startswith("drive.csv: a file of this name with other content was here")
        assert page.run(HELD, "drive.csv") == third
        assert faults(page, axe) == []
