"""What nobody measured is not drawn like a measurement: on the page, in the report, and among the values at cursors."""

import csv

import pytest

from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.record import make_record
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.report.html_figures import drive
from bms_gateway.report.html_series import clock
from bms_gateway.workbench.desk import Desk
from tests.diagnosis.logs import rows, string_model
from tests.report.html_page import unpacked
from tests.support.desk_steps import done
from tests.support.page_steps import FIT_S
from tests.truth.packs import pack as make_pack
from tests.workbench.conftest import served

INLET, SOC = "not measured: 24 °C all along", "not measured: counted from an assumed start"


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    """A table with neither an inlet nor a state of charge nor a voltage, which would tell its level."""
    made = make_pack(tmp_path_factory.mktemp("pack"), seconds=800)
    with made.hidden.open(newline="") as f:
        read = list(csv.DictReader(f))
    with made.hidden.open("w", newline="") as f:
        names = [n for n in read[0] if n not in ("coolant_inlet_C", "soc", "voltage_V")]
        out = csv.DictWriter(f, names, extrasaction="ignore")
        out.writeheader()
        out.writerows(read)
    return made


def dashes(figure):
    return {d["name"]: (d["line"]["dash"], d.get("meta", "")) for d in figure["data"]}


def figure_of(record, model):
    return drive(measured(record, model), clock(3000.0), 200, model.flow)


@pytest.mark.parametrize("lacks", [(), ("soc",), ("soc", "voltage_V")])
def test_a_counted_charge_says_from_where(lacks):
    model = string_model()
    own = {k: x for k, x in rows().items() if k not in lacks}
    record = make_record(Columns(**own), model)
    dash, told = dashes(figure_of(record, model))["SOC, %"]
    expected = "" if not lacks else SOC if "voltage_V" not in own else "not measured: counted, its start by the voltage"
    assert told == expected
    assert dash == ("dash" if lacks else "solid")
    assert dashes(figure_of(record, model))["inlet, °C"] == ("solid", "")


def test_what_nobody_measured_is_dashed_and_says_so(pack):
    """A charge that was counted from a start that nobody gave, and a typed inlet, looked like measurements."""
    desk = Desk("test")
    try:
        desk.open(
            {"tables": [str(pack.hidden)], "model": str(pack.model), "config": "", "string": "",
             "columns": ["coolant_inlet_C=24 °C"]}
        )  # fmt: skip
        assert done(desk)["error"] == ""
        figure = desk.figure("drive-0")
        assert dashes(figure) == {
            "current, A": ("solid", ""), "inlet, °C": ("dash", INLET), "SOC, %": ("dash", SOC),
        }  # fmt: skip
        assert {a["text"] for a in figure["layout"]["annotations"]} == {INLET, SOC}
        names = [m["name"] for m in desk.measures(["drive-0"], None, None)]
        assert names == ["current", f"inlet ({INLET})", f"SOC ({SOC})"]
    finally:
        desk.close()


@pytest.mark.slow
def test_the_page_and_its_report_say_it(window, pack):
    with served(pack.folder, pack.hidden, "--model", pack.model, "--columns", "coolant_inlet_C=24 °C") as url:
        page = window(url)
        page.wait("return document.querySelector('#plot-drive').data?.length === 3", patience_s=FIT_S)
        page.idle(FIT_S)
        shown = "return document.querySelector('#plot-drive').textContent"
        assert INLET in page.run(shown)
        assert SOC in page.run(shown)
        within = (
            "const p = document.querySelector('#plot-drive'), b = p.getBoundingClientRect();"
            "return [...p.querySelectorAll('.annotation')].every(a => a.getBoundingClientRect().right <= b.right)"
        )
        assert page.run(within)
        lines = "[...document.querySelectorAll('#plot-drive .js-line')]"
        assert [d == "none" for d in page.run(f"return {lines}.map(e => getComputedStyle(e).strokeDasharray)")] == [
            True,
            False,
            False,
        ]
        page.press("c")
        page.wait("return document.querySelectorAll('#measures tbody tr').length > 3")
        assert f"SOC ({SOC}), %" in page.text("#measures")
        desk = page.run("return JSON.parse(sessionStorage.workbench).desk")
        take = "return fetch(`/api/take?desk=${arguments[0]}&what=report`).then(r => r.text())"
        figures = unpacked(page.run(take, desk), "figures").decode()
        assert INLET in figures
        assert SOC in figures
        assert page.complaints() == []
