"""A hidden effect, added to the model file, live: `analyze` finds the cores better than without it, and says how well.

The pack and its effect are those of the independent truth. The model files differ in the effect alone: both know each
cell's parameters to one per cent, and the effect's numbers to a tenth.
"""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.cli.main import main
from bms_gateway.config import shipped
from bms_gateway.config.model_file import parse_model
from bms_gateway.thermal import AddedEffect, Prior
from bms_gateway.thermal.effects import catalogue
from tests.acceptance.drives import analyze, string_drive
from tests.acceptance.effects import config_with, encoded, hidden, models
from tests.acceptance.live_effects import Core, judged

ACCUSED = {"unexplained_heat", "missing_heat", "cooling", "inlet", "current", "mismatch", "unproven"}
LONG_S = dict.fromkeys(("busbar_joule", "cell_conduction", "surface_joule"), 2400)
"""Effects with which a string is also to be accused of nothing: their drives are longer."""


def before_and_after(name: str, directory: Path, seed: int = 3) -> tuple[Core, Core]:
    log = hidden(name, seed, LONG_S.get(name, 1500))
    plain, better = (config_with(m, k, directory) for m, k in zip(models(log, name), ("plain", "better"), strict=True))
    can = encoded(log, plain, directory)
    # A model that lacks a strong effect may know that it does not know a core; the right one does not. When the last
    # of a sheet has frozen, a surface leaves what an observer expects, that knows its heat to a tenth, by a kelvin.
    before = judged(log, analyze(can, plain, directory / plain.stem), 0.85)
    after = judged(log, analyze(can, better, directory / better.stem), 0.99 if name == "phase_change" else 1.0)
    print(f"{name}: core {before.rms:.2f} -> {after.rms:.2f} K, in the band {before.inside:.2f} -> {after.inside:.2f}, "
          f"band {before.sd:.2f} -> {after.sd:.2f} K")  # fmt: skip
    return before, after


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(catalogue()))
def test_every_effect_of_the_catalogue_pays_live(name: str, tmp_path: Path) -> None:
    # The plain model's identification follows some effects too, in a drive or two as well by luck: there several count.
    several = name.endswith("_drift") or name == "inlet_offset"
    drives = [before_and_after(name, tmp_path, seed) for seed in ((3, 4, 5, 6) if several else (3,))]
    assert all(after.inside >= 0.9 for _, after in drives)
    before, after = (np.sqrt(np.mean([core.rms**2 for core in cores])) for cores in zip(*drives, strict=True))
    assert after < (0.6 if name in ("coolant_bypass", "resistance_temperature", "entropic_heat") else 1.0) * before
    if name in LONG_S:  # a string with the right effects is accused of nothing
        told = [json.loads(line) for line in (tmp_path / "better" / "alerts.jsonl").read_text().splitlines()]
        assert not ACCUSED & {a["name"] for a in told}


def aged(growth: float, minutes: int, directory: Path, seed: int = 0) -> list[tuple[float, float, str]]:
    """What `last_quarter` says of one drive whose R_e has grown: without identification, and with it by windows."""
    rng = np.random.default_rng(1 + seed)
    current, inlet, core, surface = string_drive(minutes, 3 + seed, 15.0, 1.0, 5, B=3000.0, R_e=3.5e-3 * growth)
    model = parse_model(shipped("deploy/example/string.toml").read_text())
    priors = {
        k: Prior(p.value, {"R_e": 0.1, "R_c": 0.05, "R_u": 0.05}.get(k, p.rel_sd)) for k, p in model.priors.items()
    }
    falling = AddedEffect("resistance_temperature", None, {"B": 2900.0}, {"B": 200.0})
    model = replace(model, cells=5, sensors=(1, 3, 5), priors=priors, effects=(falling,))
    configs = [config_with(model, method, directory) for method in ("off", "window")]
    for config in configs:
        config.write_text(config.read_text() + f'[identify]\nmethod = "{config.stem}"\n')
    t = np.arange(len(current), dtype=float)
    columns = {"time_s": t, "current_A": current, "coolant_inlet_C": inlet[:-1]}
    columns |= {f"surface_{k}_C": surface[:-1, k - 1] + 0.1 * rng.normal(size=len(t)) for k in (1, 3, 5)}
    table = directory / "aged.csv"
    np.savetxt(table, np.column_stack(list(columns.values())), "%.6g", ",", header=",".join(columns), comments="")
    log = directory / "aged.log"
    assert main(["encode", str(table), "--config", str(configs[0]), "--out", str(log)]) == 0
    return [last_quarter(log, config, core, growth) for config in configs]


def last_quarter(log: Path, config: Path, core: np.ndarray, growth: float) -> tuple[float, float, str]:
    """Core error over the last quarter of an hour, R_e found over the true one, and its status."""
    out = config.with_suffix("")
    e = analyze(log, config, out)
    late = e["time_s"] > len(core) - 1 - 900
    error = e["core_C"][late] - core[e["time_s"][late].astype(int), e["cell"][late].astype(int) - 1]
    with (out / "parameters.csv").open() as f:
        last = [row for row in csv.DictReader(f) if row["name"] == "R_e"][-1]
    return float(np.sqrt(np.mean(error**2))), float(last["value"]) / (3.5 * growth), last["status"]


@pytest.mark.slow
def test_ageing_is_followed_with_an_effect_of_the_heat_in_the_model(tmp_path: Path) -> None:
    """R_e has grown by a fifth since the fit, B is known to 200 K; R_c and R_u of the file happen to be the true ones.

    So the fixed numbers are wrong in R_e alone, and the core's error of what is followed is that of R_c, known to 5 %.
    """
    fixed, followed = [], []
    for seed in range(4):
        (error_of_fixed, *_), (error, share, status) = aged(1.2, 75, tmp_path, seed)
        fixed.append(error_of_fixed)
        followed.append(error)
        print(
            f"core {fixed[-1]:.2f} K with the numbers of the fit, {error:.2f} K followed; R_e {share:.3f} of the truth"
        )
        assert status == "identified" or "R_e*R_u" in status
        assert share == pytest.approx(1.0, abs=0.04)
    assert np.sqrt(np.mean(np.square(followed))) < 0.9 * np.sqrt(np.mean(np.square(fixed)))
