"""Strings with a fault that heats, or that looks like it, and strings with none: independent truth, many at a time.

The truth is `tests.truth.pack`: another right-hand side and another integrator than the package's, with cells, cooling
and resistance that the model knows only within what a data sheet says. Twelve cells, thermocouples on 2, 6 and 10.
"""

from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.thermal import Prior, StringModel
from tests.truth.drives import udds, urban, us06
from tests.truth.hidden import open_circuit
from tests.truth.pack import CAPACITY_AH, integrate, terms

CELLS, SENSORS = 12, (2, 6, 10)
RAMP_S = 120.0
PACKS = {
    "liquid": {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.8, "R_cc": 4.0, "C_f": 60.0},
    "forced": {"C_c": 307.0, "C_s": 16.0, "R_e": 5.3e-3, "R_c": 1.4, "R_u": 1.6, "R_cc": 15.0, "C_f": 12.0},
    "small": {"C_c": 42.0, "C_s": 3.0, "R_e": 35e-3, "R_c": 2.0, "R_u": 15.0, "R_cc": 10.0, "C_f": 1e6},
}
LAYOUTS = {
    "one cell": (1, (1,), 1),
    "one sensor": (12, (6,), 6),
    "two sensors": (12, (2, 10), 2),
    "three sensors": (CELLS, SENSORS, 6),
}
"""Cells of a string, which have a thermocouple, and which of these is at fault."""
AMPS = {"liquid": 1.0, "forced": 0.8, "small": 0.065}
"""Current over that of the drive cycles, whose 62 A rms belong to a cell of 8 Ah."""


@dataclass(frozen=True)
class Case:
    """One string's hour or so.

    Attributes
    ----------
    pack : str
        Of `PACKS`.
    seed : int
    seconds : int
    drive : str
        "urban", "us06", "udds", or "rest".
    fault : str
        "" for none, "heat", "fan", "pump", "frozen" (the inlet), "held" (a thermocouple that freezes), "off", "loose",
        "drift", "jump", "scale", "stuck"; "flow", a step that is no fault and not recorded.
    cell : int
        1-based, of heat or of a thermocouple.
    size : float
        W of heat; K/h of drift; K of a jump; share of a scale; factor on the flow; factor on R_u of a fan (0: 3, a fan
        that stops).
    at : int
        s, when it begins.
    lasts : int
        s; 0 for ever. Of heat, and of a thermocouple that is held.
    step : float
        K, of the readings.
    hard : bool
        Normal life at its hardest: unrecorded flow steps, ambient, cold start, R_e(T).
    cells, sensors : int, tuple of int
        How many, and which have a thermocouple.
    volts : bool
        The voltage of the pack is on the bus.
    also : tuple of (int, float)
        Further cells with the same fault, "heat", "loose" or "off", since the same time, and its size in each.
    ramp : float
        K by which the coolant warms in the minutes (`RAMP_S`) from `ramp_at` on; it stays there.
    stands : tuple of int, int
        First and last second of a time in which no current flows.
    """

    pack: str
    seed: int
    seconds: int = 5400
    drive: str = "urban"
    fault: str = ""
    cell: int = 6
    size: float = 0.0
    at: int = 3600
    lasts: int = 0
    step: float = 0.1
    noise: float = 0.05
    hard: bool = True
    cells: int = CELLS
    sensors: tuple[int, ...] = SENSORS
    volts: bool = False
    also: tuple[tuple[int, float], ...] = ()
    ramp: float = 0.0
    ramp_at: int = 3600
    stands: tuple[int, int] = (0, 0)


@dataclass(frozen=True)
class Made:
    """What the gateway sees of it, and the truth: current, inlet, voltage (K,), y, core, surface (K, n).

    The voltage is that of a mean cell, V; NaN where it is not on the bus.
    """

    case: Case
    current: np.ndarray
    inlet: np.ndarray
    y: np.ndarray
    core: np.ndarray
    surface: np.ndarray
    voltage: np.ndarray


