"""Flags rise late, fall later and do not flap."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_gateway.health import Ageing, Flag, Mismatch, Thresholds


@given(st.lists(st.floats(0, 0.3), max_size=60))
def test_the_level_changes_only_after_hold_agreeing_values(values: list[float]) -> None:
    flag = Flag(Thresholds((0.10, 0.20), (0.07, 0.16), hold=3))
    since = 0
    for v in values:
        before, changed = flag.level, flag.update(v)
        since += 1
        assert changed == (flag.level != before)
        if changed:
            assert since >= 3
            since = 0
            assert flag.level == 0 or v >= (0.07, 0.16)[flag.level - 1]


def test_a_value_between_fall_and_rise_keeps_the_level() -> None:
    flag = Flag(Thresholds((0.10,), (0.07,), hold=1))
    assert [flag.update(x) for x in (0.09, 0.11, 0.08, 0.071, 0.06)] == [False, True, False, False, True]


def test_a_missing_value_changes_nothing() -> None:
    flag = Flag(Thresholds((0.10,), (0.07,), hold=1))
    flag.update(0.2)
    assert not flag.update(float("nan"))
    assert flag.level == 1


@pytest.mark.parametrize(("truth", "level"), [(1.0, 0), (1.13, 1), (1.23, 2), (1.35, 3)])
def test_growth_is_flagged_and_its_absence_is_not(truth: float, level: int) -> None:
    rng = np.random.default_rng(5)
    a = Ageing()
    for _ in range(3):
        a.update(3.5e-3 * (1 + rng.normal(0, 0.02)), 0.07e-3)
    assert a.commissioned
    for _ in range(6):
        a.update(3.5e-3 * truth * (1 + rng.normal(0, 0.02)), 0.07e-3)
    assert a.flag.level == level
    assert a.growth == pytest.approx(truth - 1, abs=3 * a.growth_sd)


def test_the_baseline_survives_a_restart() -> None:
    a, b = Ageing(), Ageing()
    for R_e in (3.4e-3, 3.5e-3, 3.6e-3):
        a.update(R_e, 0.1e-3)
    b.restore(a.snapshot())
    assert b.commissioned
    assert b.baseline == a.baseline


def test_mismatch_rises_when_innovations_outgrow_their_band_and_not_on_white_noise() -> None:
    rng = np.random.default_rng(1)
    good, bad = Mismatch(), Mismatch()
    for _ in range(3000):
        good.update(rng.normal(0, 1, 2), 1.0)
        bad.update(rng.normal(3, 1, 2), 1.0)
    assert good.flag.level == 0
    assert good.excess == pytest.approx(1.0, abs=0.2)
    assert bad.flag.level == 2
    assert "3.2 times" in bad.sentence() or "3.1 times" in bad.sentence()
