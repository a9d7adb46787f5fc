"""Tables that are none, or of which nobody can tell what they mean."""

import gzip
from pathlib import Path

from tests.cli.bad_inputs.case import HEADER, LOG, ROWS, TABLE, Case, Edit

COMPARE = "compare bench.csv --model string_1.toml"
ENCODE = "encode bench.csv --config gateway.toml --out out.log"


def _row(k: int, text: str) -> str:
    return "\n".join([HEADER, *ROWS[:k], text, *ROWS[k + 1 :]]) + "\n"


def _column(name: str, new: str) -> str:
    return TABLE.replace(name, new, 1)


def _cell(k: int, column: int, value: str) -> str:
    cells = ROWS[k].split(",")
    cells[column] = value
    return _row(k, ",".join(cells))


def _all(column: int, *values: str) -> str:
    rows = [row.split(",") for row in ROWS]
    for k, row in enumerate(rows):
        row[column] = values[k % len(values)] if len(values) < len(rows) else values[k]
    return "\n".join([HEADER, *(",".join(row) for row in rows)]) + "\n"


def _folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _case(name: str, blame: tuple[str, ...], content: Edit, words: str = COMPARE) -> Case:
    return Case(f"table: {name}", words, blame, {"bench.csv": content})


def _named(name: str, words: str, blame: tuple[str, ...], **files: Edit) -> Case:
    return Case(f"table: {name}", words, blame, {k.replace("__", "."): v for k, v in files.items()})


_DAYS = [f"0{1 + k // 5}/0{1 + k % 9}/2026 10:00:00" for k in range(40)]
_SHEET = b"PK\x03\x04\x14\x00\x06\x00" + bytes(64) + b"xl/workbook.xml" + bytes(200)

TABLES: tuple[Case, ...] = (
    _named("missing, near a real name", "compare bech.csv --model string_1.toml", ("bech.csv", "bench.csv")),
    _case("empty", ("bench.csv", "empty"), ""),
    _case("header only", ("bench.csv", "no rows"), HEADER + "\n"),
    _case("a folder", ("bench.csv", "directory"), _folder),
    _case("bytes of no text", ("bench.csv", "not a text table"), bytes(range(256)) * 40),
    _case("an Excel workbook", ("bench.csv", "excel", "csv"), _SHEET),
    _case("a PDF", ("bench.csv", "pdf"), b"%PDF-1.7\n%\xe2\xe3\xcf\xd3\n1 0 obj\n"),
    _case("a web page", ("bench.csv", "html"), "<!DOCTYPE html>\n<html><body>Please log in</body></html>\n"),
    _case("JSON", ("bench.csv", "json"), '{"time_s": [0, 1, 2],\n "current_A": [1, 2, 3]}\n'),
    _case("numbers without a header", ("line 1", "header"), "\n".join(ROWS) + "\n"),
    _case("no time", ("time_s", "--columns time_s="), _column("time_s", "zeitpunkt_x")),
    _case("no current", ("current_A", "--columns current_A="), _column("current_A", "xyz")),
    _case("no inlet", ("coolant_inlet_C", "--columns"), _column("coolant_inlet_C", "xyz")),
    _case("a column misspelt", ("current_A", "curent_A"), _column("current_A", "curent_A")),
    _case("no surface of the model", ("surface_1_C",), TABLE.replace("surface_", "skin ")),
    _case("time goes back", ("line 12", "goes back"), _cell(10, 0, "3")),
    _case("time stands still", ("line 12", "stands still"), _cell(10, 0, "9")),
    _case("time missing", ("line 12", "time_s"), _cell(10, 0, "")),
    _case("a word for a number", ("line 12", "current_A", "OL"), _cell(10, 1, "OL")),
    _case("infinite", ("line 12", "current_A", "inf"), _cell(10, 1, "inf")),
    _case("a row too short", ("line 12", "columns"), _row(10, "10,1")),
    _case("a row too long", ("line 12", "columns"), _row(10, ROWS[10] + ",1")),
    _case("an open quote", ("line 12",), _row(10, '"' + ROWS[10])),
    _case("a column twice", ("line 1", "twice"), _column("voltage_V", "current_A")),
    _case("state of charge beyond all scales", ("soc", "line"), _cell(10, 4, "5000")),
    _case(
        "milliseconds called seconds", ("time_s", "millisecond"), _all(0, *(f"{250 * k}" for k in range(40))), ENCODE
    ),
    _case("decimal commas between commas", ("line 2", "decimal comma"), TABLE.replace(".", ",")),
    _case("two kinds of decimal marks", ("line 12", "current_A"), _cell(10, 1, "1.234.5").replace(",", ";")),
    _case("day or month", ("time_s", "day", "month"), _all(0, *_DAYS)),
    _case("a date in one row only", ("line 12", "time_s"), _cell(10, 0, "2026-11-03 10:00:00")),
    _case("a unit that is none", ("current", "furlong"), _column("current_A", "current_A [furlong]")),
    _case("a unit of something else", ("current_A", "bar"), _column("current_A", "current_A [bar]")),
    _case("kelvin called °C", ("coolant_inlet_C", "[K]"), _all(2, "293.1", "294.2", "295.3")),
    _case("a candump log", ("log", "analyze"), LOG, ENCODE),
    _named("a log by its name", "compare drive.log --model string_1.toml", ("drive.log", "--config")),
    _named("gz that is none", "compare b.csv.gz --model string_1.toml", ("b.csv.gz", "gzip"), b__csv__gz=TABLE),
    _named(
        "gz cut short",
        "compare b.csv.gz --model string_1.toml",
        ("b.csv.gz", "cut short"),
        b__csv__gz=gzip.compress(TABLE.encode())[:90],
    ),
    _named("Parquet that is none", "compare b.parquet --model string_1.toml", ("b.parquet",), b__parquet=TABLE),
    _named("--columns of no table", f"{COMPARE} --columns curent_A=I", ("curent_A", "current_A")),
    _named("--columns of no column", f"{COMPARE} --columns current_A=curent_A", ("curent_A", "current_A")),
    _named("--columns without =", f"{COMPARE} --columns current_A", ("name=column",)),
    _named("--columns twice", f"{COMPARE} --columns current_A=soc --columns current_A=soc", ("once",)),
    _named("output over the table", "encode bench.csv --config gateway.toml --out bench.csv", ("bench.csv",)),
    _case("seconds from an hour ago to now, once empty", ("bench.csv",), "\n\n\n"),
)
