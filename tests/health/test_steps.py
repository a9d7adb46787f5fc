"""Steps that a bus rounds temperatures to: what is quickly seen to be divided already is what Euclid would leave."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bms_gateway.health.heat.thermocouples import Thermocouples, common_divisor, finer


@given(st.integers(0, 10_000), st.sampled_from([0.01, 0.1, 0.25, 0.5, 1.0]), st.sampled_from([0.02, 0.3]))
def test_steps_are_those_of_euclid_whatever_is_read(seed, step, noise) -> None:
    rng = np.random.default_rng(seed)
    x = np.abs(np.round(rng.normal(20.0, noise, (30, 6)) / step) * step)
    x[rng.uniform(size=x.shape) < 0.1] = np.nan
    x[rng.uniform(size=x.shape) < 0.02] = 0.0
    ours, euclid = np.full((2, 6), np.inf)
    for now in x:
        asked = rng.uniform(size=6) < 0.7
        ours, euclid = finer(ours, now, asked), np.where(asked, common_divisor(euclid, now), euclid)
        np.testing.assert_allclose(ours, euclid, rtol=0.0, atol=1e-9)


def test_the_step_of_a_bus_is_found_from_noisy_readings() -> None:
    rng = np.random.default_rng(1)
    thermocouples = Thermocouples(2, 3)
    for _ in range(5):
        y = np.round(rng.normal(25.0, 0.3, (10, 2, 3)) / 0.1) * 0.1
        thermocouples.take(y, np.zeros_like(y), 1.0)
    assert np.allclose(thermocouples.step, 0.1)
