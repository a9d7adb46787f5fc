"""Packs with a hidden effect of the independent truth as CAN traffic, and model files that hold the effect."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from bms_gateway.cli.main import main
from bms_gateway.config.model_file import format_model, parse_model
from bms_gateway.thermal import AddedEffect, Prior, StringModel
from bms_gateway.thermal.effects import catalogue
from tests.truth.hidden import HiddenLog, Scenario, make_log, open_circuit

GATEWAY = """
[bus]
interface = "socketcan"
channel = "vcan0"
transmit = false
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
