"""One record of one cell, to be fitted."""

import numpy as np

from bms_gateway.identify.coordinates import Measured
from bms_gateway.thermal import Prior, StringModel
from bms_gateway.thermal.drive import Drive, Span
from tests.truth.cycle import repeated
from tests.truth.string import C_F, TABLE_1, TruthString, rk4, wavy_inlet

SECONDS = 2400


SD = {"C_c": 0.05, "C_s": 0.05, "R_e": 0.6, "R_c": 0.6, "R_u": 0.6, "R_cc": 0.4, "C_f": 0.05}


def record(cells=1, *, seed=0, noise=0.1, B=0.0, step=0.0):
    """Readings of a pack drawn within its priors, and the logarithms by which it departs from them."""
    rng = np.random.default_rng([seed, 7])
    off = {k: rng.normal() * min(sd, 0.15) for k, sd in SD.items() if cells > 1 or k not in ("R_cc", "C_f")}
    values = {k: x * np.exp(off[k]) for k, x in (TABLE_1 | {"R_cc": 4.0, "C_f": C_F}).items() if k in off}
    current, inlet = repeated(SECONDS / 60, seed), wavy_inlet(SECONDS)
    core, surface = rk4(TruthString.of(cells, B=B, **values), current, inlet, 24.0)
    y = surface + noise * rng.normal(size=surface.shape)
    y = step * np.round(y / step) if step else y
    one, none = np.ones(SECONDS), np.full(SECONDS, np.nan)
    drive = Drive(
        dt=1.0, I=current, I2=current**2, I_abs=np.abs(current), T_in=(inlet[1:] + inlet[:-1]) / 2, flow=one,
        soc=0.5 * one, V=none, IV=none, hours=np.arange(SECONDS) / 3600, known=frozenset(),
    )  # fmt: skip
    row = np.minimum(np.arange(SECONDS + 1), SECONDS - 1)
    share = np.arange(SECONDS + 1) - row
    m = Measured(
        drive, (Span(0, SECONDS),), tuple(("surface", k + 1) for k in range(cells)),
        np.repeat(np.arange(cells), SECONDS + 1), np.tile(row, cells), np.tile(share, cells).astype(float),
        y.T.ravel(), np.ones(cells * (SECONDS + 1), bool), np.full(cells, noise), np.full(cells, step),
        (np.full(cells, 24.0),), (np.full(cells, 0.02),),
    )  # fmt: skip
    return m, off, core


def model(cells=1, *effects):
    priors = {k: Prior(v, SD[k]) for k, v in TABLE_1.items()}
    if cells > 1:
        priors |= {"R_cc": Prior(4.0, SD["R_cc"]), "C_f": Prior(C_F, SD["C_f"])}
    sensors = tuple(range(1, cells + 1))
    tolerances = {"cell_R_e": 0.0, "cell_R_u": 0.0, "cell_R_c": 0.0, "surface_offset_K": 0.0, "inlet_offset_K": 0.0}
    return StringModel(
        cells, sensors, "full" if cells > 1 else "single", priors, tolerances=tolerances, effects=effects
    )
