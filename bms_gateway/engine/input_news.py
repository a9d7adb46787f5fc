"""Changes of the inputs: which have become good, are no longer good, are wrong, or never came."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.events import Level, Notice
from bms_gateway.engine.plan import Channel
from bms_gateway.engine.reasons import CURRENT_STANDS, HELD, RIGHT_SIGN, WRONG_SIGN, why_not
from bms_gateway.engine.wiring import Wiring
from bms_gateway.frames.ammeter import Ammeter
from bms_gateway.frames.quality import Quality

UNHEARD_NS = 10_000_000_000
"""Least time after which an input counts as missed: longest period of most messages of a battery."""
GOOD = int(Quality.GOOD)  # comparing with a member of an enumeration takes numpy many times longer


class Fault(NamedTuple):
    """An input that came and is not good now.

    Attributes
    ----------
    string : str
        The first string with it.
    channel : Channel
    quality : Quality
    why : str
        In words.
    """

    string: str
    channel: Channel
    quality: Quality
    why: str


class InputNews:
    """News of all inputs of a plan.

    Parameters
    ----------
    wiring : Wiring
    meters : mapping
        Comparisons of each current with its voltage, by the inputs of both.
    due_ns : ndarray (C,)
        Time within which each input must come.

    Attributes
    ----------
    quality : ndarray of uint8 (C,)
        Present `Quality` of each input.
    held : ndarray of bool (C,)
        Whether each has jumped down and not come back.
    heard : ndarray of bool (C,)
        Whether a sample of each ever came.
    waited_ns : int
        Time for which the inputs have been read.
    """

    def __init__(self, wiring: Wiring, meters: Mapping[tuple[int, int], Ammeter], due_ns: NDArray[np.int64]) -> None:
        self._wiring, self._meters = wiring, meters
        self._missed_after_ns = np.maximum(due_ns, UNHEARD_NS)
        self._missed = np.zeros(len(wiring.channels), np.bool_)  # and reported
        self.waited_ns = 0
        self.quality: NDArray[np.uint8] = np.full(len(wiring.channels), Quality.NEVER, np.uint8)
        self._told = self.quality.copy()
        self.held = np.zeros(len(wiring.channels), np.bool_)
        self.heard = np.zeros(len(wiring.channels), np.bool_)
        self._reversed: set[int] = set()

    def changes(self, t1: int) -> list[Notice]:
        """Report which inputs have become good, or are no longer good, since the last call."""
        notices = []
        for i in np.flatnonzero(self.quality != self._told).tolist():
            if i in self._wiring.spare:
                continue
            now, before = Quality(int(self.quality[i])), Quality(int(self._told[i]))
            first = before == Quality.NEVER
            if (first or Quality.GOOD in (now, before)) and not (first and now == Quality.GOOD):
                notices.append(self._notice(t1, i, now))
        self._told = self.quality.copy()
        return notices + self._signs(t1)

    def _signs(self, t1: int) -> list[Notice]:
        """Report which currents have the wrong sign, or no longer have it, since the last call."""
        now = {i for (i, _), meter in self._meters.items() if meter.reversed}
        notices = [
            Notice(
                t1,
                Level.WARNING if i in now else Level.NOTICE,
                "current_sign",
                f"{WRONG_SIGN if i in now else RIGHT_SIGN} ({self._wiring.channels[i].source})",
                self._wiring.names[i][0],
            )
            for i in sorted(now ^ self._reversed)
        ]
        self._reversed = now
        return notices

    def _notice(self, t1: int, i: int, now: Quality) -> Notice:
        c, (string, cell) = self._wiring.channels[i], self._wiring.names[i]
        what = c.quantity.replace("_", " ") + (f" of cell {cell}" if cell is not None else "")
        if now == Quality.GOOD:
            return Notice(t1, Level.NOTICE, "sensor", f"{what} is good again ({c.source})", string, cell, c.quantity)
        why = self._why(i)
        if c.quantity == "current" and now == Quality.STUCK:
            stands = next(m.stands_at for (current, _), m in self._meters.items() if current == i)
            why = CURRENT_STANDS.format(" and ".join(f"{amps:g}" for amps in stands))
        return Notice(t1, Level.WARNING, "sensor", f"{what} is not used: {why} ({c.source})", string, cell, c.quantity)

    def compared(self) -> list[tuple[str, Channel, Ammeter]]:
        """List the currents that a voltage checks: the first string with each, its channel, the comparison."""
        return [(self._wiring.names[i][0], self._wiring.channels[i], meter) for (i, _), meter in self._meters.items()]

    def faults(self) -> list[Fault]:
        """List inputs that came and are not good now."""
        wiring = self._wiring
        bad = set(np.flatnonzero((self.quality != GOOD) & (self.quality != Quality.NEVER)).tolist()) - wiring.spare
        return [
            Fault(wiring.names[i][0], wiring.channels[i], Quality(int(self.quality[i])), self._why(i))
            for i in sorted(bad)
        ]

    def _why(self, i: int) -> str:
        return HELD if self.held[i] else why_not(self._wiring.channels[i].quantity, Quality(int(self.quality[i])))

    def unheard(self) -> dict[str, str]:
        """List the inputs without any sample, by string, as text."""
        return self._named(~self.heard)

    def missed(self) -> dict[str, str]:
        """List those of `unheard` that should have come by now."""
        return self._named(~self.heard & (self.waited_ns >= self._missed_after_ns))

    def newly_missed(self) -> dict[str, str]:
        """List those of `missed` that are new since the last call."""
        new = ~self.heard & (self.waited_ns >= self._missed_after_ns) & ~self._missed
        self._missed |= new
        return self._named(new)

    def _named(self, those: NDArray[np.bool_]) -> dict[str, str]:
        missing: dict[str, list[str]] = {}
        for i in np.flatnonzero(those).tolist():
            if self._wiring.channels[i].quantity == "cell_voltage" or i in self._wiring.spare:
                continue  # our own DBC always contains them, but few buses carry them
            missing.setdefault(self._wiring.names[i][0], []).append(self._wiring.channels[i].source)
        return {name: ", ".join(signals) for name, signals in missing.items()}
