"""The numbers of a model that lacks something still: their sd is in proportion to their error, and so is the core's.

Beside the independent truth, over hidden effects, strings and seeds; of the model as it is and with one of two effects.
"""

from functools import cache

import numpy as np
import pytest

from bms_gateway.config.model_file import format_model, parse_model
from bms_gateway.diagnosis.adding import add_effects, wanted
from bms_gateway.diagnosis.calibrate import identify
from bms_gateway.diagnosis.core_band import core_bands, posterior
from bms_gateway.diagnosis.core_known import known_core
from tests.diagnosis.hidden_record import record_of
from tests.diagnosis.measured_cells import CELLS, bench_record
from tests.diagnosis.number_errors import NAMES, off
from tests.truth.hidden import Scenario, make_log

HEAT = ("resistance_temperature", "entropic_heat")
LOSS = ("ambient_loss", "resistance_temperature")
CASES = [
    *((HEAT, added, 1, seed) for added in HEAT for seed in (31, 32)),
    *((LOSS, LOSS[0], 1, seed) for seed in (31, 32)),
    (HEAT, HEAT[1], 3, 31),
    (LOSS, LOSS[0], 3, 31),
]
MOST = 2.0
"""Root mean square of the errors, in sd; 1 where every sd is right."""


@cache
def step(hidden, added, cells, seed):
    """Log, record, model and what adding one of two effects made of it."""
    sensors, columns = ((1,), ("soc",)) if cells == 1 else ((1, 2, 3), ("soc", "flow"))
    effects = dict.fromkeys(hidden, ("strong", None))
    log = make_log(
        Scenario(effects, cells=cells, sensors=sensors, seconds=1800, seed=seed, noise=0.05, columns=columns)
    )
    record, model = record_of(log)
    return log, record, model, add_effects(model, [record], [wanted(added, model)])


@pytest.mark.slow
@pytest.mark.parametrize("side", [0, 1], ids=["as it is", "with one of two effects"])
def test_the_sd_of_numbers_is_in_proportion_to_their_error(side):
    z = np.array([off(step(*case)[3].fits[side], step(*case)[0]) for case in CASES])
    assert np.sqrt(np.mean(z**2)) < MOST


@pytest.mark.slow
def test_the_same_holds_for_what_is_written():
    z = []
    for case in CASES:
        log, _, _, addition = step(*case)
        for name in NAMES:
            prior = parse_model(format_model(addition.model)).priors[name]
            z.append((np.mean(np.log(prior.value)) - np.mean(np.log(log.pack[name]))) / prior.rel_sd)
    assert np.sqrt(np.mean(np.square(z))) < MOST


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_cores_lie_in_the_band_of_the_numbers(case):
    log, record, _, addition = step(*case)
    for fit in addition.fits:
        (band,) = core_bands(fit)
        true = np.stack([np.interp(band.time_s, record.instants, c) for c in log.core.T], axis=1)
        late = band.time_s > 600.0
        assert np.mean(np.abs(band.T_c - true)[late] <= 2.0 * band.total_K[late]) >= 0.9


@pytest.mark.slow
@pytest.mark.parametrize("name", CELLS)
def test_cores_of_measured_cells_lie_in_the_band_of_the_numbers_with_an_effect(name):
    model, record, core = bench_record(name, every=2)
    addition = add_effects(model, [record], [wanted("resistance_temperature", model)])
    (band,) = addition.core[1].bands
    late = band.time_s > 600.0
    error = band.T_c[:, 0] - np.interp(band.time_s, record.instants, core)
    assert np.mean(np.abs(error[late]) <= 2.0 * band.total_K[late, 0]) >= 0.9


@pytest.mark.parametrize("case", [CASES[3], CASES[0], CASES[6]])
@pytest.mark.slow
def test_a_model_that_is_read_again_has_the_same_numbers_to_the_last_bit(case):
    _, record, _, addition = step(*case)
    again = parse_model(format_model(addition.model))
    found = identify(again, [record])
    assert np.array_equal(found.fit.theta, addition.fits[1].theta)
    assert np.array_equal(posterior(found.fit), posterior(addition.fits[1]))
    assert known_core(again, [record]).sd_K == addition.core[1].sd_K
