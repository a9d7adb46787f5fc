"""Expected reactions of a gateway to a fault, in a form that can be found in a record."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import inf
from typing import Protocol

from bms_gateway.chaos.observed_run import Record, Seen
from bms_gateway.engine.broadcast import State
from bms_gateway.frames.quality import Quality


class Reaction(Protocol):
    """An expected reaction, which a record shows or does not show."""

    @property
    def text(self) -> str:
        """The expectation in a few words."""
        ...

    def first_s(self, record: Record) -> float | None:
        """Bench time at which the reaction is first seen after the fault began; None if never."""
        ...


def _first(record: Record, holds: Callable[[Seen], bool]) -> float | None:
    return next((s.time_s for s in record.since() if holds(s)), None)


@dataclass(frozen=True, slots=True)
class Marked:
    """Some cell is sent with one of these qualities, which no cell had before the fault."""

    qualities: frozenset[Quality]

    @classmethod
    def of(cls, *qualities: Quality) -> "Marked":
        """Any of them will do."""
        return cls(frozenset(qualities))

    @property
    def text(self) -> str:
        """The qualities as `estimates.csv` writes them."""
        return "marked " + " or ".join(sorted(q.name.lower() for q in self.qualities))

    def first_s(self, record: Record) -> float | None:
        """See `Reaction`."""
        wanted = {int(q) for q in self.qualities}
        before = record.before().quality
        changed = lambda s: any(  # noqa: E731
            q in wanted and q != b for q, b in zip(s.quality.tolist(), before.tolist(), strict=True)
        )
        return _first(record, changed)


@dataclass(frozen=True, slots=True)
class Told:
    """A notice with this code that contains this word; with `within_s`, it must come within this time."""

    code: str
    word: str = ""
    within_s: float = inf

    @property
    def text(self) -> str:
        """Code and word."""
        soon = f" within {self.within_s / 60.0:g} min" if self.within_s < inf else ""
        return f"told ({self.code}{': …' + self.word + '…' if self.word else ''}){soon}"

    def first_s(self, record: Record) -> float | None:
        """See `Reaction`."""
        found = (x for x in record.lines if x.time_s > record.start_s and x.code == self.code and self.word in x.text)
        first = next((x.time_s for x in found), None)
        return None if first is None or first > record.start_s + self.within_s else first


@dataclass(frozen=True, slots=True)
class Untold:
    """No notice with one of these codes comes while the fault lasts."""

    codes: tuple[str, ...]

    @classmethod
    def of(cls, *codes: str) -> "Untold":
        """None of them."""
        return cls(codes)

    @property
    def text(self) -> str:
        """The codes."""
        return f"nothing told as {' or '.join(self.codes)}"

    def first_s(self, record: Record) -> float | None:
        """See `Reaction`."""
        told = any(x.code in self.codes and record.start_s < x.time_s <= record.end_s for x in record.lines)
        return None if told else record.end_s


@dataclass(frozen=True, slots=True)
class Counted:
    """One of these counters goes up."""

    names: tuple[str, ...]

    @classmethod
    def of(cls, *names: str) -> "Counted":
        """Any of them will do."""
        return cls(names)

    @property
    def text(self) -> str:
        """Names of the counters."""
        return "counted as " + " or ".join(self.names)

    def first_s(self, record: Record) -> float | None:
        """See `Reaction`."""
        before = record.before().counts
        return _first(record, lambda s: any(s.counts.get(n, 0) > before.get(n, 0) for n in self.names))


@dataclass(frozen=True, slots=True)
class Uncounted:
    """None of these counters goes up."""

    names: tuple[str, ...]

    @classmethod
    def of(cls, *names: str) -> "Uncounted":
        """All of them stand still."""
        return cls(names)

    @property
    def text(self) -> str:
        """Names of the counters."""
        return "nothing counted as " + " or ".join(self.names)

    def first_s(self, record: Record) -> float | None:
        """See `Reaction`."""
        return record.end_s if Counted(self.names).first_s(record) is None else None


@dataclass(frozen=True, slots=True)
class InState:
    """The status frame says this state."""

    state: State

    @property
    def text(self) -> str:
        """The state's name."""
        return f"state {self.state.name.lower()}"

    def first_s(self, record: Record) -> float | None:
        """See `Reaction`."""
        return _first(record, lambda s: s.state == self.state)


@dataclass(frozen=True, slots=True)
class Quiet:
    """Nothing at all is sent for so many seconds."""

    seconds: int

    @property
    def text(self) -> str:
        """The duration in words."""
        return f"sends nothing for {self.seconds} s"

    def first_s(self, record: Record) -> float | None:
        """See `Reaction`."""
        run = 0
        for s in record.since():
            run = run + 1 if s.frames == 0 else 0
            if run >= self.seconds:
                return s.time_s
        return None


@dataclass(frozen=True, slots=True)
class Unmoved:
    """No quality changes while the fault lasts: it does not reach the estimates."""

    @property
    def text(self) -> str:
        """A short description."""
        return "estimates untouched"

    def first_s(self, record: Record) -> float | None:
        """See `Reaction`."""
        before = record.before()
        during = [s for s in record.since() if s.time_s <= record.end_s]
        untouched = bool(during)
        for last, s in pairwise((before, *during)):
            if s.frames == 0:  # a tick at the edge of two seconds may have been sent in the first of them
                untouched &= last.frames > before.frames
            else:
                untouched &= s.quality.tolist() == before.quality.tolist()
        return record.end_s if untouched else None
