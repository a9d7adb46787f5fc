"""A hidden effect, added to the model file, live: `analyze` finds the cores better than without it, and says how well.

The pack and its effect are those of the independent truth. The model files differ in the effect alone: both know each
cell's parameters to one per cent, and the effect's numbers to a tenth.
"""

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.cli.main import main
from bms_gateway.config import shipped
from bms_gateway.config.model_file import format_model, parse_model
from bms_gateway.thermal import AddedEffect, Prior, StringModel
from bms_gateway.thermal.effects import catalogue
from tests.acceptance.drives import analyze, string_drive
from tests.truth.hidden import HiddenLog, Scenario, make_log, open_circuit

GATEWAY = """
[bus]
interface = "socketcan"
channel = "vcan0"
[[string]]
name = "string_1"
model = "{model}"
"""
SI = {"mV/K": 1e-3, "mOhm": 1e-3, "1/h": 1 / 3600, "Ah": 3600.0}
"""Units of the truth's numbers; the others are SI already."""
NAMES = {"dU_dT": "dUdT", "s1": "s_1", "s2": "s_2", "Ah": "Q"}
"""Where the truth calls a number otherwise than the catalogue."""
KNOWN, EFFECT_KNOWN = 0.01, 0.1
CONDITIONS = {
    "current_offset": {"cycle": "us06"},  # large currents, more of them one way: 2bI is then more than b²
    "entropic_heat": {"cycle": "sweep"},
    "resistance_soc": {"cycle": "sweep"},
    "flow_dependent_cooling": {"flow": "steps"},
    "voltage_heat": {"columns": ("flow", "soc", "voltage")},
}
"""What a drive must contain for the effect to matter."""
SETTLED_S = 300


def hidden(name: str, seed: int = 3, seconds: int = 2400) -> HiddenLog:
    return make_log(Scenario({name: ("strong", None)}, seed=seed, seconds=seconds, **CONDITIONS.get(name, {})))


def true_numbers(log: HiddenLog, name: str) -> dict[str, float]:
    """Numbers of the hidden effect by the catalogue's names, SI."""
    if name == "voltage_heat":  # the truth has no open-circuit curve of knots: what is between them is lost
        curve = [
            open_circuit(soc, log.scenario.rng("chemistry").random() < 0.5) for soc in (0.05, 0.275, 0.5, 0.725, 0.95)
        ]
        return {"U": float(curve[2])} | {f"U_{k}": float(u - curve[2]) for k, u in enumerate(curve, 1)}
    found: dict[str, float] = {}
    for given, (value, unit) in log.parameters[name].items():
        factor = SI.get(unit, 1.0)
        if isinstance(value, tuple):
            found |= {"dUdT": 0.0} | {f"dUdT_{k}": float(v) * factor for k, v in enumerate(value, 1)}
        else:
            found[NAMES.get(given, given)] = float(value) * factor
    return found


def added(log: HiddenLog, name: str, rng: np.random.Generator) -> AddedEffect:
    """The effect with numbers about the true ones."""
    kind, true = catalogue()[name], true_numbers(log, name)
    values, sd = {}, {}
    for p in kind.parameters:
        value = true.get(p.name, p.neutral)
        assert value is not None, f"{name}: the truth says nothing of {p.name}"
        spread = EFFECT_KNOWN * (1.0 if p.log else abs(value)) if p.name in true else 0.0
        if name == "voltage_heat":
            spread = 0.003
        moved = value * np.exp(spread * rng.normal()) if p.log else value + spread * rng.normal()
        values[p.name], sd[p.name] = float(np.clip(moved, p.lower, p.upper)), float(spread)
    return AddedEffect(name, None if kind.place == "string" else log.cells[name], values, sd)


def models(log: HiddenLog, name: str) -> tuple[StringModel, StringModel]:
    """Without the effect, and with it."""
    rng = np.random.default_rng(log.scenario.seed)
    base = parse_model(log.model)
    priors = {k: Prior(log.pack[k] * np.exp(KNOWN * rng.normal()), KNOWN) for k in base.priors}
    plain = replace(base, priors=priors)
    return plain, replace(plain, effects=(added(log, name, rng),))


@dataclass
class Core:
    """Root mean square error of the cores, K; share of them within two stated sd; median of that sd."""

    rms: float
    inside: float
    sd: float


def encoded(log: HiddenLog, config: Path, directory: Path) -> Path:
    """Bench table as CAN traffic, by the command."""
    table = dict(log.table)
    if "voltage_V" in table:
        table["voltage_V"] = table["voltage_V"] * log.scenario.cells  # the bus has the string's
    csv, out = directory / "bench.csv", directory / "bench.log"
    replace(log, table=table).write_csv(csv)
    assert main(["encode", str(csv), "--config", str(config), "--out", str(out)]) == 0
    return out


