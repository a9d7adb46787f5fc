"""Alternating rounds: peers run in turn on the same input, figures are ratios with median, minimum and maximum."""

import gc
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

ROUNDS = 7


@dataclass(frozen=True)
class Timing:
    """CPU seconds of each round."""

    name: str
    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        return statistics.median(self.seconds)


def alternate(runs: Mapping[str, Callable[[], object]], rounds: int = ROUNDS) -> dict[str, Timing]:
    """Run each once to warm up, then all in turn, `rounds` times; process CPU time, garbage collected in between."""
    for run in runs.values():
        run()
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            gc.collect()
            start = time.process_time()
            run()
            seconds[name].append(time.process_time() - start)
    return {name: Timing(name, tuple(s)) for name, s in seconds.items()}


def ratio(a: Timing, b: Timing) -> str:
    """How many times `a` takes what `b` does, round by round."""
    r = sorted(x / y for x, y in zip(a.seconds, b.seconds, strict=True))
    return f"{statistics.median(r):.2f}x (min {r[0]:.2f}, max {r[-1]:.2f})"
