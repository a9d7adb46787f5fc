"""The form of the model: what is said of the coolant goes together, and nothing of it is assumed in silence."""

import pytest

from bms_gateway.config.model_file import read_model
from bms_gateway.errors import UsageError
from bms_gateway.thermal.cells import cell_of, cell_priors
from bms_gateway.workbench.form import with_model

FLAT, ROUND = "prismatic 148x92x27mm 50Ah 900g 0.8mOhm", "21700 5Ah 69g 25mOhm"
WATER, AIR = 0.8e-3 / 60 * 3.6e6, 570e-3 / 60 * 1190
"""Volume flow times the heat capacity of a volume, of water with glycol and of air, W/K."""


def made(folder, cell, **more):
    """The model that the form describes for five cells."""
    form = {"cell": cell, "cells": "5", "sensors": "1,5", **more}
    files = with_model({"tables": [], "model": "", "columns": [], "form": form}, folder)
    return read_model(files["model"])


@pytest.mark.parametrize(
    ("cell", "flow", "medium", "cooling", "C_f"),
    [
        (FLAT, "0.8", "liquid", "plate", WATER),
        (ROUND, "0.8", "liquid", "liquid", WATER),
        (ROUND, "570", "air", "forced", AIR),
        (f"{ROUND} forced", "570", "", "forced", AIR),
        (f"{FLAT} plate", "0.8", "", "plate", WATER),
    ],
)
def test_a_flow_and_what_cools_go_together(tmp_path, cell, flow, medium, cooling, C_f):
    """Cells past which a liquid flows had the film of still air, and a fan's air the capacity of a liquid."""
    model = made(tmp_path, cell, flow=flow, medium=medium)
    words = cell if cell.endswith(cooling) else f"{cell} {cooling}"
    expected = cell_priors(cell_of(words), conduction=True)["R_u"]
    assert model.priors["R_u"].value == pytest.approx(expected.value, rel=1e-3)
    assert model.priors["C_f"].value == pytest.approx(C_f, rel=0.15)


def test_without_a_flow_the_air_is_still(tmp_path):
    model = made(tmp_path, ROUND)
    assert model.condition == "natural"
    assert model.priors["R_u"].value == pytest.approx(
        cell_priors(cell_of(ROUND), conduction=True)["R_u"].value, rel=1e-3
    )


def test_a_flow_in_the_table_is_not_left_out_in_silence(tmp_path):
    """Bug: with a flow in the table and none in the form, each cell had coolant of its own, and nothing said so."""
    table = tmp_path / "x.csv"
    table.write_text("time_s,current_A,coolant_inlet_C,surface_1_C,surface_5_C,coolant_flow_m3_s\n0,1,25,25,25,0.01\n")
    form = {"cell": f"{ROUND} forced", "cells": "5"}
    files = {"tables": [str(table)], "model": "", "columns": [], "form": form}
    with pytest.raises(UsageError, match=r"column 'coolant_flow_m3_s' is a coolant flow of 0.01 to 0.01 m³/s: state"):
        with_model(files, tmp_path)
    conditions = {}
    for flow in ("0", "600"):
        made = with_model(files | {"form": form | {"flow": flow}}, tmp_path)
        conditions[flow] = read_model(made["model"]).condition
    assert conditions == {"0": "natural", "600": "full"}


def test_what_flows_is_asked_for(tmp_path):
    with pytest.raises(UsageError, match="say whether it is a liquid or air"):
        made(tmp_path, ROUND, flow="28")


def test_still_air_does_not_flow(tmp_path):
    with pytest.raises(UsageError, match="not in still air: say what cools them"):
        made(tmp_path, f"{ROUND} still", flow="28", medium="air")
