"""Samples through a guard, second by second."""

import numpy as np

from bms_gateway.frames.guard import Guard
from bms_gateway.frames.rules import Rule

S = 1_000_000_000


FINE = Rule("surface", 1, -38.5, 150.0, -38.9, 200.0, 5 * S, 2.5, 0.2, 20.0, needs_proof=True)


def run(
    rules: list[Rule],
    series: np.ndarray,
    *,
    active: object = True,
    flags: np.ndarray | None = None,
    guard: Guard | None = None,
) -> tuple[np.ndarray, Guard]:
    """Feed one sample per second and channel, `series` (T, C), NaN for none; qualities (T, C), 255 for none."""
    guard = guard or Guard(rules)
    told = np.full(series.shape, 255, np.uint8)
    for i, row in enumerate(series):
        c = np.flatnonzero(~np.isnan(row))
        flag = np.zeros(len(c), np.uint8) if flags is None else flags[i, c]
        end = (i + 1) * S
        on = active[i] if isinstance(active, np.ndarray) else active
        told[i, c] = guard.update(np.full(len(c), end - S // 2), c, row[c], flag, end, on).quality
    return told, guard
