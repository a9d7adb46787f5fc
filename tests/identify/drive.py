"""Truth turned into ticks, and an identifier driven through them."""

import numpy as np

from bms_gateway.identify import Tick
from bms_gateway.thermal import Prior, StringModel
from tests.truth.cycle import repeated
from tests.truth.string import C_F, TABLE_1, TruthString, rk4, wavy_inlet

START = {"R_e": 10e-3, "R_c": 0.5, "R_u": 1.5}
"""Far off Table 1: ×2.9, ×0.4, ×1.9."""
REL_SD = {"C_c": 0.05, "C_s": 0.05, "R_e": 1.0, "R_c": 0.8, "R_u": 0.8, "R_cc": 0.4, "C_f": 0.05}


def model(cells=1, sensors=(1,), **medians):
    """Table 1 with the resistances' medians far off and wide priors."""
    values = {**TABLE_1, **START, "R_cc": 4.0, "C_f": C_F, **medians}
    names = list(values) if cells > 1 else list(TABLE_1)
    return StringModel(
        cells, sensors, "full" if cells > 1 else "single", {s: Prior(values[s], REL_SD[s]) for s in names}
    )


def ticks(square, inlet, surface, heat=None, age=None, dt=1.0):
    """One tick per instant; mean I² (K,) and heat (K,) belong to the step that ends there."""
    n = surface.shape[1]
    for k in range(len(surface)):
        yield Tick(
            int(k * dt * 1e9),
            dt,
            float(square[k - 1]) if k else 0.0,
            float(heat[k - 1]) if k and heat is not None else np.nan,
            float(inlet[k]),
            surface[k],
            np.zeros(n) if age is None else age[k],
        )


def drive(identifier, stream):
    """Feed all ticks, jobs run at once; returns the estimates after each accepted job."""
    seen = []
    for tick in stream:
        job = identifier.add(tick)
        if job is not None:
            identifier.accept(job.run())
            seen.append({e.name: e for e in identifier.estimates()})
    return seen


def measured(seed, *, cells=1, sensors=(1,), minutes=91, noise=0.1, amplitude=3.0, start=28.0, **truth):
    """(mean I², inlet, noisy surfaces with NaN where no sensor, core) of Table 1 cells on the drive cycle."""
    rng = np.random.default_rng([seed, 5])
    if cells > 1:
        truth = {"R_cc": 4.0, "C_f": C_F, **truth}
    current = repeated(minutes, seed)
    inlet = wavy_inlet(minutes * 60, amplitude=amplitude, phase=float(seed))
    core, surface = rk4(TruthString.of(cells, **truth), current, inlet, start, substeps=1)
    y = surface + rng.normal(0, noise, surface.shape) if noise else surface.copy()
    y[:, [k for k in range(cells) if k + 1 not in sensors]] = np.nan
    return current**2, inlet, y, core
