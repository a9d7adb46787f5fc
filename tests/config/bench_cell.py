"""Config of one bench cell (A123 26650 in a chamber): our own DBC, priors wide or from the authors' figures."""

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import numpy as np

from tests.data import need

Priors = Literal["wide", "authors"]

# Wide: a cylinder cell of this size, within a factor of about two. Authors: C 84.5 J/K in all ± 15 %; R_c 3.0 K/W
# ± 20 %; R_u 4.8 K/W, wide. How much of C lies at the surface they do not say: as in the wide case.
PARAMETERS = {
    "wide": {"C_c": (75.0, 0.3), "C_s": (7.0, 0.5), "R_e": (12.0, 0.7), "R_c": (2.5, 0.7), "R_u": (5.0, 0.7)},
    "authors": {"C_c": (77.5, 0.15), "C_s": (7.0, 0.5), "R_e": (12.0, 0.7), "R_c": (3.0, 0.2), "R_u": (4.8, 0.5)},
}
UNITS = {"C_c": "J/K", "C_s": "J/K", "R_e": "mOhm", "R_c": "K/W", "R_u": "K/W"}


def one_cell(capacity_Ah: float, **numbers: tuple[float, float]) -> str:
    """Model file of a single cell: of each number its value, mΩ for R_e, and its relative standard deviation."""
    lines = [f'{k} = {{ value = {v}, unit = "{UNITS[k]}", rel_sd = {sd} }}' for k, (v, sd) in numbers.items()]
    top = ["cells = 1", "sensors = [1]", 'condition = "single"', "effects = []", "[cell]"]
    return "\n".join([*top, f"capacity_Ah = {capacity_Ah}", "[parameters]", *lines]) + "\n"


def write_bench_cell(
    folder: Path, *, priors: Priors = "authors", voltage: bool = False, method: str = "window"
) -> Path:
    """Write gateway.toml and model into a folder; returns the path of the config."""
    model = one_cell(2.3, **PARAMETERS[priors])
    return write_string(folder, model, also=("voltage",) if voltage else (), method=method)


ALSO = {
    "voltage": 'voltage = "string_1_electrical.voltage"',
    "soc": 'soc = "string_1_coolant.soc"',
    "flow": 'coolant_flow = "string_1_coolant.coolant_flow"',
}
"""Signals that a string may have beside current, inlet and surfaces."""


def write_string(
    folder: Path, model: str, *, sensors: Iterable[int] = (1,), also: Iterable[str] = (), method: str = "window"
) -> Path:
    """Write a model and a gateway.toml that takes these signals and no others from our own DBC; returns the config."""
    (folder / "cell.toml").write_text(model)
    lines = [
        f'[identify]\nmethod = "{method}"',
        '[[string]]\nname = "cell"\nmodel = "cell.toml"',
        "[string.signals]",
        'current = "string_1_electrical.current"',
        'coolant_inlet = "string_1_coolant.coolant_inlet"',
        *(ALSO[name] for name in also),
        "[string.signals.surface]",
        *(f'{k} = "string_1_surface.surface_{k:02}"' for k in sensors),
    ]
    config = folder / "gateway.toml"
    config.write_text("\n".join(lines) + "\n")
    return config


def write_bench_table(path: Path, *, core: bool = True) -> Path:
    """Write the record as a table: temperatures at 1 Hz, current and voltage at 10 Hz, discharge positive.

    The cycler logged rows at irregular stamps, about one a second, of a current that steps in between. A step is put
    half-way between its rows: then the means of I, I² and I·V are those of the trapezoid over the logged rows. Held
    rows would lose 3 % of I² and 16 % of the heat, for many rows pair a new current with the voltage before it.
    """
    slow = np.genfromtxt(need("core_surface", "a123_26650_hev2.csv"), delimiter=",", names=True)
    fast = np.genfromtxt(need("core_surface", "a123_26650_hev2_raw_current.csv"), delimiter=",", names=True)
    ticks = np.arange(int(fast["t_s"][-1] * 10) + 1)
    t = ticks / 10
    row = np.searchsorted((fast["t_s"][1:] + fast["t_s"][:-1]) / 2, t)
    current, voltage = -fast["I_A"][row], fast["V_V"][row]
    warm = {
        round(s["t_s"] * 10): f"{s['T_amb_C']:.4f},{s['T_surf_C']:.4f},{s['T_core_C'] if core else '':}" for s in slow
    }
    with path.open("w") as f:
        f.write("time_s,current_A,voltage_V,coolant_inlet_C,surface_1_C,core_1_C\n")
        f.writelines(f"{t[k]:.1f},{current[k]:.5f},{voltage[k]:.5f},{warm.get(k, ',,')}\n" for k in ticks.tolist())
    return path
