"""Write `bms_gateway.table`, what the gateway reads in `bms_gateway.dbc`, and the table of inputs in README.md.

Run ``python dbc/tabulate.py`` after ``python dbc/generate.py`` and after a change of the inputs; a test fails while one
of the two is out of date. With the first, no start has to parse the DBC. A table of another DBC is never believed: its
first line holds the check sum of the one it was made of.
"""

from hashlib import sha256
from pathlib import Path

from bms_gateway.config.dbc_files import shipped_head, table
from bms_gateway.frames.dbc import parse
from bms_gateway.frames.own_dbc import OWN_DBC
from bms_gateway.frames.vocabulary import INPUTS, Input

SOURCE = Path(__file__).with_name(OWN_DBC)
TARGET = SOURCE.with_suffix(".table")
README = SOURCE.with_name("README.md")
BEGIN, END = "<!-- inputs -->\n", "<!-- end of inputs -->"
HEAD = """\
| key in `[string.signals]` | unit | believed | column of a table | signal in this DBC | constant |
|---|---|---|---|---|---|
"""


def tabulated() -> str:
    """Table of the DBC as it is now."""
    text = SOURCE.read_text(encoding="utf-8")
    return table(shipped_head(sha256(text.encode()).hexdigest()), parse(OWN_DBC, text))


def inputs() -> str:
    """README with the inputs as they are now."""
    before, _, rest = README.read_text(encoding="utf-8").partition(BEGIN)
    rows = "".join(_row(name, i) for name, i in INPUTS.items())
    return f"{before}{BEGIN}{HEAD}{rows}{END}{rest.partition(END)[2]}"


def _row(name: str, i: Input) -> str:
    key = f"`{name}` of cells" if i.of_cells else f"`{name}`" + (", needed" if i.needed else "")
    constant = "none" if i.constant is None else "{:g} to {:g}".format(*i.constant)
    signal = "none" if i.own is None else "`{}`".format(i.own.replace("{k}", "K").replace("{c:02d}", "CC"))
    believed = "{:g} to {:g}".format(*i.plausible)
    said = f" ({i.said})" if i.said else ""
    return f"| {key} | {i.unit or '1'} | {believed} | `{i.column.format('K')}`{said} | {signal} | {constant} |\n"


if __name__ == "__main__":
    TARGET.write_text(tabulated(), encoding="ascii")
    README.write_text(inputs(), encoding="utf-8")
