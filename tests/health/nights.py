"""Nights of a parked string, in which a cell may discharge itself."""

from dataclasses import dataclass

import numpy as np

N, AH, R_E = 12, 8.0, 3.5e-3


@dataclass
class Night:
    """Voltages (K, n) every `every` seconds, after half an hour of driving that moved `soc0` to `soc1`."""

    time_s: np.ndarray
    V: np.ndarray
    current: np.ndarray


def curve(soc: np.ndarray) -> np.ndarray:
    """Open-circuit voltage like that of NMC, V; slope 0.62 to 1.1 V in the middle."""
    return 3.0 + 1.15 * soc + 0.08 * np.tanh((soc - 0.1) / 0.05) - 0.12 * np.sin(2.5 * np.pi * soc) / 2.5


def night(
    rng: np.random.Generator,
    hours: float,
    leak_A: float = 0.0,
    *,
    cell: int = 6,
    at_h: float = 0.0,
    step: float = 1e-3,
    every: int = 60,
    soc: float = 0.6,
) -> Night:
    """Drive at C/2 for half an hour, then rest: the truth."""
    drive, dt = 1800, every
    K = int((drive + 3600 * hours) / dt)
    t = np.arange(K) * float(dt)
    current = np.where(t < drive, 0.5 * AH, 0.0)
    q = np.clip(soc + 0.25 + rng.normal(0, 0.004, N), 0.05, 0.98)
    pairs = [(R_E * 0.8 * np.exp(rng.normal(0, 0.06, N)), 900.0), (R_E * 1.2 * np.exp(rng.normal(0, 0.06, N)), 7200.0)]
    x, V = [np.zeros(N), np.zeros(N)], np.empty((K, N))
    capacity = AH * np.exp(rng.normal(0, 0.02, N))
    warm = rng.normal(0, 1.0, N)
    for k in range(K):
        away = np.zeros(N)
        away[cell - 1] = leak_A if t[k] >= drive + 3600 * at_h else 0.0
        q = q - (current[k] + away) * dt / 3600.0 / capacity
        for i, (R, tau) in enumerate(pairs):
            x[i] = R * current[k] + (x[i] - R * current[k]) * np.exp(-dt / tau)
        cools = 2e-4 * warm * np.exp(-max(0.0, t[k] - drive) / 5400.0)
        V[k] = curve(q) - x[0] - x[1] - R_E * current[k] + cools + rng.normal(0, 4e-4, N)
    return Night(t, np.round(V / step) * step, current)
