"""A drive cycle like the paper's urban assault cycle: 1332 s, +160/−96 A, 62.2 A rms, no net charge."""

import numpy as np

SECONDS = 1332
HIGH, LOW, RMS = 160.0, -96.0, 62.2


def urban_assault(seed=0, *, seconds=SECONDS):
    """One cycle (1332,) A at 1 s, discharge positive: pulses of 2–20 s within calm and intense stretches."""
    rng = np.random.default_rng([seed, 1332])
    out = np.empty(0)
    while len(out) < SECONDS:
        stretch = rng.integers(40, 240)
        intensity = rng.choice([0.1, 0.5, 1.0, 1.6], p=[0.2, 0.25, 0.35, 0.2])
        part = []
        while len(part) < stretch:
            level = intensity * (rng.normal(0, 70) if rng.random() < 0.8 else 0.0)
            part += [level] * int(rng.integers(2, 21))
        out = np.concatenate([out, part])
    raw = out[:SECONDS]
    raw[np.argmax(raw)], raw[np.argmin(raw)] = 1e6, -1e6  # both limits are reached
    gain, offset = 1.0, 0.0
    for _ in range(200):  # alternately mend mean and rms under the clip
        cycle = np.clip(gain * raw + offset, LOW, HIGH)
        gain *= RMS / np.sqrt(np.mean(cycle**2))
        offset -= np.mean(cycle)
    return np.clip(gain * raw + offset, LOW, HIGH)


def repeated(minutes, seed=0):
    """The cycle over and over for so many minutes (K,) A."""
    K = int(minutes * 60)
    return np.tile(urban_assault(seed), K // SECONDS + 1)[:K]
