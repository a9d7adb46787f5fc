"""Which samples may be used: the guard checks range, rails, jumps, standing still and age of every channel.

Cheap sensors fail in ways that look like temperatures. A broken wire reads as one end of the range, an unconnected
input reads as a constant inside the range, and a loose one jumps when the inverter switches. Five rules find them:

* A *jump* is a step that no cell can make. After a jump, a channel is not used for `CONSISTENT` calm samples, and for
  twice as many after each repetition. One that reads less beside its neighbours than before waits longer (`stepped`).
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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.anchor import SETTLED, Anchors, Standing
from bms_gateway.frames.freshness import Turns
from bms_gateway.frames.neighbours import FAR_NEEDED, Neighbours
from bms_gateway.frames.peers import Peers
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.repeats import Repeats
from bms_gateway.frames.rules import PROOF_K, STUCK_COARSE_S, Rule
from bms_gateway.frames.stepped import Seen, Stepped

__all__ = ["Guard", "GuardResult"]

Index = NDArray[np.intp]
# numpy's own type, which numpy compares five times as fast as members of an enumeration
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
PROVEN_PATIENCE = 15.0
"""A channel that has moved may stand still this many times longer: near equilibrium, good channels do."""
QUALITIES = 16


@dataclass(frozen=True, slots=True)
class GuardResult:
    """The guard's verdict on the samples of one interval.

    Attributes
    ----------
    quality : ndarray of uint8 (n,)
        Of each sample; GOOD if it was accepted.
    value, time_ns : ndarray (C,)
        Latest accepted value of each channel (NaN for none) and its time stamp.
    channel_quality : ndarray of uint8 (C,)
        Of each channel at the end of the interval.
    rejected : ndarray of int64 (C, 16)
        Samples of this interval by `Quality`, the column of GOOD being zero.
    held : ndarray of bool (C,)
        Channels that are JUMPY because they have jumped down and not come back (`stepped`).
    """

    quality: NDArray[np.uint8]
    value: NDArray[np.float64]
    time_ns: NDArray[np.int64]
    channel_quality: NDArray[np.uint8]
    rejected: NDArray[np.int64]
    held: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Ranges:
    """Ranges and rails of C channels, each (C,)."""

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    low_rail: NDArray[np.float64]
    high_rail: NDArray[np.float64]

    @classmethod
    def of(cls, rules: Sequence[Rule]) -> "Ranges":
        """Take them from the rules."""
        return cls(*_columns(rules, "lower", "upper", "low_rail", "high_rail"))

    def judge(self, channel: Index, value: NDArray[np.float64], flag: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Judge samples by their value alone; the quality of samples that were not good is kept."""
        quality = flag.copy()
        # a rail is more specific than a range: a sample outside the DBC's range may still be OPEN or SHORT
        open_to = (flag == GOOD) | (flag == OUT_OF_RANGE)
        outside = ~((value >= self.lower.take(channel)) & (value <= self.upper.take(channel)))
        high, low = value >= self.high_rail.take(channel), value <= self.low_rail.take(channel)
        for wrong, becomes in ((outside, OUT_OF_RANGE), (high, OPEN), (low, SHORT)):
            if wrong.any():
                quality[open_to & wrong] = becomes
        return quality


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the m channels that are judged by their past, each (m,)."""

    jump: NDArray[np.float64]
    rate: NDArray[np.float64]
    stuck: NDArray[np.float64]
    stuck_coarse: NDArray[np.float64]
    proof: NDArray[np.bool_]

    @classmethod
    def of(cls, rules: Sequence[Rule]) -> "Limits":
        """Take them from the rules."""
        jump, rate, stuck = _columns(rules, "jump", "jump_rate", "stuck_after_s")
        return cls(jump, rate, stuck, np.maximum(stuck, STUCK_COARSE_S), np.array([r.needs_proof for r in rules], bool))


def _columns(rules: Sequence[Rule], *names: str) -> list[NDArray[np.float64]]:
    return [np.array([getattr(r, name) for r in rules], np.float64) for name in names]


@dataclass(frozen=True, slots=True)
class Shown:
    """Which of m channels showed a value, a new value, and a fine step in an interval."""

    updated: NDArray[np.bool_]
    changed: NDArray[np.bool_]
    fine: NDArray[np.bool_]

    @classmethod
    def nothing(cls, m: int) -> "Shown":
        """Begin an interval."""
        return cls(*np.zeros((3, m), np.bool_))


@dataclass(frozen=True, slots=True)
class Verdict:
    """Judgement of one sample of each of several channels; upset: not usable, jumped or stuck."""

    jumped: NDArray[np.bool_]
    stuck: NDArray[np.bool_]
    upset: NDArray[np.bool_]
    proves: NDArray[np.bool_]
    at_home: NDArray[np.bool_]


class Belief:
    """Which of m channels are believed, and what the others must show first.

    Attributes
    ----------
    proven : ndarray of bool (m,)
        Has moved since it was last upset.
    needed : ndarray of int64 (m,)
        Calm samples before it is believed.
    cause : ndarray of uint8 (m,)
        `Quality` for which it is not believed; GOOD if it is believed.
    """

    def __init__(self, m: int) -> None:
        self.proven, self.needed = np.zeros(m, np.bool_), np.ones(m, np.int64)
        self.cause = np.full(m, NEVER, np.uint8)
        self._calm, self._strikes = np.zeros(m, np.int64), np.zeros(m, np.int64)

    def stuck(self, c: Index | slice) -> NDArray[np.bool_]:
        """Find channels that are not believed because they stand still."""
        return np.asarray(self.cause[c] == STUCK)

    def take(self, c: Index | slice, seen: Verdict, told: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Include the quality of samples and the events about them; return the calm samples of each channel."""
        proven, calm = self.proven[c] | seen.proves, self._calm[c] + 1
        if seen.upset.any():
            proven &= ~seen.jumped & ~seen.stuck
            calm[seen.upset] = 0
            struck = seen.jumped | (seen.stuck & seen.at_home & (self.cause[c] != STUCK))
            strikes = np.minimum(self._strikes[c] + struck, MAX_STRIKES)
            needed = np.where(seen.upset, np.maximum(self.needed[c], CONSISTENT), self.needed[c])
            self._strikes[c], self.needed[c] = strikes, np.where(struck, CONSISTENT << strikes, needed)
            self.cause[c] = np.where(seen.upset, told, self.cause[c])
        forgiven = calm >= FORGIVEN_AFTER
        self._strikes[c] = np.where(forgiven, 0, self._strikes[c])
        self.needed[c] = np.where(forgiven, CONSISTENT, self.needed[c])
        self.proven[c], self._calm[c] = proven, calm
        return calm

    def settle(
        self, c: Index | slice, accepted: NDArray[np.bool_], sound: NDArray[np.bool_], told: NDArray[np.uint8]
    ) -> NDArray[np.uint8]:
        """Return the quality of samples; those that are sound and not accepted wait for the cause of their channel."""
        if accepted.all():
            self.cause[c] = GOOD
            return told
        self.cause[c] = np.where(accepted, GOOD, self.cause[c])
        return np.where(accepted, GOOD, np.where(sound, self.cause[c], told))


