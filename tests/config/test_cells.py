"""`[cells]`: what the voltages of single cells are worth reaches the plan, and a slip is told."""

import pytest

from bms_gateway.config import load_config
from bms_gateway.errors import ConfigError
from bms_gateway.identify.cell_prior import SPREAD, CellSettings
from tests.config.files import OWN, write


def test_defaults_are_those_of_the_method(tmp_path):
    settings = load_config(write(tmp_path, OWN)).plan.cells
    assert settings == CellSettings(spread=dict(SPREAD))


def test_known_joints_and_a_large_skew_reach_the_plan(tmp_path):
    text = OWN + "[cells]\njoint_rel_sd = 0.01\nvoltage_skew_s = 0.5\nR_e_rel_sd = 0.05\n"
    settings = load_config(write(tmp_path, text)).plan.cells
    assert (settings.joint_sd, settings.skew_s, settings.spread["R_e"]) == (0.01, 0.5, 0.05)


@pytest.mark.parametrize(
    ("line", "told"),
    [("joint_sd = 0.01", "did you mean 'joint_rel_sd'"), ("joint_rel_sd = 3.0", "cells.joint_rel_sd: 3.0")],
)
def test_a_slip_is_told(tmp_path, line, told):
    with pytest.raises(ConfigError, match=told):
        load_config(write(tmp_path, OWN + f"[cells]\n{line}\n"))
