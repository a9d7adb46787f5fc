"""Events of a pack, for the page: alerts and notices in groups, newest first."""

import csv
import io
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from bms_gateway.engine import Alerted, Notice
from bms_gateway.engine.events import Level
from bms_gateway.errors import UsageError
from bms_gateway.health.alerts import Condition, Severity
from bms_gateway.report.show import ranges
from bms_gateway.workbench.history import wall_clock

MOST: Final = 2000
"""Number of kept events; beyond it, the oldest are removed."""
COLUMNS: Final = (
    "time_s",
    "wall_clock",
    "level",
    "code",
    "string",
    "cell",
    "state",
    "text",
    "acknowledged",
    "reason",
)
FORMULA: Final = ("=", "+", "-", "@")
"""Characters with which a formula of a spreadsheet begins."""
GROUPS: Final = 40
"""Number of shown groups."""
MARKS: Final = 100
"""Number of alerts marked in a history."""
OF_LEVEL: Final = {Level.WARNING: Severity.WARNING, Level.NOTICE: Severity.OK, Level.INFO: Severity.OK}
Group = tuple[str, str, str, bool]
"""Kind, part, string, and whether they are alerts."""
WORDS: Final = {Severity.OK: "note", Severity.WARNING: "warning", Severity.ALARM: "alarm"}


@dataclass(frozen=True, slots=True)
class Happened:
    """One event.

    Attributes
    ----------
    state : {"raised", "changed", "over", ""}
        Of an alert; empty for a notice.
    part : str
        Distinguishes several alerts of one name, such as the quantity of a sensor.
    """

    time_ns: int
    severity: Severity
    code: str
    string: str
    cell: int | None
    text: str
    state: str
    part: str = ""

    @property
    def group(self) -> Group:
        """Events of one group are one line: those of one kind, part and string, of alerts or of notices."""
        return self.code, self.part, self.string, bool(self.state)


@dataclass(frozen=True, slots=True)
class Seen:
    """Acknowledgement of the events of a group until some moment: its time and text."""

    until_ns: int
    wall_s: float
    reason: str


@dataclass(slots=True)
class Events:
    """Events in the order of arrival, and which were acknowledged."""

    all: list[Happened] = field(default_factory=list)
    seen: dict[Group, Seen] = field(default_factory=dict)

    def take(self, event: Notice | Alerted) -> None:
        """Store an event."""
        if isinstance(event, Notice):
            severity = OF_LEVEL[event.level]
            found = Happened(
                event.time_ns, severity, event.code, event.string or "", event.cell, event.text, "", event.part
            )
        else:
            c = event.change.condition
            state = event.change.state
            found = Happened(event.time_ns, c.severity, c.name, c.string or "", c.cell, c.text, state, c.part)
        self.all = [*self.all[-MOST + 1 :], found]

    def acknowledge(self, group: Group, reason: str, until_ns: int) -> None:
        """Mark the events of a group until a moment as seen.

        Raises
        ------
        UsageError
            There is no such event.
        """
        if not any(e.group == group and e.time_ns <= until_ns for e in self.all):
            code, part, string, _ = group
            of = f" ({part})" if part else ""
            raise UsageError(f"acknowledge: nothing of the kind '{code}'{of} has happened to '{string or 'the pack'}'")
        self.seen[group] = Seen(until_ns, time.time(), reason)

    def table(self) -> bytes:
        """Write all events as CSV, oldest first, on the clock of the frames."""
        out = io.StringIO()
        write = csv.writer(out, lineterminator="\n")
        write.writerow(COLUMNS)
        for e in self.all:
            seen = self.seen.get(e.group)
            known = seen if seen is not None and e.time_ns <= seen.until_ns else None
            write.writerow(
                [
                    _seconds(e.time_ns, 0),
                    wall_clock(e.time_ns),
                    WORDS[e.severity],
                    harmless(e.code),
                    harmless(e.string),
                    "" if e.cell is None else e.cell,
                    e.state,
                    harmless(e.text),
                    "" if known is None else wall_clock(int(known.wall_s * 1e9)),
                    "" if known is None else harmless(known.reason),
                ]
            )
        return out.getvalue().encode()

    def grouped(self, until_ns: int, first_ns: int) -> list[dict[str, Any]]:
        """Return the events until a moment: events of one group are one line, newest first.

        An alert replaces the earlier notices of its kind and part. Newer notices have a line of their own.
        """
        groups: dict[Group, list[Happened]] = {}
        alerted: dict[tuple[str, str, str], int] = {}
        past = [e for e in self.all if e.time_ns <= until_ns]
        for e in past:
            if e.state:
                alerted[e.code, e.string, e.part] = e.time_ns
        for e in past:
            if e.state or e.time_ns > alerted.get((e.code, e.string, e.part), e.time_ns - 1):
                groups.setdefault(e.group, []).append(e)
        newest = sorted(groups.values(), key=lambda g: -g[-1].time_ns)[:GROUPS]
        return [
            {
                "code": g[-1].code,
                "part": g[-1].part,
                "string": g[-1].string,
                **_said(g),
                "state": g[-1].state,
                "count": sum(e.state != "over" for e in g),
                "first": _seconds(g[0].time_ns, first_ns),
                "at": _seconds(g[-1].time_ns, first_ns),
                "alert": bool(g[-1].state),
                "seen": self._told(g),
            }
            for g in newest
        ]

    def refused(self, string: str, first_ns: int, last_ns: int) -> dict[int, str]:
        """Return the cells whose thermocouple is not to be used in a stretch of time, and why.

        These are the ones that an alert of their own doubted at any time in it, and those that the guard refuses at its
        end. What it refused earlier was never recorded.
        """
        found: dict[int, str] = {}
        guard: dict[int, str] = {}
        for e in self.all:
            if e.string != string or e.cell is None or e.time_ns > last_ns:
                continue
            if e.code == "thermocouple" and e.state:
                if e.state != "over":
                    found[e.cell] = e.text
                elif e.time_ns < first_ns:  # a later end says why it ended, not why the sensor was doubted
                    found.pop(e.cell, None)
            elif e.code == "sensor" and e.part == "surface" and not e.state:
                guard[e.cell] = e.text
                if e.severity == Severity.OK:
                    del guard[e.cell]
        return {k: found.get(k) or guard[k] for k in sorted(found | guard)}

    def _told(self, group: Sequence[Happened]) -> dict[str, Any] | None:
        """Return the acknowledgement of the newest event of a group."""
        last = group[-1]
        seen = self.seen.get(last.group)
        if seen is None or last.time_ns > seen.until_ns:
            return None
        return {"wall_ms": int(1e3 * seen.wall_s), "reason": seen.reason}

    def marks(self, string: str, from_ns: int, to_ns: int, first_ns: int) -> list[dict[str, Any]]:
        """Return the alerts of a string, and of the whole pack, that were raised or ended in a stretch of time."""
        found = [e for e in self.all if e.state and e.string in ("", string) and from_ns <= e.time_ns <= to_ns]
        return [
            {"at": _seconds(e.time_ns, first_ns), "level": WORDS[e.severity], "state": e.state, "text": e.text}
            for e in found[-MARKS:]
        ]


