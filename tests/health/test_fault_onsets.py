"""Onsets since which faults are tried, and what a string must show before slow faults are told."""

import numpy as np

from bms_gateway.health.heat.course import Course
from bms_gateway.health.heat.fault_evidence import MOST, ONSETS, Evidence, Kind
from tests.benchmarks.heat_case import Case
from tests.health.heat_runs import alone, measured, raised


def test_the_onset_since_which_a_fault_is_likeliest_is_kept() -> None:
    """Bug: it made room for a newer onset within a minute or some, and the fault's evidence was gone."""
    for place in range(1, ONSETS - 1):
        f = alone()
        evidence = Evidence(f)
        f.begin(0, 30.0)
        for _ in range(60):
            evidence.take(f.step(measured(30.0)))
        onset = int(np.argsort(evidence.ages(0))[place])
        age = float(evidence.ages(0)[onset])
        jump = int(np.flatnonzero(evidence.kinds == Kind.JUMP)[0])
        evidence._C[0, onset, jump], evidence._D[0, onset, jump] = 400.0, 400.0  # a jump of 1 K, to 0.05 K
        for k in range(20):
            assert evidence.weigh().ln[0, :, jump].argmax() == onset
            evidence.take(f.step(measured(30.0)))
            assert age + (k + 1) * f.dt in evidence.ages(0)


def test_a_reading_that_falls_faster_than_any_drift_does_not_drift() -> None:
    f = alone()
    evidence = Evidence(f)
    f.begin(0, 30.0)
    for _ in range(100):
        evidence.take(f.step(measured(30.0)))
    slope = int(np.flatnonzero(evidence.kinds == Kind.SLOPE)[0])
    old = int(evidence.ages(0).argmax())
    for drift, possible in ((-0.5, True), (-1.5, False)):
        evidence._C[0, old, slope], evidence._D[0, old, slope] = 400.0, 400.0 * drift * MOST[Kind.SLOPE]
        assert np.isfinite(evidence.weigh().ln[0, old, slope]) == possible


def test_a_model_is_poor_where_a_thermocouple_is_off_by_more_than_any_is_and_has_not_jumped() -> None:
    f = alone()
    course, yes, no = Course.of(f, [False]), np.ones((1, 1), np.bool_), np.zeros((1, 1), np.bool_)
    for off, used, jumped, poor in (
        (0.8, yes, no, False),
        (1.5, yes, no, True),
        (1.5, yes, yes, False),
        (1.5, no, no, False),
    ):
        f.z[0, f.at.bias] = off
        course.compare(f, used, jumped)
        assert bool(course.poor[0]) is poor


def test_heat_in_a_cell_without_a_thermocouple_is_not_called_cooling() -> None:
    """Bug: the films of all cells and the inlet's offset strayed together to explain what one thermocouple read."""
    found = raised(Case("liquid", 0, drive="us06", fault="heat", cell=7, size=10.0), range(300, 306))
    assert [a for alerts in found for a in alerts if a[1] == "cooling"] == []
