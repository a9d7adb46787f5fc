"""Records from which nothing can be learnt: `diagnose` says so, `fit` refuses them, `compare` still compares."""

import json

import numpy as np
import pytest

from tests.cli.calls import call
from tests.config.model_texts import EXAMPLE

HEAD = "time_s,current_A,coolant_inlet_C,surface_1_C,surface_3_C,surface_5_C"
T = np.arange(1200.0)
WAVE = 25.0 + 0.5 * np.sin(T / 100.0)
FLAT = np.full_like(T, 25.0)
RECORDS = {
    "at rest": ((0.0 * T, FLAT, WAVE, WAVE, WAVE), "No current flows: there is no heat to explain."),
    "constants": (
        (0.0 * T + 10.0, FLAT, FLAT, FLAT, FLAT),
        "No surface temperature moves: nothing can be learnt",
    ),
}
NONE_FITTED = "Outside the parts of the record that are held out, no sensor has more than {} readings, 12 are the least"
NONE_HELD = "The parts of the record that are held out have 0 readings, 3 are the least"


@pytest.fixture(params=RECORDS)
def record(request, tmp_path):
    columns, says = RECORDS[request.param]
    np.savetxt(tmp_path / "a.csv", np.column_stack([T, *columns]), "%.6g", ",", header=HEAD, comments="")
    (tmp_path / "model.toml").write_text(EXAMPLE)
    return tmp_path, says


def test_fit_and_diagnose_say_alike_why_they_cannot(record):
    """Insufficient data are a verdict of `diagnose`, with its status 0; `fit` has nothing to write."""
    folder, says = record
    words = folder / "a.csv", "--model", folder / "model.toml"
    status, out, _ = call("diagnose", *words, "--json", "-")
    assert status == 0
    assert json.loads(out)["verdict"] == "insufficient_data"
    assert says in call("diagnose", *words)[1]
    status, _, err = call("fit", *words, "--out", folder / "out.toml")
    assert status == 2
    assert err.splitlines()[-1].startswith(f"bms-gateway: error: {folder / 'a.csv'}: {says}")
    assert not (folder / "out.toml").exists()


def test_compare_shows_the_model_of_the_file_and_says_first_what_is_wrong(record):
    """It said at the end that there is nothing to compare, and how well a refit knows the cores."""
    folder, says = record
    status, out, _ = call("compare", folder / "a.csv", "--model", folder / "model.toml")
    assert status == 0
    assert out.startswith(f"Look at the data first:\n  {says}")
    assert "The model with the parameters from its file." in out
    assert "nothing can be learnt from them" in out
    assert "The same model, refitted" not in out
    assert "nothing to compare" not in out


@pytest.mark.parametrize(
    ("first_s", "last_s", "says"),
    [
        (270, 380, NONE_FITTED.format(0)),
        (1060, 1199, NONE_FITTED.format(0)),
        (100, 111, NONE_FITTED.format(11)),
        (9, 200, NONE_HELD),
    ],
)
def test_too_few_readings_are_one_line_of_every_command(tmp_path, first_s, last_s, says):
    """Where all lay in the parts that are held out, the residual of the fit had no parts to look at: a traceback."""
    head = HEAD.removesuffix(",surface_3_C,surface_5_C")
    surface = np.where((first_s <= T) & (last_s > T), WAVE, np.nan)
    text = [f"{t:g},{10 * (t % 90 < 40)},25,{'' if np.isnan(y) else y}" for t, y in zip(T, surface, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join([head, *text]))
    (tmp_path / "model.toml").write_text(EXAMPLE)
    words = tmp_path / "a.csv", "--model", tmp_path / "model.toml"
    for command, more in (("compare", ()), ("diagnose", ()), ("fit", ("--out", tmp_path / "o.toml"))):
        status, _, err = call(command, *words, *more)
        assert status == 2
        assert says in err.splitlines()[-1], command
