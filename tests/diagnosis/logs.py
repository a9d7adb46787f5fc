"""A small honest log: a drive with rests, an inlet that moves, surfaces that follow; nothing of the package in it."""

import numpy as np

from bms_gateway.thermal import Prior, StringModel

PRIORS = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79, "R_cc": 4.0, "C_f": 11.33}


def string_model(cells=3, sensors=(1, 3), *, capacity_Ah=8.0, flow=0.0095):
    priors = {name: Prior(value, 0.1) for name, value in PRIORS.items()}
    condition = "full" if cells > 1 else "single"
    return StringModel(cells, tuple(sensors), condition, priors, capacity_Ah=capacity_Ah, flow=flow)


def rows(seconds=3000, *, sensors=(1, 3), noise=0.05, seed=0, dt=1.0):
    """Columns by their names: rest, pulses of both signs at 60 A, an inlet in steps, flow and charge."""
    rng = np.random.default_rng([seed, 31])
    t = np.arange(0.0, seconds + dt / 2, dt)
    level = rng.choice([-60.0, 0.0, 20.0, 60.0], seconds // 20 + 2)
    amps = np.where(t < 120, 0.0, level[(t // 20).astype(int)])
    inlet = 22 + 4.0 * ((t // 700) % 2)
    warm = np.zeros(len(t))
    for k in range(1, len(t)):
        warm[k] = warm[k - 1] + dt * (3.5e-3 * amps[k - 1] ** 2 - warm[k - 1] / 0.79) / 290
    surface = {k: 22 + warm * (1 + 0.1 * k) + 0.7 * (inlet - 22) * (t > 700) for k in sensors}
    return {
        "time_s": t,
        "current_A": amps,
        "coolant_inlet_C": inlet + 0.02 * rng.standard_normal(len(t)),
        "soc": 0.7 - np.concatenate([[0.0], np.cumsum(amps[:-1])]) * dt / 3600 / 8.0,
        "coolant_flow_m3_s": np.full(len(t), 0.0095),
        "voltage_V": 3 * (3.3 - 3.5e-3 * amps) + 1e-3 * rng.standard_normal(len(t)),
        "surface_C": {k: x + noise * rng.standard_normal(len(t)) for k, x in surface.items()},
    }
