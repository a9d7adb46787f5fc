"""The paper's regression: exact where it claims to be, honest where noise folds it."""

import numpy as np
import pytest

from bms_gateway.identify import least_squares
from bms_gateway.identify.recursive import RecursiveIdentifier
from bms_gateway.identify.regression import choose_root, roots, with_moving_inlet
from tests.identify.drive import drive, measured, model, ticks
from tests.truth.cycle import repeated
from tests.truth.string import TABLE_1, TruthString, rk4, wavy_inlet

C_c, C_s = TABLE_1["C_c"], TABLE_1["C_s"]


def off(cell):
    return max(abs(getattr(cell, s) / TABLE_1[s] - 1) for s in ("R_e", "R_c", "R_u"))


def test_discretisation_error_is_below_a_thousandth_without_noise():
    square, inlet, y, _ = measured(1, minutes=45, noise=0, amplitude=0, start=25.0)
    inlet[:] = 25.0
    theta, _ = least_squares.solve(square, y[:, 0], inlet)
    assert off(choose_root(roots(*theta, C_c, C_s), 1.2, 0.7)) < 1e-3


def test_moving_inlet_needs_no_choice_of_root_and_no_equal_start():
    square, inlet, y, _ = measured(2, minutes=45, noise=0, start=33.0)
    theta, _ = least_squares.solve(square, y[:, 0], inlet, moving_inlet=True, transient=True)
    assert off(with_moving_inlet(*theta[:4], C_c + C_s)) < 1e-3


def test_a_wrong_start_is_absorbed_by_the_impulse_response_only():
    square, inlet, y, _ = measured(2, minutes=20, noise=0, amplitude=0, start=(45.0, 35.0))
    with_it, _ = least_squares.solve(square, y[:, 0], inlet, transient=True)
    without, _ = least_squares.solve(square, y[:, 0], inlet)
    assert off(choose_root(roots(*with_it[:3], C_c, C_s), 1.2, 0.7)) < 2e-3
    assert np.abs(without[:3] / with_it[:3] - 1).max() > 0.01
    rate = (-(35.0 - inlet[0]) / 0.79 + 10.0 / 1.266) / C_s
    assert with_it[3] == pytest.approx(rate, rel=1e-3)


def test_both_roots_are_given_and_give_the_same_coefficients():
    a, b, g = 5.487085e-7, 1.984479e-4, -0.1122937
    both = roots(a, b, g, C_c, C_s)
    for c in (both.smaller, both.larger):
        assert c.R_e / (C_c * C_s * c.R_c) == pytest.approx(a)
        assert 1 / (C_c * C_s * c.R_c * c.R_u) == pytest.approx(b)
        assert (C_c + C_s) / (C_c * C_s * c.R_c) + 1 / (C_s * c.R_u) == pytest.approx(-g)
    assert both.larger.R_e * both.larger.R_c / (both.smaller.R_e * both.smaller.R_c) == pytest.approx(0.446, abs=1e-3)


def test_a_negative_discriminant_is_never_clipped_to_a_root():
    folded = roots(5.487085e-7, 1.984479e-4, -0.105, C_c, C_s)
    assert folded.smaller is None
    assert folded.larger is None
    assert "fold" in folded.why


@pytest.mark.parametrize(("P", "pole", "minutes"), [(1e4, 0.05, 4), (100.0, 0.1, 12)])
def test_recursive_reaches_5_percent_from_a_far_start(P, pole, minutes):
    square, inlet, y, _ = measured(3, minutes=minutes, noise=0, amplitude=0, start=25.0)
    inlet[:] = y[0, 0] = inlet[0]
    identifier = RecursiveIdentifier(model(R_c=1.0, R_u=0.6), P=P, pole=pole)
    square, inlet, y, _ = measured(3, minutes=minutes, noise=0, amplitude=0, start=float(inlet[0]))
    drive(identifier, ticks(square, inlet, y))
    got = {e.name: e for e in identifier.estimates()}
    for s in ("R_e", "R_c", "R_u"):
        assert got[s].value == pytest.approx(TABLE_1[s], rel=0.05), got[s]
        assert got[s].status == "identified"


def test_noise_in_the_regressors_biases_and_then_folds_least_squares():
    # Kept as a warning: this is why the windowed method exists.
    def fit(noise, seed):
        square, inlet, y, _ = measured(seed, minutes=89, noise=noise, amplitude=0)
        theta, _ = least_squares.solve(square, y[:, 0], inlet, transient=True)
        return choose_root(roots(*theta[:3], C_c, C_s), 1.2, 0.7)

    assert all(off(fit(0.02, seed)) < 0.02 for seed in (4, 5, 6))
    some = fit(0.1, 4)
    assert some.R_e < 0.96 * TABLE_1["R_e"]
    assert some.R_u > 1.04 * TABLE_1["R_u"]
    assert fit(0.2, 4) is None


@pytest.mark.slow
def test_parked_for_eight_hours_the_recursive_method_forgets_nothing():
    # Plain forgetting (0.999 a second) leaves nothing after minutes; the gate leaves all.
    drove = np.concatenate([repeated(60, 5), np.zeros(8 * 3600)])
    inlet = wavy_inlet(len(drove))
    inlet[3600:] = inlet[3600]
    _, y = rk4(TruthString.of(1), drove, inlet, 25.0, substeps=1)
    y += np.random.default_rng(1).normal(0, 0.02, y.shape)
    identifier = RecursiveIdentifier(model(), forgetting=0.999)
    stream = list(ticks(drove**2, inlet, y))
    cold = 3600 + 5400  # an hour and a half of cooling down still teaches
    drive(identifier, stream[:cold])
    before = identifier.posterior().mean
    drive(identifier, stream[cold:])
    assert np.abs(np.exp(identifier.posterior().mean - before) - 1).max() < 0.004
