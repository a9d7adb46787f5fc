"""Restarts, and inputs that are measured again: against one joint Gaussian, and against drives that nobody saw."""

import json
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from bms_gateway.observe import PARAMETERS, AdaptiveObserver, Disturbance, stack
from bms_gateway.observe.gap import PHASE_S, steps, unseen_phases
from bms_gateway.observe.model import augmented
from tests.observe.rig import Drive, follow, model, truth, wander
from tests.truth.cycle import repeated
from tests.truth.string import lsoda, rk4

NAN = np.nan
INLET, HEAT = -2, -1
AN_INSTANT = 1e-9
USUAL_W = 12.0


def loose(cells=4):
    return model(cells, (1, cells), rel_sd={"R_e": 0.3, "R_u": 0.2, "C_f": 0.2})


def taken(observer, what):
    """x and P from the filter's state, J and cov from what it keeps beside: arrays with the strings first."""
    snapshot = observer.snapshot()
    return np.array(snapshot["state" if what in ("x", "P") else "own"][what])


@cache
def driven():
    """Two strings that were driven, with an inlet that moved about."""
    rng = np.random.default_rng(6)
    drive = Drive.of(truth(4, batch=(2,)), 5, 35.0, (1, 4), inlet=25 + wander(rng, 301, 3.0, 2))
    observer = AdaptiveObserver([loose()] * 2, 1.0)
    follow(observer, drive)
    return json.dumps(observer.snapshot())


def at_the_end_of_a_gap(gap_s=120.0, **how):
    observer = AdaptiveObserver([loose()] * 2, 1.0)
    observer.restore(json.loads(driven()))
    observer.propagate(gap_s, **how)
    return observer


def an_instant_later(observer, current, inlet):
    """The same strings when these inputs have been measured, before anything has moved; surfaces were not read."""
    soon = AdaptiveObserver([loose()] * 2, AN_INSTANT)
    soon.restore(json.loads(json.dumps(observer.snapshot())))
    soon.step(np.asarray(current), None, np.asarray(inlet), np.full((2, 4), NAN), np.zeros((2, 4)))
    return soon


@pytest.mark.parametrize("moved", [4.0, -6.0])
def test_an_inlet_that_is_back_is_a_reading_of_where_it_has_gone(moved):
    """Oracle: state, parameters and the new offset as one Gaussian, given that the inlet is one for both offsets."""
    observer = at_the_end_of_a_gap(unseen=True)
    held = taken(observer, "inlet")
    x, P, J, cov = (taken(observer, k) for k in ("x", "P", "J", "cov"))
    after = an_instant_later(observer, [NAN, NAN], [held[0] + moved, NAN])
    M, p, sd = x.shape[1], len(PARAMETERS), Disturbance().inlet
    joint = np.zeros((M + p + 1, M + p + 1))
    joint[:M, :M] = P[0] + J[0] @ cov[0] @ J[0].T
    joint[:M, M:-1] = J[0] @ cov[0]
    joint[M:-1, :M], joint[M:-1, M:-1], joint[-1, -1] = joint[:M, M:-1].T, cov[0], sd**2
    h = np.zeros(M + p + 1)
    h[M + INLET], h[-1] = 1.0, -1.0  # old offset less new one: how far the measured inlet is from the one held
    gain = joint @ h / (h @ joint @ h)
    mean = np.concatenate([x[0], np.zeros(p + 1)])
    mean += gain * (moved - h @ mean)
    joint -= np.outer(gain, h @ joint)
    order = [*range(M + INLET), M + p, M + HEAT]  # the new offset in the place of the old one
    a_x, a_P, a_J = (taken(after, k)[0] for k in ("x", "P", "J"))
    assert np.abs(a_x - x[0]).max() > 1.0  # the test has something to see
    assert np.abs(a_J - J[0]).max() > 0.3
    np.testing.assert_allclose(a_x, mean[order], atol=1e-6)
    np.testing.assert_allclose(a_P + a_J @ cov[0] @ a_J.T, joint[np.ix_(order, order)], atol=1e-6)
    np.testing.assert_allclose(a_J @ cov[0], joint[np.ix_(order, range(M, M + p))], atol=1e-6)
    for what, before in (("x", x), ("P", P), ("J", J)):  # the other string's inlet is not back
        np.testing.assert_allclose(taken(after, what)[1], before[1], atol=1e-6)


