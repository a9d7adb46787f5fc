"""The observer that saves work against the dense filter that saves none: every covariance in each step."""

import json

import numpy as np
import pytest

from bms_gateway.observe import PARAMETERS, AdaptiveObserver, Disturbance, Kalman, Start, stack, start_covariance
from bms_gateway.observe.blocks import BLOCK
from bms_gateway.observe.covariance_steps import due, steps_left
from bms_gateway.observe.sensitivity import Flows, carried, corrected
from tests.observe.rig import Drive, follow, model, stacked, truth, wander

NAN = np.nan
SPREAD = {"R_e": 0.10, "R_c": 0.05, "R_u": 0.10, "C_c": 0.05, "C_s": 0.05, "R_cc": 0.2, "C_f": 0.05}


def drive(n: int, minutes: int, S: int = 1) -> Drive:
    rng = np.random.default_rng(8)
    inlet = 25 + wander(rng, minutes * 60 + 1, 2.0, S)
    return Drive.of(truth(n, batch=(S,)), minutes, 32.0, (1, n), inlet=inlet)


def dense(n: int, d: Drive) -> tuple[np.ndarray, np.ndarray]:
    """Cores and their sd without the tolerances: the filter with every step computed, sensitivities with its gain."""
    p = model(n, (1, n)).nominal
    f = Kalman(stack([p], 1.0, Disturbance()), np.array([[0, n - 1]]), np.ones((1, 2), bool), strides=False)
    level = np.nanmean(d.y[0])
    state = f.init(
        np.append(np.full(2 * n, level), [0.0, 0.0])[None], start_covariance(n, Start(), Disturbance())[None]
    )
    flows, J = Flows.of([p]), np.zeros((1, 2 * n + 2, len(PARAMETERS)))
    sd = np.array([SPREAD.get(name, 0.0) for name in PARAMETERS])
    core, core_sd, none, now = [], [], np.zeros((1, n)), np.zeros((1, n))
    for k in range(1, len(d)):
        heat, inlet = d.I2[k][:, None] * p.R_e, (d.inlet[max(k - 1, 1)], d.inlet[k])
        predicted = f.predict(state, heat, *inlet)
        after, innovation = f.update(predicted, d.y[k], now)
        F = flows.forcing((state.x + predicted.x) / 2, heat, none, (inlet[0] + inlet[1]) / 2)
        J, _ = corrected(carried(J, f.model.A, F, 1.0), J, after.K, f.sensors, innovation.lag)
        state = after
        core.append(state.x[0, 0 : 2 * n : 2])
        var = np.diagonal(state.P[0]) + (J[0] ** 2 @ sd**2)
        core_sd.append(np.sqrt(var[0 : 2 * n : 2]))
    return np.array(core), np.array(core_sd)


def test_cores_and_bands_are_those_of_the_dense_filter() -> None:
    """Half an hour, a sensor lost and found: cores within a twentieth of their band, bands those of the last block."""
    n, d = 5, drive(5, 30)
    d.y[900:1000, :, 4] = NAN
    observer = AdaptiveObserver([model(n, (1, n), rel_sd=SPREAD, tolerances={})], 1.0, heat_rel_sd=0.0)
    observer._begin(d.inlet[0], d.y[0])  # both begin before the first step
    fast = follow(observer, d, start=1)
    core, core_sd = dense(n, d)
    off = np.abs(stacked(fast, "core")[:, 0] - core) / core_sd
    assert off.max() < 0.05
    band = stacked(fast, "core_sd")[:, 0]
    recent = np.lib.stride_tricks.sliding_window_view(core_sd, BLOCK + 1, axis=0)
    assert (band[BLOCK:] > 0.98 * recent.min(axis=-1)).all()
    assert (band[BLOCK:] < 1.02 * recent.max(axis=-1)).all()
    # after the start and after the readings have changed nothing is late
    np.testing.assert_allclose(band[:255], core_sd[:255], rtol=1e-9)
    np.testing.assert_allclose(band[905:1150], core_sd[905:1150], rtol=2e-3)
    np.testing.assert_allclose(stacked(fast, "core")[:255, 0], core[:255], atol=1e-9)


