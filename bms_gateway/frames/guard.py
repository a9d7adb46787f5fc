"""Which samples may be used: the guard checks range, rails, jumps, standing still and age of every channel.

Cheap sensors fail in ways that look like temperatures. A broken wire reads as one end of the range, an unconnected
input reads as a constant inside the range, and a loose one jumps when the inverter switches. Five rules find them:

* A *jump* is a step that no cell can make. After a jump, a channel is not used for `CONSISTENT` calm samples, and for
  twice as many after each repetition.
* The *anchor* is the value at which a channel stays. Single dips do not move it: a count of at most `ANCHORED` falls by
  one with each sample that differs and rises by one with each equal sample; at zero the new value becomes the anchor.
  *Active* time is time in which current flows and the other channels move. A channel whose anchor lasts longer than
  `stuck_after_s` of active time is stuck. Time at rest does not count, because good sensors stand still then too. A
  channel that has moved before gets more time. It does not get more time if its own noise, and the noise of half of its
  peers, hardly ever gave the same value twice: such a channel has not come to rest, it has frozen.
* A *run* is a row of equal samples that noise cannot produce. Its samples are held back long before the channel counts
  as stuck, so that a frozen sensor does not move an estimate meanwhile. The quality of the channel does not change, and
  its next different value is used.
* The *home* is the anchor that lasted longest. A channel that left its home and, after active time, stands at exactly
  the same hundredth again is a disturbed input and not a temperature; it is stuck too. Noise also returns to the same
  hundredth every minute, but it does not stay there. So a home counts only if it was held for `SETTLED` times the
  active time that makes a channel stuck. A channel that returns to a home which was held for a shorter time counts as
  stuck after the same time as a channel that has never moved. A home not seen for `HOME_MEMORY_S` is forgotten.
* A channel of fine resolution is not used before its anchor has moved once (`needs_proof`), so that an unconnected
  input is never taken as a measurement. The price is that a sensor on a resting pack is used only after its first step
  of 0.01 K. This costs little, because core and surface are equal at rest; a start with a wrong temperature of 25 °C in
  winter would cost much. A return to the home, or a move that the neighbours do not make (`neighbours`), is no proof.

Some senders round to half degrees but count in hundredths. The finest step that any channel of a group has shown
reveals this. Until a step of at most `PROOF_K` was seen, standing still is judged as for coarse signals, and a return
to the home has no meaning.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.counter import CounterGuard
from bms_gateway.frames.neighbours import FAR_NEEDED, Compared, Neighbours
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.rules import PROOF_K, STUCK_COARSE_S, Rule, default_rule

__all__ = ["CounterGuard", "Guard", "GuardResult", "Rule", "default_rule"]

Index = NDArray[np.intp]
# of numpy's own type, which it compares five times as fast as members of an enumeration
GOOD, STALE, OUT_OF_RANGE, STUCK, OPEN, SHORT, JUMPY, NEVER = (
    np.uint8(q)
    for q in (
        *(Quality.GOOD, Quality.STALE, Quality.OUT_OF_RANGE, Quality.STUCK),
        *(Quality.OPEN, Quality.SHORT, Quality.JUMPY, Quality.NEVER),
    )
)
CONSISTENT = 3
"""Calm samples after an upset before a channel is believed again."""
MAX_STRIKES = 6
"""Most repetitions that lengthen the wait: it is at most 3 · 2⁶ = 192 samples, some minutes."""
FORGIVEN_AFTER = 300
"""Calm samples after which earlier jumps are forgotten."""
ANCHORED = 3
"""Net samples that must differ before a channel has left its value."""
AT_HOME = 2
"""Net samples at exactly the old value that count as a return."""
SETTLED = 2.0
"""A home counts if it was held once for this many times `stuck_after_s`, in seconds and in samples. With steps of
0.01 K, noise of 0.05 K holds a value for 20 samples once in 50,000 hours and never for 40; noise of 0.02 K holds a
value for 40 samples once in 100,000 hours."""
HOME_MEMORY_S = 300.0
"""Active time away from a home after which it is forgotten."""
PROVEN_PATIENCE = 15.0
"""A channel that has moved may stand still this many times longer: near equilibrium, good channels do."""
LIVELY = 0.2
"""Greatest share of samples equal to the one before at which a channel counts as noisy. If a channel and half of its
peers were noisy lately, standing still for `SETTLED` times `stuck_after_s` is more than noise can do."""
REMEMBERED, DOUBTED = 600, 5
"""Samples over which that share is averaged, so that noise which has ended is forgotten; and the number of repetitions
with which a channel begins, so that at least 20 samples are needed to show noise. A run of equal samples while others
move enters the share only when it ends."""
HARDLY = 1e-9
"""Probability of a run of equal samples, by that share, below which the run is held back: after 6 to 12 samples. With
noise of 0.02 to 0.1 K, steps of 0.01 K and one sample a second, a good sensor loses less than one sample in 10,000
hours."""
FEWEST = 5
"""Least repetitions of such a run: a share below 0.015 cannot be seen within some minutes."""
LONGEST_STEP_S = 10.0
"""A longer gap between intervals does not count as time of standing still."""
QUALITIES = 16


@dataclass(frozen=True, slots=True)
class GuardResult:
    """The guard's verdict on the samples of one interval.

    Attributes
    ----------
    quality : ndarray of uint8 (n,)
        Of each sample, GOOD where it was accepted.
    value, time_ns : ndarray (C,)
        Latest accepted value of each channel (NaN for none) and its time stamp.
    channel_quality : ndarray of uint8 (C,)
        Of each channel at the end of the interval.
    rejected : ndarray of int64 (C, 16)
        Samples of this interval by `Quality`, the column of GOOD being zero.
    """

    quality: NDArray[np.uint8]
    value: NDArray[np.float64]
    time_ns: NDArray[np.int64]
    channel_quality: NDArray[np.uint8]
    rejected: NDArray[np.int64]


class Guard:
    """Judges the samples of C channels, one interval after the other.

    Parameters
    ----------
    rules : sequence of Rule (C,)
    """

    def __init__(self, rules: Sequence[Rule]) -> None:
        self.rules = tuple(rules)
        n = len(self.rules)
        self._lower, self._upper, self._low_rail, self._high_rail = (
            np.array([getattr(r, name) for r in self.rules], np.float64)
            for name in ("lower", "upper", "low_rail", "high_rail")
        )
        self._stale_ns = np.array([r.stale_after_ns for r in self.rules], np.int64)
        self._value, self._value_ns = np.full(n, np.nan), np.zeros(n, np.int64)
        self._last, self._received_ns = np.full(n, NEVER, np.uint8), np.full(n, -1, np.int64)
        self._end_ns = np.full(1, -1, np.int64)
        # from here on: only the channels that are judged by their past
        self._channel = np.array([i for i, r in enumerate(self.rules) if r.remembers], np.intp)
        past = [self.rules[i] for i in self._channel]
        m = len(past)
        self._local = np.full(n, -1, np.intp)
        self._local[self._channel] = np.arange(m)
        self._jump, self._rate, self._stuck = (
            np.array([getattr(r, name) for r in past], np.float64) for name in ("jump", "jump_rate", "stuck_after_s")
        )
        self._stuck_coarse = np.maximum(self._stuck, STUCK_COARSE_S)
        self._proof = np.array([r.needs_proof for r in past], np.bool_)
        kinds = sorted({(r.quantity, r.group) for r in past})
        number = {kind: i for i, kind in enumerate(kinds)}
        self._group = np.array([number[r.quantity, r.group] for r in past], np.intp)
        self._peers = np.bincount(self._group, minlength=1)[self._group] - 1
        self._alone = self._peers == 0
        self._previous, self._previous_ns = np.full(m, np.nan), np.zeros(m, np.int64)
        self._calm, self._needed, self._strikes = np.zeros(m, np.int64), np.ones(m, np.int64), np.zeros(m, np.int64)
        self._anchor, self._anchor_count, self._anchor_clock = np.full(m, np.nan), np.zeros(m, np.int64), np.zeros(m)
        self._held, self._home_held = np.zeros(m, np.int64), np.zeros(m, np.int64)
        self._held_s, self._home_held_s = np.zeros(m), np.zeros(m)
        self._home, self._home_clock = np.full(m, np.nan), np.zeros(m)
        self._clock, self._moving = np.zeros(m), np.zeros(m, np.bool_)
        self._compared, self._repeats = np.full(m, DOUBTED), np.ones(m)
        self._run, self._around = np.zeros(m, np.int64), np.zeros(m, np.bool_)
        self._peers_lively = np.zeros(m, np.bool_)
        self._proven, self._fine = np.zeros(m, np.bool_), np.zeros(m, np.bool_)
        self._cause = np.full(m, NEVER, np.uint8)
        self._neighbours = Neighbours(self._group, self._proof)

    _STATE = (
        *("_previous", "_previous_ns", "_calm", "_needed", "_strikes", "_anchor", "_anchor_count", "_anchor_clock"),
        *("_held", "_home_held", "_held_s", "_home_held_s", "_home", "_home_clock"),
        *("_compared", "_repeats", "_run", "_around", "_peers_lively"),
        *("_clock", "_moving", "_fine", "_proven", "_cause", "_value", "_value_ns", "_last", "_received_ns", "_end_ns"),
    )

    def snapshot(self) -> dict[str, NDArray[np.generic]]:
        """Copy the whole state as plain arrays."""
        own = {name[1:]: getattr(self, name).copy() for name in self._STATE}
        return own | self._neighbours.snapshot()

    def restore(self, state: Mapping[str, NDArray[np.generic]]) -> None:
        """Take up the state of a guard with the same rules."""
        for name in self._STATE:
            mine = getattr(self, name)
            mine[...] = state[name[1:]]
        self._neighbours.restore(state)

    def update(
        self,
        time_ns: NDArray[np.int64],
        channel: Index,
        value: NDArray[np.float64],
        flag: NDArray[np.uint8],
        t1_ns: int,
        active: bool | NDArray[np.bool_],
    ) -> GuardResult:
        """Judge the samples of one interval, which ends at `t1_ns`.

        Parameters
        ----------
        time_ns, channel, value, flag : ndarray (n,)
            In the order of the bus; `flag` is the `Quality` so far.
        t1_ns : int
            End of the interval; the next one starts there.
        active : bool or ndarray of bool (C,)
            Whether enough current flowed in the interval to make temperatures move.
        """
        n = len(self.rules)
        quality = self._memoryless(channel, value, flag)
        updated, changed, fine = (np.zeros(len(self._channel), np.bool_) for _ in range(3))
        held_back: Index = np.empty(0, np.intp)
        local = self._local.take(channel)
        for part in _rounds(local):
            # a round of all channels, the usual one, needs no gathering
            c = slice(None) if len(part) == len(self._channel) else local[part]
            quality[part] = self._judge(c, value[part], time_ns[part], quality[part], updated, changed, fine)
            if np.count_nonzero(self._run >= FEWEST) and np.count_nonzero(frozen := self._freezes(c)):
                held_back = np.concatenate([held_back, part[(quality[part] == GOOD) & frozen]])
        if fine.any():
            self._fine |= np.bincount(self._group, fine, 1)[self._group] > 0
        on = np.asarray(active, np.bool_)
        self._advance(t1_ns, on.take(self._channel) if on.ndim else on, updated, changed)
        self._last[channel] = quality
        self._received_ns[channel] = time_ns
        if len(held_back):
            quality[held_back] = STUCK
        good = quality == GOOD
        self._value[channel[good]] = value[good]
        self._value_ns[channel[good]] = time_ns[good]
        rejected = np.bincount(channel[~good] * QUALITIES + quality[~good], minlength=n * QUALITIES)
        return GuardResult(
            quality, self._value.copy(), self._value_ns.copy(), self._channels(t1_ns), rejected.reshape(n, QUALITIES)
        )

    def _memoryless(self, channel: Index, value: NDArray[np.float64], flag: NDArray[np.uint8]) -> NDArray[np.uint8]:
        quality = flag.copy()
        # a rail is more specific than a range: a sample outside the DBC's range may still be OPEN or SHORT
        open_to = (flag == GOOD) | (flag == OUT_OF_RANGE)
        outside = ~((value >= self._lower.take(channel)) & (value <= self._upper.take(channel)))
        high, low = value >= self._high_rail.take(channel), value <= self._low_rail.take(channel)
        for wrong, becomes in ((outside, OUT_OF_RANGE), (high, OPEN), (low, SHORT)):
            if wrong.any():
                quality[open_to & wrong] = becomes
        return quality

    def _judge(
        self,
        c: Index | slice,
        value: NDArray[np.float64],
        time_ns: NDArray[np.int64],
        quality: NDArray[np.uint8],
        updated: NDArray[np.bool_],
        changed: NDArray[np.bool_],
        fine: NDArray[np.bool_],
    ) -> NDArray[np.uint8]:
        """Judge one sample of each of several channels by the history of the channel."""
        usable = quality == GOOD
        previous = self._previous[c]
        known = ~np.isnan(previous)
        seconds = np.maximum(time_ns - self._previous_ns[c], 0) * 1e-9
        step = np.abs(value - previous)
        jumped = usable & known & (step > self._jump[c] + self._rate[c] * seconds)
        alone = None
        if self._neighbours.any_doubted(c):
            alone = self._neighbours.compare(c, value, usable, seconds)
            jumped |= known & alone.astray
        stepped = usable & (step > 0)
        updated[c] |= usable
        changed[c] |= stepped & known
        fine[c] |= stepped & (step < 1.01 * PROOF_K)
        proof, is_fine = self._proof[c], self._fine[c]
        limit = np.where(is_fine, self._stuck[c], self._stuck_coarse[c])
        moved, returned, at_home = self._follow_anchor(c, value, usable, seconds, limit, alone)
        stood = self._clock[c] - self._anchor_clock[c]
        stands = stood > np.where(self._proven[c] & ~returned, PROVEN_PATIENCE, 1.0) * limit
        self._count_repeats(c, usable & known, usable & (step == 0.0))
        long = np.minimum(stood, self._held[c]) > SETTLED * limit
        if long.any():
            stands |= long & (self._repeats[c] <= LIVELY) & self._peers_lively[c] & is_fine
        stuck = usable & ~jumped & (stands | (at_home & proof & is_fine))
        upset = ~usable | jumped | stuck
        proves = moved & known & ~upset & (value != self._home[c])
        proven, calm, cause = self._proven[c] | proves, self._calm[c] + 1, quality
        if upset.any():
            proven &= ~jumped & ~stuck
            calm[upset] = 0
            cause = np.where(stuck, STUCK, np.where(jumped, JUMPY, quality))
            struck = jumped | (stuck & at_home & (self._cause[c] != STUCK))
            strikes = np.minimum(self._strikes[c] + struck, MAX_STRIKES)
            needed = np.where(upset, np.maximum(self._needed[c], CONSISTENT), self._needed[c])
            self._strikes[c], self._needed[c] = strikes, np.where(struck, CONSISTENT << strikes, needed)
            self._cause[c] = np.where(upset, cause, self._cause[c])
            value, time_ns = np.where(usable, value, previous), np.where(usable, time_ns, self._previous_ns[c])
        forgiven = calm >= FORGIVEN_AFTER
        self._strikes[c] = np.where(forgiven, 0, self._strikes[c])
        self._needed[c] = np.where(forgiven, CONSISTENT, self._needed[c])
        self._proven[c], self._calm[c] = proven, calm
        self._previous[c], self._previous_ns[c] = value, time_ns
        accepted = ~upset & (calm >= self._needed[c]) & (proven | ~proof)
        if alone is not None:
            accepted &= ~alone.far | (calm >= FAR_NEEDED) | (self._cause[c] == GOOD)
        self._neighbours.trust(c, accepted, usable & known, step)
        if accepted.all():
            self._cause[c] = GOOD
            return cause
        self._cause[c] = np.where(accepted, GOOD, self._cause[c])
        return np.where(accepted, GOOD, np.where(usable & ~upset, self._cause[c], cause))

    def _count_repeats(self, c: Index | slice, compared: NDArray[np.bool_], same: NDArray[np.bool_]) -> None:
        """Count samples that repeat the one before, and their share; a run while others move counts when it ends."""
        differs, again, run = compared ^ same, same & self._around[c], self._run[c]
        more = (compared ^ again) + run * differs
        self._compared[c] = count = np.minimum(self._compared[c] + more, REMEMBERED)
        repeats = self._repeats[c]
        self._repeats[c] = repeats + (more * (1.0 - repeats) - differs) / count
        self._run[c] = np.minimum((run + again) * ~differs, REMEMBERED - 1)

    def _freezes(self, c: Index | slice) -> NDArray[np.bool_]:
        """Find channels whose run of equal samples noise cannot produce; channels that may stand still are left out."""
        repeats, run = self._repeats[c], self._run[c]
        noisy = (repeats <= LIVELY) & (self._peers_lively[c] | self._alone[c]) & np.isfinite(self._stuck[c])
        return np.asarray(noisy & (run >= FEWEST) & (repeats**run < HARDLY), np.bool_)

    def _follow_anchor(
        self,
        c: Index | slice,
        value: NDArray[np.float64],
        usable: NDArray[np.bool_],
        seconds: NDArray[np.float64],
        limit: NDArray[np.float64],
        alone: Compared | None,
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        """Move the anchor of channels that have left it; return which left, which returned, and which returned home."""
        clock = self._clock[c]
        same = value == self._anchor[c]
        count = np.where(same, np.minimum(self._anchor_count[c] + 1, ANCHORED), self._anchor_count[c] - 1)
        moved = usable & (count <= 0)
        count = np.where(moved, 1, np.where(usable, count, self._anchor_count[c]))
        held = np.where(moved, 1, self._held[c] + usable)
        held_s = np.where(moved, 0.0, self._held_s[c] + usable * np.minimum(seconds, LONGEST_STEP_S))
        anchor = np.where(moved, value, self._anchor[c])
        self._anchor_count[c], self._held[c], self._held_s[c], self._anchor[c] = count, held, held_s, anchor
        self._anchor_clock[c] = np.where(moved, clock, self._anchor_clock[c])
        there = usable & same & (anchor == self._home[c]) & (count >= AT_HOME)
        longest = held > self._home_held[c]
        # at rest a good sensor may return to the same hundredth too; a sensor that was stuck before stays stuck
        found = self._cause[c] == STUCK
        returned = at_home = there & ~longest & ((clock > self._home_clock[c]) | found)
        if returned.any():
            settled = np.minimum(self._home_held[c], self._home_held_s[c]) >= SETTLED * limit
            at_home = returned & (found | settled)
            if alone is not None:
                at_home |= returned & alone.strays & (count >= ANCHORED)
        renewed = longest | (clock - self._home_clock[c] > HOME_MEMORY_S)
        self._home[c] = np.where(renewed, anchor, self._home[c])
        self._home_held[c] = np.where(renewed, held, self._home_held[c])
        self._home_held_s[c] = np.where(renewed, held_s, self._home_held_s[c])
        self._home_clock[c] = np.where(renewed | there, clock, self._home_clock[c])
        return moved, returned, at_home

    def _advance(
        self, t1_ns: int, active: NDArray[np.bool_], updated: NDArray[np.bool_], changed: NDArray[np.bool_]
    ) -> None:
        """Count active time for channels whose peers move: among resting peers, standing still proves nothing."""
        start = int(self._end_ns[0])
        self._end_ns[0] = t1_ns
        others = np.bincount(self._group, updated, 1)[self._group] - updated
        moving = np.bincount(self._group, changed, 1)[self._group] - changed
        self._moving = np.where(others > 0, 2 * moving >= others, self._moving)
        lively = self._repeats <= LIVELY
        among = np.bincount(self._group, lively, 1)[self._group] - lively
        self._peers_lively = (self._peers > 0) & (2 * among >= self._peers)
        self._around = np.where(self._alone, active, self._moving)
        self._neighbours.advance(self._previous, self._home, updated)
        if start >= 0:
            step = min(max((t1_ns - start) * 1e-9, 0.0), LONGEST_STEP_S)
            self._clock += (active & self._around) * step

    def _channels(self, t1_ns: int) -> NDArray[np.uint8]:
        late = t1_ns - self._received_ns > self._stale_ns
        received = self._received_ns >= 0
        return np.where(late & received, STALE, self._last)


def _rounds(local: Index) -> list[Index]:
    """Cut samples into rounds in which every channel occurs at most once, in the order of the channels.

    Samples of channels without memory (-1) are in none.
    """
    order = np.argsort(local, kind="stable")
    ordered = local[order]
    skipped = int(np.searchsorted(ordered, 0))
    order, ordered = order[skipped:], ordered[skipped:]
    if not len(order):
        return []
    fresh = np.ones(len(order), np.bool_)
    fresh[1:] = ordered[1:] != ordered[:-1]
    start = fresh.nonzero()[0]
    if len(start) == len(order):
        return [order]
    nth = np.arange(len(order)) - start.repeat(np.diff(np.append(start, len(order))))
    return [order[nth == k] for k in range(int(nth.max()) + 1)]
