"""What strangers try besides: written down before it was tried, as the other lists."""

import bz2
import gzip

from tests.cli.bad_inputs.case import HEADER, LOG, ROWS, TABLE, Case, Edit
from tests.config.files import DBC

CHECK = "check gateway.toml"
COMPARE = "compare bench.csv --model string_1.toml"
ENCODE = "encode bench.csv --config gateway.toml --out out.log"
ANALYZE = "analyze {} --config gateway.toml --out results"


def _table(name: str, content: Edit, *blame: str, words: str = COMPARE) -> Case:
    return Case(f"stranger: table: {name}", words, blame, {"bench.csv": content})


def _file(name: str, words: str, *blame: str, **files: Edit) -> Case:
    return Case(f"stranger: {name}", words, blame, {k.replace("__", "."): v for k, v in files.items()})


def _config(name: str, old: str, new: str, *blame: str, words: str = CHECK) -> Case:
    return Case(f"stranger: config: {name}", words, blame, {"gateway.toml": (old, new)})


def _model(name: str, old: str, new: str, *blame: str) -> Case:
    return Case(f"stranger: model: {name}", CHECK, blame, {"string_1.toml": (old, new)})


def _dbc(name: str, content: Edit, *blame: str) -> Case:
    return Case(f"stranger: dbc: {name}", CHECK, blame, {"vehicle.dbc": content})


_BLANK = "\n".join([HEADER, *(f"{k},,,,,,," for k in range(40))]) + "\n"
_TWICE = TABLE + TABLE
_MONTH = "\n".join([HEADER, *(f"2026-13-01 10:00:{k:02d},{ROWS[k].split(',', 1)[1]}" for k in range(40))]) + "\n"
_OVER = "\n".join([HEADER, *(r.replace(",16.4,", ",#REF!,") for r in ROWS)]) + "\n"
_GZ = gzip.compress(LOG.encode())
_KCD = '<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"></NetworkDefinition>\n'
_SYM = 'FormatVersion=6.0 // Do not edit this line!\nTitle="vehicle"\n{SEND}\n'
_PCAP = b"\xd4\xc3\xb2\xa1\x02\x00\x04\x00" + bytes(300)
_PCAPNG = b"\x0a\x0d\x0d\x0a" + bytes(300)
_RC = 'R_c  = { value = 1.266, unit = "K/W", rel_sd = 0.6 }'

