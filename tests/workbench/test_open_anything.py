"""Opening in a real browser: a foreign table by its columns, a cell by a form, a log with its DBC, the example."""

import json
from pathlib import Path

import pytest

from bms_gateway.config.model_file import read_model
from tests.support.page_steps import FIT_S, seen_compared, seen_diagnosed
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import come, faults
from tests.workbench.conftest import served
from tests.workbench.foreign import german

pytestmark = pytest.mark.slow  # a browser, and fits
WORKED = Path(__file__).parents[2] / "deploy" / "worked"
DROP = (
    "const dt = new DataTransfer(); dt.items.add(new File([arguments[1]], arguments[0]));"
    "dispatchEvent(new DragEvent('drop', {dataTransfer: dt, cancelable: true}))"
)
SENT_LATE = "navigator.sendBeacon('/api/look?desk=' + JSON.parse(sessionStorage.workbench).desk, b);"
"""What a page that was left may still have sent."""
IS = "return [...document.querySelectorAll('#mapping tbody tr')].map(r => r.querySelector('select').value)"


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"))


@pytest.fixture(scope="module")
def url(pack):
    with served(pack.folder) as url:
        yield url


def choose(page, css, value):
    page.run(
        "const s = document.querySelector(arguments[0]);s.value = arguments[1]; s.dispatchEvent(new Event('change'))",
        css,
        value,
    )


def compared(page):
    page.wait(
        "return document.querySelector('#step-1') && document.querySelector('#plot-surface').dataset.traces",
        patience_s=FIT_S,
    )
    page.idle(FIT_S)


