"""Several records in one picture: curves of others are moved onto the axis of the one that is shown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

from bms_gateway.errors import UsageError

Document = dict[str, Any]
By = Literal["start", "clock"]
KINDS = ("surface", "drive", "core")
"""Figures in which records can be laid over each other."""


@dataclass(frozen=True, slots=True)
class Beside:
    """Which other records are shown, by their place, and by what they are aligned."""

    records: tuple[int, ...]
    by: By = "start"

    @classmethod
    def of(cls, records: str, by: str) -> "Beside | None":
        """Read a request; None where none is shown.

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
        """Say by how much the other record is moved, s; None where its wall clock is not known, or is of another kind.

        Times of the day go with times of the day, dates with dates.
        """
        if self.by == "start":
            return 0.0
        ours, theirs = records[shown]["began"], records[other]["began"]
        if ours is None or theirs is None or records[shown]["dated"] != records[other]["dated"]:
            return None
        return float(theirs - ours)


def place_of(name: str, record: int) -> str | None:
    """Give the name of the figure of another record; None where records are not laid over each other in it.

    Examples
    --------
    >>> place_of("surface-0-3", 2), place_of("drive-0", 1), place_of("map-0", 1)
    ('surface-2-3', 'drive-1', None)
    """
    kind, _, rest = name.partition("-")
    _, dash, cell = rest.partition("-")
    return f"{kind}-{record}{dash}{cell}" if kind in KINDS else None


def moved(figure: Document, onto: Mapping[str, Any], shift_s: float, source: str, record: int) -> Document:
    """Give the curves of a joined figure on the axis of another.

    Parameters
    ----------
    figure, onto : dict
        With `seconds` of their axes.
    shift_s : float
        How much later the record began.
    source, record : str, int
        Of the one that is moved.
    """
    scale, shift = figure["seconds"] / onto["seconds"], shift_s / onto["seconds"]
    axes = {d["name"]: d.get("yaxis") for d in onto["data"]}

    def there(x: Any) -> Any:
        if isinstance(x, Mapping):
            kept = {"kept": {**x["kept"], "scale": scale, "shift": shift}} if "kept" in x else {}
            return {k: there(v) for k, v in x.items() if k != "kept"} | kept
        return x

    # what the record that is shown has no axis for is left out
    data = [
        {**there(d), "yaxis": axes.get(d["name"]) or "y"}
        for d in figure["data"]
        if d["name"] in axes or "yaxis" not in d
    ]
    first, last = figure["layout"]["xaxis"]["range"]
    ends = [scale * first + shift, scale * last + shift]
    steps = [there(s) for s in figure.get("steps", ())]
    return {"record": record, "source": source, "ends": ends, "data": data, "steps": steps}
