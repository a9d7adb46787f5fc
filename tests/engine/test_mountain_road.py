"""Reversible heat from the log to the cores: half an hour uphill, then downhill, by `encode` and `analyze`."""

import pytest

from tests.benchmarks.bench_mountain import MountainRoad, outcome
from tests.benchmarks.honesty_road import ROOT


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.2, -0.2])
def test_a_core_is_within_its_band_although_the_current_keeps_its_sign(size: float) -> None:
    """With the square of the current alone, these two strings were within 2 sd for 86 and 82 % of the time."""
    found = outcome(MountainRoad("liquid", size, False, 11), "known", ROOT, "window")
    score = found.scores["settled"]
    assert score.inside > 0.97
    assert score.rmse < 1.1
    assert score.sd < 1.6
    assert score.told == 0.0
