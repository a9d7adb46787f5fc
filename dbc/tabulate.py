"""Write `bms_gateway.table`: what the gateway reads in `bms_gateway.dbc`, so that no start has to parse it.

Run ``python dbc/tabulate.py`` after ``python dbc/generate.py``; a test fails while the table is out of date. A table of
another DBC is never believed: its first line holds the check sum of the one it was made of.
"""

from hashlib import sha256
from pathlib import Path

from bms_gateway.config.dbc_files import shipped_head, table
from bms_gateway.frames.dbc import parse
from bms_gateway.frames.own_dbc import OWN_DBC

SOURCE = Path(__file__).with_name(OWN_DBC)
TARGET = SOURCE.with_suffix(".table")


def tabulated() -> str:
    """Table of the DBC as it is now."""
    text = SOURCE.read_text(encoding="utf-8")
    return table(shipped_head(sha256(text.encode()).hexdigest()), parse(OWN_DBC, text))


if __name__ == "__main__":
    TARGET.write_text(tabulated(), encoding="ascii")
