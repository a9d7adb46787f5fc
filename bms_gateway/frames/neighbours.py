"""Whether a channel that is not trusted yet moves with its neighbours, or alone.

An unconnected input stands still while all is quiet and jumps when the inverter switches, so a move proves nothing. It
differs from a thermometer in that its neighbours do not move with it. A channel is *doubted* until `TRUSTED` of its
samples were accepted in a row. Meanwhile three rules apply:

* It must not go *astray*: its distance from the median of its group must stay constant, except for noise and heating.
* A channel that is *far* from all others is used only after it has moved with them for `FAR_NEEDED` samples.
* A channel that *strays* must not return to exactly its home (see `guard`) while its neighbours are away from theirs.
  Otherwise it is stuck, and each time the calm time that it needs is doubled.

Fewer than `FEWEST_ALIKE` channels cannot judge each other.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.intp]
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

TRUSTED = 30
"""Samples accepted in a row that end the doubt: half a minute to two minutes, in which an inverter has switched on."""
FEWEST_ALIKE = 3
"""Least channels of a group: one faulty channel does not move their median."""
OVER = 8
"""Samples over which a channel's distance from the middle, and its usual step, are averaged."""
ASTRAY_K, ASTRAY_STEPS = 2.0, 6.0
"""A channel is astray beyond this distance, K, and beyond this many usual steps of its group. No surface leaves its
neighbours by so much within some seconds. A usual step is 1.1 standard deviations of the noise, and sensors of one
string may differ in noise by a factor of four."""
SOON_S = 10.0
"""A later sample is compared from its new place on: between rare frames, a cell may leave its neighbours."""
FAR_K, FAR_SPREADS = 4.0, 6.0
"""A level is far beyond this distance from the median, K, and beyond this many usual distances: strings at rest have
even temperatures."""
FAR_NEEDED = 8
"""Calm samples after which a far channel is used."""
STRAYS_K, AWAY_K = 0.2, 0.1
"""A return home counts from this usual step on, K, and if the neighbours are this far from their homes, K. Noise of
some hundredths has smaller steps, and when a disturbance ends at rest, all channels return home together."""


@dataclass(frozen=True, slots=True)
class Compared:
    """Comparison of one sample of each of several channels with their neighbours; trusted channels are not compared.

    Attributes
    ----------
    astray, far, strays : ndarray of bool
        See the module's text; `strays`: a return home would be one that its neighbours do not make.
    """

    astray: Bools
    far: Bools
    strays: Bools


class Neighbours:
    """Channels and the groups in which they are neighbours.

    Parameters
    ----------
    group : ndarray of intp (m,)
        Number of each channel's group, from 0.
    proof : ndarray of bool (m,)
        Which channels have to prove anything at all.

    Attributes
    ----------
    step : ndarray (m,)
        Usual step of each channel from sample to sample.
    """

    def __init__(self, group: Index, proof: Bools) -> None:
        m, groups = len(group), int(group.max(initial=-1)) + 1
        self._group, self._proof = group, proof
        ordered = np.argsort(group, kind="stable")
        count = np.bincount(group, minlength=groups)
        # a row for each group, and each channel's place in it; the rest of a row stays NaN
        self._place = np.empty(m, np.intp)
        self._place[ordered] = np.arange(m) - np.repeat(np.cumsum(count) - count, count)
        self._table = np.full((groups, int(count.max(initial=1))), np.nan)
        self._trust = np.where(proof, 0, TRUSTED)
        self._distance, self.step = np.full(m, np.nan), np.zeros(m)
        # medians of each group: of its levels, of their distances from that, of usual steps, of distances from home
        self._middle, self._spread, self._usual, self._away = np.full((4, groups), np.nan)

    def any_doubted(self, c: Index | slice) -> bool:
        """Whether any of these channels is not trusted yet."""
        return bool((self._trust[c] < TRUSTED).any())

    def compare(self, c: Index | slice, value: Floats, usable: Bools, seconds: Floats) -> Compared:
        """Compare one sample of each of several channels with their groups as they were until the last interval.

        `seconds` have passed since each channel's last sample.
        """
        group, before = self._group[c], self._distance[c]
        asked = usable & (self._trust[c] < TRUSTED)
        distance = value - self._middle[group]
        astray = asked & (np.abs(distance - before) > np.maximum(ASTRAY_K, ASTRAY_STEPS * self._usual[group]))
        late = seconds > SOON_S
        astray &= ~late
        far = asked & (np.abs(distance) > np.maximum(FAR_K, FAR_SPREADS * self._spread[group]))
        strays = asked & (self.step[c] >= STRAYS_K) & (self._away[group] >= AWAY_K)
        # a channel that has left its place is compared at the new one: a thermometer that was plugged in stays there
        anew = astray | late | np.isnan(before)
        self._distance[c] = np.where(asked, np.where(anew, distance, before + (distance - before) / OVER), before)
        return Compared(astray, far, strays)

    def trust(self, c: Index | slice, accepted: Bools, stepped: Bools, step: Floats) -> None:
        """Count the samples accepted in a row, and update the usual size of a step."""
        trust, usual = self._trust[c], self.step[c]
        count = np.where(accepted, np.minimum(trust + 1, TRUSTED), 0)
        self._trust[c] = np.where(self._proof[c], count, trust)
        self.step[c] = np.where(stepped, usual + (step - usual) / OVER, usual)

    def advance(self, level: Floats, home: Floats, updated: Bools) -> None:
        """Find the medians at the end of an interval.

        Parameters
        ----------
        level, home : ndarray (m,)
            Last value of each channel, and its home; NaN for none.
        updated : ndarray of bool (m,)
            Which of them had a sample in the interval.
        """
        if not (updated & (self._trust < TRUSTED)).any():
            return
        before, self._middle = self._middle, self._medians(level)
        self._spread = self._medians(np.abs(level - self._middle[self._group]))
        self._usual = self._medians(np.where(np.isnan(level), np.nan, self.step))
        self._away = self._medians(np.abs(level - home))
        # many senders begin with one sample of exactly zero: while a median jumps, no distance from it is kept
        jumps = np.abs(self._middle - before) > ASTRAY_K
        self._distance[jumps[self._group]] = np.nan

    def _medians(self, value: Floats) -> Floats:
        """Median of each group's channels that have a value, NaN for fewer than `FEWEST_ALIKE`."""
        self._table[self._group, self._place] = value
        ordered = np.sort(self._table, axis=1)  # NaN comes last
        count = np.count_nonzero(~np.isnan(ordered), axis=1)
        enough = np.flatnonzero(count >= FEWEST_ALIKE)
        low, high = (count[enough] - 1) // 2, count[enough] // 2
        found = np.full(len(count), np.nan)
        found[enough] = 0.5 * (ordered[enough, low] + ordered[enough, high])
        return found
