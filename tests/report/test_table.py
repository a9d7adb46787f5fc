"""Tables are read as they are meant, and a broken one is told with its line."""

import contextlib
import gzip
import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bms_gateway.errors import DataError, MissingExtraError, UsageError
from bms_gateway.report.table import parse_columns, read_table
from tests.data import need

GOOD = """\
time_s,current_A,coolant_inlet_C,voltage_V,surface_1_C,surface_12_C,core_3_C,cell_voltage_2_V
0,1.5,25.0,3.3,25.1,25.2,26.0,3.31
1.5,,25.1,3.2,,25.3,26.1,3.32
2.25,-2,25.2,,25.3,25.4,,
"""


def put(tmp_path, text, name="t.csv"):
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    return file


def test_blanks_are_missing_and_sampling_may_be_irregular(tmp_path):
    t = read_table(put(tmp_path, GOOD))
    assert t.time_s.tolist() == [0.0, 1.5, 2.25]
    assert np.array_equal(t.current_A, [1.5, np.nan, -2.0], equal_nan=True)
    assert np.array_equal(t.voltage_V, [3.3, 3.2, np.nan], equal_nan=True)
    assert list(t.surface_C) == [1, 12]
    assert np.array_equal(t.surface_C[1], [25.1, np.nan, 25.3], equal_nan=True)
    assert list(t.core_C) == [3]
    assert list(t.cell_voltage_V) == [2]
    assert t.soc is None
    assert t.coolant_flow_m3_s is None
    assert t.ignored == ()


@pytest.mark.parametrize("mark", [",", ";", "\t"])
@pytest.mark.parametrize("bom", ["", "\ufeff"])
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_dialects_of_csv_read_alike(tmp_path, mark, bom, ending):
    text = bom + ("# from the bench\n" + GOOD + "\n").replace(",", mark).replace("\n", ending)
    (tmp_path / "t.csv").write_bytes(text.encode())
    assert read_table(tmp_path / "t.csv").surface_C[12].tolist() == [25.2, 25.3, 25.4]


def test_quoted_and_packed_tables_read_alike(tmp_path):
    text = 'time_s,current_A,coolant_inlet_C,"a, remark"\n0,1,"25","x, y"\n1,2,26,""\n'
    (tmp_path / "t.csv.gz").write_bytes(gzip.compress(text.encode()))
    t = read_table(tmp_path / "t.csv.gz")
    assert t.coolant_inlet_C.tolist() == [25.0, 26.0]
    assert t.ignored == ("a, remark",)


def test_columns_are_mapped_and_signs_flipped(tmp_path):
    file = put(tmp_path, "t_s,I,T amb,T_surf,extra\n0,5,8,9,text\n1,-6,8,9,text\n")
    pairs = ["time_s=t_s,current_A=-I", "coolant_inlet_C=T amb", "surface_1_C=T_surf"]
    t = read_table(file, parse_columns(pairs))
    assert t.current_A.tolist() == [-5.0, 6.0]
    assert t.surface_C[1].tolist() == [9.0, 9.0]
    assert t.ignored == ("extra",)


def test_a_mapped_name_wins_over_a_column_of_that_name(tmp_path):
    file = put(tmp_path, "time_s,current_A,mean_A,coolant_inlet_C\n0,1,2,25\n")
    assert read_table(file, {"current_A": "mean_A"}).current_A.tolist() == [2.0]


HEAD = "time_s,current_A,coolant_inlet_C\n"
FAULTS = [
    ("", "empty"),
    (HEAD, "no rows"),
    (
        "time,current_A,coolant_inlet_C\n0,1,2\n",
        "no column 'time_s'; did you mean 'time'? (map it: --columns time_s=COLUMN)",
    ),
    (
        "time,I,T_amb\n0,1,2\n",
        "no columns 'time_s', 'current_A', 'coolant_inlet_C'; the table has time, I, T_amb "
        "(map them: --columns 'time_s=time,current_A=I,coolant_inlet_C=T_amb'; "
        "a constant: --columns 'coolant_inlet_C=22 °C')",
    ),
    (HEAD + "0,1,25\n1,x,25\n", "line 3: column 'current_A': 'x' is not a number"),
    (HEAD + "0,1,25\n\n1,1e,25\n", "line 4: column 'current_A': '1e' is not a number"),
    (HEAD + "0,1,25\n1,inf,25\n", "line 3: column 'current_A': 'inf' is not a number"),
    (HEAD + "0,1,25\n1,2\n", "line 3: 2 columns, the header has 3"),
    (HEAD + "0,1,25\n1,1,25\n1,1,25\n", "line 4: time_s stands still (1 then 1); it must increase"),
    (HEAD + "0,1,25\n2,1,25\n1,1,25\n", "line 4: time_s goes back (2 then 1); it must increase"),
    (HEAD + "0,1,25\n,1,25\n", "line 3: time_s is missing"),
    ("time_s,soc,current_A,coolant_inlet_C\n0,,1,2\n1,60,1,2\n", "line 3: soc is 60; it must be a share, 0 to 1"),
    ("time_s,time_s,current_A,coolant_inlet_C\n", "line 1: column 'time_s' stands there twice"),
    (HEAD[:-1] + "".join(f",c{k}" for k in range(11_000)) + "\n", "line 1: 11,003 columns, more than 10,000"),
    (HEAD + "0,1," + "2" * 500_000, "line 2: no end of line in 128 KiB: not a table"),
    (HEAD + '0,1,"' + "2" * 140_000 + '"\n', "line 2: no end of line in 128 KiB: not a table"),
    (HEAD + "0,1," + "2" * 140_000 + "\n", "line 2: no end of line in 128 KiB: not a table"),
    (
        HEAD[:-1] + "," + "surface " * 100 + "\n",
        "line 1: the name of column 4, 'surface surface surface surface surface ' …, has 799 characters; at most 500 "
        "are read: shorten it",
    ),
]


