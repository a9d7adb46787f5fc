"""True cores in the long form: read whatever the packing, and every fault of the file is one line."""

import gzip
import os

import numpy as np
import pytest

from bms_gateway.errors import DataError
from bms_gateway.report import forecast_tables
from bms_gateway.report.forecast_tables import read_truth
from bms_gateway.report.table import read_table

HEAD = b"time_s,string,cell,core_C\n"
GOOD = HEAD + b"2,a,1,31.5\n1,a,2,30\n1,a,1,29\n1,b,1,9\n1,x,1,0\n1,a,3,0\n1,a,0,0\n"
CELLS = {"a": 2, "b": 1}


def truth(path):
    return read_truth(path, ("a", "b"), CELLS)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("t.csv", GOOD),
        ("t.csv.gz", gzip.compress(GOOD, mtime=0)),
        ("t.csv", b"\xef\xbb\xbf" + GOOD),
        ("t.csv", GOOD[:-1]),
    ],
)
def test_cores_are_sorted_by_time_and_others_cells_and_strings_are_passed_over(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    found = truth(tmp_path / name)
    assert found.keys() == {"a", "b"}
    assert found["a"][0].tolist() == [1.0, 2.0]
    assert np.array_equal(found["a"][1], [[29.0, 30.0], [31.5, np.nan]], equal_nan=True)
    assert (found["b"][0].tolist(), found["b"][1].tolist()) == ([1.0], [[9.0]])


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("t.csv.gz", GOOD, "not gzip data: leave .gz out of its name"),
        (
            "t.csv.gz",
            gzip.compress(GOOD + b"1,a,1,3\n" * 90_000, mtime=0)[:-60],
            "the gzip data are cut short or damaged",
        ),
        ("t.csv", GOOD + b"1,a,1,\xff\xfe\n", "is no text"),
        ("t.csv", HEAD + b'1,"' + b"x\n" * 100_000, "no table: field larger than field limit"),
        ("t.csv", GOOD + b"9" * 200_000, "line 9: no end of line in 128 KiB: not a table"),
        ("t.csv", GOOD + b"1,a,1\n", "line 9: expected numbers for time_s, cell and core_C"),
        ("t.csv", HEAD + b"nan,a,1,3\n", "line 2: expected numbers"),
        ("t.csv", HEAD + b"1e999,a,1,3\n", "line 2: expected numbers"),
        ("t.csv", HEAD + b"1,a,1,inf\n", "line 2: expected numbers"),
        ("t.csv", HEAD + b"1,a," + b"9" * 5000 + b",3\n", "line 2: expected numbers"),
        ("t.csv", HEAD + b"1,x,1,3\n", "speaks of none of the strings a, b"),
        ("t.csv", b"string,core_C,cell\na,1,1\n", "no column 'time_s'"),
        ("t.csv", b"", "empty"),
        ("t.csv", b"\0\1", "not a text table"),
    ],
)
def test_what_is_wrong_with_the_truth_is_one_line(tmp_path, name, content, says):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError) as error:
        truth(tmp_path / name)
    assert says in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 400


def test_instants_without_end_are_refused_before_they_fill_the_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(forecast_tables, "MOST_NUMBERS", 100)
    rows = [b"%d,a,%d,30\n" % (t, k) for t in range(6) for k in (1, 2)]
    (tmp_path / "t.csv").write_bytes(HEAD + b"".join(rows[:10]))
    assert len(truth(tmp_path / "t.csv")["a"][0]) == 5  # each takes two cores and as much as 16 more
    (tmp_path / "t.csv").write_bytes(HEAD + b"".join(rows))
    with pytest.raises(DataError, match="line 12: more instants than memory is given to"):
        truth(tmp_path / "t.csv")


@pytest.mark.parametrize("name", ["t.csv", "t.csv.gz", "t.parquet"])
def test_a_pipe_that_nobody_writes_to_is_refused_and_not_waited_for(tmp_path, name):
    os.mkfifo(tmp_path / name)
    for read in (read_table, truth):
        with pytest.raises(DataError, match="is no plain file; expected a table"):
            read(tmp_path / name)
