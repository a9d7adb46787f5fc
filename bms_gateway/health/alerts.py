"""What is wrong now, as alerts that neither flap nor come too early, and the one line that sums them up.

A *condition* is something wrong at this moment. It becomes an *alert* once it has lasted `hold_s`, and the alert ends
once the condition has been gone for `clear_s`. Conditions that bring a hysteresis and a hold time of their own (the
flags of `health`) pass at once. For `grace_s` after a start, and after each pause of the bus, nothing is raised:
senders come up one by one, and a reading that is late then is nobody's fault. What is still wrong afterwards is.

Time is an argument; nothing here reads a clock.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final, Literal

Fact = float | int | str
Key = tuple[str, str, int, str]

GRACE_S: Final = 10.0  # the slowest message of a battery comes every few seconds
HOLD_S: Final = 3.0  # a plug that rattles for a second is no alert
CORE_MAX_C: Final = 80.0
"""Above what data sheets of lithium-ion cells allow on discharge (60 to 75 °C), below where self-heating begins: the
SEI decomposes from 80 to 90 °C on."""
CLEAR_S: Final = 10.0  # nor is it mended by one good reading
AGAIN_S: Final = 30.0  # no alert is told again more often because its phase has changed


@dataclass(frozen=True, slots=True)
class AlertSettings:
    """`[alerts]` of the config: when something wrong becomes an alert, and the limits.

    Attributes
    ----------
    grace_s, hold_s, clear_s : float
        See the module's text.
    core_max_C : float
        Temperature of a cell's hottest point from which on there is an alarm, °C.
    surface_max_C : float or None
        The same of a surface that is read; None for that of the cores.
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
    urgent : bool
        It is no matter of senders that come up one by one: told in the grace time too.
    wanders : bool
        It is of the string; the cell it names is the worst one now.
    phase : str
        An alert whose phase has changed, and stayed so for `hold_s`, is told again: it has come to mean something
        else. Not sooner than `AGAIN_S` after it was told last.
    facts : mapping
        Numbers for machines, as ``heat_W``.
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

    @property
    def key(self) -> Key:
        """What makes two conditions the same one."""
        return self.name, self.string or "", 0 if self.wanders else self.cell or 0, self.part


@dataclass(frozen=True, slots=True)
class Change:
    """An alert was raised, has become another one (more or less severe, in another phase), or is over."""

    condition: Condition
    raised: bool
    again: bool = False

    @property
    def state(self) -> Literal["raised", "changed", "over"]:
        """What has happened, in one word."""
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
        Gives alerts that are raised elsewhere; they count in `raised`, `severity` and `line`.

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
    ) -> None:
        self.grace_s, self.hold_s, self.clear_s = grace_s, hold_s, clear_s
        self._quiet_until_s = float("-inf")
        self._seen: dict[Key, _Seen] = {}
        self._also = also

    def begin(self, now_s: float) -> None:
        """Start the grace time: the service or the bus has just come up."""
        self._quiet_until_s = now_s + self.grace_s

    def update(self, now_s: float, conditions: Sequence[Condition], *, last: bool = False) -> list[Change]:
        """Take what is wrong now.

        Parameters
        ----------
        now_s : float
        conditions : sequence of Condition
        last : bool
            Nobody looks again for long: what is not wrong now is over now.

        Returns
        -------
        list of Change
            What people should be told, in the order of the conditions, ended ones last.
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
                changes.append(Change(seen.condition, raised=False))
        return changes

    def go_on_from(self, others: "Alerts") -> None:
        """Take over what others have told: it is not told again."""
        self._seen = dict(others._seen)
        self._quiet_until_s = others._quiet_until_s

    @property
    def raised(self) -> list[Condition]:
        """Alerts now, the most severe first, one's own before others, older before newer."""
        found = [s for s in self._seen.values() if s.raised]
        own = [s.condition for s in sorted(found, key=lambda s: (-s.raised, s.first_s))]
        return sorted([*own, *self._also()], key=lambda c: -c.severity)

    @property
    def severity(self) -> Severity:
        """State of the whole: that of the worst alert."""
        return max((c.severity for c in self.raised), default=Severity.OK)

    @property
    def line(self) -> str:
        """One line: the state and, unless it is OK, the worst alert and how many more there are."""
        if not (raised := self.raised):
            return Severity.OK.name
        where = "" if raised[0].string is None else f"{raised[0].string}: "
        more = f" (and {len(raised) - 1} more)" if len(raised) > 1 else ""
        return f"{self.severity.name}: {where}{raised[0].text}{more}"
