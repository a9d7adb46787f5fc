"""What is said of a thermocouple in a core is what its readings are."""

import numpy as np
import pytest

from bms_gateway.diagnosis.compare import CoreCheck
from bms_gateway.report.core_text import outside, thermocouple_sentence


def check(covered):
    return CoreCheck(0, 2, 6.0, 1.8, covered, np.arange(2.0), np.arange(2.0))


@pytest.mark.parametrize(
    ("covered", "end", "alarm"),
    [
        (1.0, "6.00 K off, within the 95 % band.", False),
        (0.96, "6.00 K off; 4 % of its readings lie outside the 95 % band, as up to 5 % may.", False),
        (0.91, "6.00 K off; 9 % of its readings lie outside the 95 % band.", False),
        (0.60, "6.00 K off; 40 % of its readings lie outside the 95 % band.", True),
    ],
)
def test_a_thermocouple_is_within_a_band_only_where_its_readings_are(covered, end, alarm) -> None:
    """Of one with 9 % of its readings 20 K above the band it was said that it lies within."""
    assert thermocouple_sentence(check(covered)) == f"Thermocouple in the core of cell 2, never fitted to: {end}"
    assert outside(check(covered)) is alarm
