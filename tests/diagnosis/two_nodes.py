"""A small cell of two nodes whose current steps between the rows of its log."""

import numpy as np

from bms_gateway.config.model_file import parse_model
from bms_gateway.diagnosis.record import make_record
from bms_gateway.diagnosis.record_inputs import Columns

SMALL_CELL = """cells = 1
sensors = [1]
condition = "single"
effects = []
[parameters]
C_c = { value = 60.0, unit = "J/K", rel_sd = 0.05 }
C_s = { value = 5.0, unit = "J/K", rel_sd = 0.05 }
R_e = { value = 25.0, unit = "mOhm", rel_sd = 0.3 }
R_c = { value = 1.2, unit = "K/W", rel_sd = 0.3 }
R_u = { value = 7.0, unit = "K/W", rel_sd = 0.3 }
"""


def two_nodes(seed, *, noise=0.05, on_the_row=False, R_s=0.0, bleed_W=0.0):
    """Record and model of a cell of two nodes, 1,800 rows a second apart: its current steps at any instant.

    `bleed_W` heats its casing at times, whatever the current does.
    """
    rng = np.random.default_rng(seed)
    per_s = 20
    current, k = np.zeros(1800 * per_s), 0
    while k < len(current):
        long = int(rng.exponential(25.0) * per_s) + 1
        if on_the_row:
            long = max(round(long / per_s), 1) * per_s
        current[k : k + long] = 5.0 * rng.choice([0, 0, 1, 2, 4, -1, -2])
        k += long
    heat, k, other = np.zeros(len(current)), 0, np.random.default_rng(seed + 1000)
    for at in range(40):
        long = int(other.uniform(150.0, 450.0) * per_s)
        heat[k : k + long] = bleed_W * (at % 2)
        k += long
    t = np.arange(len(current)) / per_s
    air = 25.0 + 4.0 * np.sin(2.0 * np.pi * t / 700.0)
    core, surface, seen = 25.0, 25.0, np.empty(len(t))
    for i, (amps, around) in enumerate(zip(current.tolist(), air.tolist(), strict=True)):
        seen[i] = surface
        inwards = (core - surface) / 1.3
        core += (amps**2 * 0.022 - inwards) / 62.0 / per_s
        surface += (inwards + amps**2 * R_s + heat[i] - (surface - around) / 6.0) / 5.2 / per_s
    y = seen[::per_s] + rng.normal(0.0, noise, 1800)
    model = parse_model(SMALL_CELL)
    rows = Columns(
        time_s=t[::per_s], current_A=current[::per_s], coolant_inlet_C=air[::per_s], surface_C={1: y}, source="small"
    )
    return make_record(rows, model), model
