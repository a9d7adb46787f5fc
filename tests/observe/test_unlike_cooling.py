"""Cells that may be cooled otherwise than the model says: one more state each, of which readings tell."""

import json

import numpy as np
import pytest

from bms_gateway.observe import AdaptiveObserver, Disturbance, stack, start_covariance
from bms_gateway.observe.forecast_start import Coming
from bms_gateway.observe.outlook import Outlook
from bms_gateway.thermal import Prior, Start, StringModel, StringParameters

CELLS, R_U, R_C = 3, 0.79, 1.266
TABLE_1 = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": R_C, "R_u": R_U, "R_cc": 1e6}
UNLIKE = Disturbance(cooling_cell=0.3)


def observer(disturbance: Disturbance) -> AdaptiveObserver:
    model = StringModel(CELLS, (1, 2, 3), "natural", {k: Prior(x, 0.1) for k, x in TABLE_1.items()})
    return AdaptiveObserver([model], 1.0, disturbance, several=True)


def test_heat_that_stays_in_a_surface_warms_its_cell_as_a_whole() -> None:
    m = stack([StringParameters.of(CELLS, **TABLE_1)], 1e6, Disturbance(cooling_cell=0.3, correlation=1e12))
    assert (m.cells, m.states) == (CELLS, 3 * CELLS + 2)
    x = np.concatenate((np.full(2 * CELLS, 25.0), [0.0, 2.0, 0.0], [0.0, 0.0]))
    T = m.advance(x[None], np.zeros((1, CELLS)), np.full(1, 25.0), np.full(1, 25.0))[0]
    assert T[: 2 * CELLS] == pytest.approx([25.0, 25.0, 25.0 + 2.0 * R_U, 25.0 + 2.0 * R_U, 25.0, 25.0], abs=1e-3)


def test_at_the_start_a_cells_cooling_is_as_unknown_as_ever() -> None:
    P = start_covariance(CELLS, Start(), UNLIKE)
    assert P.diagonal()[2 * CELLS : -2] == pytest.approx(np.full(CELLS, 0.09))


def followed(of: AdaptiveObserver, steps: int, hot_K: float = 6.0) -> np.ndarray:
    """Surfaces that settle, the last one `hot_K` above the others: cores (n,) at the end."""
    heat = 3.5e-3 * 3600.0
    level = 25.0 + R_U * heat
    y = np.array([[level, level, level + hot_K]])
    for _ in range(steps):
        e = of.step(np.array([3600.0]), None, np.array([25.0]), y, np.zeros((1, CELLS)))
    return e.core[0]


def test_a_hot_surface_is_that_of_a_cell_cooled_worse_where_cells_may_be_unlike() -> None:
    """6 K above the others by cooling are 6 K in the core; by heat they would be 6 (1 + R_c / R_u) = 15.6 K."""
    by_cooling, by_heat = (followed(observer(d), 4000) for d in (UNLIKE, Disturbance()))
    assert 5.0 < by_cooling[2] - by_cooling[:2].mean() < 8.5
    assert by_heat[2] - by_heat[:2].mean() > 11.0


def test_it_goes_on_after_a_restart_bit_for_bit_and_over_a_gap() -> None:
    first, second = observer(UNLIKE), observer(UNLIKE)
    followed(first, 300)
    second.restore(json.loads(json.dumps(first.snapshot())))
    assert (followed(first, 50) == followed(second, 50)).all()
    e = first.propagate(30.0)
    assert e.core[0, 2] - e.core[0, 0] > 3.0
    assert np.isfinite(e.core_sd).all()


def test_a_forecast_keeps_the_cooling_of_each_cell() -> None:
    of = observer(UNLIKE)
    followed(of, 4000)
    s = of.standing()
    nothing = np.zeros((1, CELLS))
    by_R_e, one = np.full(1, np.nan), np.zeros((1, 1))
    coming = Coming(by_R_e, np.zeros((4, 1)), nothing, nothing, nothing, nothing, one, np.full(1, 60.0))
    ahead = Outlook().ahead(s, coming)
    assert (ahead.still.core[:, 0, 2] - ahead.still.core[:, 0, 0]).min() > 2.0