@pytest.mark.parametrize(("text", "says"), FAULTS)
def test_a_broken_table_is_one_line_with_file_and_line(tmp_path, text, says):
    file = put(tmp_path, text)
    with pytest.raises(DataError) as caught:
        read_table(file)
    assert str(caught.value) == f"{file}: {says}"


def test_blank_lines_without_end_are_no_table(tmp_path):
    with pytest.raises(DataError, match=r"line \d+: a million lines without a row: not a table"):
        read_table(put(tmp_path, HEAD + "0,1,25\n" + "\n" * 2_000_000))
    assert len(read_table(put(tmp_path, HEAD + "0,1,25\n" + "\n" * 500_000 + "1,1,25\n"))) == 2


def test_a_missing_file_names_the_nearest(tmp_path):
    put(tmp_path, GOOD, "bench.csv")
    with pytest.raises(DataError, match=r"did you mean 'bench\.csv'"):
        read_table(tmp_path / "bensh.csv")
    for k in range(15):
        (tmp_path / f"folder{k}").mkdir()
    with pytest.raises(DataError, match=r"x\.csv: no such file; valid: bench\.csv$"):  # a folder is no table
        read_table(tmp_path / "x.csv")


@pytest.mark.parametrize("content", [b"\x89PNG\xff\xfe", b"\x1f\x8b not gzip"])
@pytest.mark.parametrize("name", ["t.csv", "t.csv.gz"])
def test_what_is_no_table_is_an_error_not_a_traceback(tmp_path, content, name):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError):
        read_table(tmp_path / name)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=200)
@given(content=st.binary(max_size=200))
def test_any_bytes_give_a_table_or_an_error_of_ours(tmp_path, content):
    (tmp_path / "t.csv").write_bytes(HEAD.encode() + content)
    with contextlib.suppress(DataError):
        assert len(read_table(tmp_path / "t.csv")) > 0


@pytest.mark.parametrize(
    ("pair", "says"),
    [
        ("curent_A=I", "did you mean 'current_A'"),
        ("current_A", "expected name=column"),
        ("surface_0_C=x", "no table has a column 'surface_0_C'"),
        ("surface_1_V=x", "no table has a column 'surface_1_V'"),
    ],
)
def test_a_wrong_mapping_is_the_callers_fault(pair, says):
    with pytest.raises(UsageError, match=says):
        parse_columns([pair])


def test_a_mapping_to_no_column_names_the_nearest(tmp_path):
    with pytest.raises(DataError, match=r"no column 'curent' for current_A; did you mean 'current_A'"):
        read_table(put(tmp_path, GOOD), {"current_A": "curent"})


def test_parquet_reads_as_csv_does(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    table = pyarrow.table({"time_s": [0, 1], "current_A": [1.0, None], "coolant_inlet_C": [25.0, 26.0]})
    pq.write_table(table, tmp_path / "t.parquet")
    assert np.array_equal(read_table(tmp_path / "t.parquet").current_A, [1.0, np.nan], equal_nan=True)


def test_parquet_without_its_extra_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'bms-gateway\[report\]'"):
        read_table(put(tmp_path, "", "t.parquet"))


def test_a_hundred_thousand_rows_are_read_as_they_are(tmp_path):
    rows = np.column_stack([np.arange(100_000), np.random.default_rng(0).normal(size=(100_000, 4))])
    with (tmp_path / "t.csv").open("w") as f:
        f.write("time_s,current_A,coolant_inlet_C,voltage_V,surface_1_C\n")
        np.savetxt(f, rows, fmt="%.4f", delimiter=",")
    t = read_table(tmp_path / "t.csv")
    assert np.allclose(t.surface_C[1], rows[:, 4], atol=1e-4)


def test_the_bench_record_reads_as_numpy_reads_it():
    file = need("core_surface", "a123_26650_hev2.csv")
    pairs = ["time_s=t_s", "current_A=-I_A", "coolant_inlet_C=T_amb_C", "surface_1_C=T_surf_C", "core_1_C=T_core_C"]
    t = read_table(file, parse_columns(pairs))
    oracle = np.genfromtxt(file, delimiter=",", names=True)
    assert np.array_equal(t.current_A, -oracle["I_A"])
    assert np.array_equal(t.surface_C[1], oracle["T_surf_C"])
    assert np.array_equal(t.core_C[1], oracle["T_core_C"])


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("t.csv.gz", GOOD.encode(), "not gzip data: leave .gz out of its name"),
        ("t.csv.gz", gzip.compress(GOOD.encode())[:-9], "cut short or damaged"),
        ("t.csv", None, "is a directory"),
        ("t.parquet", None, "is a directory"),
    ],
)
def test_a_packed_table_or_a_folder_says_what_is_wrong(tmp_path, name, content, says):
    if content is None:
        (tmp_path / name).mkdir()
    else:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=says):
        read_table(tmp_path / name)


