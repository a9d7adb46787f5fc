"""Small tables that unpack to far more than a vehicle computer has: refused, in bounded memory."""

import gzip
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzz.limits import BOUND_MIB, GIB

ROOT = Path(__file__).resolve().parents[2]
HEAD = b"time_s,current_A,coolant_inlet_C"
MIB = 1 << 20

READ = """
import sys
from pathlib import Path
from bms_gateway.report.table import read_table
from bms_gateway.errors import GatewayError
from tests.memory import peak_mib
try:
    print(len(read_table(Path(sys.argv[1]))), "rows")
except GatewayError as error:
    print(error)
print(peak_mib())
"""


def filled(path, unit, size=GIB):
    """A table whose second line begins a long stretch of the same bytes."""
    block = unit * (MIB // len(unit))
    with gzip.open(path, "wb", 1) as out:
        out.write(HEAD + b"\n0,1,25\n")
        for _ in range(size // len(block)):
            out.write(block)


def many_blanks(path):
    """Columns that tables have, and rows that leave them blank: each row is some bytes, and 24 kB of numbers."""
    names = b"".join(b",surface_%d_C" % k for k in range(1, 3001))
    with gzip.open(path, "wb", 6) as out:
        out.write(HEAD + names + b"\n")
        for k in range(12_000):
            out.write(b"%d,1,25" % k + b"," * 3000 + b"\n")


def parquet(path):
    """Eight million rows of one value, with a time that goes on evenly."""
    pyarrow = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    N = 1_000_000
    schema = pyarrow.schema([("time_s", "int64"), ("current_A", "float64"), ("coolant_inlet_C", "float64")])
    same = pyarrow.array([1.0]).dictionary_encode().indices.cast("float64")
    same = pyarrow.concat_arrays([same] * N)
    coding = {"time_s": "DELTA_BINARY_PACKED", "current_A": "BYTE_STREAM_SPLIT", "coolant_inlet_C": "PLAIN"}
    options = {"use_dictionary": False, "column_encoding": coding, "compression": "zstd"}
    with pq.ParquetWriter(path, schema, **options) as out:
        for k in range(8):
            time = pyarrow.array(range(k * N, (k + 1) * N), "int64")
            out.write_table(pyarrow.table([time, same, same], schema=schema))


BOMBS = {
    "blank.csv.gz": (lambda path: filled(path, b"\n"), "a million lines without a row|unpacks to over 256 times"),
    "spaces.csv.gz": (lambda path: filled(path, b" \r\n"), "a million lines without a row|unpacks to over 256 times"),
    "remarks.csv.gz": (
        lambda path: filled(path, b"# a remark that is as long as it is\n"),
        "a million lines without a row|unpacks to",
    ),
    "line.csv.gz": (lambda path: filled(path, b"1"), "no end of line in 128 KiB"),
    "cells.csv.gz": (many_blanks, "numbers, more than a table of|unpacks to over"),
    "rows.parquet": (parquet, "numbers, more than a table of"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BOMBS)
def test_a_table_that_unpacks_to_gigabytes_is_refused_in_bounded_memory(tmp_path, name):
    make, says = BOMBS[name]
    path = tmp_path / name
    make(path)
    assert path.stat().st_size < 16 * MIB
    done = subprocess.run([sys.executable, "-c", READ, path], capture_output=True, text=True, cwd=ROOT, timeout=300)
    assert done.returncode == 0, done.stderr
    told, peak = done.stdout.strip().splitlines()
    print(f"{name}: {path.stat().st_size / MIB:.2f} MiB, peak {float(peak):.0f} MiB: {told}")
    assert float(peak) < BOUND_MIB
    assert any(x in told for x in says.split("|")), told
