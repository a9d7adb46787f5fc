"""A string whose rolls have two states each against a fine cylinder, and against all modes of the exact one."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.special import jn_zeros

from bms_gateway.thermal import StringParameters, continuous, steady_state
from bms_gateway.thermal.roll import FAST, PACE, SHARE, STATES, resting, with_roll
from tests.truth.string import TABLE_1

SHELLS = 200
WATTS = 40.0


def fine(p, share, cell):
    """Balances of one cell of `p` in still coolant: shells of equal volume, then the casing."""
    R_c, C_c, C_s, R_u = (float(getattr(p, s)[cell]) for s in ("R_c", "C_c", "C_s", "R_u"))
    A = np.zeros((SHELLS + 1, SHELLS + 1))
    spread = 2.0 * share * R_c  # of a cylinder from its centre to its edge under even heat
    conduct = [j / spread for j in range(1, SHELLS)]  # the flux is 4 pi k L times r² dT/d(r²)
    conduct.append(1.0 / (spread / (2.0 * SHELLS) + (1.0 - share) * R_c))
    for j, G in enumerate(conduct):
        here, there = (C_c / SHELLS), (C_c / SHELLS if j + 1 < SHELLS else C_s)
        A[j, [j, j + 1]] += np.array([-G, G]) / here
        A[j + 1, [j, j + 1]] += np.array([G, -G]) / there
    A[-1, -1] -= 1.0 / (R_u * C_s)
    return A, np.append(np.full(SHELLS, 1.0 / C_c), 0.0)


@pytest.mark.parametrize("share", [0.05, 0.3, 0.67, 0.95])
def test_a_step_of_heat_shows_as_in_a_fine_cylinder(share):
    p = StringParameters.of(1, **TABLE_1)
    s = with_roll(continuous(p), p, share)
    A, b = fine(p, share, 0)
    plain = continuous(p)
    apart, missed = 0.0, 0.0
    for t in (2.0, 5.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 5000.0):
        x = np.linalg.solve(s.A, (expm(s.A * t) - np.eye(len(s.A))) @ s.B_q[:, 0] * WATTS)
        y = np.linalg.solve(A, (expm(A * t) - np.eye(len(A))) @ b * WATTS)
        z = np.linalg.solve(plain.A, (expm(plain.A * t) - np.eye(2)) @ plain.B_q[:, 0] * WATTS)
        truth = np.array([y[:-1].mean(), y[-1]])
        apart = max(apart, float(np.abs(x[:2] - truth).max()))
        missed = max(missed, float(np.abs(z - truth).max()))
    assert apart < 0.05 * missed + 2e-3


def test_the_states_answer_every_slow_frequency_as_all_modes_do():
    each = 8.0 / jn_zeros(1, 4000) ** 2
    omega = np.geomspace(0.01, 60.0, 200)
    exact = (each[:, None] / (1.0 + 1j * omega * each[:, None])).sum(axis=0)
    ours = FAST + (SHARE[:, None] / (1.0 + 1j * omega * PACE[:, None])).sum(axis=0)
    assert np.abs(ours - exact).max() < 0.029
    assert pytest.approx(np.sum(each**2), abs=1e-4) == SHARE @ PACE


@pytest.mark.parametrize("share", [0.0, 0.4, 0.9])
def test_a_steady_string_is_that_of_one_node_and_starts_with_that_profile(share):
    p = StringParameters.of(3, **TABLE_1, R_cc=4.0, C_f=11.33)
    s = with_roll(continuous(p), p, share)
    heat = np.array([4.0, 9.0, 6.0])
    steady = np.linalg.solve(s.A, -(s.B_q @ heat + s.B_f * 25.0))
    assert len(steady) == (2 + (STATES if share else 0)) * 3
    assert steady[:6] == pytest.approx(steady_state(p, heat, 25.0), rel=1e-9)
    assert resting(3, share) @ steady[:6] == pytest.approx(steady, abs=1e-9)
