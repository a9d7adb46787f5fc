"""Real cells with a thermocouple in the core as cases: a table without the core, a data-sheet model, the core apart."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.benchmarks.honesty_case import model_text
from tests.config.bench_cell import write_bench_table, write_string
from tests.data import need
from tests.diagnosis.measured_cells import CELLS

HEV2 = "a123_26650_hev2"
SISTERS = {"lfp_32113_insulated_1": "lfp_32113_uninsulated_2", "lfp_32113_uninsulated_2": "lfp_32113_insulated_1"}
"""Another record of a cell of the same type."""
PRIORS = {
    "default": {"C_c": 0.1, "C_s": 0.1, "R_e": 0.6, "R_c": 0.6, "R_u": 0.6},
    "geometry": {"C_c": 0.1, "C_s": 0.25, "R_e": 0.6, "R_c": 0.45, "R_u": 0.6},
    "wide": {"C_c": 0.3, "C_s": 0.5, "R_e": 0.7, "R_c": 0.7, "R_u": 0.7},
}
"""Relative sd of what the model file says. `default` reproduces the figures that a study of these cells found."""


@dataclass(frozen=True)
class MeasuredCell:
    """One record.

    Attributes
    ----------
    name : str
        Of its file.
    has_voltage : bool
        Whether the bus has the cell's voltage.
    time_s, core, surface, ambient : ndarray (K,), (K, 1), (K, 1), (K, 1)
        s, °C, as measured.
    """

    name: str
    has_voltage: bool
    time_s: np.ndarray
    core: np.ndarray
    surface: np.ndarray
    ambient: np.ndarray
    kind: str = "measured"
    cells: int = 1

    @property
    def label(self) -> str:
        return self.name.replace("a123_26650_", "").replace("lfp_32113_", "") + " + V" * self.has_voltage

    @property
    def numbers(self) -> dict[str, float]:
        """The data sheet's numbers, SI."""
        return CELLS[self.name][0]

    def write_table(self, folder: Path) -> Path:
        """Write what the product may see."""
        path = folder / f"{self.name}.csv"
        if self.name == HEV2:  # its own table is interpolated: the square of the current lives in the raw stamps
            return write_bench_table(path, core=False)
        t = read(self.name)
        columns = (t["t_s"], -t["I_A"], t["V_V"], t["T_amb_C"], t["T_surf_C"])
        head = "time_s,current_A,voltage_V,coolant_inlet_C,surface_1_C"
        np.savetxt(path, np.column_stack(columns), "%.5f", ",", header=head, comments="")
        return path

    def write_config(self, folder: Path, priors: str, method: str = "window") -> Path:
        """Write gateway and model files with the data sheet's numbers, known as well as `priors` says."""
        numbers, capacity = CELLS[self.name]
        folder.mkdir(parents=True, exist_ok=True)
        model = model_text(numbers, PRIORS[priors], capacity)
        return write_string(folder, model, also=("voltage",) if self.has_voltage else (), method=method)

    def one_liner(self) -> np.ndarray | None:
        """T_s + (Bi/2)(T_s - T_f) with Bi from a sister record (K, 1), °C; None where there is none.

        For uniform heat in a cylinder that is the steady temperature of its centre.
        """
        if self.name not in SISTERS:
            return None
        t = read(SISTERS[self.name])
        film, rise = t["T_surf_C"] - t["T_amb_C"], t["T_core_C"] - t["T_surf_C"]
        return self.surface + (film @ rise) / (film @ film) * (self.surface - self.ambient)


def read(name: str) -> np.ndarray:
    """Columns of a record; its current counts charging as positive."""
    return np.genfromtxt(need("core_surface", f"{name}.csv"), delimiter=",", names=True)


def measured_cells(names: list[str]) -> list[MeasuredCell]:
    """Each record without and with voltage, of those whose name holds one of `names`."""
    some = [c for c in CELLS if not names or any(n in c for n in names)]
    tables = {c: read(c) for c in some}
    return [
        MeasuredCell(
            c, voltage, tables[c]["t_s"], *(tables[c][k][:, None] for k in ("T_core_C", "T_surf_C", "T_amb_C"))
        )
        for c in some
        for voltage in (False, True)
    ]