def test_the_heat_of_a_current_that_is_back_owes_nothing_to_what_was_unknown_before():
    observer = at_the_end_of_a_gap(unseen=True)
    x, P, J = (taken(observer, k) for k in ("x", "P", "J"))
    after = an_instant_later(observer, [900.0, NAN], [NAN, NAN])
    a_x, a_P, a_J = (taken(after, k) for k in ("x", "P", "J"))
    assert abs(x[0, HEAT]) > 1.0
    assert a_x[0, HEAT] == pytest.approx(0.0, abs=1e-9)
    assert a_P[0, HEAT, HEAT] == pytest.approx(Disturbance().heat_common ** 2)
    assert np.abs(a_P[0, HEAT, :HEAT]).max() < 1e-6
    assert (a_J[0, HEAT] == 0.0).all()
    np.testing.assert_allclose(a_P[0, :HEAT, :HEAT], P[0, :HEAT, :HEAT], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(a_J[0, :HEAT], J[0, :HEAT], atol=1e-6)
    np.testing.assert_allclose(a_x[1], x[1], atol=1e-6)


def test_a_current_that_fails_in_a_drive_and_is_back_leaves_the_heats_sensitivities_behind():
    """There its offset has learnt from surfaces, and with it of the parameters."""
    observer = AdaptiveObserver([loose()], 1.0)
    drive = Drive.of(truth(4, batch=(1,)), 5, 35.0, (1, 4))
    drive.I2[150:298] = NAN
    follow(observer, drive, stop=298)
    assert np.abs(taken(observer, "J")[0, HEAT]).max() > 0.5
    y, inlet = np.full((1, 4), NAN), drive.inlet[298]
    observer.step(drive.I2[298], None, inlet, y, np.zeros((1, 4)))
    assert (taken(observer, "J")[0, HEAT] == 0.0).all()


def test_heat_that_nobody_saw_is_none_that_the_parameters_were_learnt_with():
    observer = at_the_end_of_a_gap(30.0, unseen=True)
    assert (taken(observer, "J")[:, HEAT] == 0.0).all()
    assert np.abs(taken(at_the_end_of_a_gap(30.0), "J")[:, HEAT]).max() > 0.1


def test_phases_of_a_drive_leave_what_a_first_order_heat_does_that_starts_where_it_was_seen():
    """Oracle: that heat as a state of its own, in steps of a second."""
    d = Disturbance(correlation=1e12)  # the drive goes on for ever
    p = model(3, (1, 3)).nominal
    m = stack([p], 1.0, d)
    kept, M, n = np.exp(-1.0 / PHASE_S), m.states, m.cells
    A = np.zeros((M + 1, M + 1))
    A[:M, :M], A[M, M] = m.A[0], kept
    A[:M, M] = m.G[0, :, M : M + n].sum(axis=1)
    P = np.zeros_like(A)
    sd = {}
    for second in range(1, 901):
        P = A @ P @ A.T
        P[M, M] += (1 - kept**2) * USUAL_W**2
        sd[second] = np.sqrt(np.diag(P)[0 : 2 * n : 2])
    for gap_s in (60, 120, 300, 600, 900):
        found = np.sqrt(np.diag(unseen_phases(augmented(p, d).A, float(gap_s), USUAL_W, d))[0 : 2 * n : 2])
        assert np.abs(found / sd[gap_s] - 1.0).max() < 0.15, (gap_s, found, sd[gap_s])
    # after some seconds nothing has begun yet: a whole phase's heat would be ten times this
    assert np.sqrt(np.diag(unseen_phases(augmented(p, d).A, 10.0, USUAL_W, d))[0]) < 1.6 * sd[10][0]


def test_steps_over_a_gap_are_the_whole_of_it():
    for gap_s in (0.3, 5.0, 41.0, 600.0, 86_400.0):
        cut = list(steps(gap_s))
        assert cut[0][0] == 0.0
        for (begin, length), (following, _) in pairwise(cut):
            assert begin + length == pytest.approx(following)
        assert sum(cut[-1]) == pytest.approx(gap_s)


def test_cores_are_in_their_bands_after_ten_minutes_of_phases_that_nobody_saw():
    """Forty strings are driven on; then come inlet and current, and a second later a reading of both ends."""
    S, n, before, gap = 40, 12, 600, 600
    rng = np.random.default_rng(3)
    K = before + gap
    inlet = 25 + wander(rng, K + 3, 2.0, S)
    I2 = np.stack([repeated(K // 60 + 1, seed)[: K + 2] ** 2 for seed in range(S)], axis=1)
    core, surface = rk4(truth(n, batch=(S,)), np.sqrt(I2), inlet, 30.0)
    observer = AdaptiveObserver([model(n, (1, n), tolerances={})] * S, 1.0)
    now = np.zeros((S, n))
    for k in [*range(1, before + 1), None, K + 1, K + 2]:
        if k is None:
            observer.propagate(float(gap), unseen=True)
            continue
        y = surface[k] + rng.normal(0, 0.1, (S, n))
        y[:, 1:-1] = NAN
        if k == K + 1:
            y[:] = NAN  # a sensor must be seen twice to be believed
        last = observer.step(I2[k - 1], None, inlet[k], y, now)
    z = (last.core - core[K + 2]) / last.core_sd
    print(f"rms {np.sqrt(np.mean(z**2)):.2f}, worst {np.abs(z).max():.1f}, median sd {np.median(last.core_sd):.2f} K")
    assert np.mean(np.abs(z) > 2.0) < 0.08  # the cores of a string err together
    assert np.abs(z).max() < 3.5
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.0
    assert np.median(last.core_sd) < 2.0


def test_unseen_heat_goes_to_unlike_cells_by_their_resistance():
    """Nine minutes of the usual current after a minute of it, dying away as is expected; one cell has twice the R_e."""
    R_e = np.array([3.5e-3, 3.5e-3, 7.0e-3])
    observer = AdaptiveObserver([model(3, (1, 3))], 1.0)
    observer.set_parameters(0, {"R_e": R_e}, (), np.zeros((0, 0)))
    I2, none = np.array([3600.0]), np.full((1, 3), NAN)
    y = np.array([[25.0, NAN, 25.0]])
    for _ in range(60):
        observer.step(I2, None, np.array([25.0]), y, np.zeros((1, 3)))
        y = none
    start, usual = observer.estimate(), observer._usual.mean[0]
    assert usual[2] == pytest.approx(2.0 * usual[0])
    string = truth(3, R_e=R_e)
    fading = np.exp(-(np.arange(540) + 0.5) / Disturbance().correlation)
    inlet = np.full(541, 25.0)
    core, _ = rk4(string, np.zeros(540), inlet, (start.core[0], start.surface[0]), heat=fading[:, None] * usual)
    e = observer.propagate(540.0, unseen=True)
    np.testing.assert_allclose(e.core[0] - 25.0, core[-1] - 25.0, rtol=0.03)
    assert core[-1][2] - core[-1][0] > 1.0
    assert e.core_sd[0, 2] > 1.5 * e.core_sd[0, 0]


def test_a_vehicle_that_drives_off_unseen_is_reckoned_with():
    """It stood for five minutes, and two minutes later it has climbed with two and a half times a cell's usual heat."""
    observer = AdaptiveObserver([model(3, (1, 3))], 1.0)
    y = np.array([[25.0, NAN, 25.0]])
    for _ in range(300):
        observer.step(np.zeros(1), None, np.array([25.0]), y, np.zeros((1, 3)))
    e = observer.propagate(120.0, unseen=True)
    heat = 2.5 * Disturbance().heat_unknown
    core, _ = lsoda(truth(3), np.full(120, np.sqrt(heat / 3.5e-3)), np.full(121, 25.0), 25.0)
    error = core[-1] - e.core[0]
    assert (error > 8.0).all()
    assert (error < 2.0 * e.core_sd[0]).all()
