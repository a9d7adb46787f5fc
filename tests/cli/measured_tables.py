"""A table of measurements, and the log that it becomes."""

from pathlib import Path

import numpy as np

from bms_gateway.cli.main import main
from bms_gateway.config.model_file import parse_model
from tests.config.model_texts import EXAMPLE
from tests.diagnosis.logs import rows

CELLS = 5


MODEL = parse_model(EXAMPLE)


def table(folder: Path, *, seconds=1500, name="bench.csv", flow=MODEL.flow or 0.0095) -> Path:
    """Half an hour of a five-cell string as a CSV; returns its path."""
    c = rows(seconds, sensors=(1, 3, 5))
    columns = {k: v for k, v in c.items() if k != "surface_C"}
    columns["voltage_V"] = columns["voltage_V"] / 3 * CELLS
    columns["coolant_flow_m3_s"] = np.full(seconds + 1, flow)
    columns |= {f"surface_{k}_C": x for k, x in c["surface_C"].items()}
    file = folder / name
    text = [",".join(columns), *(",".join(f"{x:.5f}" for x in row) for row in zip(*columns.values(), strict=True))]
    file.write_text("\n".join(text) + "\n")
    return file


def encoded(folder: Path, file: Path, config: Path) -> Path:
    log = folder / "bench.log"
    assert main(["encode", str(file), "--config", str(config), "--out", str(log)]) == 0
    return log
