"""Thermocouples that are read in whole steps, as vehicles send them: what is rounded away is no error of the model.

Beside the independent truth: with nothing hidden, the numbers are learnt, the cores are known, and nothing is said to
be missing. With an effect hidden, the cores are not called proven.
"""

import numpy as np
import pytest

from bms_gateway.diagnosis.calibrate import identify
from bms_gateway.diagnosis.compare import compare
from bms_gateway.diagnosis.core_known import known_core
from bms_gateway.diagnosis.diagnosis import diagnose
from bms_gateway.diagnosis.filed import held_out
from bms_gateway.diagnosis.model_error import ModelError, averaged
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.record_windows import learned
from tests.diagnosis.hidden_record import record_of
from tests.diagnosis.number_errors import off
from tests.truth.hidden import Scenario, make_log

PLACES = {1: (1,), 5: (1, 3, 5)}
MOST_SD = 3.0
SURE_K = 2.5
"""95 % half width of a core, K, with steps of 1 K."""


def coarse(cells, step, seed, hidden=None, noise=0.05):
    effects = {} if hidden is None else {hidden: ("strong", None)}
    columns = ("soc",) if cells == 1 else ("soc", "flow")
    log = make_log(
        Scenario(effects, cells=cells, sensors=PLACES[cells], noise=noise, step=step, seed=seed, columns=columns)
    )
    return (log, *record_of(log))


@pytest.mark.parametrize(
    ("cells", "step", "noise", "seed"), [(1, 1.0, 0.05, 61), (1, 1.0, 0.01, 62), (5, 1.0, 0.05, 63), (5, 0.5, 0.02, 64)]
)
@pytest.mark.plain_cases(2)
def test_an_exact_model_is_told_to_be_one(cells, step, noise, seed):
    log, record, model = coarse(cells, step, seed, noise=noise)
    found = identify(model, [record])
    assert found.model_error_K == 0.0
    assert np.abs(off(found.fit, log)).max() < MOST_SD
    core = known_core(model, [record], found)
    assert core.proven
    assert max(core.half_width_K) < SURE_K
    (band,) = core.bands
    truth = np.stack([np.interp(band.time_s, log.table["time_s"], c) for c in log.core.T], axis=1)
    assert np.mean(np.abs(band.T_c - truth) <= 2.0 * band.total_K) > 0.95
    d = diagnose(model, [record])
    assert (d.verdict, d.selected) == ("adequate", ())
    assert not any(s.disagrees for s in compare(model, [record]).refitted.sensors)


@pytest.mark.parametrize(
    ("cells", "hidden"), [(1, "entropic_heat"), (1, "resistance_temperature"), (5, "ambient_loss")]
)
@pytest.mark.plain_cases(1)
def test_a_core_is_not_proven_where_an_effect_is_missing(cells, hidden):
    _, record, model = coarse(cells, 1.0, 65, hidden)
    assert not known_core(model, [record]).proven


@pytest.mark.parametrize(("cells", "seed"), [(1, 66), (5, 67)])
@pytest.mark.plain_cases(1)
def test_windows_learn_from_whole_kelvins(cells, seed):
    log, record, model = coarse(cells, 1.0, seed)
    known = learned(model, [held_out(averaged(measured(record, model), ModelError()))])
    sd = dict(zip(known.names, np.sqrt(np.diag(known.cov)), strict=True))
    mean = dict(zip(known.names, known.mean, strict=True))
    for name in ("R_e", "R_u"):
        assert sd[name] < 0.6 * model.priors[name].rel_sd
        assert abs(mean[name] - np.mean(np.log(log.pack[name]))) < MOST_SD * sd[name]
