"""Currents that two signals carry, one for each direction: their samples become those of one current.

Some battery monitors send the discharge current and the charge current as two signals, both positive. Each input is one
signal for the rest of the engine, so the two are joined here, before the guard. A joined sample stands at each frame
that carries one of the two, as the sum of the newest values of both. Where the two come in different messages, the
other value may be some milliseconds old; it is held as long as its own message allows. A sample of which one half is
refused is refused with the reason of that half.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.samples import Samples
from bms_gateway.frames.freshness import ROUNDS
from bms_gateway.frames.guard import QUALITIES
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.rules import Rule
from bms_gateway.thermal import Floats

GOOD, STALE, OUT_OF_RANGE = (np.uint8(q) for q in (Quality.GOOD, Quality.STALE, Quality.OUT_OF_RANGE))


@dataclass(slots=True)
class Half:
    """One direction of a current.

    Attributes
    ----------
    signal : int
        Its number among the decoded signals.
    rule : Rule
        Its range, and the age from which it is stale.
    counts : ndarray of int64 (16,)
        Samples so far, by `Quality`.
    """

    signal: int
    rule: Rule
    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(QUALITIES, np.int64))
    _time_ns: int = -1
    _value: float = 0.0
    _flag: np.uint8 = GOOD

    def newest(
        self, own: NDArray[np.bool_], time_ns: NDArray[np.int64], value: Floats, flag: NDArray[np.uint8]
    ) -> tuple[NDArray[np.bool_], Floats, NDArray[np.uint8]]:
        """Give the newest value and flag of this half at each sample of both halves, and whether there is any.

        Parameters
        ----------
        own : ndarray of bool (n,)
            Which samples belong to this half.
        time_ns, value, flag : ndarray (n,)
        """
        judged = flag.copy()
        outside = own & (flag == GOOD) & ~((value >= self.rule.lower) & (value <= self.rule.upper))
        judged[outside] = OUT_OF_RANGE
        self.counts += np.bincount(judged[own], minlength=QUALITIES)
        # one more in front: the newest sample before these
        at = np.maximum.accumulate(np.where(own, np.arange(1, len(own) + 1), 0))
        since = np.append(np.int64(self._time_ns), time_ns).take(at)
        values = np.append(self._value, value).take(at)
        flags = np.append(self._flag, judged).take(at)
        oldest_ns = max(self.rule.stale_after_ns, ROUNDS * self.rule.round_ns)
        flags = np.where((flags == GOOD) & (time_ns - since > oldest_ns), STALE, flags)
        if own.any():
            last = int(np.flatnonzero(own)[-1])
            self._time_ns, self._value, self._flag = int(time_ns[last]), float(value[last]), judged[last]
        return since >= 0, values, flags

    def counted(self, joined: NDArray[np.int64]) -> NDArray[np.int64]:
        """Give the samples of this half by `Quality`, with those that were refused after they were joined.

        Parameters
        ----------
        joined : ndarray of int64 (16,)
            Samples of the joined current by `Quality`.
        """
        counts = self.counts.copy()
        stood = min(int(joined[Quality.STUCK]), int(counts[GOOD]))
        counts[Quality.STUCK] += stood
        counts[GOOD] -= stood
        return counts


@dataclass(slots=True)
class BothWays:
    """All currents that two signals carry.

    Attributes
    ----------
    pairs : mapping of input to (discharge, charge)
    """

    pairs: dict[int, tuple[Half, Half]] = field(default_factory=dict)

    @classmethod
    def of(cls, inputs: Sequence[int], rules: Sequence[Rule]) -> tuple["BothWays", list[Rule]]:
        """Find the currents with two signals; returns them and the rules of the inputs.

        Parameters
        ----------
        inputs : sequence of int (K,)
            Input of each decoded signal; 0 … C − 1, and then those of the charge currents.
        rules : sequence of Rule (K,)
            Of each decoded signal.
        """
        made, own = cls(), list(rules[: max(inputs, default=-1) + 1])
        for number in range(len(own), len(rules)):
            i = inputs[number]
            discharge, charge = rules[i], rules[number]
            made.pairs[i] = Half(i, discharge), Half(number, charge)
            # each half is judged by its own range before they are joined
            own[i] = replace(
                discharge,
                lower=charge.lower,
                stale_after_ns=max(discharge.stale_after_ns, charge.stale_after_ns),
                round_ns=max(discharge.round_ns, charge.round_ns),
            )
        return made, own

    def half(self, i: int, way: int) -> Half | None:
        """Return one direction of an input: 1 discharge, −1 charge; None where one signal carries both."""
        return self.pairs[i][0 if way > 0 else 1] if way != 0 and i in self.pairs else None

    def join(self, s: Samples, frame: NDArray[np.intp]) -> Samples:
        """Join the halves.

        Parameters
        ----------
        s : Samples (n,)
            In the order of the bus; `input` is the number of the decoded signal. The value of each half is its share of
            the current: positive for the discharge, negative for the charge.
        frame : ndarray (n,)
            Frame of each sample, ascending; of two halves in one frame one sample is made.
        """
        number, value, flag = s.input.copy(), s.value.copy(), s.flag.copy()
        keep = np.ones(len(number), np.bool_)
        for i, halves in self.pairs.items():
            at = np.flatnonzero(np.isin(s.input, [half.signal for half in halves]))
            part, whose = s.where(at), s.input[at]
            (any_out, out, f_out), (any_in, into, f_in) = (
                h.newest(whose == h.signal, part.time_ns, part.value, part.flag) for h in halves
            )
            keep[at] = any_out & any_in & (np.diff(frame[at], append=-1) != 0)
            number[at], value[at], flag[at] = i, out + into, np.where(f_out != GOOD, f_out, f_in)
        return Samples(s.time_ns, number, value, flag).where(keep)
