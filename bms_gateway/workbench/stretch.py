"""A stretch of the live page's past: back from a tab's moment, or between two chosen ends."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bms_gateway.errors import UsageError
from bms_gateway.workbench.desk import Desk
from bms_gateway.workbench.uploads import safe_name

if TYPE_CHECKING:  # the engine: only the live page needs it
    from bms_gateway.workbench.live_estimates import Watch

Ends = tuple[float, float]
"""Start and end, s on the clock of the frames."""
LATEST_S: Final = 1e10
"""Limit of all times: three hundred years after 1970."""
LONGEST_S: Final = 1e9
SLACK_S: Final = 1e-3
"""Rounding of a float that names a tick, s."""


def in_order(ends: Any) -> Ends | None:
    """Check the ends of a stretch; None stays None.

    Raises
    ------
    UsageError
    """
    if ends is None:
        return None
    two = isinstance(ends, list | tuple) and len(ends) == 2
    if not two or not all(isinstance(x, int | float) and not isinstance(x, bool) for x in ends):
        raise UsageError("window: its start and its end in s are needed")
    if not 0.0 <= ends[0] < ends[1] < LATEST_S:
        raise UsageError("window: its end must be after its start")
    return float(ends[0]), float(ends[1])


def of_ends(ends: Ends) -> tuple[int, float]:
    """Return the end, ns, and the length, s, of a stretch, with a margin for the rounding of its ends.

    Examples
    --------
    >>> of_ends((3.0, 5.0))
    (5001000000, 2.002)
    """
    return int((ends[1] + SLACK_S) * 1e9), ends[1] - ends[0] + 2.0 * SLACK_S


def table_name(watch: "Watch", string: int) -> str:
    """Name the table of a string's signals (from 0) in a stretch, for all uses."""
    return f"window_of_{_called(watch, string)}.csv"


def _called(watch: "Watch", string: int) -> str:
    strings = watch.about()["strings"]
    return safe_name(strings[string]["name"] if 0 <= string < len(strings) else "string")


def signals(watch: "Watch", view: str, string: int, span_s: float, ends: Ends | None, out: Path) -> None:
    """Write the signals of one string in a stretch as a table: from the first of its estimates to the last one.

    Raises
    ------
    GatewayError
        There are no signals in this time.
    """
    first_ns, last_ns = watch.stretch_ns(view, span_s, ends)
    watch.signals.table(string, (last_ns - first_ns) * 1e-9, last_ns, out)


def on_desk(watch: "Watch", desk: Desk, body: dict[str, Any]) -> list[str]:
    """Open the signals of one string in a stretch on a tab's desk, with the model of the live page.

    What the live page knows goes along: the readings of a thermocouple that it refuses are not used, and the table says
    why.

    Returns
    -------
    list of str
        Names of both files, which the page keeps as it keeps uploads.

    Raises
    ------
    GatewayError
    """
    string, span = body.get("string"), body.get("span")
    if not isinstance(string, int) or not isinstance(span, int | float) or not 0 <= span < LONGEST_S:
        raise UsageError("window: the number of a string and a span in s are needed")
    table = desk.folder / table_name(watch, string)
    model = desk.folder / f"{_called(watch, string)}.toml"
    first_ns, last_ns = watch.stretch_ns(str(body.get("view", "")), span, in_order(body.get("ends")))
    known = 0 <= string < len(watch.about()["strings"])  # of another one, the table says that there is none
    refused = watch.refused(string, first_ns, last_ns) if known else {}
    watch.signals.table(string, (last_ns - first_ns) * 1e-9, last_ns, table, refused)
    watch.signals.model(string, model)
    desk.open({"tables": [str(table)], "model": str(model), "config": "", "string": "", "columns": []})
    return [table.name, model.name]
