"""Block response and lumped coordinates against the independent truth and finite differences."""

import numpy as np
import pytest

from bms_gateway.identify.identifiable import alias, fold_distance, fold_gradient, lumped, lumped_jacobian
from bms_gateway.identify.response import Inputs, respond
from bms_gateway.identify.window_evidence import Evidence
from bms_gateway.thermal import StringParameters, continuous, discretize
from bms_gateway.thermal.roll import resting, with_roll
from tests.truth.cycle import repeated
from tests.truth.string import C_F, TABLE_1, TruthString, rk4, wavy_inlet

PHI = np.log([268.0, 18.8, 3.5e-3, 1.266, 0.79, 4.0, 11.3])


def inputs(K):
    rng = np.random.default_rng(0)
    return Inputs(
        repeated(K / 60 + 1)[:K] ** 2, rng.uniform(0, 5, K), wavy_inlet(K), 1.0, np.zeros((K, 1)), np.zeros(1)
    )


@pytest.mark.parametrize("K", [7, 64, 333])
def test_blocks_equal_the_truth_step_by_step(K):
    p = StringParameters.of(5, **TABLE_1, R_cc=4.0, C_f=C_F)
    u = inputs(K)
    x0 = np.random.default_rng(1).normal(25, 3, 10)
    R = respond([p, p], u, np.array([x0, x0]), [0, 3])
    heat = (u.mean_square_current * 3.5e-3 + u.heat)[:, None] * np.ones(5)
    core, surface = rk4(
        TruthString.of(5, R_cc=4.0, C_f=C_F), np.zeros(K), u.inlet, (x0[::2], x0[1::2]), heat=heat, substeps=8
    )
    assert np.abs(R.surface[1] - surface[:, [0, 3]]).max() < 1e-5
    assert np.abs(R.last[0][::2] - core[-1]).max() < 1e-5


@pytest.mark.parametrize("share", [0.0, 0.6])
def test_derivatives_by_start_departure_and_swing_are_those_of_the_response(share):
    p = StringParameters.of(2, **TABLE_1, R_cc=4.0, C_f=C_F)
    K = 100
    shape = np.linspace(1, 0, K)[:, None]

    def at(x0, b, swing):
        u = inputs(K)
        u = Inputs(u.mean_square_current, u.heat, u.inlet, 1.0, shape, np.array([b]), swing)
        return respond([p], u, x0[None], [1], share)

    x0 = np.full(4, 25.0)
    here = at(x0, 0.0, 1.0)
    for i in range(4):
        there = at(x0 + np.eye(4)[i], 0.0, 1.0)
        assert np.allclose(there.surface[0] - here.surface[0], here.surface_by_start[:, :, i], atol=1e-9)
    assert np.allclose(at(x0, 1.0, 1.0).surface[0] - here.surface[0], here.surface_by_input[:, :, 0], atol=1e-9)
    assert np.allclose(at(x0, 0.0, 2.0).surface[0] - here.surface[0], here.surface_by_input[:, :, 1], atol=1e-9)


def test_a_roll_is_followed_step_by_step():
    p = StringParameters.of(2, **TABLE_1, R_cc=4.0, C_f=C_F)
    u, share = inputs(75), 0.6
    x0 = np.array([31.0, 27.0, 33.0, 28.0])
    d = discretize(with_roll(continuous(p), p, share), 1.0)
    x = resting(2, share) @ x0
    seen = [x[[1, 3]]]
    for k in range(75):
        heat = u.mean_square_current[k] * p.R_e + u.heat[k]
        x = d.step(x, heat, u.inlet[k], u.inlet[k + 1])
        seen.append(x[[1, 3]])
    R = respond([p], u, x0[None], [0, 1], share)
    assert np.abs(R.surface[0] - np.array(seen)).max() < 1e-9
    assert pytest.approx(x[:4], abs=1e-9) == R.last[0]


def test_the_alias_has_the_same_surface_under_a_still_coolant():
    current = repeated(20)
    still = np.full(1201, 25.0)
    a = np.exp(alias(PHI[:5]))
    other = TruthString.of(1, R_e=a[2], R_c=a[3], R_u=a[4])
    one, two = rk4(TruthString.of(1), current, still, 25.0), rk4(other, current, still, 25.0)
    assert np.abs(one[1] - two[1]).max() < 1e-4
    assert np.abs(one[0] - two[0]).max() > 5.0
    assert fold_distance(alias(PHI[:5])) == pytest.approx(-fold_distance(PHI[:5]))
    assert np.allclose(lumped(alias(PHI[:5]))[:3], lumped(PHI[:5])[:3])


@pytest.mark.parametrize(
    "f_df",
    [
        (lumped, lumped_jacobian),
        (lambda x: lumped(x, True), lambda x: lumped_jacobian(x, True)),
        (fold_distance, fold_gradient),
    ],
)
def test_jacobians_are_those_of_finite_differences(f_df):
    f, df = f_df
    numeric = np.array([(f(PHI + 1e-6 * e) - f(PHI - 1e-6 * e)) / 2e-6 for e in np.eye(7)]).T
    assert np.allclose(df(PHI), numeric, atol=1e-7)


def test_forgetting_equals_adding_the_steps_covariance():
    rng = np.random.default_rng(2)
    A = rng.normal(size=(4, 4))
    info, grad = A @ A.T + np.eye(4), rng.normal(size=4)
    G, sd = rng.normal(size=(4, 2)), np.array([0.3, 0.1])
    after = Evidence(np.zeros(4), info, grad).forget(G, sd)
    cov = np.linalg.inv(info) + G @ np.diag(sd**2) @ G.T
    assert np.allclose(after.info, np.linalg.inv(cov))
    assert np.allclose(np.linalg.solve(after.info, after.grad), np.linalg.solve(info, grad))  # the mean stays
