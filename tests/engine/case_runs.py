"""Cases of the benchmark of heat, through the estimators."""

import numpy as np

from bms_gateway.engine.estimators import Estimators
from bms_gateway.engine.plan import Plan, StringPlan
from bms_gateway.engine.readings import Layout, Readings
from bms_gateway.frames.quality import Quality
from tests.benchmarks.heat_case import CELLS, SENSORS, Case, make, model
from tests.support.engine_parts import slow, wire

SECOND = 1_000_000_000


def readings(made, k, y, quality):
    """Inputs of a tick."""
    nan, i = np.full(1, np.nan), made.current[k : k + 1 or None]
    means, good = np.array([i, i**2, nan, nan, np.abs(i)]), np.full(1, np.uint8(Quality.GOOD))
    inlet, parts = made.inlet[k : k + 1 or None], Layout.of(["string_1"], [CELLS]).parts
    return Readings(means, good, slow(inlet, nan, nan), y, np.zeros(CELLS), quality, parts)


def through(case: Case):
    """Estimators, their events, and the truth."""
    made = make([case])[0]
    plan = Plan((StringPlan("string_1", 1, model(case.pack), (), "off"),))
    estimators = Estimators(plan, [wire({"current": 0, "coolant_inlet": 1}, CELLS)])
    quality = np.where(np.isin(np.arange(1, CELLS + 1), SENSORS), Quality.GOOD, Quality.NEVER).astype(np.uint8)
    events = []
    for k in range(case.seconds):
        events += estimators.step(readings(made, k, made.y[k], quality), (k + 1) * SECOND).events
    return estimators, events, made
