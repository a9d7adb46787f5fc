"""Tables as people have them read like the plain one; what cannot be told is asked for, with the line to add."""

import re

import numpy as np
import pytest

from bms_gateway.errors import DataError
from bms_gateway.report.dates import date_form
from bms_gateway.report.look import look
from bms_gateway.report.table import parse_columns, read_table

N = 60
T = np.arange(N) * 0.5
CURRENT = 10 * np.sin(T / 3) + 0.25
INLET = 20 + T / 40
SURFACE = 25.5 + T / 20
SOC = 0.9 - T / 200
NAMES = ("time_s", "current_A", "coolant_inlet_C", "soc", "surface_1_C")


def columns():
    return dict(zip(NAMES, (T, CURRENT, INLET, SOC, SURFACE), strict=True))


def text(changed=None, names=NAMES, mark=",", below=None):
    """Write the plain table with some columns in other words: a list of cells, or a function of a value."""
    changed = changed or {}
    cells = []
    for name, values in columns().items():
        how = changed.get(name, lambda x: f"{x:.6f}")
        cells.append(how if isinstance(how, list) else [how(x) for x in values])
    rows = [mark.join(names), *([mark.join(below)] if below else []), *(mark.join(r) for r in zip(*cells, strict=True))]
    return "\n".join(rows) + "\n"


def reads_alike(t, at=2e-6):
    for name in NAMES[1:4]:
        assert np.allclose(getattr(t, name), columns()[name], atol=at), name
    assert np.allclose(t.surface_C[1], SURFACE, atol=at)
    assert np.allclose(t.time_s - t.time_s[0], T, atol=at)


def put(tmp_path, content, codec="utf-8"):
    file = tmp_path / "t.csv"
    file.write_bytes(content.encode(codec))
    return file


def comma(x):
    return f"{x:.6f}".replace(".", ",")


