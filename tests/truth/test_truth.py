"""The truth itself: two integrators agree, and the cycle is what it claims."""

import numpy as np
import pytest

from tests.truth.cycle import repeated, urban_assault
from tests.truth.string import C_F, TruthString, by_superposition, lsoda, rk4, step_by_step, wavy_inlet


@pytest.mark.parametrize("coolant", ["bulk", "ntu"])
@pytest.mark.parametrize("B", [0.0, 3000.0])
def test_rk4_agrees_with_lsoda_to_a_microkelvin(coolant, B):
    rng = np.random.default_rng(1)
    truth = TruthString.of(3, R_e=3.5e-3 * rng.uniform(0.8, 1.2, 3), R_cc=4.0, C_f=C_F, coolant=coolant, B=B)
    current, inlet = repeated(3), wavy_inlet(180)
    for a, b in zip(rk4(truth, current, inlet, 22.0), lsoda(truth, current, inlet, 22.0), strict=True):
        assert np.abs(a - b).max() < 1e-5


def test_a_batch_equals_its_members():
    R_e = np.array([3e-3, 4e-3])[:, None]
    current, inlet = repeated(2), wavy_inlet(120)
    together = rk4(TruthString.of(2, batch=(2,), R_e=R_e, R_cc=4.0, C_f=C_F), current, inlet, 20.0)[0]
    alone = rk4(TruthString.of(2, R_e=4e-3, R_cc=4.0, C_f=C_F), current, inlet, 20.0)[0]
    assert np.allclose(together[:, 1], alone, rtol=0, atol=1e-12)


@pytest.mark.parametrize("coolant", ["bulk", "ntu"])
@pytest.mark.parametrize("batch", [(), (3,)])
def test_steps_by_superposition_are_the_steps_one_by_one(coolant, batch):
    rng = np.random.default_rng(2)
    truth = TruthString.of(3, batch=batch, R_e=rng.uniform(2e-3, 5e-3, (*batch, 3)), R_cc=4.0, C_f=C_F, coolant=coolant)
    x, inlet = rng.uniform(10, 40, (2, *batch, 3)), rng.uniform(10, 40, (601, *batch))
    I2, heat = rng.uniform(0, 1e4, (600, *batch)), rng.uniform(0, 20, (600, *batch, 3))
    for given in (None, heat):
        how = truth, x, I2, inlet, given, 0.5, 2
        assert np.abs(by_superposition(*how) - step_by_step(*how)).max() < 1e-10


def test_heat_leaves_the_string_with_the_coolant():
    # At rest after a long constant current the stream has taken all heat: outlet − inlet = n q / C_f.
    truth = TruthString.of(4, R_cc=4.0, C_f=C_F)
    core, surface = rk4(truth, np.full(8000, 50.0), np.full(8001, 25.0), 25.0, dt=2.0)
    rates = truth.rates(core[-1], surface[-1], np.float64(25.0), np.float64(2500.0))
    assert max(np.abs(r).max() for r in rates) < 1e-5
    stream = 25.0
    for T_s in surface[-1]:
        stream += (T_s - stream) / (0.79 * C_F)
    assert (stream - 25.0) * C_F == pytest.approx(4 * 2500 * 3.5e-3, rel=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_the_cycle_has_the_papers_figures(seed):
    current = urban_assault(seed)
    assert len(current) == 1332
    assert (current.max(), current.min()) == (160.0, -96.0)
    assert np.sqrt(np.mean(current**2)) == pytest.approx(62.2, abs=0.3)
    assert abs(current.mean()) < 0.5
