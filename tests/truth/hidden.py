"""Logs with a hidden effect: a scenario says what is hidden in which pack, how it is driven and what is measured.

The parameters of each pack are drawn about the nominal ones of the model file within what that file declares, readings
get offset, noise and steps, and the truth is kept beside them: core and surface of every cell, and the numbers of what
is hidden. Everything follows from the scenario alone, in whatever company a log is made. Seeds from `FINAL_SEED` on
are for the final benchmark and never used while anything is tuned.

A row holds the current held from its stamp to the next one, the mean cell voltage over that time, and temperatures,
charge and flow at the stamp.
"""

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from zlib import crc32

import numpy as np

from tests.truth.drives import make_drive
from tests.truth.effects import CATALOGUE, SENSING, sense
from tests.truth.pack import CAPACITY_AH, NOMINAL, NOMINAL_FLOW, integrate, terms
from tests.truth.sizes import AFTER_A_CELL, LOCATED, ON_A_SENSOR, SIZES
from tests.truth.strange import OUTSIDE, STRANGE, STRANGE_SENSING

FINAL_SEED = 10000
ABSORBED = ("current_gain", "uniform_R_e", "uniform_R_c")
"""What a free parameter of the model absorbs: nothing is missing, and a product of parameters is what can be known."""
ABSORBED_SIZES = {"weak": 0.05, "medium": 0.12, "strong": 0.25}
BATCH = 48
"""Logs in one loop: more gains little and asks for memory."""


@dataclass(frozen=True)
class Scenario:
    """One log to be made.

    effects : mapping of id to (size, cell): size is weak, medium, strong or a multiple of medium; cell from 1 or None.
    sensors : measured surfaces, from 1. noise : K. step : K of the surface readings, 0 for none.
    seed : of the pack, its sensors and what is hidden. drive_seed : of the drive and the noise; the same where None.
    missing : share of readings left blank. jitter : share of a second by which stamps move.
    """

    effects: Mapping = field(default_factory=dict)
    cells: int = 5
    sensors: tuple = (1, 3, 5)
    noise: float = 0.1
    step: float = 0.0
    cycle: str = "urban"
    inlet: str = "steps"
    flow: str = "constant"
    seed: int = 0
    drive_seed: int | None = None
    columns: tuple = ("flow", "soc")
    seconds: int = 3600
    missing: float = 0.0
    jitter: float = 0.0
    coolant: str = "bulk"

    def rng(self, purpose, *, drive=False):
        """Chance for one purpose, independent of all others."""
        own = [self.seed, self.seed if self.drive_seed is None else self.drive_seed] if drive else [self.seed]
        return np.random.default_rng([*own, crc32(purpose.encode())])

    @property
    def name(self):
        hidden = "+".join(f"{k}:{s}" + (f"@{c}" if c else "") for k, (s, c) in self.effects.items()) or "nothing"
        return f"{hidden} n={self.cells} {self.cycle} {self.noise:g}K/{self.step:g}K seed={self.seed}"


@dataclass(frozen=True)
class HiddenLog:
    """A log and its truth.

    table : columns by name, (N,), NaN where blank. core, surface : (N, n) °C at the stamps.
    model : TOML of the nominal model. parameters : id to {name: (value as shown, unit)}; `cell` is in `cells`.
    pack : the drawn parameters of the pack without the hidden effect.
    """

    scenario: Scenario
    table: Mapping
    core: np.ndarray
    surface: np.ndarray
    model: str
    parameters: Mapping
    cells: Mapping
    pack: Mapping

    def write_csv(self, path):
        """The table as a file; blanks are missing values."""
        text = [[("" if np.isnan(x) else f"{x:.7g}") for x in column] for column in self.table.values()]
        with open(path, "w", newline="", encoding="utf-8") as f:
            out = csv.writer(f)
            out.writerow(self.table)
            out.writerows(zip(*text, strict=True))
        return path


def new_drive(scenario, *, drive_seed=None, **changes):
    """The same pack, sensors and hidden effect on another drive."""
    last = scenario.seed if scenario.drive_seed is None else scenario.drive_seed
    return replace(scenario, drive_seed=last + 500_000 if drive_seed is None else drive_seed, **changes)


def make_log(scenario):
    """One log."""
    return make_logs([scenario])[0]


def make_logs(scenarios):
    """Many logs, in the order asked for, the ones that share a shape through one loop over time."""
    made = [_Preparation(s) for s in scenarios]
    groups = {}
    for i, p in enumerate(made):
        groups.setdefault(p.terms.shape, []).append(i)
    logs = [None] * len(made)
    for members in groups.values():
        for at in range(0, len(members), BATCH):
            some = members[at : at + BATCH]
            for i, trace in zip(some, integrate([made[i].terms for i in some]), strict=True):
                logs[i] = made[i].log(trace)
                made[i] = None
    return logs


