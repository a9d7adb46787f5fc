"""The prototype of an honest core on the same table, as a command of its own; it sees no core."""

import csv
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tests.data import data_dir

SCRIPT = "honest_core.py"


def prototype() -> Path | None:
    """Where the prototype lies beside the measurements; None where it is absent."""
    path = data_dir().parent / "prototype" / SCRIPT
    return path if path.exists() else None


def prototype_states(
    script: Path, table: Path, numbers: Mapping[str, float], *, cells: int = 1, voltage: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run it: times (K,) s from the first row on, cores and their sd (K, n) °C and K.

    Raises
    ------
    RuntimeError
        It failed; with what it said.
    """
    out = table.with_suffix(f".{'V' if voltage else 'I'}.peer.csv")
    words = [sys.executable, str(script), str(table), "--cells", str(cells), "--out", str(out)]
    words += [w for name, value in numbers.items() for w in (f"--{name}", str(value))]
    done = subprocess.run(
        words + ["--voltage"] * voltage, capture_output=True, text=True, check=False, cwd=table.parent
    )
    if done.returncode:
        raise RuntimeError(f"{table.stem} by the prototype: {done.stderr.strip()[-500:]}")
    with out.open(newline="") as f:
        rows = list(csv.DictReader(f))

    def columns(form: str) -> np.ndarray:
        return np.array([[float(r[form.format(k)]) for k in range(1, cells + 1)] for r in rows])

    return np.array([float(r["time_s"]) for r in rows]), columns("core_{}_C"), columns("core_{}_sd_K")
