"""Frames for tests, and hypothesis strategies of them."""

import numpy as np
from hypothesis import strategies as st

from bms_gateway.frames.batch import EXTENDED, FrameBatch


def make(*frames: tuple[int, int, bytes]) -> FrameBatch:
    """A batch of (time_ns, can_id, payload)."""
    width = 64 if any(len(p) > 8 for _, _, p in frames) else 8
    data = np.zeros((len(frames), width), np.uint8)
    for row, (_, _, payload) in zip(data, frames, strict=True):
        row[: len(payload)] = np.frombuffer(payload, np.uint8)
    return FrameBatch(
        np.array([t for t, _, _ in frames], np.int64),
        np.array([c for _, c, _ in frames], np.uint32),
        np.array([len(p) for _, _, p in frames], np.uint8),
        data,
    )


def rows(batch: FrameBatch) -> list[tuple[int, int, bytes]]:
    """The reverse of `make`; checks that payloads are zero beyond their length."""
    found = []
    for t, c, n, d in zip(*(a.tolist() for a in (batch.time_ns, batch.can_id, batch.length, batch.data)), strict=True):
        assert not any(d[n:])
        found.append((t, c, bytes(d[:n])))
    return found


def same(a: FrameBatch, b: FrameBatch) -> bool:
    return rows(a) == rows(b)


ids = st.one_of(st.integers(0, 0x7FF), st.integers(0, 0x1FFF_FFFF).map(lambda i: i | EXTENDED))
payloads = st.binary(max_size=8)
