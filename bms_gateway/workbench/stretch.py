"""A stretch of the live page's past: so far back from where a tab looks, or between two ends that were chosen."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bms_gateway.errors import UsageError
from bms_gateway.workbench.desk import Desk
from bms_gateway.workbench.uploads import safe_name

if TYPE_CHECKING:  # the engine: only the live page needs it
    from bms_gateway.workbench.watch import Watch

Ends = tuple[float, float]
"""Start and end, s on the clock of the frames."""
LATEST_S: Final = 1e10
"""Of any time: three hundred years after 1970."""
LONGEST_S: Final = 1e9
SLACK_S: Final = 1e-3
"""What a float may lack of the tick that it names."""


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
    """Give the end, ns, and the length, s, of a stretch, with what its floats may lack of the ticks at its ends.

    Examples
    --------
    >>> of_ends((3.0, 5.0))
    (5001000000, 2.002)
    """
    return int((ends[1] + SLACK_S) * 1e9), ends[1] - ends[0] + 2.0 * SLACK_S


def signals(watch: "Watch", view: str, string: int, span_s: float, ends: Ends | None, out: Path) -> None:
    """Write the signals of one string in a stretch as a table.

    Raises
    ------
    GatewayError
        Nothing was heard in this time.
    """
    until_ns, last_s = of_ends(ends) if ends else (watch.until_ns(view), span_s)
    watch.signals.table(string, last_s, until_ns, out)


def on_desk(watch: "Watch", desk: Desk, body: dict[str, Any]) -> list[str]:
    """Open the signals of one string in a stretch on a tab's desk, with the model of the live page.

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
    strings = watch.about()["strings"]
    name = safe_name(strings[string]["name"] if 0 <= string < len(strings) else "string")
    table, model = desk.folder / f"window_of_{name}.csv", desk.folder / f"{name}.toml"
    signals(watch, str(body.get("view", "")), string, span, in_order(body.get("ends")), table)
    watch.signals.model(string, model)
    desk.open({"tables": [str(table)], "model": str(model), "config": "", "string": "", "columns": []})
    return [table.name, model.name]
