"""Bus time: one line of time that only goes forward, for any time stamps of the frames.

Stamps come from a wall clock. They repeat, arrive slightly out of order, step back when the clock is set, and single
stamps are absurd. The rules apply frame by frame, so that the result does not depend on how frames were cut into
batches:

* up to `BACK_NS` behind the newest: reordering; the frame takes the newest time;
* further behind: the clock was set back; from here on the same amount is added to all stamps, so that time goes on;
* more than `AHEAD_NS` ahead: the frame is held until the next one. If the next frame follows it, the bus was silent (or
  the clock was set forward), and both are taken. If the next frame continues where the others were, the stamp was
  absurd, and its frame is dropped;
* more than `LONGEST_NS` ahead of the first, which two clocks in one log can reach in turns: absurd, too.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from bms_gateway.frames.batch import FrameBatch

BACK_NS = 2_000_000_000  # USB adapters reorder by milliseconds; 2 s is beyond any of them and below any clock setting
AHEAD_NS = 60_000_000_000
LONGEST_NS = 9_100_000_000_000_000_000  # 288 years; times and their differences fit 64 bits


@dataclass(slots=True)
class Clock:
    """The state of bus time; see the module's text.

    Attributes
    ----------
    first_ns : int
        First time returned.
    last_ns : int or None
        Newest time returned.
    shift_ns : int
        Added to raw stamps since the clock was set back.
    reordered, set_back, absurd : int
        Number of frames out of order, of clocks set back, of absurd stamps.
    """

    first_ns: int = 0
    last_ns: int | None = None
    shift_ns: int = 0
    reordered: int = 0
    set_back: int = 0
    absurd: int = 0
    _held: FrameBatch | None = None
    # new texts of `faults`, with the time of the frame that caused them
    _news: deque[tuple[int, str]] = field(default_factory=deque)

    def straighten(self, frames: FrameBatch) -> FrameBatch:
        """Convert the stamps of a batch to bus time.

        Parameters
        ----------
        frames : FrameBatch
            Next frames in the order of the bus, raw stamps.

        Returns
        -------
        FrameBatch
            Frames with non-decreasing times, never below earlier ones. A frame held from before may come first, and the
            last may be held.
        """
        if self._held is not None:
            frames = FrameBatch.concat([self._held, frames])
            self._held = None
        if not len(frames):
            return frames
        if self.last_ns is None:
            self.first_ns = int(frames.time_ns[0])
        start = frames.time_ns[0] if self.last_ns is None else self.last_ns - self.shift_ns
        steps = np.diff(frames.time_ns, prepend=start)
        if steps.min() >= 0 and steps.max() <= AHEAD_NS:
            time = frames.time_ns + self.shift_ns if self.shift_ns else frames.time_ns
            self.last_ns = int(time[-1])
            return FrameBatch(time, frames.can_id, frames.length, frames.data)
        return self._one_by_one(frames)

    def faults(self) -> str:
        """Describe the faults of the stamps for people, without reordering, which is usual; empty if none."""
        back = f"clock set back {self.set_back}×" if self.set_back else ""
        absurd = f"{self.absurd} frames dropped whose stamps lie far ahead of all others" if self.absurd else ""
        return "; ".join(part for part in (back, absurd) if part)

    def news(self, before_ns: int) -> str:
        """Describe the faults that came with frames before this time, once each; empty if there are none."""
        said = ""
        while self._news and self._news[0][0] < before_ns:
            said = self._news.popleft()[1]
        return said

    def _one_by_one(self, frames: FrameBatch) -> FrameBatch:
        """Apply the rules to a batch with unusual stamps."""
        raw = frames.time_ns.tolist()
        keep: list[int] = []
        times: list[int] = []
        last = raw[0] + self.shift_ns if self.last_ns is None else self.last_ns
        odd = False
        for i, stamp in enumerate(raw):
            t = stamp + self.shift_ns
            if t > last + AHEAD_NS:
                far = t - min(self.first_ns, 0) > LONGEST_NS
                if i + 1 == len(raw) and not far:
                    self._held = frames[i : i + 1]
                    break
                if far or raw[i + 1] + self.shift_ns <= last + AHEAD_NS:
                    self.absurd += 1
                    odd = True
                    continue
            elif t < last - BACK_NS:
                self.set_back += 1
                odd = True
                self.shift_ns += last - t
                t = last
            elif t < last:
                self.reordered += 1
                t = last
            last = t
            if odd:
                if self._news and self._news[-1][0] == t:
                    self._news.pop()  # a clock that is set back repeatedly stops time here: one entry for all
                self._news.append((t, self.faults()))
                odd = False
            keep.append(i)
            times.append(t)
        if keep:
            self.last_ns = last
        index = np.array(keep, dtype=np.intp)
        return FrameBatch(
            np.array(times, dtype=np.int64), frames.can_id[index], frames.length[index], frames.data[index]
        )
