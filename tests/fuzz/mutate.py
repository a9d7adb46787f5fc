"""Ways to spoil an example: cuts, copies, other bytes, other numbers."""

import random
from collections.abc import Sequence

Edit = tuple[int, float, float, bytes]
"""(what, where, how far, with what); places are shares of the length."""
KINDS = 7
NUMBERS = (
    b"0",
    b"-1",
    b"nan",
    b"inf",
    b"1e308",
    b"-1e-300",
    b"99999999999999999999",
    b"4294967295",
    b"\xff\xff\xff\xff",
)


def apply(data: bytes, edits: Sequence[Edit]) -> bytes:
    for kind, at, span, new in edits:
        i = int(at * len(data))
        j = i + int(span * span * span * (len(data) - i))  # mostly short
        if kind == 0:
            data = data[:i] + new + data[i:]
        elif kind == 1:
            data = data[:i] + data[j:]
        elif kind == 2:
            data = data[:i] + new + data[i + len(new) :]
        elif kind == 3:
            data = data[:j] + data[i:j] * 3 + data[j:]
        elif kind == 4:
            data = data[:i]
        elif kind == 5 and data:
            i = min(i, len(data) - 1)
            data = data[:i] + bytes([data[i] ^ 1 << (len(new) % 8)]) + data[i + 1 :]
        elif kind == 6:
            data = data[:i] + NUMBERS[len(new) % len(NUMBERS)] + data[i + 1 :]
    return data


def random_edits(rng: random.Random) -> list[Edit]:
    count = 1 + int(rng.expovariate(0.6))
    return [(rng.randrange(KINDS), rng.random(), rng.random(), rng.randbytes(rng.randrange(16))) for _ in range(count)]
