"""What newcomers hand over: halves of a current, wrong lists of cells, files of other tools.

Written down before they were tried.
"""

from tests.cli.bad_inputs.case import HEADER, LOG, ROWS, TABLE, Case, Edit

CHECK = "check gateway.toml"
COMPARE = "compare bench.csv --model string_1.toml"
_CURRENT = 'current = { signal = "Pack.Current", scale = -1.0 }'
_OUT = 'current.discharge = "Pack.Current"'
_VOLTS = '\ncurrent.charge = "Pack.Voltage"'
_PAIR = 'discharge = "Pack.Current", charge = "Pack.Voltage"'
_FIRST = '1 = "Temps.T1"'


def _config(name: str, old: str, new: str, *blame: str, words: str = CHECK) -> Case:
    return Case(f"newcomer: config: {name}", words, blame, {"gateway.toml": (old, new)})


def _model(name: str, old: str, new: str, *blame: str) -> Case:
    return Case(f"newcomer: model: {name}", CHECK, blame, {"string_1.toml": (old, new)})


def _dbc(name: str, edit: Edit, *blame: str) -> Case:
    return Case(f"newcomer: dbc: {name}", CHECK, blame, {"vehicle.dbc": edit})


def _table(name: str, edit: Edit, *blame: str, words: str = COMPARE) -> Case:
    return Case(f"newcomer: table: {name}", words, blame, {"bench.csv": edit})


def _log(name: str, file: str, content: Edit, *blame: str, words: str = "init {} --yes") -> Case:
    return Case(f"newcomer: log: {name}", words.format(file), blame, {file: content})


_STILL = "".join(f"({1.7e9 + k / 10:.6f}) can0 100#F6FFA4006A32D002\n" for k in range(200))
_SHORT = "".join(LOG.splitlines(keepends=True)[:6])
_OLD = LOG.replace("can0", "").replace("(", "").replace(")", "")
_YAML = "bus:\n  channel: can0\n"

NEWCOMERS: tuple[Case, ...] = (
    Case("newcomer: a log as the config", "check drive.log", ("drive.log", "is a candump log, not a gateway config")),
    Case(
        "newcomer: a dbc as the config",
        "analyze drive.log --config vehicle.dbc --out r",
        ("vehicle.dbc", "is a DBC, not a gateway config"),
    ),
    Case(
        "newcomer: a dbc as the model",
        "compare bench.csv --model vehicle.dbc",
        ("vehicle.dbc", "is a DBC, not a model file"),
    ),
    Case(
        "newcomer: a packed log as the config",
        "check packed.toml",
        ("packed.toml", "is gzip data, not a gateway config"),
        {"packed.toml": b"\x1f\x8b\x08\x00\xff\xfe"},
    ),
    Case(
        "newcomer: a long log as the model",
        "compare bench.csv --model long.log",
        ("long.log", "is a candump log, not a model file"),
        {"long.log": LOG * 1200},
    ),
    _config("an empty list of DBCs", 'dbc = ["vehicle.dbc"]', "dbc = []", "bus.dbc names no file", "'Pack'"),
    Case(
        "newcomer: a fleet of no log",
        "fleet nix.log drivee.log --config gateway.toml --out fl",
        ("no such log: nix.log",),
    ),
    _config("a discharge without its charge", _CURRENT, _OUT, "current", "charge"),
    _config(
        "one signal for both directions",
        _CURRENT,
        _OUT + '\ncurrent.charge = "Pack.Current"',
        "Pack.Current",
        "both directions",
    ),
    _config("a direction misspelt", _CURRENT, _OUT.replace("rge", "rg") + _VOLTS, "discharg", "discharge"),
    _config("a charge in volts", _CURRENT, _OUT + _VOLTS, "current.charge", "V"),
    _config(
        "a direction and a signal", _CURRENT, f'current = {{ signal = "Pack.Current", {_PAIR} }}', "current", "signal"
    ),
    _config(
        "two directions of a voltage", 'voltage = "Pack.Voltage"', f"voltage = {{ {_PAIR} }}", "voltage", "current"
    ),
    _config(
        "a constant for a direction",
        _CURRENT,
        _OUT + "\ncurrent.charge = { constant = 0.0 }",
        "charge",
        "Message.Signal",
    ),
    _config("cells upside down", _FIRST, 'hottest = { max_of = "5-1", signal = "Temps.T1" }', "max_of", "5-1"),
    _config(
        "a list of cells with words", _FIRST, 'hottest = { max_of = "1 to 5", signal = "Temps.T1" }', "max_of", "1 to 5"
    ),
    _config(
        "two greatest readings",
        _FIRST,
        'a = { max_of = "1-5", signal = "Temps.T1" }\nb = { max_of = "1-5", signal = "Temps.T2" }',
        "max_of",
    ),
    _config(
        "greatest and least at once",
        _FIRST,
        'a = { max_of = "1-5", min_of = "1-5", signal = "Temps.T1" }',
        "max_of",
        "min_of",
    ),
    _config("a mask in words", "scale = -1.0", 'mask = "0xFFF0"', "mask", "without quotes, mask = 0xfff0"),
    _config("a mask with a hole", "scale = -1.0", "mask = 0xF0F0", "mask", "one run"),
    _config("a mask beyond the bits", "scale = -1.0", "mask = 0xFFFFFFF", "mask", "bits"),
    _config("signed in words", "scale = -1.0", 'signed = "yes"', "signed", "true or false"),
    _config("an address that is text", "[bus]", '[bus]\nsource_address = "F4"', "source_address"),
    _config("an address beyond J1939", "[bus]", "[bus]\nsource_address = 300", "source_address"),
    _config("a log for the DBC", '["vehicle.dbc"]', '["drive.log"]', "drive.log"),
    Case("newcomer: config: YAML", CHECK, ("gateway.toml", "line 1"), {"gateway.toml": _YAML}),
    _model("a sensor called 0", "sensors = [1, 3, 5]", "sensors = [0, 3, 5]", "sensors", "0"),
    _model("a percentage for an sd", "rel_sd = 0.6", 'rel_sd = "60%"', "without quotes, rel_sd = 0.6"),
    _model("a key of an older tool", "cells = 5", "cells = 5\nn_cells = 5", "n_cells", "cells"),
    _dbc("a tab for a colon", ("SG_ Current :", "SG_ Current\t"), "vehicle.dbc", "line"),
    _dbc("a big-endian signal that starts outside", ("16|16@1+ (100", "63|16@0+ (100"), "vehicle.dbc", "Voltage"),
    _dbc("a factor with a comma", ("(100,0)", "(0,1,0)"), "vehicle.dbc", "line"),
    _table("a semicolon too few", TABLE.replace(",", ";").replace("\n5;", "\n5 ", 1), "line 7", "columns"),
    _table("minutes with letters", TABLE.replace("\n3,", "\n3min,", 1), "line 5", "time_s", "3min"),
    _table("one row", "\n".join([HEADER, ROWS[0]]) + "\n", "bench.csv", "row"),
    _log("a bus that stands still", "still.log", _STILL, "still.log", "no bit", "record"),
    _log("half a second", "short.log", _SHORT, "short.log", "record"),
    _log("a stamp without brackets", "old.log", _OLD, "old.log"),
    _log(
        "a name for a folder that is a file",
        "drive2.log",
        LOG,
        "bench.csv",
        "file",
        words="init {} --yes --out bench.csv",
    ),
    Case("newcomer: a cell of two formats", "cells 18650,21700", ("18650", "21700")),
    Case("newcomer: a cell of no parallel", "init drive.log --cell 21700,0p --yes", ("0p",)),
)