@pytest.mark.parametrize("codec", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
def test_encodings_read_alike(tmp_path, codec):
    content = text(names=("time_s", "current_A", "coolant_inlet_C", "soc", "surface 1 (°C)"))
    t = read_table(put(tmp_path, content, codec))
    reads_alike(t)
    assert any("1252" in n for n in t.notes) == (codec == "cp1252")
    assert any("UTF-16" in n for n in t.notes) == codec.startswith("utf-16")


@pytest.mark.parametrize("codec", ["utf-16", "cp1252"])
def test_an_encoding_survives_how_a_file_is_cut(tmp_path, codec, monkeypatch):
    monkeypatch.setattr("bms_gateway.report.file_rows.CHUNK", 33)
    content = text(names=("time_s", "current_A", "coolant_inlet_C", "soc", "surface 1 (°C)"))
    reads_alike(read_table(put(tmp_path, content, codec)))


def test_decimal_commas_between_semicolons(tmp_path):
    t = read_table(put(tmp_path, text(dict.fromkeys(NAMES, comma), mark=";")))
    reads_alike(t)
    assert "decimal commas" in t.notes


def test_decimal_commas_in_quotes_and_points_that_part_thousands(tmp_path):
    rows = [f'{k};"{k},5";20,25;0,5;25' for k in range(20)]
    rows[3] = "3;-1.234,5;20,25;0,5;25"
    t = read_table(put(tmp_path, ";".join(NAMES) + "\n" + "\n".join(rows)))
    assert t.current_A[3] == -1234.5
    assert t.current_A[4] == 4.5
    assert "decimal commas, points part thousands" in t.notes


def test_names_with_the_other_mark_do_not_cut_the_columns(tmp_path):
    names = ("Zeit, s", "Strom, A", "Vorlauf, °C", "soc", "Haut, °C")
    pairs = ["time_s=Zeit, s,current_A=Strom, A,coolant_inlet_C=Vorlauf, °C", "surface_1_C=Haut, °C"]
    reads_alike(read_table(put(tmp_path, text(dict.fromkeys(NAMES, comma), names, ";")), parse_columns(pairs)))


def test_excels_own_first_line_is_none_of_the_table(tmp_path):
    reads_alike(read_table(put(tmp_path, "sep=;\n" + text(mark=";"))))


UNITS = {
    "time_s": [
        ("ms", lambda x: f"{1000 * x:.3f}"),
        ("min", lambda x: f"{x / 60:.9f}"),
        ("h", lambda x: f"{x / 3600:.11f}"),
    ],
    "current_A": [("mA", lambda x: f"{1000 * x:.3f}"), ("kA", lambda x: f"{x / 1000:.9f}")],
    "coolant_inlet_C": [("K", lambda x: f"{x + 273.15:.6f}"), ("°F", lambda x: f"{32 + 1.8 * x:.6f}")],
    "soc": [("%", lambda x: f"{100 * x:.6f}")],
    "surface_1_C": [("K", lambda x: f"{x + 273.15:.6f}"), ("degF", lambda x: f"{32 + 1.8 * x:.6f}")],
}
CASES = [(name, unit, how) for name, kinds in UNITS.items() for unit, how in kinds]


@pytest.mark.parametrize(("name", "unit", "how"), CASES)
@pytest.mark.parametrize("where", ["brackets", "round", "below", "asked"])
def test_units_are_converted_and_told(tmp_path, name, unit, how, where):
    base = {"time_s": "Time", "current_A": "current", "coolant_inlet_C": "Coolant inlet", "surface_1_C": "Surface 1"}
    bare = base.get(name, name)
    own = {"brackets": f"{bare} [{unit}]", "round": f"{bare} ({unit})", "below": bare, "asked": "x"}[where]
    below = None
    if where == "below":
        below = [
            f"[{unit}]" if n == name else {"time_s": "s", "current_A": "A", "soc": "-"}.get(n, "°C") for n in NAMES
        ]
    names = tuple(own if n == name else n for n in NAMES)
    pairs = parse_columns([f"{name}=x [{unit}]"]) if where == "asked" else None
    t = read_table(put(tmp_path, text({name: how}, names, below=below)), pairs)
    reads_alike(t)
    assert any(f"converted from {unit}" in n for n in t.notes)


@pytest.mark.parametrize("written", ["20.25", "20,25 °C", "68.45 °F", "293.4 [K]", "+20.25 degC"])
def test_an_inlet_that_nobody_recorded_may_be_a_constant(tmp_path, written):
    names = tuple("room" if n == "coolant_inlet_C" else n for n in NAMES)
    path = put(tmp_path, text(names=names))
    t = read_table(path, parse_columns([f"current_A=current_A,coolant_inlet_C={written}"]))
    assert t.coolant_inlet_C == pytest.approx(np.full(len(t), 20.25), abs=1e-6)
    assert "coolant_inlet_C is taken as 20.25 °C all along: no column has it" in t.notes
    assert look(path, parse_columns([f"coolant_inlet_C={written}"]))["inlet"] == written


@pytest.mark.parametrize(
    ("written", "says"),
    [
        ("293", "must be -38.5 to 120 °C; is it in another unit?"),
        ("20 bar", "no column '20 bar' for coolant_inlet_C"),
        ("chamber", "a constant inlet: --columns 'coolant_inlet_C=22 °C'"),
        ("nan", "no column 'nan'"),
    ],
)
def test_what_is_no_constant_inlet_is_one_line(tmp_path, written, says):
    with pytest.raises(DataError, match=re.escape(says)):
        read_table(put(tmp_path, text()), {"coolant_inlet_C": written})


def test_a_column_that_is_called_like_a_number_is_a_column(tmp_path):
    names = tuple("22" if n == "coolant_inlet_C" else n for n in NAMES)
    reads_alike(read_table(put(tmp_path, text(names=names)), {"coolant_inlet_C": "22"}))


def test_no_other_quantity_is_a_constant(tmp_path):
    with pytest.raises(DataError, match="no column '22' for current_A"):
        read_table(put(tmp_path, text()), {"current_A": "22"})


def test_a_unit_at_the_end_of_a_name_counts(tmp_path):
    names = ("time_ms", "current_mA", "coolant_inlet_K", "soc_pct", "surface_1_F")
    how = {n: k[0][1] for n, k in UNITS.items()} | {"surface_1_C": UNITS["surface_1_C"][1][1]}
    reads_alike(read_table(put(tmp_path, text(how, names))))


@pytest.mark.parametrize("top", [100.0, 103.5])
def test_percent_are_told_and_a_little_above_full_is_full(tmp_path, top):
    values = [f"{max(top - k / 10, 40):.1f}" for k in range(N)]
    t = read_table(put(tmp_path, text({"soc": values})))
    assert t.soc.max() == 1.0
    assert t.soc[-1] == pytest.approx((top - 5.9) / 100)
    assert "SOC is in per cent" in t.notes
    assert any("taken as empty or full" in n for n in t.notes) == (top > 100)


STAMPS = {
    "ISO": [f"2026-11-03T23:59:{40 + x:04.1f}" if x < 20 else f"2026-11-04T00:00:{x - 20:04.1f}" for x in T],
    "ISO zone": [f"2026-11-03 23:59:{10 + x:04.1f}+01:00" for x in T],
    "ISO Z, slashes": [f"2026/11/03 23:59:{10 + x:04.1f}Z" for x in T],
    "German": [f"03.11.2026 10:00:{x:04.1f}".replace(".0", ",0").replace(".5", ",5") for x in T],
    "German, two digits, midnight": [
        f"31.12.26 23:59:{40 + x:06.3f}" if x < 20 else f"01.01.27 00:00:{x - 20:06.3f}" for x in T
    ],
    "English": [f"25/12/2026 10:00:{x:04.1f}" for x in T],
    "American": [f"3/4/2026 1:59:{30 + x:04.1f} PM" for x in T],
    "a clock of twelve hours": [f"11:59:{40 + x:04.1f} AM" if x < 20 else f"12:00:{x - 20:04.1f} pm" for x in T],
    "ISO of twelve hours, midnight": [
        f"2026-11-03 11:59:{40 + x:04.1f} PM" if x < 20 else f"2026-11-04 12:00:{x - 20:04.1f} AM" for x in T
    ],
    "one day of slashes": [f"03/04/2026 10:00:{x:04.1f}" for x in T],
    "a clock of twelve hours, with points": [
        f"11:59:{40 + x:04.1f} a.m." if x < 20 else f"12:00:{x - 20:04.1f} p. m." for x in T
    ],
    "English names": [f"26-Nov-2026 10:00:{x:04.1f}" for x in T],
    "German names, two digits": [f"26. März 26, 10:00:{x:04.1f}" for x in T],
    "a clock past midnight": [f"23:59:{40 + x:04.1f}" if x < 20 else f"00:00:{x - 20:04.1f}" for x in T],
}


@pytest.mark.parametrize("kind", STAMPS)
def test_dates_and_clocks_become_seconds(tmp_path, kind):
    names = ("Zeit", *NAMES[1:])
    t = read_table(put(tmp_path, text({"time_s": STAMPS[kind]}, names, mark=";")), {"time_s": "Zeit"})
    reads_alike(t)
    assert t.time_s[0] == 0.0
    assert any("time_s is counted from its first row" in n for n in t.notes)


def test_day_or_month_is_asked_for_and_then_taken(tmp_path):
    stamps = [f"0{3 + k // 30}/04/2026 10:00:{k % 30:02d}" for k in range(N)]
    file = put(tmp_path, text({"time_s": stamps}))
    with pytest.raises(DataError, match=r"--columns 'time_s=time_s \[dd/mm/yyyy\]'"):
        read_table(file)
    for how, step in (("dd/mm/yyyy", 86_400), ("mm/dd/yyyy", 30 * 86_400 + 86_400)):
        t = read_table(file, parse_columns([f"time_s=time_s [{how}]"]))
        assert t.time_s[30] == pytest.approx(step, rel=0.04)


def test_a_minus_sign_of_a_printed_table_is_a_minus(tmp_path):
    for mark, how in ((";", comma), (",", lambda x: f"{x:.6f}")):
        given = text({n: lambda x, how=how: how(x).replace("-", "\u2212") for n in NAMES}, mark=mark)
        assert "\u2212" in given
        reads_alike(read_table(put(tmp_path, given)))


@pytest.mark.parametrize("blank", [" ", "\u00a0", "\u202f"])
def test_thousands_parted_by_blanks_are_read(tmp_path, blank):
    def spaced(x):
        return f"{1e5 * x:,.1f}".replace(",", blank).replace(".", ",").replace("-", "\u2212")

    names = ("time_s", "current [mA]", *NAMES[2:])
    given = text({**dict.fromkeys(NAMES, comma), "current_A": spaced}, names, mark=";")
    assert spaced(10.25) == f"1{blank}025{blank}000,0"
    t = read_table(put(tmp_path, given), parse_columns(["current_A=current [mA]"]))
    assert np.allclose(t.current_A, 100 * CURRENT, atol=1e-3)


def test_a_charge_beyond_all_scales_is_told_in_the_unit_of_its_column(tmp_path):
    names = (*NAMES[:3], "soc [%]", NAMES[4])
    file = put(tmp_path, text({"soc": ["-10.03" if k == 30 else "50" for k in range(N)]}, names))
    with pytest.raises(DataError, match=r"line 32: soc is -10.03 %; it must be 0 to 100 %"):
        read_table(file)


@pytest.mark.parametrize(
    ("stamps", "says"),
    [
        ([f"13/11/2026 08:{59 - k:02d}:00" for k in range(N)], r"line 3: time_s goes back \(0 then -60\)"),
        ([f"05/11/2026 08:{59 - k:02d}:00" for k in range(N)], r"line 3: time_s goes back \(0 then -60\)"),
        ([f"11/13/2026 08:00:{k // 2:02d}" for k in range(N)], r"line 3: time_s stands still \(0 then 0\)"),
        (
            [f"25/10/2026 02:59:{57 + k}" if k < 3 else f"25/10/2026 02:00:{k - 3:02d}" for k in range(N)],
            r"line 5: time_s goes back \(2 then -3597\); it must increase: one hour back is the end of summer time",
        ),
        (["13/11/2026 08:00:00", "soon", *["13/11/2026 08:00:02"] * (N - 2)], "line 3: .*'soon' is no time"),
    ],
)
def test_dates_that_go_back_are_told_as_such_not_as_an_unknown_order(tmp_path, stamps, says):
    with pytest.raises(DataError, match=says):
        read_table(put(tmp_path, text({"time_s": stamps})))


def test_an_order_in_which_time_goes_forward_is_taken(tmp_path):
    assert date_form(["11/01/2026", "12/01/2026", "01/02/2026"]).name == "dates as dd/mm/yyyy"
    assert date_form(["01/11/2026", "01/12/2026", "02/01/2026"]).name == "dates as mm/dd/yyyy"


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("11:59 AM", "12:01 p.m."),
        ("26. November 2026 10:00", "26. November 2026 10:02"),
        ("1-May-26 9:59", "1-May-26 10:01"),
    ],
)
def test_minutes_without_seconds_are_times_too(first, second):
    form = date_form([first, second])
    assert form.seconds([first, second]).tolist() == [0.0, 120.0]


