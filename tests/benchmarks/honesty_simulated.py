"""Simulated strings and cells by the independent truth as cases: one effect missing, none of a catalogue, or nothing.

An hour of a drive cycle; parameters within 15 % of the data sheet, cells unlike by 2 to 3 %; surfaces with 0.05 K of
noise in steps of 0.1 K, of a string its first, middle and last.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from tests.benchmarks.honesty_case import model_text
from tests.config.bench_cell import write_string
from tests.truth.drives import CYCLES, INLETS
from tests.truth.hidden import HiddenLog, Scenario, make_logs
from tests.truth.pack import CAPACITY_AH, NOMINAL, NOMINAL_FLOW
from tests.truth.sizes import SIZES, USUAL
from tests.truth.strange import OUTSIDE
from tests.truth.suites import NOT_WITH_ONE_CELL, suited

PRIORS = {
    "default": {"C_c": 0.05, "C_s": 0.05, "R_e": 0.3, "R_c": 0.3, "R_u": 0.3, "R_cc": 0.2, "C_f": 0.05},
    "wide": {"C_c": 0.05, "C_s": 0.05, "R_e": 0.6, "R_c": 0.6, "R_u": 0.6, "R_cc": 0.4, "C_f": 0.05},
}
"""Relative sd of what the model file says. `default` is that of the example in `deploy`."""
CELLS = (5, 8, 12)
NOTHING, NOTHING_SINGLE, FLOW = "nothing hidden", "nothing hidden, one cell", "flow +-40 %, not on the bus"
USUAL_STRING, USUAL_SINGLE = "usual effects together", "one cell, usual effects"
KINDS = (NOTHING, NOTHING_SINGLE, FLOW, "medium effect", "strong effect", "one cell, medium", "one cell, strong",
         "outside, medium", "outside, strong", USUAL_STRING, USUAL_SINGLE)  # fmt: skip
CONTROLS = (NOTHING, NOTHING_SINGLE)
LEAST_SHARE = 0.15
"""Of R_c spread over the shells: thinner rolls need steps that are too short for the truth's loop."""
CHUNK = 8
"""Logs that are made at once: those of one shape share a loop."""


@dataclass(frozen=True)
class Drive:
    """One scenario and what it is counted with."""

    kind: str
    scenario: Scenario

    @property
    def label(self) -> str:
        s = self.scenario
        hidden = "+".join(f"{name}:{size}" for name, (size, _) in s.effects.items())
        hidden = self.kind if self.kind in (USUAL_STRING, USUAL_SINGLE) else hidden
        hidden = hidden or ("unrecorded flow" if self.kind == FLOW else "nothing")
        voltage = "+V" if "voltage" in s.columns else ""
        return f"{hidden} n={s.cells} {s.cycle}{voltage} #{s.seed}"