def model(pack: str, cells: int = CELLS, sensors: tuple[int, ...] = SENSORS) -> StringModel:
    """What the gateway is told of it."""
    p = PACKS[pack] if cells > 1 else {k: v for k, v in PACKS[pack].items() if k not in ("R_cc", "C_f")}
    condition = "single" if cells == 1 else "natural" if pack == "small" else "full"
    sd = {"C_c": 0.05, "C_s": 0.1, "R_e": 0.1, "R_c": 0.15, "R_u": 0.15, "R_cc": 0.3, "C_f": 0.1}
    names = [k for k in p if not (k == "C_f" and condition == "natural")]
    return StringModel(cells, sensors, condition, {k: Prior(p[k], sd[k]) for k in names})


def _terms(c: Case, rng: np.random.Generator):
    p, K = PACKS[c.pack], c.seconds
    n = c.cells
    draw = {
        k: p[k] * np.exp(rng.normal(0, s))
        for k, s in {"R_e": 0.07, "R_c": 0.07, "R_u": 0.1, "C_c": 0.03, "C_s": 0.05, "R_cc": 0.15}.items()
    }
    for k, s in {"R_e": 0.025, "R_u": 0.025, "R_c": 0.03}.items():
        draw[k] = draw[k] * np.exp(rng.normal(0, s, n))
    draw["C_f"] = p["C_f"]
    current = np.zeros(K)
    if c.drive != "rest":
        current = {"urban": urban, "us06": us06, "udds": udds}[c.drive](rng, K)[:K] * AMPS[c.pack]
        current = current * rng.uniform(0.7, 1.1)
        if rng.random() < 0.5:  # a stop on the way
            a = int(rng.integers(0, K))
            current[a : a + int(rng.integers(120, 1500))] = 0.0
    current[slice(*c.stands)] = 0.0
    t = np.arange(K + 1)
    air = 25.0 + np.zeros(K + 1)
    if c.hard:
        air = air + 5.0 * np.sin(2 * np.pi * t / rng.uniform(5400, 20000) + rng.uniform(0, 6))
    air = air + c.ramp * np.clip((t - c.ramp_at) / RAMP_S, 0.0, 1.0)
    start = air[0] + (rng.choice([0.0, 0.0, -8.0]) if c.hard else 0.0)
    x = terms(n, current, air, np.ones(K), 0.6, start=start, **draw)
    x.soc = np.clip(x.soc, 0.1, 0.95)
    if c.hard:
        x.B = float(rng.uniform(1000, 2500))
        film = np.ones(K)
        for _ in range(int(rng.integers(0, 4))):
            film[int(rng.integers(0, K)) :] *= float(np.exp(rng.uniform(-0.18, 0.18)))
        film = np.clip(film, 0.75, 1.35)
        x.R_u = x.R_u * film[:, None]
    _break(x, c)
    return x, current, air


def _break(x, c: Case) -> None:
    """Let the fault begin that is one of the pack."""
    if c.fault == "heat":
        for cell, watts in ((c.cell, c.size), *c.also):
            x.core_heat[c.at : c.at + c.lasts if c.lasts else None, cell - 1] += watts
    elif c.fault == "fan":
        x.R_u[c.at :] *= c.size or 3.0
    elif c.fault == "pump":
        x.R_u[c.at :] *= 5.0**0.63
        x.C_f[c.at :] /= 5.0
    elif c.fault == "flow":
        x.C_f[c.at :] *= c.size
        x.R_u[c.at :] *= c.size**-0.4
    elif c.fault in ("scale", "stuck"):
        real = x.I.copy()
        real[c.at :] *= c.size
        x.I, x.I2, x.I_abs, x.rows = real, real**2, np.abs(real), real


def make(cases: list[Case]) -> list[Made]:
    """Make strings of equal length, as many as there are in one loop."""
    rngs = [np.random.default_rng([c.seed, sum(map(ord, c.pack + c.drive))]) for c in cases]
    parts = [_terms(c, rng) for c, rng in zip(cases, rngs, strict=True)]
    traces = integrate([p[0] for p in parts])
    return [_read(c, rng, *p, tr) for c, rng, p, tr in zip(cases, rngs, parts, traces, strict=True)]


