"""A hole of minutes in a log: the drive goes on in it unseen, and the cells are not at rest where the log goes on."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.diagnosis.diagnosis import diagnose
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import Scenario, make_log
from tests.truth.suites import suited

HOLE = slice(1400, 2200)
QUIET = (
    Scenario(cells=3, sensors=(1, 2, 3), cycle="urban", seed=6_400_000),
    Scenario(cells=3, sensors=(1, 2, 3), cycle="us06", inlet="sine", step=0.1, seed=6_400_003),
    Scenario(cells=3, sensors=(1, 3), cycle="pulses", inlet="constant", noise=0.05, seed=6_400_004),
    Scenario(cells=3, sensors=(1, 2, 3), cycle="mixed", inlet="sine", noise=0.05, seed=6_400_006),
)
"""Logs in which a start from rest after the hole looked like a thermocouple off its cell, or a loss to the ambient."""


def with_hole(scenario):
    log = make_log(scenario)
    keep = np.ones(scenario.seconds, np.bool_)
    keep[HOLE] = False
    table = {name: column[keep] for name, column in log.table.items()}
    return record_of(replace(log, table=table, core=log.core[keep], surface=log.surface[keep]))


@pytest.mark.parametrize("scenario", QUIET, ids=lambda s: s.cycle)
@pytest.mark.plain_cases(2)
def test_a_hole_in_a_log_is_no_effect(scenario):
    record, model = with_hole(scenario)
    assert len(record.segments) == 2
    found = diagnose(model, [record])
    assert (found.verdict, found.unknown_remains, found.selected) == ("adequate", False, ()), found.sentence


@pytest.mark.slow
def test_an_effect_is_named_in_a_log_with_a_hole():
    record, model = with_hole(suited({"resistance_temperature": "medium"}, 3, 6_400_020, reading=(0.1, 0.1)))
    found = diagnose(model, [record])
    assert [s.candidate.name for s in found.selected] == ["resistance_temperature"], found.sentence
