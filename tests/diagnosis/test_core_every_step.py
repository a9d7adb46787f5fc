"""A core at every row of the trajectory: the mean of the fit, and the band that all of its sensitivities give."""

import numpy as np
import pytest

import bms_gateway as bms
from bms_gateway.config.dbc_files import shipped
from bms_gateway.diagnosis import core_band
from bms_gateway.diagnosis.core_band import at_every_step, core_bands


@pytest.fixture(scope="module")
def fit():
    model = bms.read_model(str(shipped("deploy/worked/bench.toml")))
    (record,) = bms.read_records(str(shipped("deploy/worked/bench.csv.gz")), model=model)
    return bms.compare(model, record).comparison.refitted.fit


@pytest.mark.parametrize(("instants", "mean", "most"), [(600, 0.005, 0.05), (100, 0.03, 0.25)])
def test_it_is_the_band_of_all_rows_wherever_few_were_computed(fit, monkeypatch, instants, mean, most):
    monkeypatch.setattr(core_band, "POINTS", 1_000_000)
    (exact,) = core_bands(fit)
    monkeypatch.setattr(core_band, "POINTS", instants)
    (few,) = core_bands(fit)
    found = at_every_step(few, fit)
    assert len(few.time_s) <= 0.51 * len(exact.time_s)
    np.testing.assert_array_equal(found.time_s, exact.time_s)
    np.testing.assert_allclose(found.T_c, exact.T_c, atol=1e-9)
    off = found.total_K / exact.total_K - 1.0
    assert np.sqrt(np.mean(off**2)) < mean
    assert np.abs(off).max() < most
