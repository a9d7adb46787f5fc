"""What is wrong now, as alerts that neither flap nor come too early, and the one line that sums them up.

A *condition* is something wrong at this moment. It becomes an *alert* once it has lasted `hold_s`, and the alert ends
once the condition has been gone for `clear_s`. Conditions that bring a hysteresis and a hold time of their own (the
flags of `health`) pass at once. For `grace_s` after a start, and after each pause of the bus, nothing is raised:
senders come up one by one, and a reading that is late then is nobody's fault. What is still wrong afterwards is.

Time is an argument; nothing here reads a clock.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

GRACE_S: Final = 10.0  # the slowest message of a battery comes every few seconds
HOLD_S: Final = 3.0  # a plug that rattles for a second is no alert
CLEAR_S: Final = 10.0  # nor is it mended by one good reading


class Severity(IntEnum):
    """How soon somebody must act; also the states of the gateway as a whole."""

    OK = 0
    WARNING = 1
    ALARM = 2


@dataclass(frozen=True, slots=True)
class Condition:
    """Something that is wrong now.

    Attributes
    ----------
    name : str
        Stable word for machines: "bus", "sensor", "ageing", …
    severity : Severity
    text : str
        One sentence: what, why, and what to do.
    string : str, optional
    cell : int, optional
        From 1.
    part : str
        What tells two conditions of one name and place apart.
    settled : bool
        It has its own hysteresis and hold time.
    """

    name: str
    severity: Severity
    text: str
    string: str | None = None
    cell: int | None = None
    part: str = ""
    settled: bool = False

    @property
    def key(self) -> tuple[str, str, int, str]:
        """What makes two conditions the same one."""
        return self.name, self.string or "", self.cell or 0, self.part


@dataclass(frozen=True, slots=True)
class Change:
    """An alert was raised, has become more or less severe, or is over."""

    condition: Condition
    raised: bool


@dataclass(slots=True)
class _Seen:
    condition: Condition
    first_s: float
    last_s: float
    raised: Severity = Severity.OK


class Alerts:
    """Alerts of one gateway.

    Parameters
    ----------
    grace_s, hold_s, clear_s : float
        See the module's text.

    Examples
    --------
    >>> hot = Condition("core", Severity.ALARM, "core of cell 3 is 71 °C: stop", settled=True)
    >>> alerts = Alerts(grace_s=10.0)
    >>> alerts.begin(100.0)
    >>> alerts.update(101.0, [hot]), alerts.severity.name
    ([], 'OK')
    >>> [c.raised for c in alerts.update(110.0, [hot])], alerts.line
    ([True], 'ALARM: core of cell 3 is 71 °C: stop')
    """

    def __init__(self, *, grace_s: float = GRACE_S, hold_s: float = HOLD_S, clear_s: float = CLEAR_S) -> None:
        self.grace_s, self.hold_s, self.clear_s = grace_s, hold_s, clear_s
        self._quiet_until_s = float("-inf")
        self._seen: dict[tuple[str, str, int, str], _Seen] = {}

    def begin(self, now_s: float) -> None:
        """Start the grace time: the service or the bus has just come up."""
        self._quiet_until_s = now_s + self.grace_s

    def update(self, now_s: float, conditions: Sequence[Condition]) -> list[Change]:
        """Take what is wrong now.

        Returns
        -------
        list of Change
            What people should be told, in the order of the conditions, ended ones last.
        """
        changes = []
        for condition in conditions:
            seen = self._seen.setdefault(condition.key, _Seen(condition, now_s, now_s))
            seen.condition, seen.last_s = condition, now_s
            lasted = condition.settled or now_s - seen.first_s >= self.hold_s
            if lasted and now_s >= self._quiet_until_s and seen.raised is not condition.severity:
                seen.raised = condition.severity
                changes.append(Change(condition, raised=True))
        present = {c.key for c in conditions}
        for key in [key for key in self._seen if key not in present]:
            seen = self._seen[key]
            if not seen.raised:
                del self._seen[key]
            elif seen.condition.settled or now_s - seen.last_s >= self.clear_s:
                del self._seen[key]
                changes.append(Change(seen.condition, raised=False))
        return changes

    @property
    def raised(self) -> list[Condition]:
        """Alerts now, the most severe first, older before newer."""
        found = [s for s in self._seen.values() if s.raised]
        return [s.condition for s in sorted(found, key=lambda s: (-s.raised, s.first_s))]

    @property
    def severity(self) -> Severity:
        """State of the whole: that of the worst alert."""
        return max((s.raised for s in self._seen.values()), default=Severity.OK)

    @property
    def line(self) -> str:
        """One line: the state and, unless it is OK, the worst alert and how many more there are."""
        if not (raised := self.raised):
            return Severity.OK.name
        where = "" if raised[0].string is None else f"{raised[0].string}: "
        more = f" (and {len(raised) - 1} more)" if len(raised) > 1 else ""
        return f"{self.severity.name}: {where}{raised[0].text}{more}"
