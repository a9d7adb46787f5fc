"""What logs held before anything was made of them: how many frames, for how long, and whether any was of use."""

from collections.abc import Iterable
from pathlib import Path

from bms_gateway.engine import Engine
from bms_gateway.errors import DataError
from bms_gateway.frames.batch import FrameBatch


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

    @property
    def seconds(self) -> float:
        """From the first frame to the newest stamp."""
        return 0.0 if self._first is None else round((self._last - self._first) * 1e-9, 6)

    def note(self, batch: FrameBatch) -> None:
        """Take a batch, not empty, into account."""
        self.frames += len(batch)
        self._first = int(batch.time_ns[0]) if self._first is None else self._first
        self._last = max(self._last, int(batch.time_ns[-1]))


def expect_estimates(logs: Iterable[Path], config: Path, engine: Engine, span: Span) -> None:
    """Refuse logs from which nothing was estimated: an empty result looks too much like a good one.

    Raises
    ------
    DataError
        No frames, or none that the config speaks of.
    """
    names = ", ".join(str(log) for log in logs)
    if not span.frames:
        raise DataError(f"{names}: no data frames")
    if not engine.frames:
        wanted = ", ".join(f"{can_id & 0x1FFF_FFFF:X}" for can_id in engine.can_ids[:3].tolist())
        raise DataError(
            f"{names}: none of the {span.frames} frames carries a signal of {config}, or they span less than a "
            f"second; expected identifiers {wanted}{', …' if len(engine.can_ids) > 3 else ''}"
        )
