"""Strings of a plan side by side, and their readings."""

from dataclasses import replace

import numpy as np

from bms_gateway.engine import Plan, StringPlan
from bms_gateway.engine.estimators import Estimators, TickResult
from bms_gateway.engine.readings import Layout, Readings
from bms_gateway.frames.quality import Quality
from bms_gateway.thermal import AddedEffect, Disturbance, Prior, StringModel
from tests.support.engine_parts import slow, wire

S = 1_000_000_000


START = 1_700_000_020 * S  # twenty seconds before a whole minute


VALUES = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79, "R_cc": 4.0, "C_f": 11.33}


FALLING = AddedEffect("resistance_temperature", None, {"B": 3000.0}, {"B": 300.0})


LATE = AddedEffect("coolant_delay", None, {"tau": 20.0}, {"tau": 4.0})


def string(number: int, cells: int, identify: str, flow: float | None, *effects: AddedEffect) -> StringPlan:
    priors = {k: Prior(v * (1.0 + 0.02 * number), 0.1) for k, v in VALUES.items()}
    if cells == 1:
        del priors["R_cc"], priors["C_f"]
    kind = "full" if cells > 1 else "single"
    capacity = 9.0 if number == 4 else None
    model = StringModel(cells, (1, cells) if cells > 1 else (1,), kind, priors, flow=flow, effects=effects)
    return StringPlan(f"string_{number}", number, replace(model, capacity_Ah=capacity), (), identify)


PLAN = Plan(
    (
        string(1, 4, "window", None),
        string(2, 3, "rls", 1e-4),
        string(3, 4, "off", 2e-4),
        string(4, 3, "window", 1e-4, FALLING),
        string(5, 3, "rls", None),
        string(6, 4, "rls", 1.5e-4),
        string(7, 2, "window", None, LATE),
    ),
    disturbance=Disturbance(heat_cell=0.3),
)


VOLTAGE = {"string_1", "string_2", "string_4", "string_5"}  # one of three in its group, all of the two in theirs


WIRES = [
    wire(
        {"current": 0, "voltage": 1 if s.name in VOLTAGE else -1, "coolant_inlet": 2, "coolant_flow": 3, "soc": 4},
        s.model.cells,
        surface=np.zeros(s.model.cells, int),
    )
    for s in PLAN.strings
]


LAYOUT = Layout.of([s.name for s in PLAN.strings], [s.model.cells for s in PLAN.strings])


N = sum(s.model.cells for s in PLAN.strings)


NO, NAN = Quality.NEVER, float("nan")


def readings(seed: int, count: int) -> list[Readings]:
    """Ticks on which anything may be missing, of strings that each have their own of everything."""
    rng = np.random.default_rng(seed)
    many, found = len(PLAN.strings), []
    sensed = np.concatenate([[k in (0, s.model.cells - 1) for k in range(s.model.cells)] for s in PLAN.strings])
    noise = np.repeat([2.5, 0.05, 2.5, 2.5, 0.05, 2.5, 0.05], [s.model.cells for s in PLAN.strings])
    for k in range(count):
        I = rng.uniform(-60, 100, many)  # noqa: E741
        V = np.array([s.model.cells for s in PLAN.strings]) * (3.3 - 4e-3 * I) + rng.normal(0, 1e-3, many)
        means = np.array([I, I * I + 25.0, V, I * V, np.abs(I) + 1.0])
        means[:, (rng.random(many) < 0.05) & (k > 5)] = NAN
        flow = np.where(rng.random(many) < 0.3, NAN, rng.uniform(0.5e-4, 2e-4, many))
        found.append(
            Readings(
                means,
                rng.choice(np.array([Quality.GOOD] * 5 + [Quality.STALE, NO], np.uint8), many)
                if k % 3
                else np.full(many, Quality.GOOD, np.uint8),
                slow(
                    np.where(rng.random(many) < 0.05, NAN, rng.uniform(20, 22, many)),
                    flow,
                    np.where(rng.random(many) < 0.5, NAN, rng.uniform(0.4, 0.6, many)),
                ),
                np.where(sensed & (rng.random(N) < 0.9) & (k > 1), 25 + 0.02 * k + rng.normal(0, noise), NAN),
                rng.uniform(0, 1, N),
                rng.choice(np.array([Quality.GOOD, Quality.ESTIMATED, Quality.STUCK, NO], np.uint8), N)
                if k % 5
                else np.full(N, Quality.GOOD, np.uint8),
                LAYOUT.parts,
            )
        )
    return found


def driven(estimators: Estimators, ticks: list[Readings], first: int = 1) -> list[TickResult]:
    return [estimators.step(r, START + k * S) for k, r in enumerate(ticks, first)]