def test_a_row_is_found_again_in_its_file(tmp_path):
    t = read_table(put(tmp_path, "# from the bench\n" + GOOD))
    assert [t.place(k) for k in range(3)] == ["line 3", "line 4", "line 5"]


@pytest.mark.parametrize("chunk", [7, 64, 1000])
@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
def test_how_a_file_is_cut_into_pieces_changes_nothing(tmp_path, monkeypatch, chunk, ending):
    rows = [f"{k},{k}.5,{'' if k % 7 else 25},\u00e4{k}" for k in range(200)]
    rows[50] = '50,"50.5",25,"a, b"'
    rows[60:60] = ["", "# half way", " "]
    file = tmp_path / "t.csv"
    file.write_bytes(ending.join(["\ufefftime_s,current_A,coolant_inlet_C,\u00e4", *rows]).encode())
    whole = read_table(file)
    monkeypatch.setattr("bms_gateway.report.file_rows.CHUNK", chunk)
    cut = read_table(file)
    assert len(whole) == 200
    assert whole.place(199) == "line 204"
    assert np.array_equal(whole.lines, cut.lines)
    for name in ("time_s", "current_A", "coolant_inlet_C"):
        assert np.array_equal(getattr(whole, name), getattr(cut, name), equal_nan=True)


def test_a_fault_is_found_wherever_a_file_is_cut(tmp_path, monkeypatch):
    monkeypatch.setattr("bms_gateway.report.file_rows.CHUNK", 20)
    rows = [f"{k},1,25" for k in range(40)]
    for at, row, says in (
        (20, "19,1,25", "line 22: time_s stands still"),
        (21, ",1,25", "line 23: time_s is missing"),
        (22, "22,x,25", "line 24: column 'current_A': 'x'"),
        (23, "23,1", "line 25: 2 columns"),
    ):
        spoilt = [*rows[:at], row, *rows[at + 1 :]]
        with pytest.raises(DataError, match=says):
            read_table(put(tmp_path, HEAD + "\n".join(spoilt)))


def test_parquet_columns_that_are_no_numbers_or_twice_are_one_line(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    good = {"time_s": [0, 1], "current_A": [1.0, None], "coolant_inlet_C": [25.0, 26.0]}
    for name, values in (("current_A", ["1", "2"]), ("coolant_inlet_C", [[1.0], [2.0]])):
        pq.write_table(pyarrow.table({**good, name: values}), tmp_path / "t.parquet")
        with pytest.raises(DataError, match=f"column '{name}': not numbers"):
            read_table(tmp_path / "t.parquet")
    twice = pyarrow.table([[0], [1.0], [25.0], [2.0]], names=[*good, "current_A"])
    pq.write_table(twice, tmp_path / "t.parquet")
    with pytest.raises(DataError, match="column 'current_A' stands there twice"):
        read_table(tmp_path / "t.parquet")


@pytest.mark.parametrize("name", ["t.csv", "t.csv.gz", "t.parquet"])
def test_how_far_it_is_goes_from_nothing_to_all(tmp_path, monkeypatch, name):
    rows = [f"{k},1,25" for k in range(50_000)]
    if name.endswith("parquet"):
        pyarrow = pytest.importorskip("pyarrow")
        table = pyarrow.table({"time_s": range(50_000), "current_A": [1] * 50_000, "coolant_inlet_C": [25] * 50_000})
        pytest.importorskip("pyarrow.parquet").write_table(table, tmp_path / name)
    else:
        text = (HEAD + "\n".join(rows)).encode()
        (tmp_path / name).write_bytes(gzip.compress(text) if name.endswith("gz") else text)
    told = []
    assert len(read_table(tmp_path / name, tell=told.append)) == 50_000
    assert len(told) > 2
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1.0)


@pytest.mark.parametrize(("given", "sign"), [("-current_A [furlong]", "-"), ("current_A [furlong]", "")])
def test_the_words_that_are_told_turn_a_current_as_the_user_did(tmp_path, given, sign):
    """The minus was lost, and whoever followed the words turned the current."""
    with pytest.raises(DataError, match=rf"--columns 'current_A={sign}current_A \[A\]'"):
        read_table(put(tmp_path, GOOD), parse_columns([f"current_A={given}"]))
