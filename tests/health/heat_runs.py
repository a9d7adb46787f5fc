"""Alerts of the benchmark's cases, and a heat filter of one cell with its steps."""

import numpy as np

from bms_gateway.health.heat.filter import HeatFilter, Step
from bms_gateway.thermal import Prior, StringModel
from tests.benchmarks.bench_heat import follow
from tests.benchmarks.heat_case import Case, make, with_seeds

ONE = {"C_c": 42.0, "C_s": 3.0, "R_e": 0.035, "R_c": 2.0, "R_u": 15.0}


def raised(case: Case, seeds: range) -> list[list[tuple[int, str, int | None]]]:
    return [x.alerts for x in follow(make(with_seeds(case, seeds)))]


def alone() -> HeatFilter:
    return HeatFilter([StringModel(1, (1,), "single", {k: Prior(x) for k, x in ONE.items()})], 10.0, 1)


def measured(y: float, heat: float = 0.0) -> Step:
    one, cell = np.ones(1), np.ones((1, 1))
    at_end = np.array([[[0.0, 0.0, 1.0]]])
    return Step(heat * cell[None], 0.0 * one, 25.0 * one, 25.0 * one, y * cell, 1e-4 * cell, at_end)