def _said(group: Sequence[Happened]) -> dict[str, str]:
    """Return the present text: the newest one of an alert; of notices, the most severe last one of any cell.

    Faults of notices that are over stand behind it, and the worst level of all, by which a filter finds them.
    """
    newest, worst = group[-1], max(e.severity for e in group)
    if newest.state:
        return {"level": WORDS[worst], "worst": WORDS[worst], "text": newest.text}
    last = {e.cell: e for e in group}
    grave = max(e.severity for e in last.values())
    told = [e for e in last.values() if e.severity == grave]
    top = max(told, key=lambda e: e.time_ns)
    text = f"{top.text}{_too([e.cell for e in told], top.cell)}"
    over = [e for e in group if e.severity == worst and (grave < worst or e.cell not in {x.cell for x in told})]
    if over:
        text += f"; before: {over[-1].text}{_too([e.cell for e in over], over[-1].cell)}"
    return {"level": WORDS[grave], "worst": WORDS[worst], "text": text}


def _too(cells: Iterable[int | None], told: int | None) -> str:
    """Name the other cells of which a sentence holds."""
    others = sorted({c for c in cells if c is not None and c != told})
    return f"; cell{'s' * (len(others) > 1)} {ranges(others)} too" if others else ""


def alerts_now(raised: Sequence[Condition]) -> tuple[dict[str, Any], ...]:
    """Return the present alerts, the most severe first."""
    return tuple(
        {"level": WORDS[c.severity], "code": c.name, "string": c.string or "", "cell": c.cell, "text": c.text}
        for c in raised
    )


def harmless(text: str) -> str:
    """Prevent a spreadsheet from reading a text as a formula, by an apostrophe before it; the text is then shown.

    Examples
    --------
    >>> harmless("=cmd|'/C calc'!A0"), harmless("fan replaced")
    ("'=cmd|'/C calc'!A0", 'fan replaced')
    """
    return f"'{text}" if text.lstrip().startswith(FORMULA) or text.startswith(("\t", "\r", "\n")) else text


def _seconds(time_ns: int, first_ns: int) -> float:
    return round((time_ns - first_ns) * 1e-9, 1)