class Guard:
    """Judges the samples of C channels, one interval after the other.

    Parameters
    ----------
    rules : sequence of Rule (C,)
    """

    def __init__(self, rules: Sequence[Rule]) -> None:
        self.rules = tuple(rules)
        n = len(self.rules)
        self._ranges = Ranges.of(self.rules)
        self._turns = Turns(self.rules)
        self._value, self._value_ns = np.full(n, np.nan), np.zeros(n, np.int64)
        self._last, self._received_ns = np.full(n, NEVER, np.uint8), np.full(n, -1, np.int64)
        # from here on: only the channels that are judged by their past
        self._channel = np.array([i for i, r in enumerate(self.rules) if r.remembers], np.intp)
        past = [self.rules[i] for i in self._channel]
        m = len(past)
        self._local = np.full(n, -1, np.intp)
        self._local[self._channel] = np.arange(m)
        self._limits = Limits.of(past)
        kinds = sorted({(r.quantity, r.group) for r in past})
        number = {kind: i for i, kind in enumerate(kinds)}
        group = np.array([number[r.quantity, r.group] for r in past], np.intp)
        self._peers, self._neighbours = Peers(group), Neighbours(group, self._limits.proof)
        self._anchors, self._repeats, self._belief = Anchors(m), Repeats(m), Belief(m)
        self._stepped = Stepped(group, self._limits.jump)
        self._previous, self._previous_ns = np.full(m, np.nan), np.zeros(m, np.int64)
        self._fine = np.zeros(m, np.bool_)

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
        quality = self._ranges.judge(channel, value, flag)
        shown = Shown.nothing(len(self._channel))
        held_back: Index = np.empty(0, np.intp)
        self._stepped.begin(self._previous, self._belief.cause == GOOD)
        local = self._local.take(channel)
        for part in _rounds(local):
            # a round of all channels, the usual one, needs no gathering
            c = slice(None) if len(part) == len(self._channel) else local[part]
            quality[part] = self._judge(c, value[part], time_ns[part], quality[part], shown)
            if self._repeats.any_run and np.count_nonzero(frozen := self._freezes(c)):
                held_back = np.concatenate([held_back, part[(quality[part] == GOOD) & frozen]])
        if shown.fine.any():
            self._fine |= self._peers.of_any(shown.fine)
        on = np.asarray(active, np.bool_)
        on = on.take(self._channel) if on.ndim else on
        self._peers.advance(t1_ns, on, shown.updated, shown.changed, self._repeats.noisy())
        self._neighbours.advance(self._previous, self._anchors.home, shown.updated)
        self._last[channel] = quality
        self._turns.take(channel, time_ns, self._received_ns)
        self._received_ns[channel] = time_ns
        if len(held_back):
            quality[held_back] = STUCK
        good = quality == GOOD
        self._value[channel[good]] = value[good]
        self._value_ns[channel[good]] = time_ns[good]
        rejected = np.bincount(channel[~good] * QUALITIES + quality[~good], minlength=n * QUALITIES)
        now, held = self._channels(t1_ns), np.zeros(n, np.bool_)
        held[self._channel] = self._stepped.held
        held &= now == JUMPY
        counts = rejected.reshape(n, QUALITIES)
        return GuardResult(quality, self._value.copy(), self._value_ns.copy(), now, counts, held)

    def _judge(
        self,
        c: Index | slice,
        value: NDArray[np.float64],
        time_ns: NDArray[np.int64],
        quality: NDArray[np.uint8],
        shown: Shown,
    ) -> NDArray[np.uint8]:
        """Judge one sample of each of several channels by the history of the channel."""
        usable = quality == GOOD
        previous = self._previous[c]
        known = ~np.isnan(previous)
        seconds = np.maximum(time_ns - self._previous_ns[c], 0) * 1e-9
        step = np.abs(value - previous)
        jumped = usable & known & (step > self._limits.jump[c] + self._limits.rate[c] * seconds)
        alone = None
        if self._neighbours.any_doubted(c):
            alone = self._neighbours.compare(c, value, usable, seconds)
            jumped |= known & alone.astray
        held = None
        if self._stepped.some or jumped.any():
            believed, usual = self._belief.cause[c] == GOOD, self._neighbours.step[c]
            held = self._stepped.judge(c, Seen(value, time_ns, usable, jumped, previous, believed, usual))
        stepped = usable & (step > 0)
        shown.updated[c] |= usable
        shown.changed[c] |= stepped & known
        shown.fine[c] |= stepped & (step < 1.01 * PROOF_K)
        proof, is_fine = self._limits.proof[c], self._fine[c]
        limit = np.where(is_fine, self._limits.stuck[c], self._limits.stuck_coarse[c])
        clock = self._peers.clock[c]
        left = self._anchors.follow(c, value, usable, seconds, Standing(clock, limit, self._belief.stuck(c), alone))
        stood = clock - self._anchors.since[c]
        stands = stood > np.where(self._belief.proven[c] & ~left.returned, PROVEN_PATIENCE, 1.0) * limit
        self._repeats.count(c, usable & known, value - previous, self._peers.around[c])
        long = np.minimum(stood, self._anchors.held[c]) > SETTLED * limit
        if long.any():
            stands |= long & self._repeats.lively(c) & self._peers.noisy[c] & is_fine
        stuck = usable & ~jumped & (stands | (left.at_home & proof & is_fine))
        upset = ~usable | jumped | stuck
        proves = left.moved & known & ~upset & (value != self._anchors.home[c])
        told = quality
        if upset.any():
            told = np.where(stuck, STUCK, np.where(jumped, JUMPY, quality))
            value, time_ns = np.where(usable, value, previous), np.where(usable, time_ns, self._previous_ns[c])
        self._previous[c], self._previous_ns[c] = value, time_ns
        calm = self._belief.take(c, Verdict(jumped, stuck, upset, proves, left.at_home), told)
        accepted = ~upset & (calm >= self._belief.needed[c]) & (self._belief.proven[c] | ~proof)
        if alone is not None:
            accepted &= ~alone.far | (calm >= FAR_NEEDED) | (self._belief.cause[c] == GOOD)
        if held is not None:
            accepted &= ~held
            self._belief.cause[c] = np.where(held & ~upset, JUMPY, self._belief.cause[c])
        self._neighbours.trust(c, accepted, usable & known, step)
        return self._belief.settle(c, accepted, usable & ~upset, told)

    def _freezes(self, c: Index | slice) -> NDArray[np.bool_]:
        """Find channels whose run of equal samples noise cannot produce; channels that may stand still are left out."""
        judged = (self._peers.noisy[c] | self._peers.alone[c]) & np.isfinite(self._limits.stuck[c])
        return np.asarray(judged & self._repeats.freezes(c), np.bool_)

    def _channels(self, t1_ns: int) -> NDArray[np.uint8]:
        late = t1_ns - self._received_ns > self._turns.stale_ns()
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
