"""Conditions become alerts after a hold time; one line sums the alerts up.

A *condition* is a fault that exists at this moment. It becomes an *alert* after it has lasted `hold_s`, and the alert
ends after the condition has been absent for `clear_s`. A condition with its own hysteresis and hold time (the flags of
`health`) becomes an alert at once. For `grace_s` after a start, and after each pause of the bus, no alert is raised:
the senders start one after the other, and a reading that is late at this time shows no fault. A condition that still
exists after the grace time is raised then.

Time is an argument; nothing here reads a clock.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Final, Literal

Fact = float | int | str
Key = tuple[str, str, int, str]

GRACE_S: Final = 10.0  # the slowest message of a battery has a period of a few seconds
HOLD_S: Final = 3.0  # a loose plug that interrupts for one second raises no alert
CORE_MAX_C: Final = 80.0
"""Above what data sheets of lithium-ion cells allow on discharge (60 to 75 °C), below where self-heating begins: the
SEI decomposes from 80 to 90 °C on."""
CLEAR_S: Final = 10.0  # one good reading does not end an alert
AGAIN_S: Final = 30.0  # least time between two reports of one alert whose phase changes


@dataclass(frozen=True, slots=True)
class AlertSettings:
    """`[alerts]` of the config: the times after which a condition becomes an alert or ends one, and the limits.

    Attributes
    ----------
    grace_s, hold_s, clear_s : float
        See the module's text.
    core_max_C : float
        Hottest point of a cell at which the alarm begins, °C.
    surface_max_C : float or None
        Reading of a surface at which the alarm begins, °C; None: the same limit as `core_max_C`.
    """

    grace_s: float = GRACE_S
    hold_s: float = HOLD_S
    clear_s: float = CLEAR_S
    core_max_C: float = CORE_MAX_C
    surface_max_C: float | None = None

    @property
    def surface_limit_C(self) -> float:
        """Limit of the surfaces, °C."""
        return self.core_max_C if self.surface_max_C is None else self.surface_max_C


class Severity(IntEnum):
    """How soon somebody must act; also the states of the gateway as a whole."""

    OK = 0
    WARNING = 1
    ALARM = 2


@dataclass(frozen=True, slots=True)
class Condition:
    """A fault that exists now.

    Attributes
    ----------
    name : str
        Stable word for machines: "bus", "sensor", "ageing", …
    severity : Severity
    text : str
        One sentence: what is wrong, why, and what to do.
    string : str, optional
    cell : int, optional
        From 1.
    part : str
        Distinguishes two conditions of the same name, string and cell.
    settled : bool
        The condition has its own hysteresis and hold time.
    urgent : bool
        The start of the senders cannot cause this condition: it is reported in the grace time too.
    wanders : bool
        The condition belongs to the whole string; `cell` names the cell that is worst now.
    phase : str
        An alert is reported again when its phase has changed and has kept the new value for `hold_s`: its meaning has
        changed. Two reports of one alert are at least `AGAIN_S` apart.
    facts : mapping
        Numbers for machines, as ``heat_W``.
    minor : bool
        Of a signal without which all estimates go on: told after the others of its severity.
    """

    name: str
    severity: Severity
    text: str
    string: str | None = None
    cell: int | None = None
    part: str = ""
    settled: bool = False
    urgent: bool = False
    wanders: bool = False
    phase: str = ""
    facts: Mapping[str, Fact] = field(default_factory=dict, compare=False)
    minor: bool = False

    @property
    def key(self) -> Key:
        """Two conditions with the same key are the same condition at two times."""
        return self.name, self.string or "", 0 if self.wanders else self.cell or 0, self.part


@dataclass(frozen=True, slots=True)
class Change:
    """An alert was raised, has changed its severity or its phase, or has ended."""

    condition: Condition
    raised: bool
    again: bool = False

    @property
    def state(self) -> Literal["raised", "changed", "over"]:
        """The change in one word."""
        return "over" if not self.raised else "changed" if self.again else "raised"


@dataclass(slots=True)
class _Seen:
    condition: Condition
    first_s: float
    last_s: float
    raised: Severity = Severity.OK
    phase: str = ""
    told_s: float = float("-inf")
    newest: str = ""
    since_s: float = float("-inf")


class Alerts:
    """Alerts of one gateway.

    Parameters
    ----------
    grace_s, hold_s, clear_s : float
        See the module's text.
    also : callable, optional
        Gives alerts that other code has raised; `raised`, `severity` and `line` include them.
    ended : callable, optional
        Gives, for the last condition of an alert that ends, the same with the sentence that says why it has ended.

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

    def __init__(
        self,
        *,
        grace_s: float = GRACE_S,
        hold_s: float = HOLD_S,
        clear_s: float = CLEAR_S,
        also: Callable[[], Sequence[Condition]] = tuple,
        ended: Callable[[Condition], Condition] | None = None,
    ) -> None:
        self.grace_s, self.hold_s, self.clear_s = grace_s, hold_s, clear_s
        self._quiet_until_s = float("-inf")
        self._seen: dict[Key, _Seen] = {}
        self._also, self._ended = also, ended or no_longer

    def begin(self, now_s: float) -> None:
        """Start the grace time: the service or the bus has just started."""
        self._quiet_until_s = now_s + self.grace_s

    def update(self, now_s: float, conditions: Sequence[Condition], *, last: bool = False) -> list[Change]:
        """Update the alerts with the conditions that exist now.

        Parameters
        ----------
        now_s : float
        conditions : sequence of Condition
        last : bool
            The next call comes after a long time: an alert whose condition does not exist now ends now.

        Returns
        -------
        list of Change
            The changes to report, in the order of the conditions; alerts that have ended come last.
        """
        if not conditions and not self._seen:
            return []
        changes = []
        for condition in conditions:
            seen = self._seen.setdefault(condition.key, _Seen(condition, now_s, now_s))
            seen.condition, seen.last_s = condition, now_s
            if seen.newest != condition.phase:
                seen.newest, seen.since_s = condition.phase, now_s
            lasted = condition.settled or now_s - seen.first_s >= self.hold_s
            told = seen.raised is condition.severity
            if told and seen.phase != condition.phase:
                told = now_s - seen.since_s < self.hold_s or now_s - seen.told_s < AGAIN_S
            if lasted and not told and (condition.urgent or now_s >= self._quiet_until_s):
                changes.append(Change(condition, raised=True, again=seen.raised is not Severity.OK))
                seen.raised, seen.phase, seen.told_s = condition.severity, condition.phase, now_s
        present = {c.key for c in conditions}
        for key in [key for key in self._seen if key not in present]:
            seen = self._seen[key]
            if not seen.raised:
                del self._seen[key]
            elif last or seen.condition.settled or now_s - seen.last_s >= self.clear_s:
                del self._seen[key]
                changes.append(Change(self._ended(seen.condition), raised=False))
        return changes

    def go_on_from(self, others: "Alerts") -> None:
        """Take over the alerts that `others` has reported, so that they are not reported a second time."""
        self._seen = dict(others._seen)
        self._quiet_until_s = others._quiet_until_s

    @property
    def raised(self) -> list[Condition]:
        """The present alerts: the more severe first, minor ones last; then those of `also` last; then by age."""
        found = [s for s in self._seen.values() if s.raised]
        own = [s.condition for s in sorted(found, key=lambda s: (-s.raised, s.first_s))]
        return sorted([*own, *self._also()], key=lambda c: (-c.severity, c.minor))

    @property
    def severity(self) -> Severity:
        """State of the gateway: the severity of the worst alert."""
        return max((c.severity for c in self.raised), default=Severity.OK)

    @property
    def line(self) -> str:
        """One line: the state and, unless it is OK, the worst alert and the number of the others."""
        if not (raised := self.raised):
            return Severity.OK.name
        where = "" if raised[0].string is None else f"{raised[0].string}: "
        more = f" (and {len(raised) - 1} more)" if len(raised) > 1 else ""
        return f"{self.severity.name}: {where}{raised[0].text}{more}"


def no_longer(last: Condition) -> Condition:
    """Return the condition of an alert that ends because its condition does not exist any more."""
    return replace(last, text=f"no longer so: {last.text}")
