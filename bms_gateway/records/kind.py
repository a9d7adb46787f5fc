"""Distinguishes logs from tables, and checks that a table's time is in seconds."""

from pathlib import Path

import numpy as np

from bms_gateway.bus.candump import LATEST_S
from bms_gateway.bus.logfile import FORMATS
from bms_gateway.bus.sniff import HEAD, kind_of
from bms_gateway.errors import DataError
from bms_gateway.report.file_mdf import holds_signals
from bms_gateway.report.table import Table

LONGEST_S = 10 * 86_400  # longest bench run; a longer time must be in another unit
WIDEST_STEP_S = 100.0  # ten rows a second, in ms; a current that is known this seldom does not determine the heat
LEAST_STEP_S = 5e-4  # a row a second, in hours, is half of it; frames come every hundredth of a second at most
MANY_ROWS = 10

COLDEST_K, HOTTEST_K = 230.0, 400.0  # possible temperatures of a cell in K; the same numbers in °C would be a fire


def log_kind(path: Path) -> str | None:
    """Find the kind of log of a file by its name, otherwise by its first bytes; None if it is no log.

    An MF4 file of decoded signals is none.

    Raises
    ------
    MissingExtraError
        An MF4 file without asammdf.
    """
    suffixes = [s for s in Path(path.name.lower()).suffixes if s != ".gz"]
    kind: str | None = suffixes[-1] if suffixes else ""
    if kind == ".mf4" and path.is_file() and holds_signals(path):
        return None
    if kind == ".csv" or kind not in FORMATS:
        kind = None if path.suffix.lower() == ".gz" else _content(path)
    return kind


def _content(path: Path) -> str | None:
    """Return the format of a log whose text cannot be that of a table."""
    try:
        if not path.is_file():
            return None
        with path.open("rb") as file:
            kind = kind_of(file.read(HEAD))
    except OSError:  # the reader of the table reports it
        return None
    return kind if kind in (".log", ".csv") else None


def check_time(table: Table) -> None:
    """Refuse a time that no log can hold, or that is plainly not in seconds.

    Raises
    ------
    DataError
    """
    if table.time_s[0] < 0:
        raise DataError(f"{table.source}: time_s begins at {table.time_s[0]:g}: a log cannot hold times below zero")
    check_seconds(table)


def check_seconds(table: Table) -> None:
    """Refuse a time that is plainly not in seconds, or dates that are not those of one measurement.

    Raises
    ------
    DataError
    """
    t = table.time_s
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    if t[-1] >= LATEST_S and not table.dated:
        seen = f"ends at {t[-1]:g}, after the year 2255"
    elif step >= WIDEST_STEP_S:
        seen = f"goes on by {step:g} from row to row, where less than {WIDEST_STEP_S:g} s are needed"
    elif t[-1] - t[0] > LONGEST_S:
        seen = f"spans {(t[-1] - t[0]) / 86_400:.3g} days, more than the {LONGEST_S // 86_400} that one table may"
    elif len(t) >= MANY_ROWS and step < LEAST_STEP_S and not table.dated:
        raise DataError(
            f"{table.source}: time_s looks like hours or days, it must be in seconds: {len(t)} rows span "
            f"{t[-1] - t[0]:.3g} s"
        )
    else:
        return
    # stamps of today, s since 1970, have ten digits in seconds and three more in each smaller unit
    small = "nanoseconds" if 1e17 <= t[-1] < 1e20 else "microseconds" if 1e14 <= t[-1] < 1e17 else "milliseconds"
    unit = "" if table.dated else f" looks like {small}, it must be in seconds: it"
    raise DataError(f"{table.source}: time_s{unit} {seen}")


def check_kelvin(table: Table) -> None:
    """Refuse temperatures that no cell survives in °C and that are normal in K.

    Raises
    ------
    DataError
        Names the option that states the unit.
    """
    columns = {"coolant_inlet_C": table.coolant_inlet_C}
    columns |= {f"surface_{k}_C": x for k, x in table.surface_C.items()}
    for name, x in columns.items():
        given = x[np.isfinite(x)]
        with np.errstate(over="ignore"):  # the mean of two values may be too large for a float
            median = float(np.median(given)) if len(given) else 0.0
        if COLDEST_K < median < HOTTEST_K:
            raise DataError(
                f"{table.source}: {name}: half of its values are above {median:.4g} °C: are they in K? "
                f"Say it: --columns '{name}=COLUMN [K]'"
            )