def test_years_of_two_digits_between_slashes_are_asked_for_and_then_taken(tmp_path):
    file = put(tmp_path, text({"time_s": [f"11/26/26 10:00:{x:04.1f}" for x in T]}))
    with pytest.raises(DataError, match=r"which of the numbers is the year .*--columns 'time_s=time_s \[mm/dd/yyyy\]'"):
        read_table(file)
    reads_alike(read_table(file, parse_columns(["time_s=time_s [mm/dd/yyyy]"])))


@pytest.mark.parametrize("word", ["12-Foo-2026 10:00:00", "10-Amp-2026", "11:59 XM"])
def test_what_only_looks_like_a_date_is_none(word):
    assert date_form([word]) is None


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (text(names=("time_s", "current [furlong]", *NAMES[2:])), r"'furlong' is no unit .*--columns 'current_A="),
        (text(names=NAMES, below=["s", "mA", "K", "-", "°C"]), r"--columns 'current_A=current_A \[mA\]'"),
        (text(names=("Zeit", *NAMES[1:])), r"--columns 'time_s=Zeit'"),
        (text(names=(NAMES[0], "Strom", *NAMES[2:])), r"--columns 'current_A=Strom'"),
        (text({"time_s": [f"12:{k:02d}" for k in range(N)]}), "hh:mm:ss"),
        (text({"current_A": ["1,5" if k == 7 else "1.5" for k in range(N)]}, mark=";"), "line 9.*decimal commas and"),
        (text({"soc": ["170" if k == 30 else "50" for k in range(N)]}), "line 32: soc is 170; it must be 0 to 100 %"),
        (text({"time_s": [*STAMPS["ISO"][:-1], "later"]}), "line 61.*'later' is no time"),
        (
            text({"time_s": [*STAMPS["a clock of twelve hours"][:-1], "13:00:50 PM"]}),
            "line 61.*'13:00:50 PM' is no time",
        ),
    ],
)
def test_what_cannot_be_told_is_one_line_with_what_to_add(tmp_path, content, says):
    with pytest.raises(DataError, match=says):
        read_table(put(tmp_path, content))