def drives(seed: int) -> list[Drive]:
    """All cases of a seed, every one a pack and a drive of its own."""
    numbers = iter(range(seed * 10_000 + 7_000, seed * 10_000 + 8_000))

    def string(i: int) -> dict:
        n = CELLS[i % len(CELLS)]
        return {"cells": n, "sensors": (1, (n + 1) // 2, n), "noise": 0.05, "step": 0.1}

    def plain(i: int, **more) -> Scenario:
        own = {"cycle": list(CYCLES)[i % len(CYCLES)], "inlet": INLETS[(i + i // 6) % len(INLETS)]}
        return Scenario(**(own | {"seed": next(numbers), "noise": 0.05, "step": 0.1} | more))

    def hiding(name: str, size: str, **where) -> Scenario:
        s = suited({name: size}, where["cells"], next(numbers), reading=(0.05, 0.1))
        return replace(s, effects={name: (size, None)}, sensors=where["sensors"])  # in whatever cell the pack draws

    def usual(i: int, **where) -> Scenario:
        s = plain(i, **where)
        return replace(s, effects=usual_effects(s))

    found = [(NOTHING, plain(i, **string(i))) for i in range(12)]
    found += [(NOTHING_SINGLE, plain(i, cells=1, sensors=(1,))) for i in range(6)]
    found += [(FLOW, plain(i, **string(i), flow="steps", columns=("soc",))) for i in range(8)]
    single = {"cells": 1, "sensors": (1,)}
    for j, size in enumerate(("medium", "strong")):
        found += [(f"{size} effect", hiding(name, size, **string(i + j))) for i, name in enumerate(SIZES)]
        some = [name for name in SIZES if name not in NOT_WITH_ONE_CELL]
        found += [(f"one cell, {size}", hiding(name, size, **single)) for name in some]
        found += [
            (f"outside, {size}", plain(i + j, effects={name: (size, None)}, **string(i + j)))
            for i, name in enumerate(OUTSIDE)
        ]
    found += [(USUAL_STRING, usual(i, **string(i))) for i in range(12)]
    found += [(USUAL_SINGLE, usual(i, **single)) for i in range(6)]
    return [Drive(kind, scenario) for kind, scenario in found]


def usual_effects(s: Scenario) -> dict[str, tuple[float, None]]:
    """Every effect that each real pack has, all at once, of sizes about what is usual: a population, no worst case."""
    rng = s.rng("usual")
    one_cell = s.cells == 1
    drawn = {name: (sd * abs(rng.normal()), None) for name, sd in USUAL.items()}
    share = 1.0 / (1.0 + np.exp(rng.normal(1.0, 1.2)))  # of R_c within the roll: 0.27 in the middle, 0.03 to 0.8
    drawn["radial_gradient"] = (max(share, LEAST_SHARE) / SIZES["radial_gradient"][0].medium, None)
    return {k: v for k, v in drawn.items() if not (one_cell and k in NOT_WITH_ONE_CELL)}


def chosen(some: Sequence[Drive], limit: int | None, seed: int, names: Sequence[str] = ()) -> list[Drive]:
    """Those whose label or kind holds one of `names`; `limit` of them at most, of each kind its share, by the seed."""
    some = [d for d in some if not names or any(n in d.label or n in d.kind for n in names)]
    if limit is None or limit >= len(some):
        return list(some)
    ranked = []
    rng = np.random.default_rng([seed, 7])
    for kind in dict.fromkeys(d.kind for d in some):
        mine = [d for d in some if d.kind == kind]
        ranked += [((i + 0.5) / len(mine), mine[k]) for i, k in enumerate(rng.permutation(len(mine)).tolist())]
    kept = {id(d) for _, d in sorted(ranked, key=lambda r: r[0])[:limit]}
    return [d for d in some if id(d) in kept]


@dataclass(frozen=True)
class SimulatedDrive:
    """A log of the truth as a case; see `honesty_case.Case`."""

    drive: Drive
    log: HiddenLog

    @property
    def label(self) -> str:
        return self.drive.label

    @property
    def kind(self) -> str:
        return self.drive.kind

    @property
    def cells(self) -> int:
        return self.log.scenario.cells

    @property
    def has_voltage(self) -> bool:
        return "voltage" in self.log.scenario.columns

    @property
    def numbers(self) -> dict[str, float]:
        """The data sheet's numbers, SI."""
        return {k: v for k, v in NOMINAL.items() if self.cells > 1 or k not in ("R_cc", "C_f")}

    @cached_property
    def time_s(self) -> np.ndarray:
        return self.log.table["time_s"]

    @cached_property
    def core(self) -> np.ndarray:
        return self.log.core

    def write_table(self, folder: Path) -> Path:
        """Write what the product may see."""
        table = dict(self.log.table)
        if self.has_voltage:
            table["voltage_V"] = table["voltage_V"] * self.cells  # the bus has the string's
        return replace(self.log, table=table).write_csv(folder / f"{self.log.scenario.seed}.csv")

    def write_config(self, folder: Path, priors: str, method: str = "window") -> Path:
        """Write gateway and model files with the data sheet's numbers, known as well as `priors` says."""
        folder.mkdir(parents=True, exist_ok=True)
        s = self.log.scenario
        rel_sd = {k: v for k, v in PRIORS[priors].items() if k in self.numbers}
        model = model_text(self.numbers, rel_sd, CAPACITY_AH, cells=s.cells, sensors=s.sensors, flow_m3_s=NOMINAL_FLOW)
        return write_string(folder, model, sensors=s.sensors, also=s.columns, method=method)


def simulated(some: Sequence[Drive]) -> Iterator[SimulatedDrive]:
    """Make the logs, a few at a time."""
    for at in range(0, len(some), CHUNK):
        part = some[at : at + CHUNK]
        logs = make_logs([d.scenario for d in part])
        yield from (SimulatedDrive(d, log) for d, log in zip(part, logs, strict=True))
