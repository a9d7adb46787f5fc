"""Several records in one picture: curves of other records are moved onto the axis of the shown one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

from bms_gateway.errors import UsageError

Document = dict[str, Any]
By = Literal["start", "clock"]
KINDS = ("surface", "drive", "core")
"""Figures in which several records can be shown together."""


@dataclass(frozen=True, slots=True)
class Beside:
    """The other shown records, by index, and the kind of alignment."""

    records: tuple[int, ...]
    by: By = "start"

    @classmethod
    def of(cls, records: str, by: str) -> "Beside | None":
        """Read a request; None if no other record is shown.

        Raises
        ------
        UsageError
        """
        if not records:
            return None
        if by not in get_args(By):
            raise UsageError(f"figure: records are aligned by {' or '.join(get_args(By))}, not '{by[:20]}'")
        parts = records.split(",")
        if not all(p.isascii() and p.isdecimal() and len(p) < 4 for p in parts):
            raise UsageError("figure: beside must be places of records, such as 1,2")
        return cls(tuple(sorted({int(p) for p in parts})), by)  # type: ignore[arg-type]  # looked up just now

    def shift_s(self, records: Sequence[Mapping[str, Any]], shown: int, other: int) -> float | None:
        """Return the shift of the other record, s; None if its wall clock is not known, or is of another kind.

        Times of the day are compared with times of the day, dates with dates, and dates without a time zone with such.
        """
        if self.by == "start":
            return 0.0
        ours, theirs = records[shown]["began"], records[other]["began"]
        if ours is None or theirs is None or records[shown]["clock"] != records[other]["clock"]:
            return None
        return float(theirs - ours)


def place_of(name: str, record: int) -> str | None:
    """Return the name of the figure of another record; None if this figure cannot show several records.

    Examples
    --------
    >>> place_of("surface-0-3", 2), place_of("drive-0", 1), place_of("map-0", 1)
    ('surface-2-3', 'drive-1', None)
    """
    kind, _, rest = name.partition("-")
    _, dash, cell = rest.partition("-")
    return f"{kind}-{record}{dash}{cell}" if kind in KINDS else None


def moved(figure: Document, onto: Mapping[str, Any], shift_s: float, source: str, record: int) -> Document:
    """Return the curves of a joined figure on the axis of another.

    Parameters
    ----------
    figure, onto : dict
        With `seconds` of their axes.
    shift_s : float
        Start of the record, later by this time.
    source, record : str, int
        Of the moved record.
    """
    scale, shift = figure["seconds"] / onto["seconds"], shift_s / onto["seconds"]
    axes = {d["name"]: d.get("yaxis") for d in onto["data"]}

    def there(x: Any) -> Any:
        if isinstance(x, Mapping):
            kept = {"kept": {**x["kept"], "scale": scale, "shift": shift}} if "kept" in x else {}
            return {k: there(v) for k, v in x.items() if k != "kept"} | kept
        return x

    # curves without an axis in the shown record are left out
    data = [
        {**there(d), "yaxis": axes.get(d["name"]) or "y"}
        for d in figure["data"]
        if d["name"] in axes or "yaxis" not in d
    ]
    first, last = figure["layout"]["xaxis"]["range"]
    ends = [scale * first + shift, scale * last + shift]
    steps = [there(s) for s in figure.get("steps", ())]
    return {"record": record, "source": source, "ends": ends, "data": data, "steps": steps}


def with_others(
    found: Document, own: Mapping[str, Any], others: Sequence[tuple[int, str, Document, float]]
) -> Document:
    """Return a joined figure with the curves of other records, on an axis that contains all.

    Parameters
    ----------
    found : dict
        The joined figure of the shown record.
    own : mapping
        The same before it was joined.
    others : sequence of (record, source, its joined figure, its shift in s)
    """
    if not others:
        return found
    beside = [moved(figure, own, shift_s, source, r) for r, source, figure, shift_s in others]
    axis = found["layout"]["xaxis"]
    ends = [axis["range"], *(b["ends"] for b in beside)]
    whole = [min(e[0] for e in ends), max(e[1] for e in ends)]
    return {**found, "beside": beside, "layout": {**found["layout"], "xaxis": {**axis, "range": whole}}}
