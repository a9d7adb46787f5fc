"""Errors of the priors of published and measured cells, in sd.

The measured values are found here, by a plain least-squares fit of two nodes to surface and core, by the decay of the
surface in rests, and by regression of the voltage: by none of the product's own code.
"""

import gzip
import math
from functools import cache

import numpy as np
from scipy.linalg import expm
from scipy.optimize import curve_fit, least_squares

from bms_gateway.thermal.cells import PUBLISHED, CellFacts, cell_of, stated_parameters
from tests.data import need

# Published: X. Lin et al. Table 1 (32157); Lin et al. 2014, J. Power Sources 257 (26650, two states); Richardson
# (26650: sum of the capacities, centre to surface, surface to air; 32113: half as much again as its mean to surface).
LITERATURE = [
    ("a123_32157", {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79}),
    ("a123_26650", {"C_c": 62.7, "C_s": 4.5, "R_c": 1.94, "R_u": 3.19}),
    ("a123_26650", {"C": 84.5, "R_c": 3.0, "R_u": 4.8}),
    ("a123_32113", {"R_c": 1.76}),
]


def log_sd(cell: CellFacts, symbol: str) -> tuple[float, float]:
    """Logarithm of the prior's median, and its sd; `C` is the sum of the capacities, `tau` what a rest shows."""
    p = stated_parameters(cell)
    if symbol in p:
        return math.log(p[symbol].value), p[symbol].rel_sd
    C = p["C_c"].value + p["C_s"].value
    sd_C = math.hypot(p["C_c"].value * p["C_c"].rel_sd, p["C_s"].value * p["C_s"].rel_sd) / C
    if symbol == "C":
        return math.log(C), sd_C
    R = p["R_u"].value + p["R_c"].value
    sd_R = math.hypot(p["R_u"].value * p["R_u"].rel_sd, p["R_c"].value * p["R_c"].rel_sd) / R
    return math.log(C * R), math.hypot(sd_C, sd_R)


def off(cell: CellFacts, found: dict[str, float]) -> dict[str, float]:
    """Errors in sd."""
    errors = {}
    for symbol, truth in found.items():
        middle, sd = log_sd(cell, symbol)
        errors[f"{cell.name} {symbol}"] = (math.log(truth) - middle) / sd
    return errors


def two_nodes(p, heat, air, start, dt):
    C_c, C_s, R_c, R_u = np.exp(p)
    M = np.zeros((4, 4))
    M[:2] = dt * np.array(
        [
            [-1 / (C_c * R_c), 1 / (C_c * R_c), 1 / C_c, 0],
            [1 / (C_s * R_c), -(1 / R_c + 1 / R_u) / C_s, 0, 1 / C_s / R_u],
        ]
    )
    E = expm(M)
    x, out = np.array(start), np.empty((len(heat), 2))
    for k, u in enumerate(zip(heat, air, strict=True)):
        out[k] = x
        x = E[:2, :2] @ x + E[:2, 2:] @ np.array(u)
    return out


def fitted(name: str, guess: tuple[float, ...]) -> dict[str, float]:
    """Two nodes fitted to core and surface of a record, with the heat I (U − V)."""
    d = np.genfromtxt(need("core_surface", f"{name}.csv"), delimiter=",", names=True)
    step = 10
    n = len(d) // step * step
    mean = {c: d[c][:n].reshape(-1, step).mean(axis=1) for c in d.dtype.names}
    current, V = -d["I_A"], d["V_V"]  # the record counts charge positive
    charge = np.cumsum(current) / 3600
    U0, slope, R_e = np.linalg.lstsq(np.stack([np.ones(len(V)), charge, -current], 1), V, rcond=None)[0]

    def residual(p):
        heat = (current * (U0 + p[4] + slope * charge - V))[:n].reshape(-1, step).mean(axis=1)
        T = two_nodes(p[:4], heat, mean["T_amb_C"], [mean["T_core_C"][0], mean["T_surf_C"][0]], float(step))
        return np.concatenate([T[:, 0] - mean["T_core_C"], T[:, 1] - mean["T_surf_C"], [p[4] / 0.02]])

    p = least_squares(residual, [*np.log(guess), 0.0]).x
    C_c, C_s, R_c, R_u = np.exp(p[:4])
    assert np.sqrt(np.mean(residual(p) ** 2)) < 1.0  # K: these numbers do describe the record
    return {"C_c": C_c, "C_s": C_s, "R_c": R_c, "R_u": R_u, "R_e": R_e}


def rested(name: str, at_rest_A: float) -> float:
    """Time constant with which the surface falls in the longest rest after a load, s."""
    with gzip.open(need("bench", f"{name}.csv.gz"), "rt") as f:
        d = np.genfromtxt(f, delimiter=",", names=True)
    d = d[np.isfinite(d["surface_1_C"])]
    T = d["surface_2_C"] if "surface_2_C" in d.dtype.names else d["surface_1_C"]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.abs(d["current_A"]) < at_rest_A, [0]]).astype(int)))
    best = None
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        t, y = d["time_s"][a:b] - d["time_s"][a], T[a:b]
        keep = (t > 60) & (t < 5400)
        if keep.sum() > 8 and (fall := y[keep][0] - y[keep][-1]) > 1.5 and (best is None or fall > best[0]):
            shape = curve_fit(lambda u, a, b, tau: a + b * np.exp(-u / tau), t[keep], y[keep], p0=[y[-1], fall, 800.0])
            best = fall, float(shape[0][2])
    assert best is not None
    return best[1]


CHAMBER = {"lg_m50": "forced", "leaf_pouch": "still", "melasta_5Ah5": "still"}


@cache
def known_errors() -> dict[str, float]:
    """Errors in sd of all that was published, of the records with a core, and of long rests."""
    errors: dict[str, float] = {}
    for k, (name, values) in enumerate(LITERATURE):
        errors |= {f"published {k} {what}": e for what, e in off(PUBLISHED[name], values).items()}
    for record, name, guess in (
        ("a123_26650_hev2", "a123_26650", (75.0, 5.0, 2.5, 4.0)),
        ("lfp_32113_insulated_1", "a123_32113", (190.0, 15.0, 1.5, 3.0)),
        ("lfp_32113_uninsulated_2", "a123_32113", (190.0, 15.0, 1.5, 2.0)),
    ):
        errors |= {f"{record} {what}": e for what, e in off(PUBLISHED[name], fitted(record, guess)).items()}
    for record, name, amps in (
        ("lgm50_rate_2C_T25", "lg_m50", 0.05),
        ("lgm50_rate_0p5C_T0", "lg_m50", 0.05),
        ("lgm50_2C_25C_cell796", "lg_m50", 0.05),
        ("leaf_cell_pouch_1c", "leaf_pouch", 0.5),
        ("leaf_cell_pouch_3c", "leaf_pouch", 0.5),
        ("melasta_5Ah5_pouch_still", "melasta_5Ah5", 0.1),
    ):
        cell = cell_of(f"{name} {CHAMBER[name]}")
        errors |= {f"{record} {what}": e for what, e in off(cell, {"tau": rested(record, amps)}).items()}
    return errors
