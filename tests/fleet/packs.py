"""Logs of a fleet whose truth is made by `tests/truth`: every vehicle its own pack, sensors, drive and noise."""

from pathlib import Path

import numpy as np

from bms_gateway.bus.logfile import write_log
from bms_gateway.bus.traffic import SECOND, Traffic, lines, steps
from bms_gateway.config.load import load_config
from bms_gateway.frames.batch import FrameBatch
from tests.truth.hidden import Scenario, make_logs, model_text

EPOCH_S = 1_700_000_000  # 2023-11-14, 22:13:20 UTC
GATEWAY = """\
[bus]
channel = "vcan0"

[[string]]
name = "string_1"
model = "model.toml"
"""
KINDS = {"coolant_inlet_C": ("coolant_inlet", None), "soc": ("soc", None), "coolant_flow_m3_s": ("coolant_flow", None)}


def config(folder: Path, **scenario: object) -> Path:
    (folder / "model.toml").write_text(model_text(Scenario(**scenario)))
    (folder / "gateway.toml").write_text(GATEWAY)
    return folder / "gateway.toml"


def logs(folder: Path, scenarios: dict[str, Scenario], start_s: int = EPOCH_S) -> tuple[Path, list[Path]]:
    """Config and one candump log per vehicle, `NAME.log.gz`."""
    file = config(folder)
    loaded = load_config(file)
    made = []
    for (name, scenario), log in zip(scenarios.items(), make_logs(list(scenarios.values())), strict=True):
        t = np.arange(len(log.table["time_s"]), dtype=float)
        feed = {("current", None): steps(t, log.table["current_A"])}
        feed |= {key: lines(t, log.table[column]) for column, key in KINDS.items() if column in log.table}
        feed |= {("surface", k): lines(t, log.table[f"surface_{k}_C"]) for k in scenario.sensors}
        b = Traffic(loaded.plan, loaded.database, noise_K=0.0, seed=scenario.seed).between(
            [feed], 0, (len(t) - 1) * SECOND
        )
        b = FrameBatch(b.time_ns + start_s * SECOND, b.can_id, b.length, b.data)
        made.append(folder / f"{name}.log")
        write_log(made[-1], [b])
    return file, made
