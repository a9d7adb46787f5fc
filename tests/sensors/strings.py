"""Strings that tests ask about, and how well their cores are known by scipy's Riccati solution."""

import numpy as np
import scipy.linalg

from bms_gateway.thermal import Disturbance, StringParameters, continuous, gathered_noise
from tests.truth.string import C_F, TABLE_1

COUPLINGS = {
    "full": {"R_cc": 32.0, "C_f": C_F},
    "natural": {"R_cc": 32.0},
    "no-conduction": {"C_f": C_F},
    "single": {},
}


def cells(n, condition="full", **other):
    return StringParameters.of(n, **{**TABLE_1, **COUPLINGS[condition], **other})


def sampled(p, d, dt):
    """Transition, noise of a step and readings' noise, by Van Loan's exponential."""
    s = continuous(p)
    common = s.B_q.sum(axis=1)
    W = d.heat_common**2 * np.outer(common, common) + d.heat_cell**2 * s.B_q @ s.B_q.T
    return gathered_noise(s.A, 2 * d.correlation * (W + d.inlet**2 * np.outer(s.B_f, s.B_f)), dt)


def riccati(p, sensors, d=None, dt=1.0):
    """Standard deviation of each core after a reading, by scipy."""
    d = d or Disturbance()
    Phi, Q = sampled(p, d, dt)
    if not sensors:
        return np.sqrt(np.diag(scipy.linalg.solve_discrete_lyapunov(Phi, Q))[0::2])
    C, R = np.eye(len(Phi))[[2 * k - 1 for k in sensors]], d.sensor**2 * np.eye(len(sensors))
    P = scipy.linalg.solve_discrete_are(Phi.T, C.T, Q, R)
    return np.sqrt(np.diag(P - P @ C.T @ np.linalg.solve(C @ P @ C.T + R, C @ P))[0::2])
