"""Which effects let the windowed method follow a string, and that the others keep the numbers of their fit."""

import numpy as np
import pytest

from bms_gateway.identify import FixedIdentifier, WindowIdentifier, build
from bms_gateway.identify.window_effects import heat_only
from bms_gateway.thermal import AddedEffect, Prior, StringModel
from bms_gateway.thermal.effects import catalogue

VALUES = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79, "R_cc": 4.0, "C_f": 11.33}
HEAT_AND_INPUTS = {
    "entropic_heat", "voltage_heat", "resistance_temperature", "resistance_soc", "resistance_asymmetry",
    "charge_transfer", "hysteresis", "polarization", "resistance_drift", "cell_resistance", "coolant_delay",
    "inlet_offset", "current_offset",
}  # fmt: skip
"""By their equations in the catalogue: heat of the core, current or inlet, and nothing else."""


def model(name: str) -> StringModel:
    kind = catalogue()[name]
    added = AddedEffect(name, None if kind.place == "string" else 2, {p.name: p.probe for p in kind.parameters})
    return StringModel(4, (1, 4), "full", {k: Prior(v, 0.1) for k, v in VALUES.items()}, effects=(added,))


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_only_effects_of_heat_and_inputs_are_followed(name: str) -> None:
    assert heat_only(model(name)) == (name in HEAT_AND_INPUTS)
    expected = WindowIdentifier if name in HEAT_AND_INPUTS else FixedIdentifier
    assert type(build("window", model(name))) is expected
    assert type(build("rls", model(name))) is FixedIdentifier


def test_what_is_fixed_says_why() -> None:
    fixed, off = build("window", model("surface_joule")), build("off", model("surface_joule"))
    assert {e.status for e in fixed.estimates()} == {"fixed: identified offline, with its effects"}
    assert {e.status for e in off.estimates()} == {"fixed"}
    np.testing.assert_array_equal([e.value for e in fixed.estimates()], [e.value for e in off.estimates()])