def config_with(model: StringModel, name: str, directory: Path) -> Path:
    (directory / f"{name}_model.toml").write_text(format_model(model))
    config = directory / f"{name}.toml"
    config.write_text(GATEWAY.format(model=f"{name}_model.toml"))
    return config


def judged(log: HiddenLog, estimates: dict[str, np.ndarray]) -> Core:
    second = np.rint(estimates["time_s"]).astype(int)
    use = (second >= SETTLED_S) & (second < len(log.core))
    error = estimates["core_C"][use] - log.core[second[use], estimates["cell"][use].astype(int) - 1]
    sd = estimates["core_sd_K"][use]
    assert np.isfinite(error).all()
    return Core(float(np.sqrt(np.mean(error**2))), float(np.mean(np.abs(error) < 2 * sd)), float(np.median(sd)))


def before_and_after(name: str, directory: Path, seed: int = 3, seconds: int = 2400) -> tuple[Core, Core]:
    log = hidden(name, seed, seconds)
    plain, better = (config_with(m, k, directory) for m, k in zip(models(log, name), ("plain", "better"), strict=True))
    can = encoded(log, plain, directory)
    before, after = (judged(log, analyze(can, c, directory / c.stem)) for c in (plain, better))
    print(f"{name}: core {before.rms:.2f} -> {after.rms:.2f} K, in the band {before.inside:.2f} -> {after.inside:.2f}, "
          f"band {before.sd:.2f} -> {after.sd:.2f} K")  # fmt: skip
    return before, after


@pytest.mark.parametrize("name", ["resistance_temperature", "entropic_heat", "coolant_bypass"])
def test_the_broadcast_core_is_better_with_the_effect_in_the_model_file(name: str, tmp_path: Path) -> None:
    before, after = before_and_after(name, tmp_path, seconds=1500)
    assert after.rms < 0.6 * before.rms
    assert after.inside >= 0.9


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(catalogue()))
def test_every_effect_of_the_catalogue_pays_live(name: str, tmp_path: Path) -> None:
    before, after = before_and_after(name, tmp_path)
    assert after.inside >= 0.9
    assert after.rms < before.rms


def aged(growth: float, minutes: int, identify: str, directory: Path) -> tuple[float, float, str]:
    """Core error over the last quarter of an hour, R_e found over the true one, and its status."""
    rng = np.random.default_rng(1)
    current, inlet, core, surface = string_drive(minutes, 3, 15.0, 1.0, 5, B=3000.0, R_e=3.5e-3 * growth)
    model = parse_model(shipped("deploy/example/string.toml").read_text())
    priors = {
        k: Prior(p.value, {"R_e": 0.1, "R_c": 0.05, "R_u": 0.05}.get(k, p.rel_sd)) for k, p in model.priors.items()
    }
    falling = AddedEffect("resistance_temperature", None, {"B": 2900.0}, {"B": 200.0})
    model = replace(model, cells=5, sensors=(1, 3, 5), priors=priors, effects=(falling,))
    config = config_with(model, identify, directory)
    config.write_text(config.read_text() + f'[identify]\nmethod = "{identify}"\n')
    t = np.arange(len(current), dtype=float)
    columns = {"time_s": t, "current_A": current, "coolant_inlet_C": inlet[:-1]}
    columns |= {f"surface_{k}_C": surface[:-1, k - 1] + 0.1 * rng.normal(size=len(t)) for k in (1, 3, 5)}
    table = directory / "aged.csv"
    np.savetxt(table, np.column_stack(list(columns.values())), "%.6g", ",", header=",".join(columns), comments="")
    log = directory / "aged.log"
    assert main(["encode", str(table), "--config", str(config), "--out", str(log)]) == 0
    e = analyze(log, config, directory / f"{identify}_out")
    late = e["time_s"] > 60 * (minutes - 15)
    error = e["core_C"][late] - core[e["time_s"][late].astype(int), e["cell"][late].astype(int) - 1]
    with (directory / f"{identify}_out" / "parameters.csv").open() as f:
        last = [row for row in csv.DictReader(f) if row["name"] == "R_e"][-1]
    return float(np.sqrt(np.mean(error**2))), float(last["value"]) / (3.5 * growth), last["status"]


@pytest.mark.slow
def test_ageing_is_followed_with_an_effect_of_the_heat_in_the_model(tmp_path: Path) -> None:
    """R_e has grown by a fifth since the fit, B is known to 200 K."""
    fixed, _, _ = aged(1.2, 75, "off", tmp_path)
    followed, share, status = aged(1.2, 75, "window", tmp_path)
    print(f"core {fixed:.2f} K with the numbers of the fit, {followed:.2f} K followed; R_e {share:.3f} of the true one")
    assert status == "identified"
    assert share == pytest.approx(1.0, abs=0.08)
    assert followed < 0.7 * fixed
