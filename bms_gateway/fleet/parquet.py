"""Parquet: the columns of a fleet's rows, and files that come to be as a whole or not at all."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from bms_gateway.errors import MissingExtraError
from bms_gateway.fleet.day import Row
from bms_gateway.fleet.residual import REGIMES
from bms_gateway.whole import whole

try:
    import pyarrow as pa  # type: ignore[import-not-found,import-untyped,unused-ignore]
    import pyarrow.parquet as pq  # type: ignore[import-not-found,import-untyped,unused-ignore]
except ImportError:
    raise MissingExtraError("fleet (Parquet)", "fleet") from None

_CELL = pa.struct(
    [
        ("regime", pa.string()),
        ("cell", pa.int32()),
        ("readings", pa.int64()),
        ("mean_K", pa.float64()),
        ("sd_K", pa.float64()),
        ("rms_K", pa.float64()),
        ("normalised", pa.float64()),
    ]
)
_TEXT, _COUNT, _NUMBER = pa.string(), pa.int64(), pa.float64()
SCHEMA = pa.schema(
    [
        ("vehicle", _TEXT),
        ("log", _TEXT),
        ("error", _TEXT),
        ("day", _TEXT),
        ("string", _TEXT),
        ("cells", pa.int32()),
        ("start_s", _NUMBER),
        ("duration_s", _NUMBER),
        ("frames", _COUNT),
        ("dropped", _COUNT),
        ("broken_lines", _COUNT),
        ("rejected", _COUNT),
        ("rejected_reasons", pa.map_(_TEXT, _COUNT)),
        ("R_e_mOhm", _NUMBER),
        ("R_e_sd_mOhm", _NUMBER),
        ("R_e_status", _TEXT),
        ("R_u_K_W", _NUMBER),
        ("R_u_sd_K_W", _NUMBER),
        ("R_u_status", _TEXT),
        ("growth_pct", _NUMBER),
        ("growth_sd_pct", _NUMBER),
        ("worst_core_C", _NUMBER),
        ("worst_core_sd_K", _NUMBER),
        ("worst_core_cell", pa.int32()),
        ("worst_core_time_s", _NUMBER),
        ("hottest_point_C", _NUMBER),
        ("hottest_point_sd_K", _NUMBER),
        ("hottest_point_cell", pa.int32()),
        ("mismatch", _NUMBER),
        ("flags", pa.list_(_TEXT)),
        *((f"{what}_{regime}", _NUMBER) for regime in REGIMES for what in ("seconds", "rms_K", "normalised")),
        ("residuals", pa.list_(_CELL)),
    ]
)
"""One row per log, day and string; a log that could not be read has one row with `error` and nothing else."""

ATLAS = pa.schema(
    [
        ("string", _TEXT),
        ("cell", pa.int32()),
        ("regime", _TEXT),
        ("vehicles", pa.int32()),
        ("median_K", _NUMBER),
        ("median_sd_K", _NUMBER),
        ("spread_K", _NUMBER),
        ("alike", _NUMBER),
        ("outlier", _TEXT),
        ("outlier_K", _NUMBER),
        ("outlier_sd", _NUMBER),
        ("finding", _TEXT),
    ]
)


GROUP = 1000
"""Number of logs whose rows are packed together: each pack adds 10 kB, each row 1 kB."""


def write_rows(path: Path, rows: Iterable[Row], schema: Any = SCHEMA) -> None:
    """Write rows as one file, whole or not at all.

    Raises
    ------
    OSError
        It cannot be written.
    """
    with whole(path) as file:
        pq.write_table(pa.Table.from_pylist([_maps(r) for r in rows], schema), file)


def join(path: Path, parts: Sequence[Path], more: Iterable[Row]) -> None:
    """Write one file from many, one after the other, and further rows; never more than `GROUP` parts in memory."""
    with whole(path) as file, pq.ParquetWriter(file, SCHEMA) as out:
        for at in range(0, len(parts), GROUP):
            some = [pq.read_table(part, schema=SCHEMA, partitioning=None) for part in parts[at : at + GROUP]]
            out.write_table(pa.concat_tables(some).combine_chunks())
        if rows := [_maps(r) for r in more]:
            out.write_table(pa.Table.from_pylist(rows, SCHEMA))


def read_rows(path: Path) -> list[Row] | None:
    """Read rows back; None if the file is not a complete result, for example because the disk was full."""
    try:
        rows: list[Row] = pq.read_table(path, schema=SCHEMA, partitioning=None).to_pylist()
    except (pa.ArrowInvalid, OSError, KeyError):
        return None
    return rows


def _maps(row: Row) -> Row:
    """Convert mappings to the form that Arrow takes."""
    return {k: list(v.items()) if isinstance(v, dict) else v for k, v in row.items()}
