"""What a record says of its own current sensor counts more than what an offset of it would do for a temperature."""

import numpy as np
import pytest

from bms_gateway.diagnosis.adding import check_signals, wanted
from bms_gateway.diagnosis.candidates import candidates
from bms_gateway.diagnosis.current_sensor import charge_too_much, rests_at_zero
from bms_gateway.errors import DataError
from bms_gateway.thermal.drive import Drive
from tests.diagnosis.hidden_record import hidden
from tests.diagnosis.logs import string_model


def drive(amps, dt=1.0):
    amps = np.asarray(amps, float)
    one, none = np.ones(len(amps)), np.full(len(amps), np.nan)
    return Drive(dt, amps, amps**2, np.abs(amps), 25 * one, one, 0.5 * one, none, none, 0 * one, frozenset())


def pulses(rest, level=40.0):
    """Pulses both ways with rests of a minute that read `rest`, A."""
    return drive(np.tile(np.repeat([level, rest, -level, rest], 60), 5))


@pytest.mark.parametrize("read", [0.0, 0.01, -0.05])
def test_a_rest_that_reads_zero_rules_an_offset_out(read):
    assert rests_at_zero(pulses(read))
    offered = {c.name for c in candidates(string_model(), pulses(read), (20.0, 40.0))}
    assert "current_offset" not in offered
    assert "resistance_asymmetry" in offered


@pytest.mark.parametrize("read", [0.8, -2.2, 5.5])
def test_a_rest_that_reads_an_offset_does_not(read):
    assert not rests_at_zero(pulses(read))
    assert "current_offset" in {c.name for c in candidates(string_model(), pulses(read), (20.0, 40.0))}


def test_a_drive_that_passes_through_zero_does_not_rest_there():
    through = np.tile(np.concatenate([np.linspace(60, -60, 240), np.linspace(-60, 60, 240)]), 40)
    assert not rests_at_zero(drive(through))
    assert not rests_at_zero(drive(np.random.default_rng(3).uniform(-60, 60, 40000)))


def test_rests_of_a_coarse_grid_count_by_their_length():
    assert rests_at_zero(drive([30, 0, 0, -30, 0, 0], dt=20.0))


@pytest.mark.parametrize(("b", "told"), [(-0.63, True), (0.63, True), (0.05, False), (-0.05, False)])
def test_an_offset_that_moves_the_whole_cell_is_none(b, told):
    """7.6 h, of which a cell of 5 Ah is discharged for one and charged for three: 4.8 Ah more have no place in it."""
    amps = np.repeat([0.0, 4.7, 0.0, -1.5, 0.0], [360, 360, 720, 1128, 168])
    said = charge_too_much(drive(amps, dt=10.0), b, 5.0)
    assert bool(said) == told
    assert not said or "through a cell of 5 Ah" in said


def test_a_true_offset_is_not_excluded_by_the_charge():
    """What is read too high is no charge: the current without the offset moves no more than the cell holds."""
    assert charge_too_much(drive(pulses(0.0).I + 5.5), 5.5, 0.4 * 8.0) == ""


def test_add_says_what_rules_it_out():
    _, record, model = hidden("entropic_heat", cycle="pulses", seconds=900, seed=3)
    if not rests_at_zero(record.drive):
        pytest.fail("this drive is to have rests")
    with pytest.raises(DataError, match="current_offset cannot be: the current reads zero where it rests"):
        check_signals([wanted("current_offset", model)], [record])