def pack_of(s):
    """Parameters of a scenario's pack, drawn within the declared tolerances; what is absorbed is in them."""
    rng, n = s.rng("pack"), s.cells

    def scatter(share):
        return 1 + share * np.clip(rng.normal(size=n), -2, 2) if n > 1 else np.ones(1)

    def known(share):
        return 1 + share * np.clip(rng.normal(), -2, 2)

    pack = {
        "R_e": NOMINAL["R_e"] * rng.uniform(0.85, 1.15) * scatter(0.02),
        "R_c": NOMINAL["R_c"] * rng.uniform(0.85, 1.15) * scatter(0.03),
        "R_u": NOMINAL["R_u"] * rng.uniform(0.85, 1.15) * scatter(0.02),
        "C_c": NOMINAL["C_c"] * known(0.02),
        "C_s": NOMINAL["C_s"] * known(0.02),
        "C_f": NOMINAL["C_f"] * known(0.02),
        "R_cc": NOMINAL["R_cc"] * rng.uniform(0.85, 1.15),
    }
    for name, parameter in (("uniform_R_e", "R_e"), ("uniform_R_c", "R_c")):
        if name in s.effects:
            pack[parameter] = pack[parameter] * (1 + _absorbed(s, name))
    return pack


def _absorbed(s, name):
    size = s.effects[name][0]
    value = ABSORBED_SIZES["medium"] * size if isinstance(size, int | float) else ABSORBED_SIZES[size]
    return value * s.rng(name).choice([-1, 1])


def draw(s, name, mean_inlet):
    """Parameters of a hidden effect for `effects.py`, and as shown: {name: (value, unit)}, and its cell."""
    rng = s.rng(name)
    size, cell = s.effects[name]
    sign = rng.choice([-1, 1])  # one for all of its parameters
    given, shown = {}, {}
    for p in SIZES[name]:
        value = p.at(size if p.weak != p.strong else "medium") * (sign if p.signed else 1)
        value += mean_inlet if p.name == "T_m" else 0.0
        given[p.name], shown[p.name] = value * p.factor, (value, p.unit)
    if name == "charge_transfer" and isinstance(size, int | float):
        I_0, E = (p.medium for p in SIZES[name])
        given |= {"I_0": I_0 / size, "E": E}
        shown |= {"I_0": (I_0 / size, "A"), "E": (E, "K")}
    if name == "entropic_heat" and rng.random() < 0.5:
        profile = given["dUdT"] * np.array([-0.6, 1.4, 0.8, -0.2])
        given["dUdT"], shown = profile, {"dUdT at 5, 35, 65, 95 %": (tuple(profile.tolist()), "mV/K")}
    if name == "voltage_heat":
        given |= {"periods": rng.uniform(350, 1800, 5), "phases": rng.uniform(0, 2 * np.pi, 5)}
    if name in LOCATED:
        if cell is None:
            cell = _some_cell(s, name, rng)
        given["cell"] = cell
    return given, shown, cell


def _some_cell(s, name, rng):
    if name in AFTER_A_CELL:
        return int(rng.integers(1, s.cells - 1))
    return int(rng.choice(s.sensors if name in ON_A_SENSOR else np.arange(1, s.cells + 1)))


