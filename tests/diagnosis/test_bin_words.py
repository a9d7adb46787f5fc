"""Edges of the bins of regimes, as people read them."""

import numpy as np

from bms_gateway.diagnosis.regimes import directions, rounded


def test_no_edge_is_a_negative_zero_nor_is_a_current_told_by_its_sign():
    edges = rounded(np.array([-1.004, -0.004, 0.004, 1.004]), 5.0)
    assert [f"{x:g}" for x in edges] == ["-1", "0", "0", "1"]
    current = np.repeat([-40.0, -20.0, -0.5, 0.0, 0.5, 20.0, 40.0], 100)
    _, labels = directions(current, 40.0)
    assert labels == (
        "while charging above 20 A",
        "while charging below 20 A",
        "at rest",
        "while discharging below 20 A",
        "while discharging above 20 A",
    )
    assert not any("-" in text or "−" in text for text in labels)
