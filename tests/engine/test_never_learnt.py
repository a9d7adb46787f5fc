"""The band of a string that only has the greatest reading: its R_c is never learnt, and known to a factor."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.engine.observed import _never_learnt
from bms_gateway.thermal import Prior, StringModel


@pytest.mark.parametrize("s", [0.1, 0.35, 0.6])
def test_two_deviations_hold_what_a_log_normal_number_may_be(s: float) -> None:
    priors = {"C_c": 1800.0, "C_s": 130.0, "R_e": 6e-4, "R_c": 0.35, "R_u": 0.5}
    model = StringModel(1, (1,), "single", {k: Prior(v, s) for k, v in priors.items()})
    wide = _never_learnt(model)
    draws = np.exp(s * np.random.default_rng(1).normal(size=20_000))
    for name in ("R_e", "R_c"):
        assert np.mean(np.abs(draws - 1.0) <= 2.0 * wide.priors[name].rel_sd) > 0.97
        assert wide.priors[name].value == model.priors[name].value
    assert np.mean(np.abs(draws - 1.0) <= 2.0 * s) < 0.96 or s < 0.2
    assert wide.priors["R_u"] == model.priors["R_u"]
    assert replace(wide, priors=model.priors) == model
