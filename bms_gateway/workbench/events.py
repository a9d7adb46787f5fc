"""What happened to a pack, for the page: alerts and notices in groups, newest first."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from bms_gateway.engine import Alerted, Notice
from bms_gateway.engine.events import Level
from bms_gateway.health.alerts import Condition, Severity

MOST: Final = 2000
"""Events kept; of more the oldest go."""
GROUPS: Final = 40
"""Groups shown."""
MARKS: Final = 100
"""Alerts marked in a history."""
OF_LEVEL: Final = {Level.WARNING: Severity.WARNING, Level.NOTICE: Severity.OK, Level.INFO: Severity.OK}
WORDS: Final = {Severity.OK: "note", Severity.WARNING: "warning", Severity.ALARM: "alarm"}


@dataclass(frozen=True, slots=True)
class Happened:
    """One event.

    Attributes
    ----------
    state : {"raised", "changed", "over", ""}
        Of an alert; empty for a notice.
    """

    time_ns: int
    severity: Severity
    code: str
    string: str
    cell: int | None
    text: str
    state: str


@dataclass(slots=True)
class Events:
    """Events in the order in which they came."""

    all: list[Happened] = field(default_factory=list)

    def take(self, event: Notice | Alerted) -> None:
        """Keep one."""
        if isinstance(event, Notice):
            severity = OF_LEVEL[event.level]
            found = Happened(event.time_ns, severity, event.code, event.string or "", event.cell, event.text, "")
        else:
            c = event.change.condition
            state = event.change.state
            found = Happened(event.time_ns, c.severity, c.name, c.string or "", c.cell, c.text, state)
        self.all = [*self.all[-MOST + 1 :], found]

    def grouped(self, until_ns: int, first_ns: int) -> list[dict[str, Any]]:
        """Tell what happened until a moment: alerts and notices of one kind and string are one line, newest first."""
        groups: dict[tuple[str, str, bool], list[Happened]] = {}
        for e in self.all:
            if e.time_ns <= until_ns:
                groups.setdefault((e.code, e.string, bool(e.state)), []).append(e)
        newest = sorted(groups.values(), key=lambda g: -g[-1].time_ns)[:GROUPS]
        return [
            {
                "code": g[-1].code,
                "string": g[-1].string,
                "level": WORDS[max(e.severity for e in g)],
                "state": g[-1].state,
                "count": sum(e.state != "over" for e in g),
                "first": _seconds(g[0].time_ns, first_ns),
                "at": _seconds(g[-1].time_ns, first_ns),
                "text": g[-1].text,
            }
            for g in newest
        ]

    def marks(self, string: str, from_ns: int, to_ns: int, first_ns: int) -> list[dict[str, Any]]:
        """Tell the alerts of a string, and those of the whole, that were raised or ended in a stretch of time."""
        found = [e for e in self.all if e.state and e.string in ("", string) and from_ns <= e.time_ns <= to_ns]
        return [
            {"at": _seconds(e.time_ns, first_ns), "level": WORDS[e.severity], "state": e.state, "text": e.text}
            for e in found[-MARKS:]
        ]


def alerts_now(raised: Sequence[Condition]) -> tuple[dict[str, Any], ...]:
    """Tell the alerts that are raised, the gravest first."""
    return tuple(
        {"level": WORDS[c.severity], "code": c.name, "string": c.string or "", "cell": c.cell, "text": c.text}
        for c in raised
    )


def _seconds(time_ns: int, first_ns: int) -> float:
    return round((time_ns - first_ns) * 1e-9, 1)
