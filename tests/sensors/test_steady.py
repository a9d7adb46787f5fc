"""Steady uncertainties are those of the Riccati equation that scipy solves, and of the filter itself."""

import itertools

import numpy as np
import pytest

from bms_gateway.sensors import Steady, steady_core_sd
from bms_gateway.sensors import steady as module
from bms_gateway.thermal import Disturbance, StringParameters
from tests.sensors.strings import COUPLINGS, cells, riccati, sampled


@pytest.mark.parametrize(
    ("sensors", "sd"),
    [
        ((), 1.411),
        ((12,), 0.732),
        ((1, 12), 0.485),
        ((1, 2, 12), 0.467),
        ((3, 6, 9, 12), 0.496),
        ((1, 2, 11, 12), 0.429),
        (tuple(range(1, 13)), 0.366),
    ],
)
def test_worst_core_of_twelve_cells_is_as_derived(sensors, sd):
    assert steady_core_sd(cells(12), sensors).max() == pytest.approx(sd, rel=0.01)


@pytest.mark.parametrize("condition", COUPLINGS)
@pytest.mark.parametrize("n", [1, 2, 5, 12])
def test_every_core_is_known_as_scipys_riccati_says(n, condition):
    p = cells(n, condition)
    sets = [(), (1,), (n,), tuple(range(1, n + 1)), tuple(range(1, n + 1, 3))]
    sets = list(dict.fromkeys(sets))
    for got, s in zip(Steady.of(p).core_sd(sets), sets, strict=True):
        np.testing.assert_allclose(got, riccati(p, s), rtol=2e-6, err_msg=str(s))


@pytest.mark.parametrize("seed", range(12))
def test_other_cells_other_errors_and_other_rates_too(seed):
    rng = np.random.default_rng(seed)
    n, dt = int(rng.integers(1, 8)), float(rng.choice([0.1, 1.0, 10.0]))
    p = StringParameters.of(
        n,
        C_c=rng.uniform(20, 2000, n),
        C_s=rng.uniform(5, 60, n),
        R_e=1e-3,
        R_c=rng.uniform(0.5, 3.0, n),
        R_u=rng.uniform(0.3, 5.0, n),
        R_cc=float(rng.choice([0.5, 30.0, np.inf])),
        C_f=float(rng.choice([5.0, 50.0, np.inf])),
        coolant="ntu",
    )
    d = Disturbance(
        heat_common=float(rng.choice([0.0, 2.0])),
        heat_cell=float(rng.choice([0.05, 1.0])),
        inlet=float(rng.choice([0.1, 2.0])),
        correlation=float(rng.choice([60.0, 3600.0])),
        sensor=float(rng.choice([0.02, 0.5])),
    )
    steady = Steady.of(p, d, dt=dt)
    for m in {1, n}:
        s = tuple(sorted(rng.choice(np.arange(1, n + 1), m, replace=False).tolist()))
        # slow cells that nothing couples to a sensor are beyond scipy's last digits, by 1.3e-5 in one of these
        np.testing.assert_allclose(steady.core_sd([s])[0], riccati(p, s, d, dt), rtol=5e-5)


def test_long_strings_are_solved_exactly_too():
    p = cells(60)
    for s in ((30,), (1, 60), tuple(range(5, 61, 5))):
        np.testing.assert_allclose(steady_core_sd(p, s), riccati(p, s), rtol=2e-6)


def test_a_set_is_worth_the_same_alone_and_among_others():
    steady = Steady.of(cells(6))
    sets = [(), *itertools.chain.from_iterable(itertools.combinations(range(1, 7), m) for m in (3, 1, 2))]
    np.testing.assert_allclose(steady.core_sd(sets), [steady.core_sd([s])[0] for s in sets], rtol=1e-12)


def test_the_filter_itself_ends_there():
    p, sensors, d = cells(3), (1, 3), Disturbance()
    Phi, Q = sampled(p, d, 1.0)
    C = np.eye(6)[[1, 5]]
    P = np.eye(6) * 100
    for _ in range(6000):
        P = Phi @ P @ Phi.T + Q
        P -= P @ C.T @ np.linalg.solve(C @ P @ C.T + d.sensor**2 * np.eye(2), C @ P)
    np.testing.assert_allclose(steady_core_sd(p, sensors), np.sqrt(np.diag(P)[0::2]), rtol=1e-5)


def test_with_independent_heat_errors_only_no_placement_helps_an_unsensed_cell():
    d = Disturbance(heat_common=0.0, heat_cell=0.5, inlet=0.0)
    p = cells(6, "single")
    np.testing.assert_allclose(steady_core_sd(p, (1, 6), d)[1:5], steady_core_sd(p, (), d)[1:5], rtol=1e-6)


def test_where_nothing_is_unknown_every_core_is_known():
    d = Disturbance(heat_common=0.0, heat_cell=0.0, inlet=0.0)
    assert steady_core_sd(cells(3), (2,), d).max() < 1e-9


def test_what_has_not_settled_is_doubled_to_the_same(monkeypatch):
    p, sets = cells(6), [(1,), (3, 6), (1, 2, 3)]
    settled = Steady.of(p).core_sd(sets)
    monkeypatch.setattr(module, "PATIENCE", 8)
    np.testing.assert_allclose(Steady.of(p).core_sd(sets), settled, rtol=1e-7)
    np.testing.assert_allclose(settled, [riccati(p, s) for s in sets], rtol=2e-6)


@pytest.mark.parametrize("R_cc", [0.05, 4.0, np.inf])
def test_cells_that_differ_by_orders_of_magnitude_are_solved_too(R_cc):
    p = StringParameters.of(
        3,
        C_c=np.array([5.0, 9000.0, 268.0]),
        C_s=np.array([0.3, 700.0, 18.8]),
        R_e=1e-3,
        R_c=np.array([0.02, 4.0, 1.266]),
        R_u=np.array([150.0, 0.05, 0.79]),
        R_cc=R_cc,
        C_f=40.0,
        coolant="ntu",
    )
    for s in ((1,), (2, 3), (1, 2, 3)):
        np.testing.assert_allclose(steady_core_sd(p, s), riccati(p, s), rtol=1e-4, err_msg=str(s))