STRANGERS: tuple[Case, ...] = (
    _table("blank cells alone", _BLANK, "bench.csv", "no row has a value", "--columns", words=ENCODE),
    _table("blank cells alone, compared", _BLANK, "bench.csv", "current_A has no values"),
    _table("two tables in one file", _TWICE, "line 42", "not a number"),
    _table("a month 13", _MONTH, "line 2", "time_s"),
    _table("errors of a spreadsheet", _OVER, "line 2", "voltage_V", "#ref!"),
    _table("a header of blanks", ",,,,,,,\n" + "\n".join(ROWS) + "\n", "line 1"),
    _table("an SQLite file", b"SQLite format 3\x00" + bytes(200), "bench.csv", "not a text table"),
    _file("table: a string that is none", f"{ENCODE} --string strng_1", "strng_1", "string_1"),
    _file("table: for another format by its name", "compare b.xlsx --model string_1.toml", "b.xlsx", b__xlsx=TABLE),
    _file("log: bz2", ANALYZE.format("d.log.bz2"), "d.log.bz2", "unpack", d__log__bz2=bz2.compress(LOG.encode())),
    _file("log: a capture of Ethernet", ANALYZE.format("d.pcap"), "d.pcap", "format", d__pcap=_PCAP),
    _file("log: the same twice", ANALYZE.format("drive.log drive.log"), "drive.log", "twice"),
    _file("log: results over the config", "analyze drive.log --config gateway.toml --out gateway.toml", "gateway.toml"),
    _file("log: the config for a log", "check gateway.toml --log gateway.toml", "gateway.toml"),
    _file(
        "log: gz twice", ANALYZE.format("d.log.gz"), "d.log.gz", d__log__gz=gzip.compress(gzip.compress(LOG.encode()))
    ),
    _file("log: a cell that nobody makes", "init drive.log --cell 21700,5000Ah --yes", "5000Ah"),
    _file("log: a cell misspelt", "init drive.log --cell lg_m05 --yes", "lg_m05", "lg_m50"),
    _file(
        "log: a forecast of no current", "forecast drive.log --config gateway.toml --current lots", "--current", "lots"
    ),
    _file("log: a profile that is missing", "forecast drive.log --config gateway.toml --profile p.csv", "p.csv"),
    _file("log: a cycle of no kind", "simulate --config gateway.toml --out s.log --cycle usO6", "usO6", "us06"),
    _file("log: a drive of no time", "simulate --config gateway.toml --out s.log --duration -5", "--duration"),
    _file("log: a span of no unit", "export --last 2parsecs --out t.csv --config gateway.toml", "--last", "2parsecs"),
    _dbc("a KCD", _KCD, "vehicle.dbc", "xml"),
    _dbc("a SYM", _SYM, "vehicle.dbc", "line 1"),
    _dbc("UTF-16", DBC.encode("utf-16"), "vehicle.dbc"),
    _dbc("a scale of 1e300", ("(100,0)", "(1e300,0)"), "voltage", "1e+300", "valid: "),
    _dbc("two signals of one name", ("SG_ Voltage", "SG_ Current"), "vehicle.dbc", "Current"),
    _config("a scale of 1e300", "scale = -1.0", "scale = 1e300", "current", "1e+300", "valid: "),
    _config("an offset of no temperature", "offset = 0.5", "offset = 5000", "surface.3", "offset"),
    _config("one bracket for two", "[[string]]", "[string]", "string", "[[string]]"),
    _config("a comma for a point", "scale = -1.0", "scale = -1,0", "gateway.toml", "line"),
    _config("a mask of nothing", "scale = -1.0", "mask = 0", "current", "mask"),
    _config("a range that is infinite", "scale = -1.0", "minimum = nan", "current", "minimum"),
    _config("a folder for a DBC", '["vehicle.dbc"]', '["."]', "directory"),
    _config("a channel of nothing", 'channel = "vcan0"', 'channel = ""', "channel"),
    _config("a path of Windows", '["vehicle.dbc"]', '["C:\\\\cars\\\\vehicle.dbc"]', "vehicle.dbc"),
    _model("a number that is infinite", "value = 1.266", "value = inf", "R_c"),
    _model("a deviation below zero", _RC, _RC.replace("0.6", "-0.6"), "R_c", "rel_sd"),
    _model("a unit too large by a thousand", 'value = 3.5, unit = "mOhm"', 'value = 3.5, unit = "Ohm"', "R_e"),
    _model("an effect of no kind", "effects = []", 'effects = ["entropic_heet"]', "entropic_heet", "entropic_heat"),
    _model("a list that is too short", "value = 3.5", "values = [3.5, 3.6]", "R_e", "5"),
    _model("no sensors", "sensors = [1, 3, 5]", "sensors = []", "sensors"),
    _model("a capacity of nothing", "capacity_Ah = 8.0", "capacity_Ah = 0.0", "capacity_Ah"),
    _dbc("nothing", "", "vehicle.dbc", "is empty"),
    _dbc("a KCD by the name of a DBC", _KCD, "vehicle.dbc", "xml", "export"),
    _dbc("a log by the name of a DBC", LOG, "vehicle.dbc", "candump log"),
    _table("numbers of a hex editor", ("0,-2.5", "0,0xFF"), "line 2", "current_a", "0xff"),
    _table("thousands parted by commas", ("0,-2.5", '0,"1,234.5"'), "line 2", "current_a", "1,234.5"),
    _table("marks of a merge", ("\n3,", "\n<<<<<<< HEAD\n3,"), "line 5", "1 columns"),
    _table("a number beyond all floats", ("0,-2.5", "0,1e400"), "line 2", "1e400"),
    _table("a time that stands", TABLE.replace("\n3,", "\n2,"), "line 5", "stands still"),
    _file(
        "log: a capture by the name of a log",
        ANALYZE.format("n.log"),
        "n.log",
        "not a .log log",
        "binary",
        n__log=_PCAPNG,
    ),
    _file(
        "log: zstd", ANALYZE.format("q.log.zst"), "q.log.zst", "unpack", q__log__zst=b"\x28\xb5\x2f\xfd" + bytes(300)
    ),
    _config("the number of a file for the dbc", 'dbc = ["vehicle.dbc"]', "dbc = 5", "bus.dbc", "list"),
    _config("an address of 77 bits", "[bus]", "[bus]\nsource_address = 99999999999999999999999", "source_address"),
    _model("cells as a fraction", "cells = 5", "cells = 5.0", "cells", "integer"),
    _model("an sd below zero", "rel_sd = 0.6", "rel_sd = -0.6", "rel_sd", "greater than 0"),
    _model("a value in quotes", "value = 1.266", 'value = "1.266"', "r_c.value", "number"),
    _model("an endless sd", "rel_sd = 0.6", "rel_sd = inf", "rel_sd", "finite"),
)