def test_words_for_nothing_are_blanks(tmp_path):
    values = [("n/a", "NaN", "-", "#N/A", "null")[k % 5] if k > 5 else "1.5" for k in range(N)]
    t = read_table(put(tmp_path, text({"current_A": values})))
    assert np.isnan(t.current_A[6:]).all()


def test_parquet_with_stamps_counts_from_its_first_row(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    start = np.datetime64("2026-11-03T10:00:00.000000")
    table = {n: x for n, x in columns().items() if n != "time_s"}
    table["time_s"] = start + (1e6 * T).astype("timedelta64[us]")
    parquet.write_table(pyarrow.table(table), tmp_path / "t.parquet")
    reads_alike(read_table(tmp_path / "t.parquet"))


@pytest.mark.parametrize(
    "tail", [" degF", ", degF", ", F", ",°F", " deg F", ", deg F", " Fahrenheit", " (degF)", " °F"]
)
@pytest.mark.parametrize("asked", [False, True])
def test_fahrenheit_in_a_name_is_converted_however_it_is_written(tmp_path, tail, asked):
    name = "TC1" if asked else "surface 1"
    content = text({NAMES[4]: lambda x: f"{1.8 * x + 32:.6f}"}, (*NAMES[:4], f'"{name}{tail}"'))
    pairs = parse_columns([f"surface_1_C={name}{tail}"]) if asked else None
    t = read_table(put(tmp_path, content), pairs)
    reads_alike(t)
    assert any("converted from" in n for n in t.notes)


@pytest.mark.parametrize("letter", ["F", "K"])
def test_a_letter_that_may_be_a_unit_is_asked_for(tmp_path, letter):
    file = put(tmp_path, text(names=(*NAMES[:4], f"TC1 {letter}")))
    with pytest.raises(DataError, match=rf"is {letter} its unit\? say it: --columns 'surface_1_C=TC1 {letter} \["):
        read_table(file, parse_columns([f"surface_1_C=TC1 {letter}"]))
    reads_alike(read_table(file, parse_columns([f"surface_1_C=TC1 {letter} [°C]"])))


TITLES = (
    "Prüfstand 7; Zelle <b>3</b>\nDatum: 13.11.2026 08:15\n\n",  # a blank line too
    "Prüfstand 7;;;;\nDatum;13.11.2026;;;\n",  # as Excel writes it
    "\n".join(f"Kanal {k}: 1,5 V" for k in range(30)) + "\n",
)


@pytest.mark.parametrize("title", TITLES, ids=["words", "excel", "thirty lines"])
@pytest.mark.parametrize("below", [None, ("s", "A", "°C", "1", "°C")], ids=["plain", "units"])
def test_lines_above_the_names_are_a_title(tmp_path, title, below):
    changed = dict.fromkeys(NAMES, comma)
    below = below and ("s", "A", "°C", "-", "°C")
    t = read_table(put(tmp_path, title + text(changed, mark=";", below=below), "cp1252"))
    reads_alike(t)
    (said,) = [note for note in t.notes if "title" in note]
    at = 1 + title.count("\n")
    assert said.endswith(f"line {at} as the names of the columns")
    shown = look(put(tmp_path, title + text(changed, mark=";", below=below), "cp1252"))
    assert [c["name"] for c in shown["columns"]] == list(NAMES)


def test_a_broken_line_below_a_title_is_told_by_its_own_number(tmp_path):
    content = "Bench 7\nrun 3\n" + text().replace(f"{INLET[4]:.6f}", "warm")
    with pytest.raises(DataError, match=r"line 8: column 'coolant_inlet_C': 'warm' is not a number"):
        read_table(put(tmp_path, content))


def test_a_short_header_is_no_title(tmp_path):
    content = text().replace(",surface_1_C", "", 1)
    with pytest.raises(DataError, match="line 2: 5 columns, the header has 4"):
        read_table(put(tmp_path, content))


@pytest.mark.parametrize("word", ["#NV", "#N/A"])
def test_what_excel_writes_where_nothing_is_available_is_no_value(tmp_path, word):
    cells = [f"{x:.6f}" for x in SURFACE]
    cells[3] = cells[7] = word
    t = read_table(put(tmp_path, text({"surface_1_C": cells})))
    assert np.flatnonzero(np.isnan(t.surface_C[1])).tolist() == [3, 7]


@pytest.mark.parametrize(("header_ends", "rows_end"), [("\t", ""), ("", "\t"), ("\t", "\t")])
def test_an_export_with_a_title_whose_header_or_rows_end_with_a_separator(tmp_path, header_ends, rows_end):
    path = tmp_path / "GCPL.mpt.csv"
    title = [
        "EC-Lab ASCII FILE",
        "Nb header lines : 6",
        "",
        "Modulo Bat",
        "Acquisition started on : 11/27/2026 08:00:00",
    ]
    head = "mode\ttime/s\tEwe/V\tI/mA\tTemperature/°C" + header_ends
    rows = [f"1\t{k:.6E}\t3.7000000E+000\t{1000 * (k % 3):.3E}\t{22 + k % 2}{rows_end}" for k in range(60)]
    path.write_bytes("\r\n".join([*title, head, *rows, ""]).encode("latin-1"))
    found = {c["name"]: c["ours"] for c in look(path)["columns"] if c["ours"]}
    assert found == {
        "time/s": "time_s",
        "Ewe/V": "voltage_V",
        "I/mA": "current_A",
        "Temperature/°C": "surface_1_C",
    }
    columns = ["time_s=time/s", "current_A=-I/mA", "surface_1_C=Temperature/°C", "coolant_inlet_C=22 °C"]
    table = read_table(path, parse_columns(columns))
    assert table.time_s.tolist() == [float(k) for k in range(60)]
    assert table.current_A.tolist() == [-float(k % 3) for k in range(60)]
    assert table.surface_C[1].tolist() == [22.0 + k % 2 for k in range(60)]


def test_columns_parted_by_blanks_are_told(tmp_path):
    path = tmp_path / "blanks.csv"
    rows = [f"{k}   {k % 3}   20.0   21.5" for k in range(30)]
    path.write_text("\n".join(["time_s   current_A   coolant_inlet_C   surface_1_C", *rows]) + "\n")
    with pytest.raises(DataError, match=r"only one column, .*: part the columns by commas, semicolons or tabs"):
        read_table(path)
