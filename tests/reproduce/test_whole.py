"""The whole reproduction, as a newcomer runs it."""

import json

import pytest

from bms_gateway.cli.main import main
from bms_gateway.reproduce import SECTIONS

LIMITS = {
    "fig4.ours": ("minutes", 1.0, 4.0),
    "fig4.paper": ("minutes", 6.0, 13.0),
    "fig5.paper_known": ("core_min", 20.0, 40.0),
    "fig5.kalman_known": ("core_min", 0.0, 1.0),
    "fig5.ours": ("core_min", 0.0, 5.0),
    "noise.0.rls": ("core_rmse_K", 0.0, 0.1),
    "noise.0.05.rls": ("R_e_bias", -0.12, -0.01),
    "noise.0.1.rls": ("folds", 0.1, 1.0),
    "noise.0.05.step0.5.rls": ("folds", 0.9, 1.0),
    "noise.0.02.window": ("core_rmse_K", 0.0, 0.3),
    "noise.0.05.window": ("core_rmse_K", 0.0, 0.6),
    "noise.0.1.window": ("core_rmse_K", 0.0, 1.0),
    "noise.0.05.step1.window": ("identified", 0.0, 0.2),
    "noise.0.1.nothing_known": ("identified", 0.0, 0.0),
    "noise.0.1.moving_inlet": ("core_rmse_K", 0.0, 0.5),
    "cells.surfaces": ("coverage", 0.85, 1.0),
    "cells.voltages_3": ("core_rmse_K", 0.0, 2.0),
    "cells.voltages_1": ("core_rmse_K", 0.0, 1.5),
    "cells.all_sensed": ("core_rmse_K", 0.0, 0.65),
}


@pytest.mark.slow
def test_all_of_it_holds(tmp_path, capsys):
    assert main(["reproduce", "--json", str(tmp_path / "r.json")]) == 0
    out, err = capsys.readouterr()
    assert "Errors of the print" in out
    assert err == ""
    rows = {r["id"]: r for r in json.loads((tmp_path / "r.json").read_text())["rows"]}
    assert {r["section"] for r in rows.values()} == set(SECTIONS)
    assert [i for i, r in rows.items() if r["verdict"] == "missed"] == []
    assert {i for i, r in rows.items() if r["verdict"] == "differs"} <= {"fig5.paper", "table3.r_cc"}
    for name, (key, low, high) in LIMITS.items():
        assert low <= rows[name]["values"][key] <= high, name
