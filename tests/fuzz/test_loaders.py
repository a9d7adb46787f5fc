"""Whatever is fed to what reads: it reads it, or says in one line of ours why not."""

import gzip
import io
import random
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import pytest
from can.io import blf
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bms_gateway.bus.logfile import LogNotes, read_log
from bms_gateway.cli.main import main
from bms_gateway.errors import DataError
from tests.fuzz.configs import lay, spoilt
from tests.fuzz.limits import BOUND_MIB, GIB
from tests.fuzz.mutate import KINDS, apply
from tests.fuzz.targets import LONGEST, log, survives, targets

ROOT = Path(__file__).resolve().parents[2]

NAMES = (
    *(f"log{s}{z}" for s in (".log", ".asc", ".csv", ".trc", ".blf") for z in ("", ".gz")),
    *("table", "table.gz", "config", "model", "dbc", "state", "snapshot", "frames"),
)
SHARE = st.floats(0.0, 1.0, exclude_max=True)
EDITS = st.lists(st.tuples(st.integers(0, KINDS - 1), SHARE, SHARE, st.binary(max_size=12)), min_size=1, max_size=6)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="module")
def all_targets(folder):
    return Named(targets(folder))


class Named(dict):
    """Targets that do not fill a report."""

    def __repr__(self):
        return "targets"


@pytest.mark.parametrize("name", NAMES)
def test_sound_examples_are_taken(name, all_targets, folder):
    assert all(survives(all_targets[name], seed, folder) for seed in all_targets[name].seeds)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(which=st.integers(0, 10), edits=EDITS)
def test_spoilt_ones_are_taken_or_refused_in_one_line(name, all_targets, folder, which, edits):
    target = all_targets[name]
    survives(target, apply(target.seeds[which % len(target.seeds)], edits), folder)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(max_size=400))
def test_anything_at_all_is_taken_or_refused_in_one_line(name, all_targets, folder, data):
    survives(all_targets[name], data, folder)


@pytest.mark.parametrize("seed", range(4))
def test_check_answers_for_whatever_is_in_the_files_of_a_config(seed, tmp_path, capsys):
    rng = random.Random(seed)
    for _ in range(20):
        name, content = spoilt(rng)
        status = main(["check", str(lay(tmp_path, name, content))])
        told = capsys.readouterr()
        assert status in (0, 1, 2), content
        assert "error: " not in told.err or (status == 2 and told.err.count("\n") == 1), (told.err, content)
        assert len(told.err) < LONGEST


def zeros_gz(path: Path, head: bytes, size: int, fill: bytes = b"\0") -> None:
    """Write gzip data that unpack to so many bytes."""
    with gzip.open(path, "wb", 1) as out:
        out.write(head)
        for _ in range(size >> 20):
            out.write(fill * (1 << 20))


def blf_of(path: Path, folder: Path, containers: list[bytes]) -> None:
    header = log(".blf", folder)[: struct.unpack_from("<4sI", log(".blf", folder))[1]]
    out = io.BytesIO()
    out.write(header)
    for packed in containers:
        body = blf.LOG_CONTAINER_STRUCT.pack(blf.ZLIB_DEFLATE, 128 << 10) + packed
        size = blf.OBJ_HEADER_BASE_STRUCT.size + len(body)
        out.write(blf.OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", blf.OBJ_HEADER_BASE_STRUCT.size, 1, size, blf.LOG_CONTAINER))
        out.write(body + bytes(size % 4))
    path.write_bytes(out.getvalue())


def bombs(folder: Path) -> dict[str, Path]:
    """Small files that claim, or unpack to, far more than a vehicle computer has."""
    found = {
        name: folder / name for name in ("a.log.gz", "line.log", "b.csv.gz", "c.asc.gz", "d.trc.gz", "e.blf", "f.blf")
    }
    found["g.blf.gz"] = folder / "g.blf.gz"
    zeros_gz(found["a.log.gz"], b"(1700000000.000000) can0 123#11\n", GIB, b"A")
    with found["line.log"].open("wb") as out:
        out.write(b"(1700000000.000000) can0 123#11\n")
        out.truncate(GIB)  # a hole: a line of a gibibyte that takes no room on the disk
    zeros_gz(found["b.csv.gz"], b"timestamp,arbitration_id,extended,remote,error,dlc,data\n", GIB, b"1")
    zeros_gz(found["c.asc.gz"], b"date Tue Nov 14 22:13:20 2023\nbase hex timestamps absolute\n", GIB, b"1")
    zeros_gz(found["d.trc.gz"], b";$FILEVERSION=2.1\n", GIB, b"1")
    bomb = zlib.compress(bytes(GIB), 1)
    blf_of(found["e.blf"], folder, [bomb])
    # one object that says that it goes on for four gibibytes, through containers that stay below the bound
    endless = blf.OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", 16, 1, 0xFFFF_FFF0, 1) + bytes(15 << 20)
    blf_of(found["f.blf"], folder, [zlib.compress(endless, 1), *[zlib.compress(bytes(15 << 20), 1)] * 60])
    with gzip.open(found["g.blf.gz"], "wb", 1) as out:
        head = log(".blf", folder)[: struct.unpack_from("<4sI", log(".blf", folder))[1]]
        out.write(head + blf.OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", 16, 1, 0xFFFF_FFF0, blf.LOG_CONTAINER))
        for _ in range(GIB >> 20):
            out.write(bytes(1 << 20))
    return found


READ = """
import sys
from pathlib import Path
from bms_gateway.bus.logfile import LogNotes, read_log
from bms_gateway.errors import GatewayError
from tests.memory import peak_mib
try:
    for batch in read_log(Path(sys.argv[1]), notes=LogNotes()):
        pass
except GatewayError as error:
    print(error)
print(peak_mib())
"""


@pytest.mark.slow
def test_bombs_do_not_fill_the_memory(folder):
    for name, path in bombs(folder).items():
        assert path.stat().st_blocks * 512 < 16 << 20, name
        done = subprocess.run([sys.executable, "-c", READ, path], capture_output=True, text=True, cwd=ROOT)
        assert done.returncode == 0, (name, done.stderr)
        print(f"{name}: peak {float(done.stdout.split()[-1]):.0f} MiB")
        assert float(done.stdout.split()[-1]) < BOUND_MIB, (name, done.stdout)
        path.unlink()


def test_a_line_without_end_is_refused_or_passed_over(tmp_path):
    long = b"1" * 200_000
    (tmp_path / "a.log").write_bytes(b"(1700000000.000000) can0 123#11\n" + b"(" + long)
    with pytest.raises(DataError, match="no end of line in 64 KiB"):
        list(read_log(tmp_path / "a.log"))
    lines = log(".csv", tmp_path).splitlines(keepends=True)
    (tmp_path / "a.csv").write_bytes(b"".join([*lines[:5], long + b"\n", *lines[5:]]))
    notes = LogNotes()
    assert sum(map(len, read_log(tmp_path / "a.csv", notes=notes))) == 30
    assert notes.broken_at == [(6, "a line of over 64 KiB")]


def test_a_container_that_unpacks_to_too_much_costs_itself_only(tmp_path):
    sound = log(".blf", tmp_path)
    blf_of(tmp_path / "a.blf", tmp_path, [zlib.compress(bytes(20 << 20), 1)])
    head = struct.unpack_from("<4sI", sound)[1]
    (tmp_path / "a.blf").write_bytes((tmp_path / "a.blf").read_bytes() + sound[head:])
    notes = LogNotes()
    assert sum(map(len, read_log(tmp_path / "a.blf", notes=notes))) == 30
    assert notes.broken_at[0][1] == "a container of over 16 MiB"
