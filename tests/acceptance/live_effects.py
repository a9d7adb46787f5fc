"""A log with a hidden effect through the live gateway."""

from dataclasses import dataclass

import numpy as np

from tests.truth.hidden import HiddenLog

SETTLED_S = 300


@dataclass
class Core:
    """Root mean square error of the cores, K; share of them within two stated sd; median of that sd."""

    rms: float
    inside: float
    sd: float


def judged(log: HiddenLog, estimates: dict[str, np.ndarray], stated: float) -> Core:
    """Judge the cores that are stated: at least this share of them."""
    second = np.rint(estimates["time_s"]).astype(int)
    use = (second >= SETTLED_S) & (second < len(log.core))
    assert np.mean(np.isfinite(estimates["core_C"][use])) >= stated
    use &= np.isfinite(estimates["core_C"])
    error = estimates["core_C"][use] - log.core[second[use], estimates["cell"][use].astype(int) - 1]
    sd = estimates["core_sd_K"][use]
    return Core(float(np.sqrt(np.mean(error**2))), float(np.mean(np.abs(error) < 2 * sd)), float(np.median(sd)))
