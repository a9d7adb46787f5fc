"""Where a record starts: the surfaces before the first load bent their readings, and how well they are known."""

import numpy as np
import pytest

from bms_gateway.diagnosis.diagnosis import diagnose
from bms_gateway.diagnosis.prepare import measured
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import Scenario, make_log, make_logs
from tests.truth.suites import suited

LOADED = [
    Scenario(cells=3, sensors=(1, 2, 3), seed=6_500_000 + i, cycle=cycle, noise=noise, seconds=600, effects=effects)
    for i, (cycle, noise, effects) in enumerate(
        (c, n, e)
        for c in ("pulses", "us06", "mixed", "urban")
        for n in (0.05, 0.2)
        for e in ({}, {"surface_joule": ("strong", None)}, {"busbar_joule": ("strong", None)})
    )
]


def test_cells_start_as_far_from_each_other_as_is_claimed():
    """What all are wrong by together has a number of its own in a fit, whose sd is half a kelvin."""
    z, common = [], []
    for log in make_logs(LOADED):
        record, model = record_of(log)
        m = measured(record, model)
        error = m.start[0] - log.surface[0]
        common.append(error.mean())
        z.append((error - error.mean()) / np.hypot(m.start_sd[0], 0.05))  # K, what a thermocouple may be off by
    assert np.sqrt(np.mean(np.square(z))) < 1.0
    assert np.abs(z).max() < 3.0
    assert np.abs(common).max() < 1.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "seed", "reading"),
    [
        ({"flow_dependent_cooling": "strong", "busbar_joule": "medium"}, 90005042, (0.1, 0.0)),
        ({"natural_convection": "strong", "cell_resistance": "medium"}, 90005044, (0.05, 0.0)),
        ({"cooling_drift": "strong", "cell_resistance": "medium"}, 90005041, (0.05, 0.1)),
    ],
    ids=lambda x: "+".join(x) if isinstance(x, dict) else None,
)
def test_nothing_superfluous_is_named_beside_a_strong_effect(hidden, seed, reading):
    log = make_log(suited(hidden, 5, seed, reading=reading))
    record, model = record_of(log)
    found = diagnose(model, [record])
    assert {s.candidate.name for s in found.selected} == set(hidden), found.sentence
    (resistance,) = [s for s in found.selected if s.candidate.name == "cell_resistance"] or [None]
    if resistance is not None:
        assert resistance.candidate.cell == log.cells["cell_resistance"]
