"""A bar that moves while a long step of the work goes on: what was told, and a little further with each piece of work.

The search tells the share of its work at its steps, of which one can take half a minute with sixty cells. In between,
every trajectory moves the bar on towards the next step, ever less, and the text counts them.
"""

import math
import time
from collections.abc import Callable
from typing import Final

from bms_gateway.errors import counted

Tell = Callable[[float, str], None]
ROOM: Final = 0.1
"""Share of all work by which pieces alone can move the bar."""
PIECES: Final = 150.0
"""After so many of them it has moved by two thirds of that."""
EVERY_S: Final = 0.25
"""Between two lines: a person reads no faster."""


class Moving:
    """Tells shares that never fall.

    Parameters
    ----------
    tell : callable
        Told the share and the text.
    """

    def __init__(self, tell: Tell) -> None:
        self._tell = tell
        self._share, self._shown, self._text = 0.0, 0.0, ""
        self._pieces, self._said = 0, 0.0

    def step(self, share: float, text: str) -> None:
        """Take what the work itself tells."""
        self._share, self._text, self._pieces = max(share, self._shown), text, 0
        self._say(self._share, text)

    def beat(self) -> None:
        """Take one more piece of work."""
        self._pieces += 1
        if time.monotonic() - self._said >= EVERY_S:
            further = ROOM * (1.0 - math.exp(-self._pieces / PIECES))
            share = self._share + min(further, 0.9 * (1.0 - self._share))
            self._say(share, f"{self._text} ({counted(self._pieces, 'trajectory', 'trajectories')})")

    def _say(self, share: float, text: str) -> None:
        self._shown, self._said = max(self._shown, share), time.monotonic()
        self._tell(self._shown, text)
