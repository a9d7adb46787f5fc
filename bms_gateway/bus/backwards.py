"""Finds logs whose time stamps run backwards: frames of a reversed file say nothing about a battery in their order."""

import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from bms_gateway.frames.batch import FrameBatch

FEWEST: Final = 10
"""Least number of steps back: adapters reorder some frames."""

MOSTLY: Final = 0.75


@dataclass(slots=True)
class Steps:
    """Steps of the stamps of one log, in the order of the file.

    Attributes
    ----------
    back, forth : int
        Number of frames whose stamp is less, or greater, than the one before.
    """

    back: int = 0
    forth: int = 0
    _last: list[int] = field(default_factory=list)

    def take(self, batch: FrameBatch) -> None:
        """Count the steps of the next frames."""
        steps = np.diff(batch.time_ns, prepend=self._last or batch.time_ns[:1])
        self.back += int(np.count_nonzero(steps < 0))
        self.forth += int(np.count_nonzero(steps > 0))
        self._last = batch.time_ns[-1:].tolist()

    @property
    def backwards(self) -> bool:
        """Whether nearly all steps go back; of frames in no order it is half of them."""
        return self.back >= FEWEST and self.back > MOSTLY * (self.back + self.forth)


def how_to_sort(path: Path) -> str:
    """Give the command that sorts a candump log by time; other formats are sorted by the program that wrote them."""
    name = path.name.lower()
    if not name.endswith((".log", ".log.gz")):
        return "sort its frames by time"
    read = "zcat" if name.endswith(".gz") else "cat"
    return f"sort it by time: {read} {shlex.quote(str(path))} | sort -s -k1,1 > sorted.log"
