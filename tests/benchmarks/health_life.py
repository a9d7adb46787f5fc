"""Lives of strings for the health benchmark: drives by the independent integrator, with all that a year brings."""

from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.health.window_fit import DriveWindow
from tests.truth.drives import make_drive
from tests.truth.pack import KELVIN, NOMINAL, T_REF, integrate, terms

CELLS, SENSORS = 3, (1, 3)
TICK_S = 4
"""Seconds of a tick: a quarter of the work, and readings are means of four."""
SOC_SLOPE = 0.08
"""R_e at empty over full, −0.5: a lithium-ion cell between 10 and 90 %."""
CYCLES = ("urban", "us06", "udds", "mixed")


@dataclass(frozen=True)
class Life:
    """What differs between the vehicles of the benchmark.

    growth : relative growth of R_e per drive. exponent : K. fault : (name, first drive, size).
    """

    seed: int
    growth: float = 0.0
    exponent: float = 2500.0
    fault: tuple[str, int, float] = ("", 0, 0.0)
    flow_known: bool = True


def weather(rng, k, per_year=400):
    """Mean inlet of drive k, °C: a season between 5 and 35, and a day that adds its own."""
    season = 20.0 - 13.0 * np.cos(2 * np.pi * (k + 40) / per_year)
    return float(np.clip(season + rng.normal(0.0, 5.0), 0.0, 40.0))


def drives_of(life, first, last):
    """(window, current once a second) of drives first…last − 1, in order."""
    for window, current, _ in heard_of(life, first, last):
        yield window, current


def heard_of(life, first, last):
    """(window, current once a second, resistance that heats, Ω) of each drive; all are one loop of the integrator.

    The resistance is that of the mean cell at the cores' own temperatures, as the heat that it makes weights them.
    """
    rng = [np.random.default_rng([life.seed, 31, k]) for k in range(first, last)]
    seconds = 1260
    logs, made, flows = [], [], []
    for k, r in enumerate(rng, start=first):
        d = make_drive(
            str(r.choice(CYCLES)),
            str(r.choice(["constant", "sine", "ramp", "steps"])),
            seed=int(r.integers(1 << 30)),
            seconds=seconds,
            mean_inlet=weather(r, k),
        )
        I = d.current * r.uniform(0.75, 1.25)  # noqa: E741
        flow = float(r.choice([0.6, 0.8, 1.0, 1.0, 1.2]))
        name, _, size = life.fault if k >= life.fault[1] else ("", 0, 0.0)
        cells = np.random.default_rng([life.seed, 5]).normal(0, 0.02, CELLS)
        t = terms(
            CELLS,
            I,
            d.inlet,
            np.full(seconds, flow),
            d.soc_0,
            coolant="ntu",
            R_e=NOMINAL["R_e"] * np.exp(cells) * (1.0 + life.growth * k),
            R_u=NOMINAL["R_u"] * flow**-0.5 * (1.0 + size if name == "cooling" else 1.0),
            C_c=NOMINAL["C_c"] * 1.04,
            R_c=NOMINAL["R_c"] * 0.95,
            start=float(d.inlet[0] + r.uniform(-1.0, 8.0)),
        )
        t.B = life.exponent
        t.R_e *= np.exp(SOC_SLOPE * (0.5 - t.soc))[:, None] * (1.0 + size if name == "joint" else 1.0)
        logs.append(t)
        made.append(replace(d, current=I))
        flows.append(flow)
    for k, (r, d, t, flow, trace) in enumerate(zip(rng, made, logs, flows, integrate(logs), strict=True), start=first):
        yield (*_measured(life, k, r, d, t, flow, trace), _resistance(t, trace))


def _resistance(t, trace):
    """Of the mean cell over the window, Ω, weighted by the current's square."""
    core = (trace.core[1:] + trace.core[:-1]) / 2 + KELVIN
    R = (t.R_e * np.exp(t.B * (1 / core - 1 / T_REF))).mean(axis=1)
    return float(np.average(R[:1200], weights=t.I2[:1200]))


def _measured(life, k, rng, d, t, flow, trace):
    """Readings as a bus brings them: noise, steps of 0.1 K, a second of age at most, and the fault's own."""
    K = 1200
    name, since, size = life.fault if k >= life.fault[1] else ("", 0, 0.0)
    sd = rng.uniform(0.05, 0.1)
    at = [c - 1 for c in SENSORS]
    late = rng.uniform(0.0, 1.0, (K, 2))
    y = np.full((K, CELLS), np.nan)
    age = np.zeros((K, CELLS))
    surface = trace.surface[1 : K + 1, at] * (1 - late) + trace.surface[:K, at] * late
    if name == "thermocouple":
        surface[:, 0] += size * min(1.0, (k - since) / 60.0)
    if name == "loose":
        surface[:, 0] += size * (surface[:, 0] - d.inlet[1 : K + 1])
    y[:, at] = np.round((surface + rng.normal(0, sd, (K, 2))) / 0.1) * 0.1
    age[:, at] = late
    inlet = np.round((d.inlet[: K + 1] + (size if name == "inlet" else 0.0) + rng.normal(0, 0.05, K + 1)) / 0.1) * 0.1
    I = d.current[:K] + rng.normal(0, 0.3, K)  # noqa: E741
    if name == "gain":
        I = I * (1.0 + size)  # noqa: E741
    if name == "clipped":
        I = np.clip(I, -size, size)  # noqa: E741
    if name == "stuck":
        I = np.full(K, size)  # noqa: E741
    square, y, age = ((I**2).reshape(-1, TICK_S).mean(axis=1), *(_ticks(x) for x in (y, age)))
    age = age + np.where(np.isnan(y), 0.0, (TICK_S - 1) / 2)
    known = flow if life.flow_known else float("nan")
    window = DriveWindow(square, inlet[::TICK_S], y, age, float(TICK_S), float(t.soc[:K].mean()), known)
    return window, I


def _ticks(x):
    """Means over ticks of readings once a second."""
    return x.reshape(-1, TICK_S, x.shape[1]).mean(axis=1)