@pytest.mark.parametrize("cut", [300, 401, 407, 430, 650])
@pytest.mark.plain_cases(2)
def test_a_restart_within_a_block_goes_on_bit_for_bit(cut: int) -> None:
    """Whatever waits, and whichever way the running observer has taken, the restored one takes to the same bits."""
    n, d = 4, drive(4, 13, S=2)
    models = [model(n, (1, n), rel_sd=SPREAD), model(n, (1,), rel_sd={"R_u": 0.1})]
    a, b = AdaptiveObserver(models, 1.0), AdaptiveObserver(models, 1.0)
    follow(a, d, stop=cut)
    stored = json.dumps(a.snapshot(), allow_nan=False)
    assert json.dumps(a.snapshot(), allow_nan=False) == stored  # asking changes nothing
    b.restore(json.loads(stored))
    for x, y in zip(follow(a, d, start=cut), follow(b, d, start=cut), strict=True):
        for name in ("core", "core_sd", "surface", "surface_sd", "innovation", "innovation_sd"):
            assert getattr(x, name).tobytes() == getattr(y, name).tobytes()
    assert json.dumps(a.snapshot()) == json.dumps(b.snapshot())


def test_a_state_from_before_sensitivities_went_in_blocks_is_taken_up() -> None:
    n, d = 4, drive(4, 10)
    a, b = (AdaptiveObserver([model(n, (1, n), rel_sd=SPREAD)], 1.0) for _ in range(2))
    follow(a, d, stop=450)
    old = {k: v for k, v in json.loads(json.dumps(a.snapshot())).items() if k != "block"}
    b.restore(old)
    before, after = a.estimate(), b.estimate()
    assert (before.core == after.core).all()
    np.testing.assert_allclose(after.core_sd, before.core_sd, rtol=1e-12)
    x, y = (stacked(follow(o, d, start=450), "core_sd") for o in (a, b))
    np.testing.assert_allclose(y, x, rtol=0.03)  # one has made the steps that wait in the other


def test_a_string_is_observed_as_if_alone() -> None:
    """Others of the stack lose sensors and inlets, and take parameters, at times of their own."""
    n, S, d = 3, 4, drive(3, 12, S=4)
    d.y[400:420, 1, 2] = NAN
    d.inlet[500:530, 2] = NAN
    models = [model(n, (1, n), rel_sd=SPREAD, R_e=3.5e-3 * (1 + 0.01 * s)) for s in range(S)]

    def run(at: list[int]) -> np.ndarray:
        o = AdaptiveObserver([models[s] for s in at], 1.0)
        part = Drive(d.core[:, at], d.surface[:, at], d.I2[:, at], d.inlet[:, at], d.y[:, at])
        first = follow(o, part, stop=600)
        if 3 in at:
            o.set_parameters(at.index(3), {"R_e": 3.4e-3}, ("R_e",), np.array([[0.01]]))
        both = first + follow(o, part, start=600)
        return np.concatenate([stacked(both, "core"), stacked(both, "core_sd")])

    together = run([0, 1, 2, 3])
    for s in range(S):
        np.testing.assert_array_equal(run([s])[:, 0], together[:, s])


def test_the_next_stride_is_told_as_it_comes() -> None:
    rng = np.random.default_rng(0)
    held, since = rng.integers(1, 5000, 200), rng.integers(0, 100, 200)
    since = np.minimum(since, held)
    left = steps_left(held, since)
    for k in range(int(left.max()) + 1):
        now = due(held + k + 1, since + k)
        assert not now[left > k].any()
        assert now[left == k].all()


def test_a_block_is_its_steps_one_by_one() -> None:
    """Steps of constant forcing at once, and by `carried` and `corrected`."""
    n, d = 4, drive(4, 8)
    o = AdaptiveObserver([model(n, (1, n), rel_sd=SPREAD)], 1.0)
    follow(o, d, stop=300)
    every = np.array([0])
    while o._blocks.waiting[0] < BLOCK:
        follow(o, d, start=300, stop=301)
    whole = o._blocks.caught_up(every, o._flows, o._kalman, o._state)
    F, J = o._blocks._forcing(every, o._flows), o._blocks.J.copy()
    for _ in range(BLOCK):
        on = carried(J, o._kalman.model.A, F, 1.0)
        J, _ = corrected(on, J, o._blocks._K, o._kalman.sensors, np.zeros((1, 2)))
    np.testing.assert_allclose(whole, J, rtol=1e-9, atol=1e-9)