def test_a_german_table_from_another_tool_is_opened_by_its_columns(window, url, axe, pack, tmp_path):
    page = window(url)
    page.upload("#tables-file", german(pack.hidden, tmp_path / "Messung, Akku 7.csv"))
    page.wait("return document.querySelectorAll('#mapping tbody tr').length === 8")
    page.idle()
    shown = ["", "time_s", "current_A", "coolant_inlet_C", "soc", "coolant_flow_m3_s", "surface", "surface"]
    assert page.run(IS) == shown
    assert page.run("return document.querySelector('#column-2-flip').checked")  # the charge rises with it
    assert "guessed" in page.text("#mapping-told")
    assert "the SOC rises with it" in page.text("#mapping tbody tr:nth-child(3)")  # why, to be read without a pointer
    assert faults(page, axe) == []
    for width in (1024, 1280, 1920):  # all of the table is to be seen
        page.cdp("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False)
        page.wait("const s = document.querySelector('#mapping .scroll'); return s.scrollWidth <= s.clientWidth")

    # a wrong choice is told, and the values follow the unit
    choose(page, "#column-7", "")
    choose(page, "#column-6", "")
    assert "surface of a cell" in page.text("#mapping-told")
    for k, cell in ((6, "1"), (7, "3")):
        choose(page, f"#column-{k}", "surface")
        assert page.run(f"return document.querySelector('#column-{k}-cell').value") == cell
    for unit, seen in (("h", "89940 s"), ("min", "1499 s")):
        choose(page, "#column-1-unit", unit)
        page.wait("return document.querySelectorAll('#mapping tbody tr')[1].innerText.includes(arguments[0])", seen)
    page.idle()

    page.upload("#model-file", pack.model)
    page.wait("return document.querySelector('#model').value")
    page.click("#open")
    compared(page)
    assert "3,000 readings of cells 1, 3; a fit takes 2,996 of them" in page.text(
        "#opened"
    ) or "3000 readings of cells 1, 3" in page.text("#opened")
    page.click("#tab-take")  # the commands do the same
    assert "--columns 'current_A=-Packstrom, gesamt [mA]'" in page.text("#commands")
    assert page.complaints() == []


def test_a_foreign_table_of_the_command_line_shows_its_columns(window, pack, tmp_path):
    """The page asked for the table of the columns, and there was none."""
    table = german(pack.hidden, tmp_path / "messung.csv")
    with served(tmp_path, table, "--model", pack.model) as url:
        page = window(url)
        page.wait("return document.querySelectorAll('#mapping tbody tr').length > 6")
        page.idle()
        assert "columns" in page.text("#error-text")
        assert page.run("return document.querySelector('#tables').value") == str(table)
        assert page.run("return document.querySelector('#model').value") == str(pack.model)
        assert "guessed" in page.text("#mapping-told")
        page.click("#open")
        compared(page)
        assert page.text("#error-text") == ""


def test_each_of_several_tables_has_its_columns(window, url, pack, tmp_path):
    """Two by a foreign tool, which share their names, and one of ours; the fourth has other names again."""
    page = window(url)
    ours, other = tmp_path / "ours.csv", tmp_path / "other.csv"
    ours.write_bytes(pack.clean.read_bytes())
    head, _, rows = pack.clean.read_text().partition("\n")
    other.write_text(head.replace("current_A", "Strom (A)").replace("surface_3_C", "Platz drei") + "\n" + rows)
    for path in (german(pack.hidden, tmp_path / "eins.csv"), german(pack.clean, tmp_path / "zwei.csv"), ours, other):
        page.upload("#tables-file", path)
        page.wait("return document.querySelector('#tables').value.includes(arguments[0])", path.name)
    heads = "return [...document.querySelectorAll('#mapping h3')].map(h => h.innerText)"
    wanted = ["Columns of eins.csv, zwei.csv", "Columns of ours.csv", "Columns of other.csv"]
    come(lambda: page.run(heads) == wanted, lambda: page.run(heads))
    page.idle()
    assert "guessed" in page.text("#mapping-told")
    assert "the SOC rises with it" in page.text("#mapping tbody tr:nth-child(3)")  # also after the looks at the others
    assert page.text("#mapping-told-1") == "The names of the columns say what they are."
    third = "#table-2-column-6"
    assert page.run("return document.querySelector(arguments[0]).value", third) in ("", "surface")
    choose(page, third, "surface")
    choose(page, f"{third}-cell", "3")
    choose(page, "#table-2-column-1", "current_A")
    page.idle()
    page.upload("#model-file", pack.model)
    page.wait("return document.querySelector('#model').value")
    page.click("#open")
    compared(page)
    assert page.text("#error-text") == ""
    assert page.text("#opened").count("of cells 1, 3") == 4
    page.click("#tab-take")
    said = page.text("#commands").splitlines()
    assert said[0].startswith("# One command takes one mapping of columns")
    assert "# other.csv: current_A=Strom (A), surface_3_C=Platz drei" in said
    session = page.run("return fetch(document.querySelector('#take-session').href).then(r => r.json())")
    assert [len(pairs) for pairs in session["files"]["each"]] == [7, 7, 0, 2]
    page.reload()  # and each keeps them when the same files are opened anew
    page.idle(FIT_S)
    page.click("#tab-open")
    page.click("#open")
    compared(page)
    assert page.text("#error-text") == ""
    assert page.text("#opened").count("of cells 1, 3") == 4


def test_a_cell_that_is_described_needs_no_model_file(window, url, pack, tmp_path):
    page = window(url)
    page.upload("#tables-file", pack.hidden)
    page.wait("return document.querySelectorAll('#mapping tbody tr').length === 7")
    page.idle()
    page.click("#describe summary")
    page.wait("return document.querySelectorAll('#presets option').length > 20")
    page.type("#form-cell", "a123_32157 mauve")
    page.click("#open")
    page.wait("return document.querySelector('#error-text').innerText.includes(\"'mauve'\")")
    page.type("#form-cell", "a123_32157")
    page.type("#form-flow", "570")
    page.run("document.querySelector('#form-medium').value = 'air'")
    page.click("#open")
    compared(page)
    page.click("#tab-take")
    text = page.run("return fetch(document.querySelector('#take-model').href).then(r => r.text())")
    (tmp_path / "taken.toml").write_text(text)
    model = read_model(tmp_path / "taken.toml")
    assert (model.cells, model.sensors, model.condition) == (3, (1, 3), "full")
    assert model.priors["C_f"].value == pytest.approx(1190 * 570e-3 / 60, rel=1e-3)
    # a session goes the same way without the file, which was never anybody's
    session = page.run("return fetch(document.querySelector('#take-session').href).then(r => r.json())")
    assert session["files"]["model"] == ""
    assert session["files"]["form"]["cell"] == "a123_32157"
    page.reload()
    seen_compared(page)
    page.click("#tab-open")
    assert page.run("return document.querySelector('#form-cell').value") == "a123_32157"
    assert page.complaints() == []


def test_an_inlet_that_nobody_recorded_is_typed(window, url, pack, tmp_path, axe):
    page, table = window(url), tmp_path / "chamber.csv"
    head, _, rows = pack.hidden.read_text().partition("\n")
    table.write_text(head.replace("coolant_inlet_C", "remark") + "\n" + rows)
    page.upload("#tables-file", table)
    page.wait("return document.querySelector('#mapping-told')?.innerText === 'Still missing: coolant inlet.'")
    page.idle()
    page.upload("#model-file", pack.model)
    page.wait("return document.querySelector('#model').value")
    page.type("#inlet", "295,15 K")
    page.press("Tab")
    page.wait("return !document.querySelector('#mapping-told').innerText.includes('Still missing')")
    page.idle()
    assert faults(page, axe) == []
    page.reload()  # nothing is open yet, and what was filled in is still there
    page.wait("return document.querySelector('#inlet')?.value === '295,15 K'")
    assert page.run("return document.querySelector('#tables').value") == "chamber.csv"
    assert page.run("return document.querySelector('#model').value") == "pack.toml"
    page.idle()
    typed = "const i = document.querySelector('#inlet'); i.value = arguments[0]; i.dispatchEvent(new Event('change'));"
    page.run(f"{typed} location.reload()", "22 °C")  # at once, before what was typed has been looked at
    page.wait("return document.querySelector('#inlet')?.value === '22 °C'")
    page.idle()
    late = json.dumps({"tables": ["chamber.csv"], "each": [["coolant_inlet_C=23 °C"]]})
    page.run(f"const b = new Blob([{late!r}], {{type: 'application/json'}});" + SENT_LATE)  # after the page is loaded
    page.wait("return document.querySelector('#inlet')?.value === '23 °C'")
    page.run(typed, "295,15 K")
    page.click("#open")
    compared(page)
    assert page.text("#error-text") == ""
    page.click("#notes summary")
    assert "coolant_inlet_C is taken as 22 °C all along" in page.text("#notes")
    page.click("#tab-take")
    assert "--columns 'coolant_inlet_C=295,15 K'" in page.text("#commands")
    assert page.complaints() == []


def test_a_dropped_log_and_its_dbc_go_the_way_of_init(window, url):
    page = window(url)
    page.upload("#tables-file", WORKED / "drive.log.gz")
    page.wait("return document.querySelector('#mapping').innerText.includes('CAN log')")
    page.run(DROP, "vehicle.dbc", (WORKED / "vehicle.dbc").read_text())
    page.wait("return document.querySelector('#dbc').value === 'vehicle.dbc'")
    page.idle()
    page.wait("return document.querySelector('#mapping').innerText.includes('found with vehicle.dbc')")
    assert "needs a gateway config" not in page.text("#mapping")
    page.click("#open")
    compared(page)
    assert "readings of cells 1, 2, 3, 4" in page.text("#opened")
    page.click("#notes summary")
    assert "Current: BMS_PackStatus.PackCurrent" in page.text("#notes")
    assert "he cell is unknown" in page.text("#notes")
    assert page.complaints() == []


def test_the_example_is_one_click_and_has_something_to_find(window, url, axe):
    page = window(url, dark=True)
    page.click("#example")
    compared(page)
    assert faults(page, axe) == []
    seen_diagnosed(page)
    assert "entropic_heat" in page.text("#panel-diagnose .verdict")


def test_a_log_alone_says_what_it_needs(window, url):
    page = window(url)
    page.upload("#tables-file", WORKED / "drive.log.gz")
    page.wait("return document.querySelector('#mapping').innerText.includes('DBC')")
    page.idle()
    page.click("#describe summary")
    page.type("#form-cell", "lg_m50")
    page.click("#open")
    come(lambda: "drive.log.gz" in page.text("#error-text"), lambda: page.text("#error-text"))
