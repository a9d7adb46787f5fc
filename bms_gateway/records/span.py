"""Extent of logs: how many frames, for how long, and whether any carries a configured signal."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from bms_gateway.engine import Engine
from bms_gateway.errors import DataError
from bms_gateway.frames.batch import EXTENDED, FrameBatch
from bms_gateway.frames.j1939 import parameter_group

MOST_IDS = 10_000  # more identifiers than any bus has; made-up ones then cost no memory


class Span:
    """How many frames the logs held and how long they last.

    Attributes
    ----------
    frames : int
    """

    def __init__(self) -> None:
        self.frames = 0
        self._first: int | None = None
        self._last = 0
        self._ids: set[int] = set()

    @property
    def seconds(self) -> float:
        """From the first frame to the newest stamp."""
        return 0.0 if self._first is None else round((self._last - self._first) * 1e-9, 6)

    @property
    def first_ns(self) -> int:
        """Stamp of the first frame, ns; 0 before there is one."""
        return self._first or 0

    def note(self, batch: FrameBatch) -> None:
        """Take a batch, not empty, into account."""
        self.frames += len(batch)
        if len(self._ids) < MOST_IDS:
            self._ids.update(np.unique(batch.can_id).tolist())
        self._first = int(batch.time_ns[0]) if self._first is None else self._first
        self._last = max(self._last, int(batch.time_ns[-1]))

    def elsewhere(self, wanted: Iterable[int]) -> str:
        """Say from which addresses the parameter groups that are wanted come, if only those differ."""
        groups = {parameter_group(i) for i in wanted if i & EXTENDED}
        seen = Counter(i & 0xFF for i in self._ids if i & EXTENDED and parameter_group(i) in groups)
        if not seen:
            return ""
        address = seen.most_common(1)[0][0]
        where = f"{seen[address]} of them come from 0x{address:02X}"
        return f"; if they are of J1939, {where}: [bus] source_address = {address}"


def expect_estimates(logs: Iterable[Path], config: Path, engine: Engine, span: Span) -> None:
    """Refuse logs from which nothing was estimated, because an empty result could be taken for a good one.

    Raises
    ------
    DataError
        There are no frames, or none of them carries a signal of the config.
    """
    names = ", ".join(str(log) for log in logs)
    if not span.frames:
        raise DataError(f"{names}: no data frames")
    if not engine.frames:
        wanted = ", ".join(f"{can_id & 0x1FFF_FFFF:X}" for can_id in engine.can_ids[:3].tolist())
        raise DataError(
            f"{names}: none of the {span.frames} frames carries a signal of {config}, or they span less than a "
            f"second; expected identifiers {wanted}{', …' if len(engine.can_ids) > 3 else ''}"
            f"{span.elsewhere(engine.can_ids.tolist())}"
        )
