"""Seeded drives: current, coolant inlet and flow at 1 Hz, with the state of charge kept within 0.1…0.95.

Nothing here is a measured cycle: each is made of random pulses and micro-trips with the character of its namesake, so
that two seeds never share a wave form.
"""

from dataclasses import dataclass

import numpy as np

from tests.truth.cycle import urban_assault
from tests.truth.pack import CAPACITY_AH

RMS = 62.0
"""A: of the paper's cycle; the milder cycles say their own."""
LOWEST, HIGHEST = 0.1, 0.95


@dataclass(frozen=True)
class Drive:
    """current (K,) A held from each second on, inlet (K + 1,) °C, flow (K,) ratio, soc_0."""

    current: np.ndarray
    inlet: np.ndarray
    flow: np.ndarray
    soc_0: float


def urban(rng, K):
    """The urban assault cycle over and over: the same 22 minutes at the start and at the end."""
    cycle = urban_assault(int(rng.integers(1 << 30)))
    return np.tile(cycle, K // len(cycle) + 1)[:K]


def _trips(rng, K, speed, stop, pull):
    """Current of micro-trips: pull away, cruise with ripple, brake with regeneration, stand."""
    parts, length = [], 0
    while length < K:
        v = rng.uniform(*speed)
        away, cruise, brake = (
            int(rng.integers(5, 16)),
            int(rng.integers(10, 15 + int(8 * v))),
            int(rng.integers(5, 14)),
        )
        ripple = np.repeat(rng.normal(0, 0.35, cruise // 3 + 1), 3)[:cruise]
        part = np.concatenate(
            [
                pull * v / 10 * rng.uniform(0.7, 1.2) * np.linspace(0.6, 1.4, away),
                0.25 * (v / 10) ** 1.6 + ripple * v / 10,
                -0.8 * pull * v / 10 * rng.uniform(0.6, 1.1) * np.linspace(1.3, 0.3, brake),
                np.zeros(int(rng.integers(*stop))),
            ]
        )
        parts.append(part)
        length += len(part)
    return np.concatenate(parts)[:K]


def us06(rng, K):
    """Fast and hard, few stops."""
    return 62.0 * _norm(_trips(rng, K, (8, 35), (2, 15), 1.6))


def udds(rng, K):
    """Town traffic: mild, many stops."""
    return 48.0 * _norm(_trips(rng, K, (4, 22), (5, 40), 1.2))


def pulses(rng, K):
    """Short and long pulses at several amplitudes, both directions, rests between; ends with a cool-down."""
    parts, length, sign = [], 0, 1
    while length < K - 480:
        A = rng.choice([25.0, 50.0, 80.0, 100.0, 118.0])
        if rng.random() < 0.5:  # a train of short ones, alternately out and in
            on, times = int(rng.integers(3, 12)), 2 * int(rng.integers(2, 7))
            part = np.concatenate([[sign * A * (1 - 2 * (i % 2))] * on + [0.0] * on for i in range(times)])
        else:
            on = int(min(rng.integers(40, 200), 9000 / A))
            part = np.concatenate([np.full(on, sign * A), np.zeros(int(rng.integers(10, 90))), np.full(on, -sign * A)])
        rest = np.zeros(int(rng.choice([20, 60, 180])))
        parts += [part, rest]
        length += len(part) + len(rest)
        sign = -sign
    out = np.concatenate(parts)[: K - 480]
    return np.concatenate([out, np.zeros(K - len(out))])


def sweep(rng, K):
    """Partial cycles: minutes of discharge and minutes of charge, unequal currents, short pulses on top."""
    parts, length = [], 0
    while length < K:
        deep = rng.uniform(2.5, 4.8) * 3600  # As, there and back
        for sign in (1, -1):
            A = rng.uniform(25, 70)
            on = int(deep / A)
            ripple = np.repeat(rng.normal(0, 0.6, on // 6 + 1), 6)[:on]
            parts += [sign * A * (1 + ripple - ripple.mean()), np.zeros(int(rng.integers(10, 100)))]
            length += len(parts[-2]) + len(parts[-1])
    return np.concatenate(parts)[:K]


def mixed(rng, K):
    """Urban, a rest of eight minutes, fast, and a cool-down of twelve."""
    rest, end = min(480, K // 7), min(720, K // 5)
    half = (K - rest - end) // 2
    return np.concatenate(
        [urban(rng, half), np.zeros(rest), 75.0 * _norm(us06(rng, K - rest - end - half)), np.zeros(end)]
    )


def _norm(x):
    """No net charge and unit rms; rests stay at 0 A."""
    driving = x != 0
    x = np.where(driving, x - np.mean(x[driving]), 0.0)
    return x / np.sqrt(np.mean(x**2))


CYCLES = {f.__name__: f for f in (urban, us06, udds, pulses, sweep, mixed)}


def _within(current, rng):
    """Keep the charge within limits: the slow drift is taken out where there is too much; then a start that fits."""
    room = HIGHEST - LOWEST
    current = np.clip(current, -120.0, 160.0)
    driving = current != 0
    for attempt in range(31):
        moved = np.concatenate([[0.0], -np.cumsum(current)]) / 3600 / CAPACITY_AH
        span = moved.max() - moved.min()
        if span <= 0.9 * room or attempt == 30:
            break
        # the drift over ten minutes goes where current flows anyway: rests stay rests
        window = np.ones(601) / 601
        slow = np.convolve(np.pad(current, 300, mode="reflect"), window, mode="valid")
        duty = np.maximum(np.convolve(np.pad(driving.astype(float), 300, mode="reflect"), window, mode="valid"), 0.1)
        current = current - 0.3 * driving * slow / duty
    if span > 0.9 * room:
        current, moved = current * (0.9 * room / span), moved * (0.9 * room / span)
    low, high = LOWEST - moved.min(), HIGHEST - moved.max()
    return current, rng.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low))


def _inlet(kind, rng, K, mean):
    s = np.arange(K + 1.0)
    if kind == "constant":
        return np.full(K + 1, mean)
    if kind == "ramp":
        return mean + rng.choice([-1, 1]) * np.linspace(-4.0, 4.0, K + 1)
    if kind == "sine":
        return mean + rng.uniform(3, 4) * np.sin(2 * np.pi * s / rng.uniform(700, 1500) + rng.uniform(0, 6))
    if kind == "steps":  # ±5 K about the mean; ducts and flaps take some seconds
        out = _levels(rng, K + 1, (350, 800), lambda i: 5.0 * (1 - 2 * (i % 2)) * rng.uniform(0.7, 1.0))
        return mean + _smooth(out, 8.0)
    raise ValueError(f"no inlet profile {kind!r}: {', '.join(INLETS)}")


def _flow(kind, rng, K):
    if kind == "constant":
        return np.ones(K)
    if kind == "steps":
        return _smooth(_levels(rng, K, (250, 600), lambda _: rng.uniform(0.6, 1.4)), 3.0)
    raise ValueError(f"no flow profile {kind!r}: {', '.join(FLOWS)}")


INLETS = ("constant", "steps", "ramp", "sine")
FLOWS = ("constant", "steps")


def _levels(rng, K, stay, level):
    out, k, i = np.empty(K), 0, int(rng.integers(2))
    while k < K:
        n = int(rng.integers(*stay))
        out[k : k + n] = level(i)
        k, i = k + n, i + 1
    return out


def _smooth(x, tau):
    out, a = np.empty_like(x), np.exp(-1 / tau)
    y = x[0]
    for k, v in enumerate(x):
        y = a * y + (1 - a) * v
        out[k] = y
    return out


def make_drive(cycle="urban", inlet="constant", flow="constant", *, seed=0, seconds=3600, mean_inlet=22.0):
    """One drive, the same for the same arguments; the mean inlet lies within 2 K of `mean_inlet` °C."""
    if cycle not in CYCLES:
        raise ValueError(f"no cycle {cycle!r}: {', '.join(CYCLES)}")
    rng = [np.random.default_rng([seed, 77, i]) for i in range(4)]
    current, soc_0 = _within(CYCLES[cycle](rng[0], seconds), rng[1])
    mean = mean_inlet + rng[2].uniform(-2.0, 2.0)
    return Drive(current, _inlet(inlet, rng[2], seconds, mean), _flow(flow, rng[3], seconds), float(soc_0))
