"""The filter against conditioning of one joint Gaussian, written here with none of its formulas."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.observe import AdaptiveObserver, Disturbance, Kalman, StackedModel, Start, stack, start_covariance
from bms_gateway.thermal import StringParameters
from tests.observe.rig import model
from tests.truth.cycle import repeated
from tests.truth.string import C_F, TABLE_1, TruthString, lsoda, rk4

QUARTERS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])


def string(n, **other):
    return StringParameters.of(n, **{**TABLE_1, "R_cc": 4.0, "C_f": C_F, **other})


def kalman(parameters, sensors, disturbance=None, **other):
    m = stack(parameters, 1.0, disturbance or Disturbance())
    at = np.tile(np.array(sensors) - 1, (len(parameters), 1))
    return Kalman(m, at, np.ones(at.shape, bool), **other)


def start(n, T, S=1, P=None):
    x = np.concatenate((np.full((S, 2 * n), float(T)), np.zeros((S, 2))), axis=1)
    P = start_covariance(n, Start(), Disturbance()) if P is None else P
    return x, np.tile(P, (S, 1, 1))


def readings(rng, steps, S, n, sensors, share=1.0):
    y = np.full((steps, S, n), np.nan)
    for k in sensors:
        there = rng.random((steps, S)) < share
        y[:, :, k - 1] = np.where(there, 30 + rng.normal(0, 3, (steps, S)), np.nan)
    return y


def test_model_without_offsets_is_the_truth():
    p = string(4)
    m = stack([p], 1.0, Disturbance())
    rng = np.random.default_rng(0)
    current, inlet = rng.uniform(-90, 160, 50), 25 + np.cumsum(rng.normal(0, 0.3, 51))
    core, _ = lsoda(TruthString.of(4, R_cc=4.0, C_f=C_F), current, inlet, 30.0)
    x = start(4, 30.0)[0]
    for k, i in enumerate(current):
        x = m.advance(x, np.full((1, 4), i**2 * 3.5e-3), inlet[[k]], inlet[[k + 1]])
    np.testing.assert_allclose(x[0, 0:8:2], core[-1], atol=2e-6)


def test_offsets_act_as_heat_and_as_inlet():
    """With a correlation time of years an offset is the same as a changed input."""
    m = stack([string(4)], 300.0, Disturbance(correlation=1e12))
    x = start(4, 25.0)[0]
    off = x.copy()
    off[0, -2:] = 1.5, 0.7
    a = m.advance(off, np.full((1, 4), 5.0), np.array([20.0]), np.array([22.0]))
    b = m.advance(x, np.full((1, 4), 5.7), np.array([21.5]), np.array([23.5]))
    np.testing.assert_allclose(a[0, :8], b[0, :8], atol=1e-9)


def test_filter_is_the_conditional_mean_and_covariance_for_late_and_missing_readings():
    """Oracle: stack the states of all instants into one Gaussian and condition it on all readings at once."""
    n, steps = 2, 7
    rng = np.random.default_rng(5)
    f = kalman([string(n)], (1, 2), strides=False)
    m = f.model
    M = m.states
    y = readings(rng, steps, 1, n, (1, 2), share=0.7)
    w = rng.choice(QUARTERS, (steps, n))
    heat, inlet = rng.uniform(0, 20, (steps, 1, n)), 25 + rng.normal(0, 1, (steps + 1, 1))
    x0, P0 = start(n, 28.0)

    mean = np.zeros((steps + 1) * M)
    cov = np.zeros((len(mean), len(mean)))
    mean[:M], cov[:M, :M] = x0[0], P0[0]
    for k in range(steps):
        a, b = slice(k * M, (k + 1) * M), slice((k + 1) * M, (k + 2) * M)
        mean[b] = m.advance(mean[None, a], heat[k], inlet[k], inlet[k + 1])[0]
        A = m.A[0]
        cov[b, : b.start] = A @ cov[a, : b.start]
        cov[: b.start, b] = cov[b, : b.start].T
        cov[b, b] = A @ cov[a, a] @ A.T + m.Q[0]
    H, z = [], []
    for k in range(steps):
        for c in range(n):
            if np.isfinite(y[k, 0, c]):
                row = np.zeros(len(mean))
                row[(k + 1) * M + 2 * c + 1] = 1 - w[k, c]
                row[k * M + 2 * c + 1] = w[k, c]
                H.append(row)
                z.append(y[k, 0, c])
    state = f.init(x0, P0)
    for k in range(steps):
        state, _ = f.update(f.predict(state, heat[k], inlet[k], inlet[k + 1]), y[k], w[k][None])
    H, z = np.array(H), np.array(z)
    gain = cov @ H.T @ np.linalg.inv(H @ cov @ H.T + 0.01 * np.eye(len(z)))
    np.testing.assert_allclose(state.x[0], (mean + gain @ (z - H @ mean))[-M:], atol=1e-6)
    np.testing.assert_allclose(state.P[0], (cov - gain @ H @ cov)[-M:, -M:], atol=1e-6)


def test_strides_are_the_full_filter_and_bands_between_them_are_late_by_a_per_cent():
    """Sensors fail, come back late, the inlet is lost: the same covariances when caught up, nearly the same always."""
    n, steps = 5, 2400
    full, fast = (kalman([string(n)], (1, 5), strides=s) for s in (False, True))
    a = b = full.init(*start(n, 30.0))
    y = np.full((steps, 1, n), np.nan)
    y[:, 0, [0, 4]] = 30.0 + np.random.default_rng(1).normal(0, 1, (steps, 2))
    y[500:1100, 0, 4] = np.nan
    age = np.zeros((steps, 1, n))
    age[1100:] = 0.6
    known = np.ones((steps, 1, 2), bool)
    known[1500:2000, 0, 0] = False
    heat, T = np.full((1, n), 10.0), np.array([25.0])
    ratio, computed = [], 0
    for k in range(steps):
        a, _ = full.update(full.predict(a, heat, T, T, known[k]), y[k], age[k])
        b, _ = fast.update(fast.predict(b, heat, T, T, known[k]), y[k], age[k])
        sd_a, sd_b = (np.sqrt(np.diagonal(s.P[0])) for s in (a, b))
        ratio.append(sd_b / sd_a)
        computed += int(b.since[0] == 0)
        if k % 97 == 0:
            np.testing.assert_allclose(fast.caught_up(b, np.array([0])).P, a.P, rtol=1e-9, atol=1e-12)
        assert (np.abs(b.x - a.x) < 0.1 * sd_a).all()
    assert np.min(ratio) > 0.984
    assert np.max(ratio) < 1.05
    assert computed < 0.65 * steps  # five changes in forty minutes


def test_work_ceases_while_the_same_readings_come_whatever_the_jitter_of_their_age():
    f = kalman([string(2)], (1, 2))
    state = f.init(*start(2, 30.0))
    rng = np.random.default_rng(0)
    T, heat, computed = np.array([25.0]), np.zeros((1, 2)), []
    for _ in range(4000):
        state, _ = f.update(f.predict(state, heat, T, T), np.full((1, 2), 25.0), rng.uniform(0.3, 0.45, (1, 2)))
        computed.append(state.since[0] == 0)
    assert all(computed[:256])
    assert sum(computed[256:1200]) < 100
    assert sum(computed[2000:]) < 50


def test_a_string_wakes_when_a_reading_fails_and_others_do_not():
    n = 2
    f = kalman([string(n)] * 2, (1, 2))
    state = f.init(*start(n, 30.0, S=2))
    T, now, heat = np.full(2, 25.0), np.zeros((2, n)), np.zeros((2, n))
    y = np.full((2, n), 25.0)

    def run(steps, y):
        nonlocal state
        for _ in range(steps):
            state, _ = f.update(f.predict(state, heat, T, T), y, now)

    run(2500, y)
    before = state
    broken = y.copy()
    broken[0] = np.nan
    run(1, broken)
    assert state.since[0] == 0
    assert state.since[1] == before.since[1] + 1
    run(299, broken)
    assert (np.diagonal(state.P[0])[:4] > np.diagonal(before.P[0])[:4]).all()
    np.testing.assert_allclose(state.P[1], before.P[1], rtol=2e-3, atol=1e-6)
    run(2500, y)
    np.testing.assert_allclose(state.P[0], before.P[0], rtol=0.02, atol=1e-5)


@pytest.mark.parametrize("count", [1, 2, 7, 64, 1000])
def test_many_steps_at_once_are_the_steps_one_by_one(count):
    n, counts = 4, np.array([count, 3, 1])
    f = kalman([string(n, R_e=3e-3 + 1e-4 * s) for s in range(3)], (1, 4), strides=False)
    rng = np.random.default_rng(count)
    y, lag = np.full((3, n), 25.0), rng.choice(QUARTERS, (3, n))
    y[1, 0] = np.nan
    T, heat = np.full(3, 25.0), np.zeros((3, n))
    first, _ = f.update(f.predict(f.init(*start(n, 30.0, S=3)), heat, T, T), y, lag)
    state = first
    for k in range(count):
        state, _ = f.update(f.predict(state, heat, T, T), y, lag)
        for s in np.flatnonzero(counts == k + 1):
            one = f.caught_up(replace(first, since=counts), np.array([s]))
            np.testing.assert_allclose(one.P[s], state.P[s], rtol=1e-8, atol=1e-11)


def test_each_string_is_computed_as_if_alone():
    n, S, steps = 3, 4, 300
    rng = np.random.default_rng(2)
    strings = [string(n, R_e=3e-3 + 1e-4 * s) for s in range(S)]
    y = readings(rng, steps, S, n, (1, 3), share=0.8)
    age = rng.uniform(0, 1, (steps, S, n))
    heat = rng.uniform(0, 20, (steps, S, n))

    def run(chosen):
        f = kalman([strings[s] for s in chosen], (1, 3))
        state = f.init(*start(n, 30.0, S=len(chosen)))
        T = np.full(len(chosen), 25.0)
        for k in range(steps):
            state, _ = f.update(f.predict(state, heat[k, chosen], T, T), y[k, chosen], age[k, chosen])
        return state

    together = run([0, 1, 2, 3])
    for s in range(S):
        alone = run([s])
        assert (alone.x[0] == together.x[s]).all()
        assert (alone.P[0] == together.P[s]).all()


def test_covariance_stays_symmetric_and_positive_from_an_absurd_start():
    f = kalman([string(5)], (1, 5))
    state = f.init(*start(5, 30.0, P=1e6 * np.eye(12)))
    T, heat = np.array([25.0]), np.zeros((1, 5))
    y = np.full((1, 5), np.nan)
    y[0, [0, 4]] = 25.0
    for _ in range(500):
        state, _ = f.update(f.predict(state, heat, T, T), y, np.zeros((1, 5)))
    np.testing.assert_array_equal(state.P, state.P.swapaxes(1, 2))
    assert np.linalg.eigvalsh(state.P[0]).min() > 0


def test_unknown_inlet_widens_and_its_return_starts_its_offset_anew():
    observer = AdaptiveObserver([model(3, (1,), tolerances={})], 1.0)
    heat, now = np.zeros((1, 3)), np.zeros((1, 3))
    y = np.array([[25.0, np.nan, np.nan]])

    def run(steps, inlet_known):
        for _ in range(steps):
            observer.step(np.zeros(1), heat, np.array([25.0 if inlet_known else np.nan]), y, now)
        return np.sqrt(observer.covariances[0, 0, 0])

    usual = run(1500, True)
    offset = observer.covariances[0, -2, -2]
    lost = run(1500, False)
    assert lost > 1.15 * usual
    assert observer.covariances[0, -2, -2] > 2 * offset
    run(1, True)
    assert observer.covariances[0, -2, -2] <= Disturbance().inlet ** 2 * 1.01
    assert run(1500, True) == pytest.approx(usual, rel=0.01)


def test_gap_in_one_step_is_the_gap_in_many():
    p = string(3)
    f = kalman([p], (1, 3), strides=False)
    state = f.init(*start(3, 45.0, P=4.0 * np.eye(8)))
    T, heat = np.array([25.0]), np.zeros((1, 3))
    none, now = np.full((1, 3), np.nan), np.zeros((1, 3))
    many = state
    for _ in range(600):
        many, _ = f.update(f.predict(many, heat, T, T, np.array([[False, True]])), none, now)
    one = f.propagate(state, stack([p], 600.0, Disturbance()), T, T)
    np.testing.assert_allclose(one.x, many.x, atol=1e-8)
    np.testing.assert_allclose(one.P, many.P, rtol=1e-8, atol=1e-9)


def settling(error, limit):
    """First second from which the error stays within the limit."""
    late = np.flatnonzero(np.abs(error) > limit)
    return 0 if not len(late) else late[-1] + 1


def single_cell_core(seed, minutes=6):
    current = repeated(minutes)
    core, surface = rk4(TruthString.of(1), current, np.full(len(current) + 1, 25.0), 30.0)
    rng = np.random.default_rng(seed)
    return current, core, surface + rng.normal(0, 0.1, surface.shape)


@pytest.mark.parametrize("seed", range(3))
def test_single_cell_is_found_within_a_minute_where_the_papers_gain_needs_forty(seed):
    """Fig 5: 10 K off at the start; within 1 K for good."""
    current, core, y = single_cell_core(seed)
    f = kalman([StringParameters.of(1, **TABLE_1)], (1,))
    P = np.diag([1e4, 1e4, 0.25, 0.25])
    state = f.init(*start(1, 20.0, P=P))
    T, now, error = np.array([25.0]), np.zeros((1, 1)), []
    for k, i in enumerate(current):
        state, _ = f.update(f.predict(state, np.full((1, 1), i**2 * 3.5e-3), T, T), y[[k + 1]], now)
        error.append(state.x[0, 0] - core[k + 1, 0])
    assert settling(np.array(error), 1.0) < 60


@pytest.mark.parametrize("common", [True, False])
def test_common_mode_is_what_makes_a_sensor_speak_for_the_others(common):
    """Five cells, sensors {1, 5}, 7 K off: seconds with common-mode errors, twenty minutes with independent ones."""
    n, current = 5, repeated(30)
    core, surface = rk4(TruthString.of(n, R_cc=32.0, C_f=C_F), current, np.full(len(current) + 1, 25.0), 37.0)
    y = np.full(surface.shape, np.nan)
    y[:, [0, 4]] = surface[:, [0, 4]] + np.random.default_rng(0).normal(0, 0.1, (len(y), 2))
    if common:
        d, P = Disturbance(), None
    else:
        d, P = Disturbance(heat_common=1e-6, heat_cell=0.5, inlet=1e-6, inlet_unknown=1.0), 100.0 * np.eye(2 * n + 2)
    f = kalman([string(n, R_cc=32.0)], (1, 5), d)
    state = f.init(*start(n, 30.0, P=P))
    T, now, error = np.array([25.0]), np.zeros((1, n)), []
    for k, i in enumerate(current):
        state, _ = f.update(f.predict(state, np.full((1, n), i**2 * 3.5e-3), T, T), y[[k + 1]], now)
        error.append(state.x[0, 0 : 2 * n : 2] - core[k + 1])
    seconds = max(settling(e, 1.0) for e in np.array(error).T)
    assert seconds < 30 if common else 12 * 60 < seconds < 28 * 60


def test_noise_of_known_and_unknown_strings_keeps_apart():
    m: StackedModel = stack([string(2)] * 3, 1.0, Disturbance())
    Q = m.noise(np.array([0, 2]), np.array([[True, True], [False, True]]))
    assert (Q[0] == m.Q[0]).all()
    assert Q[1, -2, -2] > 50 * m.Q[2, -2, -2]
    assert Q[1, -1, -1] == m.Q[2, -1, -1]
