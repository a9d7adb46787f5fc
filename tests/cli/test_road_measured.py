"""The same road on a measured cell: two effects, one after the other, by its surface alone; the core only judges."""

import pytest

from tests.cli.calls import told
from tests.cli.measured_model import MODEL
from tests.data import need

COLUMNS = "time_s=t_s,current_A=-I_A,coolant_inlet_C=T_amb_C,surface_1_C=T_surf_C,core_1_C=T_core_C"
EVERY = 2
"""Rows taken: one every two seconds finds the same effects in half the time."""


@pytest.mark.slow
def test_effects_added_by_the_surface_bring_the_core_down(tmp_path):
    table = tmp_path / "cell.csv"
    names, *rows = need("core_surface", "lfp_32113_insulated_1.csv").read_text().splitlines()
    table.write_text("\n".join([names, *rows[::EVERY]]))
    models = [tmp_path / f"{name}.toml" for name in ("nominal", "fitted", "one", "two")]
    models[0].write_text(MODEL)
    told("fit", table, "--model", models[0], "--out", models[1], "--columns", COLUMNS)
    words = ("--data", table, "--columns", COLUMNS)
    first = told("add", "resistance_temperature", "--model", models[0], "--out", models[2], *words)
    last = told("add", "entropic_heat", "--model", models[2], "--out", models[3], *words)
    # one of two missing effects need not bring the error down where nothing was fitted: that is held against it
    fell = first["after"]["heldout_rmse_K"] < first["before"]["heldout_rmse_K"]
    assert fell or "The error where nothing was fitted does not fall with what was added." in first["core"]["why"]
    assert not first["core"]["proven"]
    assert last["after"]["heldout_rmse_K"] < 0.5 * first["before"]["heldout_rmse_K"]
    assert last["before"] == first["after"]
    assert last["after"]["heldout_rmse_K"] < 0.5 * last["before"]["heldout_rmse_K"]
    before, after = (
        told("compare", table, "--model", m, "--columns", COLUMNS)["filed"]["core_measured"][0]["rmse_K"]
        for m in (models[1], models[3])
    )
    assert before > 4.0
    assert after < 1.0