class _Preparation:
    """A scenario up to the integration, and from there on."""

    def __init__(self, s):
        for name in s.effects:
            if name not in (*CATALOGUE, *SENSING, *OUTSIDE, *ABSORBED):
                raise ValueError(f"no effect {name!r} to hide")
        self.s, K = s, s.seconds
        mean = s.rng("inlet").uniform(17.0, 27.0)
        self.drive = make_drive(
            s.cycle,
            s.inlet,
            s.flow,
            seed=int(s.rng("drive", drive=True).integers(1 << 31)),
            seconds=K,
            mean_inlet=mean,
        )
        self.stamps = np.arange(K, dtype=float)
        if s.jitter:
            self.stamps[1:] += s.jitter * s.rng("jitter", drive=True).uniform(-1, 1, K - 1)
        self.pack = pack_of(s)
        self.terms = terms(
            s.cells,
            self.drive.current,
            self.drive.inlet,
            self.drive.flow,
            self.drive.soc_0,
            means=means_between(self.stamps, self.drive.current) if s.jitter else None,
            start=float(self.drive.inlet[0] + 0.3 * s.rng("start", drive=True).normal()),
            coolant=s.coolant,
            **self.pack,
        )
        self.parameters, self.cells, self.given = {}, {}, {}
        for name in s.effects:
            if name in SIZES:
                self.given[name], self.parameters[name], self.cells[name] = draw(s, name, mean)
        for name, effect in (CATALOGUE | STRANGE).items():
            if name in self.given:
                effect(self.terms, **self.given[name])
            elif name in s.effects:
                effect(self.terms, _multiple(s.effects[name][0]), s.rng(name, drive=True))

    def log(self, trace):
        """Read the trace as the logger does."""
        s, instants = self.s, np.arange(self.s.seconds + 1.0)
        y, inlet, current = self._without_noise(trace)

        def at(x):
            return np.stack([np.interp(self.stamps, instants, c) for c in x.reshape(len(x), -1).T], axis=1)

        noise = s.rng("noise", drive=True)
        offset = 0.03 * np.clip(s.rng("offsets").normal(size=s.cells + 1), -2, 2)

        def white(sigma, *more):
            return sigma * noise.normal(size=(s.seconds, *more))

        columns = {
            "time_s": self.stamps,
            "current_A": np.round(current + white(0.05), 1),
            "coolant_inlet_C": _steps(at(inlet)[:, 0] + offset[-1] + white(0.03), min(s.step, 0.1)),
        }
        read = _steps(at(y) + offset[:-1] + white(s.noise, s.cells), s.step)
        U = open_circuit(self.terms.soc, s.rng("chemistry").random() < 0.5)
        optional = {
            "voltage": ("voltage_V", np.round(U - trace.overpotential + white(0.001), 3)),
            "soc": ("soc", np.round(self.terms.soc, 3)),
            "flow": ("coolant_flow_m3_s", np.round(NOMINAL_FLOW * self.drive.flow * (1 + white(0.004)), 5)),
        }
        columns |= dict(column for name, column in optional.items() if name in s.columns)
        columns |= {f"surface_{k}_C": read[:, k - 1] for k in s.sensors}
        if s.missing:
            holes = s.rng("missing", drive=True)
            for x in list(columns.values())[2:]:
                x[holes.random(s.seconds) < s.missing] = np.nan
        return HiddenLog(
            s, columns, at(trace.core), at(trace.surface), model_text(s), self.parameters, self.cells, self.pack
        )

    def _without_noise(self, trace):
        """Readings at the instants, as wrong as hidden effects of the measurement make them."""
        s, d = self.s, self.drive
        sensing = {k: v for k, v in self.given.items() if k in SENSING}
        y, inlet, current = sense(trace.surface, trace.coolant, d.inlet, d.current, sensing)
        for name, effect in STRANGE_SENSING.items():
            if name in s.effects:
                y = effect(y, trace.coolant, s.sensors, _multiple(s.effects[name][0]), s.rng(name, drive=True))
        if "current_gain" in s.effects:
            current = current / (1 + _absorbed(s, "current_gain"))
        return y, inlet, current


def _multiple(size):
    return float(size) if isinstance(size, int | float) else {"weak": 0.33, "medium": 1.0, "strong": 2.5}[size]


def means_between(stamps, current):
    """Means per second of I, I², I² while charging and |I| of a current that changes at the stamps."""
    edges, K = np.append(stamps, len(stamps)), len(stamps)

    def mean(x):
        return np.diff(np.interp(np.arange(K + 1.0), edges, np.concatenate([[0.0], np.cumsum(x * np.diff(edges))])))

    return mean(current), mean(current**2), mean(np.minimum(current, 0) ** 2), mean(np.abs(current))


def _steps(x, q):
    return np.round(x / q) * q if q else x


def open_circuit(soc, phosphate):
    """Open-circuit voltage V of an iron-phosphate or a nickel-manganese-cobalt cell, smooth and rising."""
    if phosphate:
        return 3.29 + 0.045 * (soc - 0.5) - 0.35 * np.exp(-soc / 0.035) + 0.02 * np.tanh((soc - 0.68) / 0.04)
    return 3.45 + 0.62 * soc + 0.12 * soc**3 - 0.3 * np.exp(-soc / 0.05) + 0.015 * np.sin(9 * soc)


def model_text(s):
    """The nominal model with this scenario's sensors, as a model file."""
    several = s.cells > 1
    lines = [
        f"cells = {s.cells}",
        f"sensors = {list(s.sensors)}",
        f'condition = "{"full" if several else "single"}"',
        "effects = []",
        "",
        "[cell]",
        f"capacity_Ah = {CAPACITY_AH}",
        "",
        "[parameters]",
    ]
    rows = [("C_c", 1, "J/K", 0.05), ("C_s", 1, "J/K", 0.05), ("R_e", 1e3, "mOhm", 0.6), ("R_c", 1, "K/W", 0.6)]
    rows += [("R_u", 1, "K/W", 0.6)]
    if several:
        rows += [("R_cc", 1, "K/W", 0.4), ("C_f", 1, "W/K", 0.05)]
    for name, scale, unit, sd in rows:
        lines.append(f'{name} = {{ value = {NOMINAL[name] * scale:.6g}, unit = "{unit}", rel_sd = {sd} }}')
    lines.append(f'coolant_flow = {{ value = {NOMINAL_FLOW}, unit = "m3/s" }}')
    return "\n".join(lines) + "\n"
