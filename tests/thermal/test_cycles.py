"""Drive cycles have the figures of their namesakes, carry no net charge, and belong to their seed."""

import numpy as np
import pytest

from bms_gateway.thermal.cycles import CYCLES, UDDS_S, URBAN_ASSAULT_S, US06_S, udds, urban_assault, us06


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("capacity", [8.0, 2.3])
def test_the_urban_assault_cycle_has_the_papers_figures_per_ampere_hour(seed, capacity):
    current = urban_assault(np.random.default_rng(seed), capacity)
    assert current.shape == (URBAN_ASSAULT_S,)
    assert current.max() == pytest.approx(20 * capacity)
    assert current.min() == pytest.approx(-12 * capacity)
    assert np.sqrt(np.mean(current**2)) == pytest.approx(62.2 / 8 * capacity, rel=1e-3)
    assert abs(current.mean()) < 1e-3 * capacity


@pytest.mark.parametrize("seed", range(8))
def test_the_motorway_is_harder_than_the_town_for_the_same_vehicle(seed):
    hard, mild = (f(np.random.default_rng(seed)) for f in (us06, udds))
    assert (len(hard), len(mild)) == (US06_S, UDDS_S)
    rms = [float(np.sqrt(np.mean(x**2))) for x in (hard, mild)]
    assert 45 < rms[0] < 70
    assert 20 < rms[1] < 45
    for current in (hard, mild):
        assert abs(current.mean()) < 0.05
        assert current.max() <= 160
        assert current.min() >= -96


@pytest.mark.parametrize("name", CYCLES)
def test_a_cycle_belongs_to_its_seed_and_grows_with_the_cell(name):
    draw = CYCLES[name]
    one, two, other = (draw(np.random.default_rng(s), 8.0) for s in (3, 3, 4))
    assert np.array_equal(one, two)
    assert not np.array_equal(one, other)
    assert draw(np.random.default_rng(3), 2.0) == pytest.approx(one / 4)
