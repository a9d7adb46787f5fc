"""A fault as a small object, and the judgement of the reaction to it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bms_gateway.bus.traffic import Key
from bms_gateway.bus.virtual import PackFault
from bms_gateway.chaos.observed_run import Record, Seen
from bms_gateway.chaos.reaction import Reaction
from bms_gateway.chaos.simulated_pack import CYCLE
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.thermal import Floats

Kind = Literal["heat", "sensor", "frame", "time", "bus", "service"]
STEADY = 5  # number of consecutive sound seconds after which the gateway counts as recovered


@dataclass(frozen=True, slots=True)
class Injection:
    """What a fault changes in the traffic of a simulated pack while it lasts.

    Attributes
    ----------
    values : mapping of (quantity, cell) to callable
        Sensors of the first string: what they show in place of the true value, ``(time_s, value) -> value``.
    frames : callable, optional
        Frames of a tenth of a second as they are put on the bus, ``(frames, rng) -> frames``.
    stamps : callable, optional
        Stamps that the frames get, ns of the wall clock, ``(stamps, rng) -> stamps``.
    wall_s : float
        Step of the wall clock when the fault begins, s.
    epoch_s : float
        What the wall clock shows when the bench starts, s since 1970.
    parked : bool
        The vehicle rests: no current, and no traffic.
    rests : bool
        No current flows from beginning to end; the frames go on.
    pack : PackFault, optional
        Fault of the pack itself while the fault lasts.
    cycle : str
        Drive cycle, a name of `thermal.cycles.CYCLES`.
    restart : bool
        The gateway is stopped when the fault begins, with its state kept, and started when it ends.
    stored : callable, optional
        What happens to the directory of the state while it is stopped, ``(directory)``.
    ends : bool
        Whenever the gateway has restored a stored state, it ends with its first tick; it is started again every second.
    """

    values: dict[Key, Callable[[Floats, Floats], Floats]] = field(default_factory=dict)
    frames: Callable[[FrameBatch, np.random.Generator], FrameBatch] | None = None
    stamps: Callable[[NDArray[np.int64], np.random.Generator], NDArray[np.int64]] | None = None
    wall_s: float = 0.0
    epoch_s: float = 1_700_000_000.0
    parked: bool = False
    restart: bool = False
    stored: Callable[[Path], None] | None = None
    ends: bool = False
    rests: bool = False
    pack: PackFault | None = None
    cycle: str = CYCLE


@dataclass(frozen=True, slots=True)
class Scenario:
    """One fault and what is expected.

    Attributes
    ----------
    name : str
        As `--scenario` takes it.
    kind : Kind
    fault : str
        What happens, for people.
    expected : tuple of Reaction
        All of them must be seen.
    lasts_s : float
        How long it lasts.
    recovers_s : float
        How long the gateway may take after it.
    injection : Injection
    warm_s : float
        How long the gateway runs before the fault: until the sensors are accepted and the unknown start is forgotten.
    misleads : bool
        The cores may be wrong until the gateway notices the fault; afterwards they must be inside their bands again.
    unfit : str
        Why the scenario cannot be run with this config or on this bus; empty if it can.
    """

    name: str
    kind: Kind
    fault: str
    expected: tuple[Reaction, ...]
    lasts_s: float
    recovers_s: float
    injection: Injection = field(default_factory=Injection)
    unfit: str = ""
    misleads: bool = False
    warm_s: float = 90.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a scenario.

    Attributes
    ----------
    scenario : Scenario
    reacted_s : tuple of float or None
        Seconds from the fault to each expected reaction.
    in_band : bool
        No core was sent outside its band, from the fault to the end; not checked if the fault misleads.
    recovered_s : float or None
        Seconds from the end of the fault until all was as before it.
    sound_before : bool
        The cores were right before the fault; otherwise the rest of the outcome has no meaning.
    """

    scenario: Scenario
    reacted_s: tuple[float | None, ...] = ()
    in_band: bool = True
    recovered_s: float | None = None
    sound_before: bool = True

    @property
    def tried(self) -> bool:
        """Whether it was run at all."""
        return not self.scenario.unfit

    @property
    def holds(self) -> bool:
        """Whether all reactions were as expected; true for a scenario that cannot be run."""
        if not self.tried:
            return True
        late = self.recovered_s is None or self.recovered_s > self.scenario.recovers_s
        return self.sound_before and self.in_band and not late and None not in self.reacted_s

    @property
    def seen(self) -> str:
        """The observed reaction, for people."""
        if not self.tried:
            return f"not tried: {self.scenario.unfit}"
        if not self.sound_before:
            return (
                "cores were wrong BEFORE THE FAULT: can the signals of this config carry the simulated pack "
                "(ranges, scale, flow)?"
            )
        parts = [
            f"{r.text} " + ("NOT SEEN" if s is None else f"after {s:.1f} s")
            for r, s in zip(self.scenario.expected, self.reacted_s, strict=True)
        ]
        parts += [] if self.in_band else ["a core was sent OUTSIDE ITS BAND"]
        return "; ".join(parts)


def judge(scenario: Scenario, record: Record) -> Outcome:
    """Compare a record with the expected reactions."""
    found = [r.first_s(record) for r in scenario.expected]
    reacted = tuple(None if s is None else max(0.0, s - record.start_s) for s in found)
    in_band = scenario.misleads or all(s.in_band for s in record.since())
    return Outcome(scenario, reacted, in_band, recovered_s(record), record.before().in_band)


def is_sound(now: Seen, before: Seen) -> bool:
    """Whether a second is as good as the last one before the fault."""
    same = now.state == before.state and bool((now.quality == before.quality).all())
    return same and now.in_band and bool((np.isfinite(now.error) == np.isfinite(before.error)).all())


def recovered_s(record: Record) -> float | None:
    """Seconds from the end of the fault to the first of `STEADY` sound seconds; None if there are none."""
    before = record.before()
    run = 0
    after = [s for s in record.seen if s.time_s > record.end_s]
    for s in after:
        run = run + 1 if is_sound(s, before) else 0
        if run == STEADY:
            lasting = [x.time_s for x in after if x.time_s <= s.time_s][-STEADY:]
            # a second of the bench ends up to a second after the event that it shows
            step = min((b - a for a, b in pairwise(lasting)), default=1.0)
            return max(0.0, lasting[0] - record.end_s - step)
    return None
