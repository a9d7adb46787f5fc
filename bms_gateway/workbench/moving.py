"""A progress bar that moves during a long step: by the reported shares, and a little further with each piece of work.

The search reports the share of its work at its steps, one of which can take half a minute with sixty cells. In between,
every trajectory moves the bar on towards the next step, ever less, and the text counts them. They may move it past the
next steps; the bar then goes on from where it is, because one that waits for the work looks like work that has stopped.
"""

import math
import time
from collections.abc import Callable
from typing import Final

from bms_gateway.errors import counted

Tell = Callable[[float, str], None]
ROOM: Final = 0.1
"""Most that pieces of work without a known total can move the bar, as a share of all work."""
AGAIN: Final = 0.5
"""Share of the rest of the bar for a search that begins anew."""
PIECES: Final = 150.0
"""Number of pieces after which they have moved the bar by two thirds of the way to `ROOM` beyond the reported share."""
ONE_PIECE: Final = 1.0 - math.exp(-1.0 / PIECES)
EVERY_S: Final = 0.25
"""Time between two lines: a person reads no faster."""


class Moving:
    """Reports shares that never fall.

    A search that begins anew reports smaller shares than before. Its work was not foreseen, nor is what may come
    after it: it gets `AGAIN` of the rest of the bar.

    Parameters
    ----------
    tell : callable
        Gets the share and the text.
    """

    def __init__(self, tell: Tell) -> None:
        self._tell = tell
        self._reported, self._share, self._at, self._text = 0.0, 0.0, 0.0, ""
        self._from, self._per = 0.0, 1.0  # a reported share x is shown as _from + _per x
        self._pieces, self._said = 0, 0.0

    def step(self, share: float, text: str) -> None:
        """Use the share reported by the work itself."""
        if share < self._reported:
            self._per = AGAIN * (1.0 - self._at) / max(1.0 - share, 1e-9)
            self._from = self._at - self._per * share
        self._reported, self._text, self._pieces = share, text, 0
        self._share = 1.0 if share >= 1.0 else self._from + self._per * share
        self._at = max(self._at, self._share)
        self._say(text)

    def beat(self) -> None:
        """Count one more piece of work."""
        self._pieces += 1
        end = self._share + min(self._per * ROOM, 0.9 * (1.0 - self._share))
        self._at += max(end - self._at, 0.0) * ONE_PIECE
        if time.monotonic() - self._said >= EVERY_S:
            self._say(f"{self._text} ({counted(self._pieces, 'trajectory', 'trajectories')})")

    def _say(self, text: str) -> None:
        self._said = time.monotonic()
        self._tell(self._at, text)
