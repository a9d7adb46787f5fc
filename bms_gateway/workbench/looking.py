"""A first look at chosen files: the columns of a table, or the kind of a log."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bms_gateway.records.kind import log_kind
from bms_gateway.report.look import look
from bms_gateway.report.table import parse_columns


def surfaces(tables: Sequence[Path], columns: Sequence[str], each: Sequence[Sequence[str]] = ()) -> tuple[int, ...]:
    """Return the cells of the first table with a surface, according to its names and the mappings."""
    names = [c["ours"] for c in _used(tables, columns, each) if c["ours"].startswith("surface_")]
    return tuple(sorted(int(name.split("_")[1]) for name in names))


def measured_flow(tables: Sequence[Path], columns: Sequence[str], each: Sequence[Sequence[str]] = ()) -> str:
    """Say which column of the first table is the coolant flow and what it reads; empty if there is none or no flow."""
    flow = next((c for c in _used(tables, columns, each) if c["ours"] == "coolant_flow_m3_s"), None)
    if flow is None or not flow["high"]:
        return ""
    return f"column '{flow['name']}' is a coolant flow of {flow['low']:.4g} to {flow['high']:.4g} {flow['in']}"


def _used(tables: Sequence[Path], columns: Sequence[str], each: Sequence[Sequence[str]]) -> list[dict[str, Any]]:
    """Columns of the first table that stand for something, by their names and the mappings."""
    first = next((k for k, t in enumerate(tables) if log_kind(t) is None), None)
    if first is None:
        return []
    found = looked(tables[first], [*columns, *(each[first] if first < len(each) else ())])["columns"]
    return [c for c in found if c["by"] in ("name", "told")]


def looked(path: Path, columns: Sequence[str]) -> dict[str, Any]:
    """Look at a table, or return the kind of a log."""
    kind = log_kind(path)
    if kind is not None:
        return {"source": path.name, "log": kind, "columns": [], "missing": [], "notes": [], "units": {}}
    return {**look(path, parse_columns(columns)), "log": ""}
