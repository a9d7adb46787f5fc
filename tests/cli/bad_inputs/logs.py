"""Logs that are none, are cut, or are of another vehicle."""

import gzip
from pathlib import Path

from tests.cli.bad_inputs.case import LOG, TABLE, Case, Edit

ANALYZE = "analyze {} --config gateway.toml --out results"
PNG = b"\x89PNG\r\n\x1a\n" + bytes(400)


def _case(name: str, file: str, blame: tuple[str, ...], content: Edit, words: str = ANALYZE) -> Case:
    return Case(f"log: {name}", words.format(file), blame, {file: content})


def _folder(path: Path) -> None:
    path.mkdir()


_ERRORS = "".join(f"({1.7e9 + k:.6f}) can0 20000004#0004000000000000\n" for k in range(50))
_OTHERS = "".join(f"({1.7e9 + k / 10:.6f}) can0 7AA#0011223344556677\n" for k in range(200))
_ASC = "date Mon Nov 3 10:00:00.000 am 2026\nbase hex  timestamps absolute\n"

LOGS: tuple[Case, ...] = (
    Case("log: missing, near a real name", ANALYZE.format("drve.log"), ("drve.log", "drive.log")),
    _case("a folder", "logs", ("logs", "directory"), _folder),
    _case("empty", "e.log", ("e.log", "no data frames"), ""),
    _case("prose", "p.log", ("p.log",), "Dear driver,\nthe battery was fine.\n"),
    _case("name of no format", "drive.logg", ("drive.logg", "format"), LOG),
    _case("no ending, no log", "drive", ("drive",), "hello\n" * 9),
    _case("zeros only", "z.log", ("z.log",), bytes(4096)),
    _case("a picture", "p.log", ("p.log",), PNG),
    _case("UTF-16 rubbish", "u.log", ("u.log",), "what is this\nno log\n".encode("utf-16")),
    _case("gzip cut short", "c.log.gz", ("c.log.gz", "end too early"), gzip.compress(LOG.encode())[:80]),
    _case("gz that is none", "n.log.gz", ("n.log.gz", "gzip"), PNG),
    _case("asc of nothing", "a.asc", ("a.asc",), _ASC),
    _case("asc of prose", "a.asc", ("a.asc",), "no log\n" * 30),
    _case("blf of zeros", "b.blf", ("b.blf",), bytes(900)),
    _case("blf head only", "b.blf", ("b.blf",), b"LOGG" + bytes(20)),
    _case("mf4 of zeros", "m.mf4", (".mf4",), bytes(900)),
    _case("trc of prose", "t.trc", ("t.trc",), "no trace\n" * 30),
    _case("csv of something", "l.csv", ("l.csv",), "a,b,c\n1,2,3\n"),
    _case("a table", "bench2.csv", ("bench2.csv", "table", "encode"), TABLE),
    _case("a zip of logs", "drives.zip", ("drives.zip", "unpack"), b"PK\x03\x04" + bytes(300)),
    _case("another vehicle's", "o.log", ("o.log", "none of the 200 frames"), _OTHERS),
    _case("error frames only", "f.log", ("f.log",), _ERRORS),
    _case("one frame", "one.log", ("one.log",), LOG.splitlines()[0] + "\n"),
    Case("log: results onto a file", "analyze drive.log --config gateway.toml --out bench.csv", ("bench.csv",)),
    Case("log: results nowhere", "analyze drive.log --config gateway.toml --out=", ("--out",)),
    Case("log: config missing", "analyze drive.log --out results", ("--config",)),
    Case("log: config is the log", "analyze drive.log --config drive.log --out results", ("drive.log",)),
    Case("log: check a missing one", "check gateway.toml --log none.log", ("none.log",)),
    Case("log: check a table", "check gateway.toml --log bench.csv", ("bench.csv",)),
    Case("log: replay at no speed", "replay drive.log --to vcan0 --speed 0", ("--speed",)),
    Case("log: replay to no interface", "replay drive.log --to nocan7", ("nocan7",)),
    Case("log: replay a missing one", "replay none.log --to vcan0", ("none.log",)),
    Case("log: init of nothing", "init none.log --yes", ("none.log",)),
)
