"""A string, states and inputs on which to try effects; nothing here is computed by the code under test."""

import numpy as np

from bms_gateway.thermal import AddedEffect, Prior, StringModel
from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects import effect_named

VALUES = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79, "R_cc": 4.0, "C_f": 11.33}


def model(cells, *effects, coolant="bulk", C_f=VALUES["C_f"]):
    """Table 1's cell, `cells` of them along a stream, with effects (name, cell, values)."""
    single = cells == 1
    return StringModel(
        cells=cells,
        sensors=tuple(range(1, cells + 1)),
        condition="single" if single else "full",
        priors={k: Prior(v) for k, v in (VALUES | {"C_f": C_f}).items() if not (single and k in ("R_cc", "C_f"))},
        coolant=coolant,
        effects=tuple(AddedEffect(name, cell, values) for name, cell, values in effects),
    )


def values(name, *, by="neutral", **given):
    """Numbers of an effect at their neutral value (the prior's centre where there is none), lower or upper bound."""
    out = {}
    for p in effect_named(name).parameters:
        out[p.name] = {
            "neutral": p.prior if p.neutral is None else p.neutral,
            "probe": p.probe,
            "lower": p.lower,
            "upper": p.upper,
        }[by]
    return out | given


def place(name):
    """A cell for an effect that sits on one; a leak needs two cells after it."""
    return {"string": None, "gap": 1}.get(effect_named(name).place, 2)


def drive(N=100, seed=0, dt=1.0, **given):
    """Intervals that see both directions, with everything recorded."""
    rng = np.random.default_rng(seed)
    amps = np.where(rng.random(N) < 0.2, 0.0, rng.uniform(-100, 150, N))
    ripple = rng.uniform(0, 20, N)
    V = rng.uniform(2.8, 3.6, N)
    V[rng.random(N) < 0.1] = np.nan
    u = {
        "I": amps,
        "I2": amps * amps + ripple**2,
        "I_abs": np.maximum(np.abs(amps), rng.uniform(0, 1, N) * ripple),
        "T_in": rng.uniform(15, 30, N),
        "flow": rng.uniform(0.5, 1.6, N),
        "soc": rng.uniform(0.0, 1.0, N),
        "V": V,
        "IV": amps * V,
        "hours": (np.arange(N) + 0.5) * dt / 3600,
    } | given
    return Drive(dt, **u, known=frozenset({"flow", "soc", "voltage"}))


def states(N, cells, extra=0, seed=1, low=-5.0, high=70.0):
    """Temperatures (N, D) without any order."""
    return np.random.default_rng(seed).uniform(low, high, (N, 2 * cells + extra * cells))
