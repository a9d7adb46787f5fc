"""A voltage beside the current: heat that the current seems to make, and does not."""

import numpy as np
import pytest

from bms_gateway.health.heat import HeatWatch
from bms_gateway.health.heat.heat_tick import HeatTick
from bms_gateway.health.heat.voltage_witness import VoltageWitness
from tests.benchmarks.heat_case import Case, make, model

STEP_S = 10.0


def steps(witness, shown, by_voltage, count):
    out = []
    for _ in range(count):
        witness.take(np.array([shown]), by_voltage, STEP_S)
        out.append(bool(witness.denies[0]))
    return out


def test_a_voltage_that_sags_believes_the_current() -> None:
    witness = VoltageWitness.of(np.array([0.5]))
    assert not any(steps(witness, 10.0, [np.array([8.0])], 20))
    assert not any(steps(witness, 10.0, [np.array([5.0])], 20))


def test_a_voltage_that_does_not_sag_denies_the_current_within_a_minute() -> None:
    witness = VoltageWitness.of(np.array([0.5]))
    steps(witness, 10.0, [np.array([10.0])], 20)
    denies = steps(witness, 10.0, [np.array([0.0])], 12)
    assert denies[6:] == [True] * 6
    assert not any(steps(witness, 0.0, [np.array([0.0])], 60)[30:])  # at rest, there is nothing to deny


@pytest.mark.parametrize("by_voltage", [[None], [np.array([np.nan])], [None, np.array([np.nan])]])
def test_without_a_voltage_nothing_is_denied(by_voltage) -> None:
    witness = VoltageWitness.of(np.array([0.5]))
    assert not any(steps(witness, 10.0, by_voltage, 20))


def minutes_to_missing_heat(by_voltage) -> float:
    """The shown current flows until minute 60, and not afterwards; heat by the voltage is that of the real current."""
    c = Case("liquid", 4, 4500, "us06", "scale", size=0.0, hard=False)
    (made,) = make([c])
    watch = HeatWatch([model("liquid")], 1.0)
    R_e = model("liquid").nominal.R_e.mean()
    for k in range(c.seconds):
        I = made.current[k : k + 1]  # noqa: E741
        heat = I**2 * R_e * (k < c.at) if by_voltage else None
        tick = HeatTick(I**2, I, made.inlet[k : k + 1], made.y[k][None, :], np.zeros((1, 12)), None, heat)
        for _, f in watch.add((k + 1) * 10**9, tick) or ():
            assert k >= c.at, "told before the fault"
            if f.code == "missing_heat":
                return (k - c.at) / 60.0
    return np.inf


def test_a_voltage_that_agrees_with_cool_cells_does_not_hide_that_the_current_is_wrong() -> None:
    alone = minutes_to_missing_heat(by_voltage=False)
    assert minutes_to_missing_heat(by_voltage=True) <= min(alone, 3.0)
