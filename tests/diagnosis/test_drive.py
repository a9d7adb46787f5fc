"""A drive whose parts do not fit together is refused where it is made."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.diagnosis.record import make_record
from bms_gateway.diagnosis.record_inputs import Columns
from tests.diagnosis.logs import rows, string_model


@pytest.mark.parametrize(
    ("wrong", "word"),
    [({"I2": np.ones(3)}, "I2"), ({"dt": 0.0}, "last"), ({"known": frozenset({"humidity"})}, "humidity")],
)
def test_parts_that_do_not_fit_are_refused(wrong, word):
    drive = make_record(Columns(**rows(600), source="log"), string_model()).drive
    with pytest.raises(ValueError, match=word):
        replace(drive, **wrong)
