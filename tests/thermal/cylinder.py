"""A roll as a cylinder of many shells in a casing: made by itself, with nothing of the product in it.

Shells of equal width, heat between their radii of equal volume by the logarithm of the radii, steps of implicit Euler.
"""

from dataclasses import dataclass

import numpy as np

SHELLS = 80


@dataclass(frozen=True)
class Run:
    """Temperatures at each step, °C; `hottest` of all shells and the casing."""

    mean: np.ndarray
    surface: np.ndarray
    centre: np.ndarray
    hottest: np.ndarray


def cylinder(share, heat, coolant, dt=1.0, C_c=268.0, C_s=18.8, R_c=1.266, R_u=0.79, start=0.0) -> Run:
    """Run with a share of R_c in the roll (1/(8πkL)), the rest between roll and casing; W and °C at each step."""
    r = np.linspace(0.0, 1.0, SHELLS + 1)
    volume = np.diff(r**2)
    middle = np.sqrt((r[1:] ** 2 + r[:-1] ** 2) / 2.0)
    k2piL = 1.0 / (4.0 * share * R_c)  # 2πkL
    between = k2piL / np.log(middle[1:] / middle[:-1])
    out = 1.0 / (np.log(1.0 / middle[-1]) / k2piL + (1.0 - share) * R_c)
    G = np.append(between, out)
    n = SHELLS + 1
    A = np.zeros((n, n))
    for i, g in enumerate(G):
        A[i : i + 2, i : i + 2] += g * np.array([[-1.0, 1.0], [1.0, -1.0]])
    A[-1, -1] -= 1.0 / R_u
    C = np.append(C_c * volume, C_s)
    step = np.linalg.inv(np.eye(n) - dt * A / C[:, None])
    x, rows = np.full(n, float(start)), []
    for q, T_f in zip(heat, coolant, strict=True):
        x = step @ (x + dt * np.append(q * volume, T_f / R_u) / C)
        rows.append(x)
    X = np.array(rows)
    # the innermost shell is a hundredth of the radius: its mean is the axis to 1 part in 10,000
    return Run(X[:, :-1] @ volume, X[:, -1], X[:, 0], X.max(axis=1))
