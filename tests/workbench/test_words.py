"""Words of the page: the number of things, capital letters, noughts, times; what is not used; no button twice."""

import json
import subprocess
import sys

import pytest

from bms_gateway.config.model_file import format_model
from bms_gateway.library.models import cell_model
from tests.support.page_steps import FIT_S, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import faults
from tests.workbench.conftest import served

USED = "const u = await import('/page/util.js'); return arguments[0].map(x => u[arguments[1]](...x))"


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("many", [[1, "row"], [0, "row"], [2, "row"], [1, "is", "are"]], ["1 row", "0 rows", "2 rows", "1 is"]),
        ("fixed", [[-0.001, 2], [-0.0, 0], [-1.25, 1], [3, 0]], ["0.00", "0", "−1.3", "3"]),
        ("plain", [[47.8 - 50], [70.3 - 50], [47.8], [80], [0.1 + 0.2]], ["−2.2", "20.3", "47.8", "80", "0.3"]),
        ("sentence", [["name an effect"], ["hidden.csv: no"], ["add: x"], [""]],
         ["Name an effect", "hidden.csv: no", "Add: x", ""]),
        ("moment", [[0, 10], [86_400_000 * 3 + 47_000_000, 10]], None),
    ],
)  # fmt: skip
def test_words(window, tmp_path, name, given, expected):
    with served(tmp_path) as url:
        page = window(url)
        page.cdp("Emulation.setTimezoneOverride", timezoneId="UTC")
        page.cdp("Emulation.setLocaleOverride", locale="en-US")
        found = page.run(USED, given, name)
        assert found == (expected or ["00:00:00", "1970-01-04 13:03:20"])


TWO = """
const own = window.fetch;
window.fetch = async (url, how) => {
  const answer = await own(url, how);
  if (!url.startsWith('/api/state')) return answer;
  const state = await answer.json();
  const core = {sentence: '', why: [], proven: true};
  const none = {ranking: [], card: [], absorbed: [], error: '', next: '', core};
  const selected = ['entropic_heat', 'thermocouple_lag'];
  state.diagnosed = {...none, verdict: 'missing_effect', tag: 'Missing', sentence: 'Two.', selected, offer: selected};
  return new Response(JSON.stringify(state), {headers: {'Content-Type': 'application/json'}});
};
"""
BUTTONS = "return [...document.querySelectorAll('#panel-diagnose button')].map(b => b.innerText)"


@pytest.mark.slow  # a browser, and fits
def test_sensors_that_are_not_used_are_told_and_no_button_stands_there_twice(window, axe, tmp_path):
    """56 thermocouples were left out, and only a folded list said so."""
    pack = make_pack(tmp_path, cells=6, sensors=(1, 2, 3, 4, 5, 6), seconds=900)
    model = tmp_path / "few.toml"
    model.write_text(pack.model.read_text().replace("sensors = [1, 2, 3, 4, 5, 6]", "sensors = [1, 6]"))
    assert "[1, 6]" in model.read_text()
    with served(tmp_path, pack.hidden, "--model", model) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        page.click("#tab-open")
        told = "4 temperatures of the table are not used, because the model has no sensor there: cells 2 to 5."
        assert told in page.text("#opened .checks")
        assert page.there("#opened .checks")
        assert faults(page, axe) == []
        page.run(TWO)
        page.click("#tab-diagnose")
        page.run("dispatchEvent(new Event('focus'))")
        page.run(
            "const { desk } = JSON.parse(sessionStorage.workbench);"
            "await fetch(`/api/note?desk=${desk}`, {method: 'POST', headers: {'Content-Type': 'application/json'},"
            "body: JSON.stringify({notes: 'x'})});"
        )
        page.wait("return document.querySelector('#add-named')")
        adds = [text for text in page.run(BUTTONS) if text.startswith("Add ")]
        assert len(adds) == 1
        assert adds[0].endswith("thermocouples answer late (thermocouple_lag) at once")


def test_an_error_of_a_column_names_what_the_page_has(tmp_path):
    """The page has no option --columns."""
    (tmp_path / "bench.csv").write_text("time_s,current_A,T1\n" + "".join(f"{k},1,20\n" for k in range(5)))
    (tmp_path / "model.toml").write_text(format_model(cell_model("lg_m50")))
    files = {"tables": [str(tmp_path / "bench.csv")], "model": str(tmp_path / "model.toml"), "columns": []}
    wish = json.dumps({"do": "open", "folder": str(tmp_path), "files": files})
    command = [sys.executable, "-m", "bms_gateway.workbench.worker"]
    said = subprocess.run(command, input=wish + "\n", text=True, capture_output=True, check=True).stdout
    error = json.loads(said.splitlines()[-1])["error"]
    assert "no column 'coolant_inlet_C'" in error
    assert "--columns" not in error
    assert error.endswith(": say in the table of the columns which one it is, or type the inlet above it")