def _voltage(c: Case, x, tr) -> np.ndarray:
    """Voltage of a mean cell (K,), by the current that flows, in steps of 2 mV."""
    if not c.volts:
        return np.full(c.seconds, np.nan)
    rng = np.random.default_rng([c.seed, 0x56])
    moved = np.cumsum(x.I) / 3600.0 / (CAPACITY_AH * AMPS[c.pack])
    soc = np.clip(rng.uniform(0.5, 0.8) - moved, 0.05, 0.97)
    lagged, polarised, kept = 0.0, np.empty(c.seconds), np.exp(-1.0 / 40.0)
    for k, amps in enumerate(x.I):
        lagged = kept * lagged + (1.0 - kept) * amps
        polarised[k] = lagged
    slow = 0.25 * x.R_e[:, 0] * polarised  # diffusion, which builds up in 40 s; its heat is not in the truth
    V = open_circuit(soc, c.seed % 2 == 0) - tr.overpotential - slow + 0.002 * rng.normal(size=c.seconds)
    return np.round(V / 0.002) * 0.002


def _misread(c: Case, surface: np.ndarray, coolant: np.ndarray) -> np.ndarray:
    """What the thermocouples feel (K, n): the surfaces, but for a fault of one or several of them."""
    K = c.seconds
    y = surface.copy()
    k, after = c.cell - 1, np.arange(K) >= c.at
    hours = np.maximum(np.arange(K) - c.at, 0) / 3600.0
    if c.fault == "off":  # follows in 90 s
        a, here = np.exp(-1 / 90.0), [k, *(cell - 1 for cell, _ in c.also)]
        for i in range(c.at, K):
            y[i, here] = a * y[i - 1, here] + (1 - a) * y[i, here]
    elif c.fault == "loose":
        for cell, share in ((c.cell, c.size), *c.also):
            y[:, cell - 1] += after * share * (coolant[:, cell - 1] - surface[:, cell - 1])
    elif c.fault == "drift":
        y[:, k] += c.size * hours
    elif c.fault == "jump":
        y[:, k] += after * c.size
    return y


def _read(c: Case, rng: np.random.Generator, x, current: np.ndarray, air: np.ndarray, tr) -> Made:
    K, n = c.seconds, c.cells
    surface, coolant, core = tr.surface[1:].copy(), tr.coolant[1:], tr.core[1:]
    offset = rng.normal(0, 0.2, n) + np.cumsum(rng.normal(0, 0.1 / 60.0, (K, n)), axis=0)
    inlet = air[1:] + rng.normal(0, 0.3)
    if c.hard:  # what meets the cells is not what the sensor reads
        inlet = inlet + rng.normal(0, 0.4) * np.sin(2 * np.pi * np.arange(K) / rng.uniform(2000, 6000))
    y, k = _misread(c, surface, coolant), c.cell - 1
    y = y + offset + rng.normal(0, c.noise, (K, n))
    inlet = inlet + rng.normal(0, 0.03, K)
    if c.fault == "frozen":
        inlet[c.at :] = inlet[c.at]
    if c.fault == "stuck":
        current = current.copy()
        current[c.at :] = 150.0 * AMPS[c.pack]
    y = np.round(y / c.step) * c.step if c.step else y
    if c.fault == "held":
        y[c.at : c.at + c.lasts if c.lasts else None, k] = y[c.at - 1, k]
    inlet = np.round(inlet / 0.01) * 0.01
    sensed = np.isin(np.arange(n), np.array(c.sensors) - 1)
    return Made(c, current, inlet, np.where(sensed, y, np.nan), core, tr.surface[1:], _voltage(c, x, tr))


def with_seeds(case: Case, seeds) -> list[Case]:
    return [replace(case, seed=s) for s in seeds]
