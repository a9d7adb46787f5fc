"""Lists of scenarios for benchmarks, by a seed base: every scenario of a list is a pack and a drive of its own.

Bases from `hidden.FINAL_SEED` on are for the final benchmark and never used while anything is tuned.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from tests.truth.drives import CYCLES, FLOWS, INLETS
from tests.truth.hidden import ABSORBED, Scenario
from tests.truth.sizes import AFTER_A_CELL, ANY, LEAST_CELLS, NEEDS, ON_A_CELL, ON_A_SENSOR, SIZES
from tests.truth.strange import UNKNOWN

SENSORS = {1: (1,), 2: (1, 2), 3: (1, 3), 5: (1, 3, 5), 8: (1, 3, 6, 8), 12: (1, 4, 7, 10, 12)}
"""Measured cells by the number of cells: both ends and some between."""
READING = ((0.05, 0.0), (0.05, 0.1), (0.1, 0.0), (0.1, 0.1), (0.1, 0.25), (0.2, 0.1), (0.2, 0.5), (0.3, 0.1))
"""Noise and step, K, that the suites with hidden effects choose from."""
NOT_WITH_ONE_CELL = (*(name for name, cells in LEAST_CELLS.items() if cells > 1), "neighbour_heat", "inlet_offset")
"""With one sensor the last two are an offset of the thermocouple."""

LATER = ("core_loss",)
"""Effects that came to the catalogue after its packs were numbered."""

PAIRS = (
    ("entropic_heat", "resistance_temperature"),
    ("resistance_temperature", "ambient_loss"),
    ("resistance_temperature", "coolant_delay"),
    ("resistance_temperature", "cell_cooling"),
    ("resistance_temperature", "thermocouple_offset"),
    ("entropic_heat", "surface_joule"),
    ("entropic_heat", "coolant_delay"),
    ("entropic_heat", "flow_dependent_cooling"),
    ("entropic_heat", "cell_resistance"),
    ("resistance_soc", "ambient_loss"),
    ("resistance_soc", "coolant_bypass"),
    ("resistance_asymmetry", "thermocouple_lag"),
    ("polarization", "ambient_loss"),
    ("polarization", "thermocouple_contact"),
    ("hysteresis", "end_plate"),
    ("radial_gradient", "ambient_loss"),
    ("resistance_drift", "coolant_delay"),
    ("cooling_drift", "cell_resistance"),
    ("flow_dependent_cooling", "busbar_joule"),
    ("flow_dependent_cooling", "neighbour_heat"),
    ("natural_convection", "cell_resistance"),
    ("surface_joule", "coolant_delay"),
    ("end_plate", "cell_cooling"),
    ("current_offset", "coolant_delay"),
)
"""Effects that act apart: what two that mimic each other do is a matter of ties, not of pairs."""


def suited(effects, cells, seed, *, reading=None, **more):
    """A scenario that gives all hidden effects what they need.

    effects : mapping of id to size. Effects on a cell sit on one that has a sensor.
    """
    rng = np.random.default_rng([seed, 41])
    needs = [NEEDS.get(name, ANY) for name in effects]

    def shared(of):
        sets = [getattr(n, of) for n in needs]
        common = [x for x in sets[0] if all(x in s for s in sets)]
        return common or [x for s in sets for x in s]

    cycle, inlet = str(rng.choice(shared("cycles"))), str(rng.choice(shared("inlets")))
    flow = "steps" if any(n.flows == ("steps",) for n in needs) else str(rng.choice(needs[0].flows))
    noise, step = reading or READING[int(rng.integers(len(READING)))]
    sensors = SENSORS[cells]
    located = {}
    for name, size in effects.items():
        cell = None
        if name in ON_A_CELL or name in ON_A_SENSOR:
            cell = int(rng.choice(sensors))
        elif name in AFTER_A_CELL:
            cell = int(rng.integers(1, cells - 2))  # at least two cells feel it
        located[name] = (size, cell)
    columns = tuple(dict.fromkeys(c for n in needs for c in n.columns))
    if "voltage" not in columns and rng.random() < 0.25:
        columns += ("voltage",)
    chosen = {"cycle": cycle, "inlet": inlet, "flow": flow, "columns": columns, "noise": noise, "step": step}
    return Scenario(**({"effects": located, "cells": cells, "sensors": sensors, "seed": seed} | chosen | more))


def _seeds(base, suite):
    """Numbers that no other suite and no other base uses."""
    return iter(range(base * 10_000 + suite * 1_000, base * 10_000 + (suite + 1) * 1_000))


def _by_age(names):
    """The names in two groups, so that the packs of an effect keep their numbers when another is added."""
    return [n for n in names if n not in LATER], [n for n in names if n in LATER]


def singles(seed, names: Iterable[str] = SIZES):
    """One effect each: all sizes with 5 cells, medium and strong with 8 and 12."""
    seeds, names = _seeds(seed, 0), list(names)
    return [
        suited({name: size}, cells, next(seeds))
        for some in _by_age(names)
        for cells, sizes in ((5, ("weak", "medium", "strong")), (8, ("medium", "strong")), (12, ("medium", "strong")))
        for size in sizes
        for name in some
    ]


def one_cell(seed):
    """One effect each in a single cell, all sizes."""
    seeds = _seeds(seed, 1)
    names = [name for name in SIZES if name not in NOT_WITH_ONE_CELL]
    return [
        suited({name: size}, 1, next(seeds))
        for some in _by_age(names)
        for size in ("weak", "medium", "strong")
        for name in some
    ]


def controls(seed):
    """Nothing hidden: all cycles, noises and steps, 1…12 cells, and what logs have: holes, jitter, still inlets."""
    seeds, out = _seeds(seed, 2), []
    columns = ((), ("flow",), ("flow", "soc"), ("flow", "soc", "voltage"), ("soc",))
    for i, (cycle, noise, step) in enumerate(
        (c, n, q) for c in CYCLES for n in (0.05, 0.1, 0.2, 0.3) for q in (0.0, 0.1, 0.25, 0.5)
    ):
        cells = (5, 5, 12, 1, 5, 8, 2, 3)[i % 8]
        flow = FLOWS[i % 3 == 1]
        have = columns[(i // 2) % 5]
        out.append(
            Scenario(
                cells=cells,
                sensors=SENSORS[cells],
                noise=noise,
                step=step,
                cycle=cycle,
                inlet=INLETS[(i + i // 16) % 4],
                flow=flow,
                columns=("flow", *have) if flow == "steps" and "flow" not in have else have,
                missing=0.1 if i % 3 == 0 else 0.0,
                jitter=0.3 if i % 4 == 1 else 0.0,
                seed=next(seeds),
            )
        )
    # The plainest and the hardest: nothing moves but the current, all faults of a log at once.
    for cycle in CYCLES:
        for more in (
            {"inlet": "constant", "columns": ()},
            {"inlet": "constant", "noise": 0.3, "step": 0.5, "missing": 0.1, "jitter": 0.3},
            {"inlet": "steps", "flow": "steps", "missing": 0.1, "jitter": 0.3, "columns": ("flow", "soc", "voltage")},
            {"inlet": "sine", "flow": "steps", "noise": 0.05, "cells": 12, "sensors": SENSORS[12]},
        ):
            out.append(replace(Scenario(cycle=cycle, seed=next(seeds)), **more))
    # What a vehicle's bus sends: whole kelvins.
    for cells in (1, 5, 12):
        for noise in (0.01, 0.05, 0.2):
            for inlet in ("constant", "steps"):
                out.append(
                    Scenario(cells=cells, sensors=SENSORS[cells], noise=noise, step=1.0, inlet=inlet, seed=next(seeds))
                )
    return out


def absorbed(seed):
    """What a free parameter takes up: a current gain, R_e or R_c of all cells."""
    seeds = _seeds(seed, 3)
    return [
        replace(suited({name: size}, cells, next(seeds)), columns=("flow", "soc"))
        for cells in (1, 5)
        for size in ("weak", "medium", "strong")
        for name in ABSORBED
    ]


def unknowns(seed):
    """Effects that are in no catalogue, medium and strong, in strings of 5 and 8."""
    seeds, out = _seeds(seed, 4), []
    for cells in (5, 8):
        for size in ("medium", "strong"):
            for name in UNKNOWN:
                number = next(seeds)
                rng = np.random.default_rng([number, 43])
                noise, step = READING[int(rng.integers(4))]
                out.append(
                    Scenario(
                        {name: (size, None)},
                        cells,
                        SENSORS[cells],
                        noise=noise,
                        step=step,
                        cycle=str(rng.choice(["urban", "us06", "mixed", "sweep"])),
                        inlet=str(rng.choice(["constant", "steps", "sine"])),
                        seed=number,
                    )
                )
    return out


def pairs(seed):
    """Two effects each, both medium, then one of them strong, in strings of 5."""
    seeds = _seeds(seed, 5)
    return [
        suited({a: one, b: two}, 5, next(seeds), reading=READING[i % 4])
        for one, two in (("medium", "medium"), ("strong", "medium"))
        for i, (a, b) in enumerate(PAIRS)
    ]


SUITES = {f.__name__: f for f in (singles, one_cell, controls, absorbed, unknowns, pairs)}
