"""The number by which a refusal measures an error is called what it is: the noise of a record has one value."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.diagnosis import weighing
from bms_gateway.diagnosis.weighing import Settings, gate


@pytest.mark.parametrize(
    ("left_open", "told"),
    [(0.0, "(noise 0.09 K)"), (0.12, "(noise 0.09 K, and 0.12 K that the current between rows leaves open)")],
)
def test_what_rows_leave_open_is_not_called_noise(monkeypatch, left_open, told):
    # Bug: of one record of 60 rows, "noise alone 0.0904 K" here and "(noise 0.116 K)" there.
    sigma, held = np.full(10, 0.09), np.ones(10, np.bool_)
    monkeypatch.setattr(weighing, "stacked", lambda _: (None, sigma))
    monkeypatch.setattr(weighing, "within", lambda _: held)
    monkeypatch.setattr(weighing, "rmse", lambda fit, _: fit.error_K)
    monkeypatch.setattr(weighing, "log_density", lambda fit, _: -fit.error_K)
    monkeypatch.setattr(weighing, "_needed", lambda *_: 0.0)
    before, after = (SimpleNamespace(problem=None, error_K=x) for x in (2.0, 1.9))
    said = gate(before, after, 1e6, 1.0, replace(Settings(), left_open=left_open))
    assert said == f"however closely fitted, it leaves a held-out error of 1.9 K {told}"
