"""What a file is by its first bytes, format by format."""

import gzip

import pytest

from bms_gateway.bus import sniff
from bms_gateway.bus.sniff import kind_of, misnamed

CANDUMP = b"(1700000000.000000) can0 123#11\n"
SCREEN = "this is candump's output without exact time stamps: record with candump -l or -L"
TABLE = (
    "this is a table of measurements, no log: encode makes frames of it, and compare, fit and diagnose take it as it is"
)
NAMES = b"a,b,c\n"


def test_the_bounds():
    assert (sniff.HEAD, sniff.FEWEST_COLUMNS) == (4096, 3)


@pytest.mark.parametrize(
    ("head", "kind"),
    [
        (b"LOGG\x90\0", ".blf"),
        (b"MDF     4.10", ".mf4"),
        (b"date Sat Sep 30 15:06:13 2017\n", ".asc"),
        (b"\xef\xbb\xbfdate Sat\n", ".asc"),
        (b"\n;$FILEVERSION=1.1\n", ".trc"),
        (b"timestamp,arbitration_id,extended\n", ".csv"),
        (CANDUMP, ".log"),
        (b"x\n" * 19 + CANDUMP, ".log"),
        (b"x\n" * 20 + CANDUMP, None),
        (b"\n" * 4 + CANDUMP, ".log"),
        (b"  can0  123   [8]  11 22 33 44 55 66 77 88\n", "screen"),
        (b"can0 123#1122\n", "screen"),
        (b"\nhello\ncan0 123#1122\n", "screen"),
        (b"hello\n", None),
        (b"", None),
    ],
)
def test_a_head_tells_its_format(head, kind):
    assert kind_of(head) == kind


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize(
    ("kind", "content", "said"),
    [
        (".log", CANDUMP, None),
        (".log", b"hello\n", None),
        (".log", b"", None),
        (".asc", CANDUMP, "this is a candump log: name it .log"),
        (".log", b"date Sat\n", "this is a Vector ASC log: name it .asc"),
        (".log", b"LOGG\0", "this is a Vector BLF log: name it .blf"),
        (".log", b";$FILEVERSION=1.1\n", "this is a PEAK TRC log: name it .trc"),
        (".log", b"timestamp,arbitration_id,\n", "this is a .csv log: name it .csv"),
        (".log", b"MDF     4.10", "this is a .mf4 log: name it .mf4"),
        (".log", b"can0 123#1122\n", SCREEN),
        (".csv", b"can0 123#1122\n", SCREEN),
        (".csv", CANDUMP, "this is a candump log: name it .log"),
        (".csv", b"timestamp,arbitration_id,\n", None),
        (".csv", b"time_s,x\n", TABLE),
        (".csv", b"\xef\xbb\xbfwhen,surface_12_C\n", TABLE),
        (".log", b"time_s,x\n", None),
        (".csv", NAMES + b"1,2,3\n4,5", TABLE),
        (".csv", NAMES + b"\n1,2,3\n", None),
        (".csv", NAMES + b"1,2,3\n\n0x4,5,6\n7,8,9\n", None),
        (".csv", NAMES + b"0x1,2,3\n4,5,6\n7,8,9\n", None),
        (".csv", NAMES + b"1,2,3\n4,5,6\n0x7,8,9\n1,2,3\n", TABLE),
        (".csv", b"0xa,b,c\n1,2,3\n4,5,6\n", TABLE),
        (".csv", b"a,b,3\n1,2,3\n4,5,6\n", None),
        (".csv", b"a;b;c\n1,5;2,5;3,5\n4,5;5,5;6,5\n", TABLE),
        (".csv", b"a\tb\tc\td\n1\t2\t3\t4\n5\n", TABLE),
        (".csv", "Prüfstand 7\nZeit;Strom;Kühlluft\n;[mA];[K]\n0;1,5;296,1\n1;1,5;296,1\n".encode("cp1252"), TABLE),
        (".csv", "Prüfstand 7;Zelle 3\nZeit;Strom;Kühlluft\n;[mA];[K]\n0;1,5;296\n1;2;3".encode("cp1252"), TABLE),
        (".csv", "Prüfstand 7\nZeit;Strom;T\n".encode("cp1252") + b"0,1;1,5;29,1\n" * 9, TABLE),
        (".csv", b"Bus 7\nTime;ID;Data\n0;0x123;11\n1;0x123;11\n2;0x123;11\n", None),
        (".csv", b"a\0,b,c\n1,2,3\n4,5,6\n", None),
        (".csv", (NAMES + b"1,2,3\n4,5,6\n").decode().encode("utf-16") + b"x", TABLE),
        (".csv", "\ufeffa,b,c\n1,2,3\n4,5,6\n".encode("utf-16-be"), TABLE),
        (".csv", "a,b,c\n1,2,3\n4,5,6\n".encode("utf-16-le"), None),
    ],
)
def test_a_file_that_is_not_what_its_name_says_is_told(tmp_path, packed, kind, content, said):
    path = tmp_path / f"a{kind}{'.gz' if packed else ''}"
    path.write_bytes(gzip.compress(content) if packed else content)
    if packed and said is not None and "name it" in said:
        said += ".gz"
    assert misnamed(path, kind) == said


def test_gzip_data_have_their_ending_and_nothing_else_has(tmp_path):
    for name, content, said in (
        ("a.log", gzip.compress(CANDUMP), "this is gzip data: end its name with .gz"),
        ("a.log.GZ", gzip.compress(CANDUMP), None),
        ("b.log.gz", CANDUMP, "not gzip data: leave .gz out of its name"),
        ("c.log.gz", b"", None),
        ("d.log.gz", b"\x1f\x8bdamaged", None),
    ):
        (tmp_path / name).write_bytes(content)
        assert misnamed(tmp_path / name, ".log") == said
