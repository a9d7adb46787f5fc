"""One single temperature of the battery beside others: told for what it is by the data, and never in place of them."""

import numpy as np
import pytest

from tests.setup.proposals import proposed
from tests.setup.vehicles import drive, plain

WARM = drive(8).surface[:, :4] + np.array([0.0, 1.5, 2.5, 5.0])
RISE = WARM.mean(axis=1) - WARM.mean(axis=1)[0]
LONE = {
    "mean": (WARM.mean(axis=1), "by the data the mean of"),
    "greatest": (WARM.max(axis=1), "by the data the greatest of"),
    "a cell": (WARM[:, 1], "a sensor of an unknown place, between the least and the greatest of"),
    "elsewhere": (WARM.min(axis=1) - 4.0 - 0.5 * RISE, "a sensor of an unknown place, up to"),
}
PATH = "Thermal_BatteryTemp.BatteryTemp"
MODULES = {f"ModuleTemp{k + 1}": WARM[:, k] for k in range(4)}
ENDS = {"BatteryTempMax": WARM.max(axis=1), "BatteryTempMin": WARM.min(axis=1)}


def found(values, folder):
    proposal = proposed(plain(values, unit="degC"), folder)
    return proposal, [p.path for p in proposal.of("surface")]


@pytest.mark.parametrize("kind", LONE)
def test_beside_modules_it_is_told_in_one_line(kind, tmp_path):
    values, says = LONE[kind]
    proposal, used = found(MODULES | {"BatteryTemp": values}, tmp_path)
    assert used == [f"Thermal_{k}.{k}" for k in MODULES]
    told = [r for r in proposal.remarks if r.startswith(f"{PATH}: ")]
    assert len(told) == 1
    assert says in told[0]
    assert dict(proposal.unused)[PATH] in told[0]


@pytest.mark.parametrize("kind", LONE)
def test_beside_the_greatest_and_the_least_too(kind, tmp_path):
    values, says = LONE[kind]
    proposal, used = found(ENDS | {"BatteryTemp": values}, tmp_path)
    assert used == [f"Thermal_{k}.{k}" for k in ENDS]
    told = " ".join(r for r in proposal.remarks if r.startswith(f"{PATH}: "))
    # a mean that no signal gives is between the two, as the sensor of a cell is
    assert (says if kind != "mean" else "between the least and the greatest of the cells") in told


def test_the_greatest_alone_goes_before_it(tmp_path):
    proposal, used = found({"BatteryTemp": WARM[:, 1], "BatteryTempMax": WARM.max(axis=1)}, tmp_path)
    assert used == ["Thermal_BatteryTempMax.BatteryTempMax"]
    assert next(proposal.of("surface")).statistic == "max"
    assert any("below the greatest of the cells" in r for r in proposal.remarks)


def test_a_limit_that_is_called_maximum_does_not(tmp_path):
    limit = np.full(len(WARM), 55.0)
    assert found({"BatteryTemp": WARM[:, 1], "BatteryTempMax": limit}, tmp_path)[1] == [PATH]


def test_alone_it_is_a_cell_nobody_knows_which(tmp_path):
    proposal, used = found({"BatteryTemp": WARM[:, 1]}, tmp_path)
    assert used == [PATH]
    p = next(proposal.of("surface"))
    assert not p.sure
    assert any("where its sensor sits is not known" in why for why in p.why)


def test_the_inlet_of_the_battery_is_not_said_to_be_unused(tmp_path):
    """A TMS_T_BatIn was the sure inlet, and a sensor of an unknown place that is not used."""
    inlet = drive(8).inlet
    proposal, _ = found(MODULES | {"TMS_Act.TMS_T_BatIn": inlet}, tmp_path)
    assert [p.path for p in proposal.of("coolant_inlet")] == ["TMS_Act.TMS_T_BatIn"]
    assert "TMS_Act.TMS_T_BatIn" not in dict(proposal.unused)
    assert not any("TMS_T_BatIn" in r for r in proposal.remarks)
