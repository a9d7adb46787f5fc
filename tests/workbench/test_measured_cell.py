"""The road on a measured cell: two effects by its surface alone, and the gateway's core is better with them."""

import csv
import json

import numpy as np
import pytest

from bms_gateway.cli.main import main
from tests.cli.measured_model import MODEL
from tests.data import need
from tests.workbench.conftest import served

FIT_S = 600.0
EVERY = 2
"""Rows taken: one every two seconds finds the same effects in half the time."""
CONFIG = """\
[bus]
interface = "virtual"
channel = "test"
transmit = false
[[string]]
name = "cell"
model = "{}"
[identify]
method = "off"
"""
NAMES = {
    "t_s": "time_s",
    "I_A": "current_A",
    "T_amb_C": "coolant_inlet_C",
    "T_surf_C": "surface_1_C",
    "T_core_C": "core_1_C",
}


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    with need("core_surface", "lfp_32113_insulated_1.csv").open(newline="") as f:
        found = list(csv.DictReader(f))[::EVERY]
    return {ours: np.array([float(r[theirs]) for r in found]) for theirs, ours in NAMES.items()}


def write(path, rows):
    columns = list(rows)
    path.write_text("\n".join([",".join(columns), *(",".join(map(str, r)) for r in zip(*rows.values(), strict=True))]))


def core_error(folder, model, rows):
    """Root mean square of the gateway's core against the thermocouple, K."""
    config, log, out = folder / f"{model}.config.toml", folder / "cell.log", folder / f"{model}.out"
    config.write_text(CONFIG.format(model))
    table = folder / "encoded.csv"
    write(table, {k: v for k, v in rows.items() if k != "core_1_C"})
    assert main(["encode", str(table), "--config", str(config), "--out", str(log)]) == 0
    assert main(["analyze", str(log), "--config", str(config), "--out", str(out)]) == 0
    with (out / "estimates.csv").open(newline="") as f:
        found = [r for r in csv.DictReader(f) if r["core_C"]]
    t = np.array([float(r["time_s"]) for r in found])
    core = np.array([float(r["core_C"]) for r in found])
    return float(np.sqrt(np.mean((core - np.interp(t, rows["time_s"], rows["core_1_C"])) ** 2)))


@pytest.mark.slow
def test_two_effects_added_on_the_page_give_the_gateway_the_better_core(window, rows, tmp_path, capsys):
    rows = {**rows, "current_A": -rows["current_A"], "time_s": rows["time_s"] - rows["time_s"][0]}
    write(tmp_path / "cell.csv", rows)
    (tmp_path / "cell.toml").write_text(MODEL)
    with served(tmp_path, tmp_path / "cell.csv", "--model", tmp_path / "cell.toml") as url:
        page = window(url)
        page.wait("return Number(document.querySelector('#plot-core').dataset.traces) > 0", patience_s=FIT_S)
        page.click("#tab-diagnose")
        page.click("#diagnose")
        page.wait("return document.querySelector('#panel-diagnose .verdict')", patience_s=FIT_S)
        verdict = page.text("#panel-diagnose .verdict")
        assert "entropic_heat" in verdict
        assert "resistance_temperature" in verdict
        for n, name in enumerate(("resistance_temperature", "entropic_heat"), start=3):
            page.click("#tab-add")
            page.type("#effect-name", name)
            page.click("#add")
            page.wait(
                "return document.querySelectorAll('#panel-add .way li').length === arguments[0]", n, patience_s=FIT_S
            )
            page.idle(FIT_S)
        state = page.run(
            "return fetch('/api/state?desk=' + JSON.parse(sessionStorage.workbench).desk).then(r => r.json())"
        )
        model = page.run("return fetch(document.querySelector('#take-model').href).then(r => r.text())")
    steps = state["steps"][1:]  # the first is the model as its file has it
    stairs = [s["stair"] for s in steps]
    assert not any(s["forced"] for s in steps)
    assert stairs[2]["trained_K"] < 0.5 * stairs[0]["trained_K"]
    # a surface alone proves no core: the band is no narrower for it, and page and file say so
    assert stairs[2]["core_K"] >= stairs[1]["core_K"] >= stairs[0]["core_K"] > 0.0
    assert all(s["told"]["tag"] == "Added, core not proven" for s in steps[1:])
    assert "core_proven = false" in model
    (tmp_path / "taken.toml").write_text(model)
    words = ["fit", str(tmp_path / "cell.csv"), "--model", str(tmp_path / "cell.toml")]
    assert main([*words, "--out", str(tmp_path / "fitted.toml")]) == 0
    before, after = (core_error(tmp_path, name, rows) for name in ("fitted.toml", "taken.toml"))
    capsys.readouterr()
    print(json.dumps({"core before, K": before, "after": after, "stairs": stairs}))
    assert before < 2.5  # a fit of a model that lacks effects is not led far off by them
    assert after < 1.0
    assert after < 0.5 * before
