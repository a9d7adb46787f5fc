"""`forecast` on a log: what comes next against the truth, its score, its files, and its complaints; and the alert."""

import csv
import json

import numpy as np
import pytest

from bms_gateway.cli.main import main
from tests.config.bench_cell import one_cell, write_string
from tests.truth.string import TruthString, rk4

SECONDS, LIMIT = 600, 45.0
NUMBERS = {"C_c": 76.0, "C_s": 5.5, "R_e": 0.012, "R_c": 3.0, "R_u": 4.8}
MODEL = one_cell(2.3, C_c=(76.0, 0.03), C_s=(5.5, 0.03), R_e=(12.0, 0.05), R_c=(3.0, 0.05), R_u=(4.8, 0.05))


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A cell that is charged with 22 A from second 60 on: config, log, the true core, each second."""
    folder = tmp_path_factory.mktemp("forecast")
    current = np.where(np.arange(SECONDS) < 60, 0.0, -22.0)
    core, surface = rk4(TruthString.of(1, **NUMBERS), current, np.full(SECONDS + 1, 25.0), 25.0)
    noisy = surface[:-1, 0] + np.random.default_rng(0).normal(0.0, 0.03, SECONDS)
    table, truth, config = folder / "cell.csv", folder / "truth.csv", write_string(folder, MODEL, method="off")
    config.write_text(config.read_text() + f"[alerts]\ncore_max_C = {LIMIT}\n")
    time = np.arange(SECONDS)
    head = "time_s,current_A,coolant_inlet_C,surface_1_C"
    np.savetxt(
        table, np.column_stack((time, current, np.full(SECONDS, 25.0), noisy)), "%.4f", ",", header=head, comments=""
    )
    np.savetxt(truth, np.column_stack((time, core[:-1, 0])), "%.4f", ",", header="time_s,core_1_C", comments="")
    log = folder / "cell.log"
    assert main(["encode", str(table), "--config", str(config), "--out", str(log)]) == 0
    return folder, config, log, truth, core[:, 0], surface[:, 0]


def forecast(bench, tmp_path, *more):
    _, config, log, *_ = bench
    out = tmp_path / "f.json"
    words = ["forecast", str(log), "--config", str(config), "--json", str(out), *map(str, more)]
    return main(words), json.loads(out.read_text()) if out.exists() else None


def test_what_comes_next_and_its_score_against_the_truth(bench, tmp_path, capsys):
    _, _, _, truth, core, _ = bench
    rows = tmp_path / "rows.csv"
    status, found = forecast(bench, tmp_path, "--truth", truth, "--out", rows, "--every", 10)
    assert status == 0
    ten = found["score"]["strings"]["cell"]["actual_current"]["300"]
    assert ten["forecasts"] > 20
    assert ten["rms_K"] < 0.6
    assert ten["inside_2sd"] >= 0.9
    assert found["score"]["strings"]["cell"]["core_stays_as_it_is"]["300"]["rms_K"] > 3.0
    cell = found["strings"]["cell"]["cells"][0]
    assert found["strings"]["cell"]["load_A"] == pytest.approx(-22.0, abs=0.1)
    later, surface = rk4(
        TruthString.of(1, **NUMBERS), np.full(600, -22.0), np.full(601, 25.0), (core[-2], bench[5][-2])
    )
    for ahead in cell["ahead"]:
        true = later[int(ahead["horizon_s"]), 0]
        assert abs(ahead["core_C"] - true) <= 2 * ahead["core_sd_K"]
        assert ahead["any_load_core_sd_K"] >= ahead["core_sd_K"]
    assert found["strings"]["cell"]["first"] is None or found["strings"]["cell"]["first"]["cell"] == 1
    with rows.open(newline="") as f:
        told = list(csv.DictReader(f))
    assert {r["load"] for r in told} == {"actual current", "load as it was"}
    mid = next(
        r for r in told if float(r["time_s"]) == 200.0 and r["horizon_s"] == "300" and r["load"] == "actual current"
    )
    assert float(mid["came_C"]) == pytest.approx(core[500], abs=0.01)
    text = capsys.readouterr().out
    assert "actual current" in text
    assert "A, that keeps every hottest point below 45 °C" in text
    del surface


@pytest.mark.slow
def test_a_profile_and_a_constant_current_say_the_same_where_they_are_the_same(bench, tmp_path):
    profile = tmp_path / "plan.csv"
    profile.write_text("time_s,current_A\n100,-30\n160,-30\n")
    one = forecast(bench, tmp_path, "--every", 600, "--profile", profile)[1]["strings"]["cell"]["planned"]
    two = forecast(bench, tmp_path, "--every", 600, "--current", -30)[1]["strings"]["cell"]["planned"]
    assert one == two
    plain = forecast(bench, tmp_path, "--every", 600)[1]["strings"]["cell"]["cells"][0]
    assert two["cells"][0]["ahead"][-1]["core_C"] > plain["ahead"][-1]["core_C"] + 5.0


def test_the_alert_says_minutes_before_when_the_limit_is_reached(bench, tmp_path):
    _, config, log, _, core, surface = bench
    assert main(["analyze", str(log), "--config", str(config), "--out", str(tmp_path / "r")]) == 0
    alerts = [json.loads(line) for line in (tmp_path / "r" / "alerts.jsonl").read_text().splitlines()]
    mine = [a for a in alerts if a["name"] == "forecast"]
    # the hottest point of the truth: the roll's profile has settled by then, half of R_c lies within the roll
    reached = int(np.argmax(core + 0.5 * (core - surface) >= LIMIT))
    first = mine[0]
    assert first["state"] == "raised"
    assert (first["severity"], first["string"], first["cell"]) == ("warning", "cell", 1)
    assert first["time_s"] <= 120.0
    assert first["time_s"] + first["in_s"] == pytest.approx(reached, rel=0.15)
    assert "at this load (22 A charging" in first["text"]
    assert mine[-1]["state"] == "over"
    assert next(a["time_s"] for a in alerts if a["name"] == "core") == pytest.approx(reached, abs=40.0)


def test_what_cannot_be_is_one_line(bench, tmp_path, capsys):
    bad = tmp_path / "bad.csv"
    bad.write_text("time_s,current_A\n0,5\n10,\n")
    other = tmp_path / "other.csv"
    other.write_text("time_s,string,cell,core_C\n0,nobody,1,25\n")
    for words, said in (
        (["--every", "15"], "multiples of 10 s"),
        (["--current", "nan"], "--current nan: valid"),
        (["--current", "5", "--profile", str(bad)], "give one of them"),
        (["--profile", str(bad)], "line 3: current_A is missing"),
        (["--profile", str(tmp_path / "none.csv")], "no such file"),
        (["--truth", str(other)], "none of the strings cell"),
        (["--truth", str(bad)], "nothing is known of cores"),
    ):
        capsys.readouterr()
        assert forecast(bench, tmp_path, *words)[0] == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1
