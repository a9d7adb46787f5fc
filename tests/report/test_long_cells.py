"""Cells, names and times of any length: read in a time that grows as their length does, or refused in one line."""

import time
from itertools import product

import numpy as np
import pytest

from bms_gateway.errors import DataError
from bms_gateway.records.read import read_measurements
from bms_gateway.report.columns import split_unit
from bms_gateway.report.dates import date_form
from bms_gateway.report.table import read_table
from bms_gateway.report.table_cells import is_number
from tests.cli.measured_tables import MODEL

LONG = 30_000
SOON_S = 2.0
"""A time that grows with the square of the length takes minutes; one that grows with the length, milliseconds."""


@pytest.fixture
def soon():
    begun = time.process_time()
    yield
    assert time.process_time() - begun < SOON_S


@pytest.mark.parametrize("cell", ["1" * LONG + "x", "1" + " " * LONG + "x", "+" * LONG, "1" + ".111" * LONG + "x"])
def test_a_long_cell_is_soon_known_to_be_no_number(cell, soon):
    assert not is_number(cell)


@pytest.mark.parametrize(("cell", "says"), [("5.", True), (".5", True), ("5.e3", True), (".", False), ("5..", False)])
def test_a_point_may_stand_at_either_end_of_a_number(cell, says):
    assert is_number(cell) is says


def test_noon_is_soon_looked_for_in_long_cells(soon):
    told = date_form(["03/04/2026 10:00:00", "x" + " " * LONG + "x"])
    assert isinstance(told, str)
    assert "which is the day" in told


@pytest.mark.parametrize("name", ["a" + " " * LONG + "x", "a" + "_" * LONG + "[", "a[" * LONG, "a ,; " * LONG + "(A"])
def test_a_long_name_has_soon_been_split(name, soon):
    assert split_unit(name) == (name, None)


@pytest.mark.parametrize("marks", [*product(["[", "("], ["]", ")"], ["", " ", " _ "])])
def test_units_in_brackets_stand_behind_blanks_and_strokes(marks):
    opens, closes, between = marks
    assert split_unit(f"T (x) cell{between}{opens} degC {closes}") == ("T (x) cell", "degC")


def test_times_of_day_go_on_for_any_number_of_days(soon):
    """Midnights were counted one by one, for each row all of those before it."""
    cells = [f"{8 * (k % 3):02d}:00:00" for k in range(LONG)]
    form = date_form(cells[:3])
    assert np.array_equal(form.seconds(cells), 8 * 3600.0 * np.arange(LONG))


@pytest.mark.parametrize("at", ["0001-01-01T00:00:00+14:00", "9999-12-31T23:59:00-14:00"])
@pytest.mark.parametrize("first", [True, False])
def test_times_beyond_the_calendar_are_one_line(tmp_path, at, first):
    rows = [f"{t},1,25" for t in ([at, "2026-01-01T00:00:00Z"] if first else ["2026-01-01T00:00:00Z", at])]
    file = tmp_path / "t.csv"
    file.write_text("\n".join(["time_s,current_A,coolant_inlet_C", *rows]))
    with pytest.raises(DataError) as told:
        read_table(file)
    line = 2 if first else 3
    assert str(told.value) == f"{file}: line {line}: column 'time_s': '{at}' is no time; the column has ISO dates"


@pytest.mark.parametrize(
    ("times", "says"),
    [
        (("0001-01-01", "9999-12-31"), "time_s goes on by 3.15538e+11 from row to row, where less than 100 s are"),
        (("-1e300", "0", "1e300"), "time_s looks like milliseconds, it must be in seconds: it ends at 1e+300, after"),
        (("-9e5", *range(40)), "it spans 10.4 days, more than the 10 that one table may"),
    ],
)
def test_what_is_no_time_of_one_measurement_is_told_however_it_is_written(tmp_path, times, says):
    """Times that begin below zero were not looked at, and dates were taken for milliseconds."""
    file = tmp_path / "t.csv"
    rows = [f"{t},1,25,26" for t in times]
    file.write_text("\n".join(["time_s,current_A,coolant_inlet_C,surface_1_C", *rows]))
    with pytest.raises(DataError) as told:
        read_measurements([file], model=MODEL)
    assert says in str(told.value)
    assert ("milliseconds" in str(told.value)) == (times[0] != "0001-01-01")


@pytest.mark.parametrize(
    ("unit", "first", "says"),
    [
        ("ns", 1_767_225_600_000_000_001, "2026-01-01 00:00:00"),
        ("ms", 1_767_225_600_250, "2026-01-01 00:00:00.250000"),
        ("s", 1 << 40, "1.09951e+12 s after 1970"),
        ("s", -(1 << 40), "-1.09951e+12 s after 1970"),
        ("us", -62_135_596_800_000_000, "0001-01-01 00:00:00"),
    ],
)
@pytest.mark.parametrize("zone", [None, "America/New_York"])
def test_stamps_of_parquet_may_have_nanoseconds_and_any_year(tmp_path, unit, first, says, zone):
    """Dates of Python can hold neither: a traceback."""
    pyarrow = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    step = {"s": 1, "ms": 500, "us": 500_000, "ns": 500_000_000}[unit]
    stamps = pyarrow.array([first + k * step for k in range(5)], pyarrow.timestamp(unit, tz=zone))
    file = tmp_path / "t.parquet"
    pq.write_table(pyarrow.table({"time_s": stamps, "current_A": [1.0] * 5, "coolant_inlet_C": [25.0] * 5}), file)
    t = read_table(file)
    assert t.time_s == pytest.approx(np.arange(5) * (1.0 if unit == "s" else 0.5), abs=1e-9)
    assert t.notes == (f"'time_s' has dates: time_s is counted from its first row, {says}",)
    assert t.dated
