"""DBC files that are none, that contradict themselves, or lack what the config names."""

from pathlib import Path

from tests.cli.bad_inputs.case import LOG, Case, Edit
from tests.config.files import DBC

CHECK = "check gateway.toml"


def _case(name: str, blame: tuple[str, ...], content: Edit) -> Case:
    return Case(f"dbc: {name}", CHECK, blame, {"vehicle.dbc": content})


def _folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _line(new: str) -> tuple[str, str]:
    return ' SG_ Voltage : 16|16@1+ (100,0) [0|600000] "mV" Vector__XXX', new


_ARXML = '<?xml version="1.0"?>\n<AUTOSAR xmlns="http://autosar.org/schema/r4.0"></AUTOSAR>\n'

DBCS: tuple[Case, ...] = (
    _case("missing", ("vehicle.dbc",), None),
    _case("a folder", ("vehicle.dbc",), _folder),
    _case("empty", ("vehicle.dbc",), ""),
    _case("prose", ("vehicle.dbc", "line 1"), "This is no DBC.\n"),
    _case("a log", ("vehicle.dbc",), LOG),
    _case("AUTOSAR XML", ("vehicle.dbc", "xml"), _ARXML),
    _case("zeros", ("vehicle.dbc",), bytes(500)),
    _case("cut in a line", ("vehicle.dbc", "line"), DBC[: DBC.index("100,0")]),
    _case("a signal without its name", ("vehicle.dbc", "line 10"), ("SG_ Current :", "SG_ :")),
    _case("signal beyond its message", ("vehicle.dbc", "Voltage"), ("16|16@1+ (100", "56|16@1+ (100")),
    _case("two signals on the same bits", ("vehicle.dbc", "Voltage"), ("16|16@1+ (100", "8|16@1+ (100")),
    _case("a signal of no bits", ("vehicle.dbc", "Voltage"), ("16|16@1+ (100", "16|0@1+ (100")),
    _case("a signal of four billion bits", ("vehicle.dbc",), ("16|16@1+ (100", "16|4000000000@1+ (100")),
    _case("a scale of zero", ("vehicle.dbc", "Voltage"), ("(100,0)", "(0,0)")),
    _case("a scale that is a word", ("vehicle.dbc", "line 11"), ("(100,0)", "(hundred,0)")),
    _case("an identifier of 33 bits", ("vehicle.dbc",), ("BO_ 256", "BO_ 8589934592")),
    _case("an identifier that is a word", ("vehicle.dbc", "line"), ("BO_ 256", "BO_ PACK")),
    _case("a length of 3000", ("vehicle.dbc", "Pack"), ("Pack: 8", "Pack: 3000")),
    _case("a multiplexed signal without multiplexer", ("vehicle.dbc",), ("Mux M :", "Mux :")),
    _case(
        "a message twice",
        ("vehicle.dbc",),
        ("BO_ 256 Pack: 8 VEHICLE", "BO_ 256 Pack: 8 VEHICLE\n\nBO_ 256 Pack: 8 VEHICLE"),
    ),
    _case("the signal is not in it", ("signals.voltage", "did you mean 'Volt'"), ("SG_ Voltage", "SG_ Volt")),
    _case("the message is not in it", ("Pack",), ("BO_ 256 Pack", "BO_ 256 Battery")),
    _case("a unit of another quantity", ("current", "rpm"), ('"mA"', '"rpm"')),
    _case("a temperature in volts", ("surface.1", "V"), ('[-100|500] "C"', '[-100|500] "V"')),
    _case("a start value of nonsense", ("vehicle.dbc", "line"), ("VERSION", "BA_ nonsense;\nVERSION")),
    Case("dbc: init with none there", "init drive.log --dbc none.dbc --yes", ("none.dbc",)),
    Case("dbc: init with a log", "init drive.log --dbc drive.log --yes", ("drive.log",)),
    Case("dbc: init with prose", "init drive.log --dbc p.dbc --yes", ("p.dbc",), {"p.dbc": "nothing here\n"}),
)
