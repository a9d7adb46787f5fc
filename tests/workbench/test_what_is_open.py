"""What is open is told as it is: the string of a log, readings of file and fit, thermocouples by their record."""

import csv

import pytest

from bms_gateway.workbench.desk import Desk
from tests.data import need
from tests.support.desk_steps import done, files
from tests.support.page_steps import FIT_S, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser, and fits
TOLD = "return document.querySelector('#opened').textContent"


@pytest.mark.plain_cases(1)
def test_one_string_of_several_says_so_and_the_others_are_a_choice_away(window, tmp_path):
    """One of eight was opened in silence, and how the data were read was a wall of 290 lines."""
    log, dbc = need("can", "uwfe_july7_run12.log.gz"), need("dbc", "uwfe_2024CAR_fixed.dbc")
    with served(tmp_path) as url:
        page = window(url)
        page.upload("#tables-file", log)
        page.wait("return document.querySelector('#tables').value.includes('july7')")
        page.idle()
        page.upload("#tables-file", dbc)
        page.wait("return document.querySelector('#dbc').value.includes('uwfe')")
        page.idle()
        page.click("#open")
        page.wait("return document.querySelector('#string-told')", patience_s=FIT_S)
        page.idle(FIT_S)
        assert page.text("#string-told").startswith("string_1 of 8")
        options = "return [...document.querySelectorAll('#string-choice option')].map(o => o.value)"
        assert page.run(options) == [f"string_{k}" for k in range(1, 9)]
        page.run("document.querySelector('#notes').open = true")
        lines = page.run("return document.querySelectorAll('#notes > ul > li').length")
        notes = page.run("return document.querySelectorAll('#notes li').length")
        assert lines < 30 < notes < 200
        assert "string_2" not in page.run("return document.querySelector('#notes').textContent")
        assert "more of this kind" in page.text("#notes")
        page.run(
            "const s = document.querySelector('#string-choice'); s.value = 'string_2';"
            "s.dispatchEvent(new Event('change'))"
        )
        page.wait(
            "return document.querySelector('#string-told')?.innerText.startsWith('string_2 of 8')", patience_s=FIT_S
        )
        page.idle(FIT_S)
        assert page.run("return document.querySelector('#string').value") == "string_2"
        assert page.complaints() == []


def test_readings_of_a_long_file_are_those_of_the_file(window, tmp_path):
    """14,398 readings were said of a file with 72,000; they are means of 5 s, which a fit takes."""
    pack = make_pack(tmp_path, seconds=9000, cells=1, sensors=(1,))
    with pack.hidden.open(newline="") as f:
        heard = sum(bool(row["surface_1_C"]) for row in csv.DictReader(f))
    assert heard > 7200
    desk = Desk("test")
    try:
        desk.open(files(pack))
        (record,) = done(desk)["opened"]["records"]
    finally:
        desk.close()
    assert record["heard"] == heard
    assert record["readings"] < 0.75 * heard
    with served(tmp_path, *pack.words) as url:
        page = window(url)
        page.wait("return document.querySelector('#opened li')", patience_s=FIT_S)
        said = f"{heard:,} readings of cell 1; a fit takes {record['readings']:,} means of {record['means_s']:g} s"
        assert said in page.run(TOLD)
        page.idle(FIT_S)


def test_a_thermocouple_in_a_core_is_told_by_its_record(window, tmp_path):
    """The same sentence stood twice with other numbers, and neither said of which record it was."""
    pack = make_pack(tmp_path, seconds=800)
    for path in (pack.hidden, pack.clean):
        with path.open(newline="") as f:
            rows = list(csv.DictReader(f))
        with path.open("w", newline="") as f:
            out = csv.DictWriter(f, [*rows[0], "core_1_C"])
            out.writeheader()
            out.writerows({**r, "core_1_C": float(r["surface_1_C"] or "nan") + 1.0} for r in rows)
    with served(tmp_path, pack.hidden, pack.clean, "--model", pack.model) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        page.click("#tab-compare")
        said = page.run("return document.querySelector('#panel-compare').textContent")
        for name in ("hidden.csv", "clean.csv"):
            assert said.count(f"Thermocouple in the core of cell 1 of {name}, never fitted to: ") == 1
        assert page.complaints() == []
