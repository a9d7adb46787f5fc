"""All given records of real cells as a user brings them: a table, a data-sheet model, and what cannot be missing there.

A model's numbers come from the data sheet's mass, format and capacity, and from text books: heat capacity of about
1,000 J/(kg K), of which 6 to 8 % is the can; radial conductivity 1 W/(m K) in a roll, 0.7 across a pouch; still or
gently moved air 5 to 25 W/(m2 K). Nobody fitted them to the records.
"""

import csv
import gzip
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tests.data import need

SD = {"C_c": 0.1, "C_s": 0.25, "R_e": 0.6, "R_c": 0.6, "R_u": 0.6, "R_cc": 0.6}
NOTHING_MELTS = frozenset({"phase_change"})
"""Neither sheet nor wax about any of these cells."""
NO_STREAM = frozenset({"coolant_delay", "coolant_bypass", "flow_dependent_cooling", "cooling_drift"})
"""A chamber or still air: nothing flows along the cell that could come late, be short, or slow down."""
ONE_CELL = frozenset({"busbar_joule", "end_plate", "neighbour_heat", "cell_resistance", "cell_cooling"})
RESTS_AT_ZERO = frozenset({"current_offset"})
"""The rests read zero and the charge balance over the record closes: the ammeter has no offset worth naming."""
FORMATS = {
    "a123": "a123_26650",
    "lfp_32113": "a123_32113",
    "dmegc": "18650 2.5Ah",
    "k2": "k2_26650",
    "pan18650pf": "panasonic_18650pf",
    "s30q": "samsung_30q",
    "s40t": "samsung_40t liquid",
    "21700": "21700 4.5Ah",
    "leaf_cell": "leaf_pouch",
    "lgm50": "lg_m50",
    "melasta": "melasta_5Ah5",
}
BENCH = NOTHING_MELTS | NO_STREAM | ONE_CELL


@dataclass(frozen=True)
class MeasuredRecord:
    """One record.

    Attributes
    ----------
    name, folder : str
        Of the file, in the folder of real data.
    numbers : mapping of symbol to float, SI
    capacity_Ah : float
    impossible : frozenset of str
        Effects that nobody who knows the set-up would name.
    known : str
        What is right, from literature or the record's own channels.
    columns : mapping of our column to (theirs, factor)
    inlet : float or None
        °C where the surroundings were not recorded.
    keep : callable, optional
        Of a row as text: whether it belongs to the record.
    """

    name: str
    folder: str
    numbers: Mapping[str, float]
    capacity_Ah: float
    impossible: frozenset[str]
    known: str
    columns: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    inlet: float | None = None
    keep: Callable[[Mapping[str, str]], bool] | None = None
    cells: int = 1
    gap_s: float = 3600.0

    @property
    def format(self) -> str:
        """The cell in words of `bms-gateway cells`; empty where what is measured is a module."""
        return next((words for start, words in FORMATS.items() if self.name.startswith(start)), "")

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Write table and model."""
        table, model = folder / f"{self.name}.csv", folder / f"{self.name}.toml"
        with table.open("w", newline="") as f:
            out = csv.writer(f)
            for row in self.rows():
                out.writerow(row)
        lines = [
            f"cells = {self.cells}",
            f"sensors = {list(range(1, self.cells + 1))}",
            f'condition = "{"single" if self.cells == 1 else "natural"}"',
            "effects = []",
            "[cell]",
            *([f'format = "{self.format}"'] if self.format else []),
            f"capacity_Ah = {self.capacity_Ah}",
            "[parameters]",
        ]
        units = {"C_c": "J/K", "C_s": "J/K", "R_e": "mOhm", "R_c": "K/W", "R_u": "K/W", "R_cc": "K/W"}
        for symbol, value in self.numbers.items():
            shown = value * 1e3 if symbol == "R_e" else value
            lines.append(f'{symbol} = {{ value = {shown:.6g}, unit = "{units[symbol]}", rel_sd = {SD[symbol]} }}')
        model.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return table, model

    def rows(self) -> list[list[str]]:
        """Head and rows of the table as the commands take it."""
        path = need(self.folder, f"{self.name}.csv.gz" if self.folder == "bench" else f"{self.name}.csv")
        with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as f:
            rows = [r for r in csv.DictReader(f) if self.keep is None or self.keep(r)]
        columns = self.columns or {c: (c, 1.0) for c in rows[0] if c.split("_")[0] not in ("half", "heat")}
        names = [*columns, *(["coolant_inlet_C"] if self.inlet is not None else [])]
        out, shift, last = [names], 0.0, None
        for r in rows:
            t = float(r[columns["time_s"][0]])
            if last is not None and t + shift <= last:  # a new run of the tester, or its clock was set back
                shift = last + self.gap_s - t
            last = t + shift
            cells = [
                f"{last:.4f}" if c == "time_s" else ("" if r[own] == "" else f"{float(r[own]) * factor:.6g}")
                for c, (own, factor) in columns.items()
            ]
            out.append([*cells, *([f"{self.inlet}"] if self.inlet is not None else [])])
        return out


def _numbers(C: float, R_e: float, R_c: float, R_u: float, can: float = 0.07, **more: float) -> dict[str, float]:
    return {"C_c": (1 - can) * C, "C_s": can * C, "R_e": R_e, "R_c": R_c, "R_u": R_u, **more}


CHARGING_POSITIVE = {
    "time_s": ("t_s", 1.0),
    "current_A": ("I_A", -1.0),
    "voltage_V": ("V_V", 1.0),
    "coolant_inlet_C": ("T_amb_C", 1.0),
    "surface_1_C": ("T_surf_C", 1.0),
}
NO_AMBIENT = {k: v for k, v in CHARGING_POSITIVE.items() if k != "coolant_inlet_C"}
MIDDLE = {"time_s": ("time_s", 1.0), "current_A": ("current_A", 1.0), "voltage_V": ("voltage_V", 1.0)}
MIDDLE |= {"coolant_inlet_C": ("coolant_inlet_C", 1.0), "surface_1_C": ("surface_2_C", 1.0)}
LIQUID = {"time_s": ("t_s", 1.0), "current_A": ("I_A", -1.0), "voltage_V": ("V_V", 1.0)}
LIQUID |= {"coolant_inlet_C": ("T3_C", 1.0), "surface_1_C": ("T2_C", 1.0)}
A123, LFP = _numbers(81.5, 0.012, 3.0, 4.8), _numbers(216.0, 0.007, 1.1, 2.2, 0.055)
R21700, LGM50 = _numbers(68.0, 0.025, 1.2, 9.0), _numbers(68.5, 0.03, 1.2, 9.0)
POUCH = _numbers(790.0, 1.7e-3, 0.03, 1.0, 0.1)
MODULES = _numbers(3600.0, 1.7e-3, 0.1, 0.5, 0.15, R_cc=2.0)
MELASTA = _numbers(130.0, 3e-3, 0.3, 7.0, 0.1)
P18650, S30Q, DMEGC = (
    _numbers(45.0, 0.035, 1.5, 15.0),
    _numbers(45.0, 0.022, 1.5, 15.0),
    _numbers(42.0, 0.05, 1.5, 15.0),
)
K2, S40T = _numbers(82.0, 0.03, 2.0, 9.0), _numbers(66.0, 0.02, 1.2, 3.0)
TEMPERATURE = "R_e falls with temperature, B 2,000 to 4,000 K; dU/dT a few 0.1 mV/K"

RECORDS = (
    MeasuredRecord("a123_26650_hev2", "core_surface", A123, 2.3, BENCH | RESTS_AT_ZERO, "R_e(T)", CHARGING_POSITIVE),
    MeasuredRecord(
        "lfp_32113_insulated_1", "core_surface", LFP, 4.4, BENCH | RESTS_AT_ZERO, TEMPERATURE, CHARGING_POSITIVE
    ),
    MeasuredRecord(
        "lfp_32113_uninsulated_2", "core_surface", LFP, 4.4, BENCH | RESTS_AT_ZERO, TEMPERATURE, CHARGING_POSITIVE
    ),
    MeasuredRecord(
        "dmegc_18650_randomwalk_R1",
        "surface_cells",
        DMEGC,
        2.5,
        BENCH | RESTS_AT_ZERO,
        "ambient not recorded",
        {k: (own, 1.0) for k, (own, _) in NO_AMBIENT.items()},
        inlet=26.0,
        keep=lambda r: int(float(r["seq"])) < 8,
    ),
    MeasuredRecord("k2_26650_dis1C_20C", "surface_cells", K2, 2.6, BENCH, TEMPERATURE, CHARGING_POSITIVE),
    MeasuredRecord("k2_26650_hppc_20C", "surface_cells", K2, 2.6, BENCH, TEMPERATURE, CHARGING_POSITIVE),
    MeasuredRecord("pan18650pf_10C_us06", "surface_cells", P18650, 2.9, BENCH, "R_e(T), R_e(SOC)", NO_AMBIENT, 10.0),
    MeasuredRecord("pan18650pf_25C_la92", "surface_cells", P18650, 2.9, BENCH, "R_e(T), R_e(SOC)", CHARGING_POSITIVE),
    MeasuredRecord("pan18650pf_25C_us06", "surface_cells", P18650, 2.9, BENCH, "R_e(T), R_e(SOC)", CHARGING_POSITIVE),
    MeasuredRecord("s30q_18650_S001_1C", "surface_cells", S30Q, 3.0, BENCH, "dU/dT(SOC), R_e(SOC)", CHARGING_POSITIVE),
    MeasuredRecord("s30q_18650_S001_4C", "surface_cells", S30Q, 3.0, BENCH, "R_e(T), R_e(SOC)", CHARGING_POSITIVE),
    MeasuredRecord("s40t_21700_liquidcooled_1.5C", "surface_cells", S40T, 4.0, NOTHING_MELTS, "dU/dT(SOC)", LIQUID),
    MeasuredRecord("s40t_21700_liquidcooled_1C", "surface_cells", S40T, 4.0, NOTHING_MELTS, "dU/dT(SOC)", LIQUID),
    MeasuredRecord("21700_4C_heatflux", "bench", R21700, 4.5, BENCH | RESTS_AT_ZERO, "R_e(T), R_e(SOC)"),
    MeasuredRecord("21700_hppc_heatflux", "bench", R21700, 4.5, BENCH | RESTS_AT_ZERO, "dU/dT(SOC)"),
    MeasuredRecord("leaf_cell_pouch_1c", "bench", POUCH, 33.0, BENCH | RESTS_AT_ZERO, "dU/dT(SOC) of LMO", MIDDLE),
    MeasuredRecord("leaf_cell_pouch_3c", "bench", POUCH, 33.0, BENCH | RESTS_AT_ZERO, "dU/dT(SOC) of LMO", MIDDLE),
    MeasuredRecord(
        "leaf_pack_3modules_0_3c", "bench", MODULES, 66.0, NOTHING_MELTS | NO_STREAM, "dU/dT(SOC) of LMO", cells=3
    ),
    MeasuredRecord(
        "leaf_pack_3modules_2_0c", "bench", MODULES, 66.0, NOTHING_MELTS | NO_STREAM, "R_e(T), dU/dT(SOC)", cells=3
    ),
    MeasuredRecord("lgm50_2C_25C_cell796", "bench", LGM50, 5.0, BENCH | RESTS_AT_ZERO, "R_e(T), dU/dT(SOC)"),
    MeasuredRecord("lgm50_rate_0p5C_T0", "bench", LGM50, 5.0, BENCH | RESTS_AT_ZERO, "R_e(T), dU/dT(SOC)"),
    MeasuredRecord("lgm50_rate_1C_T25", "bench", LGM50, 5.0, BENCH | RESTS_AT_ZERO, "R_e(T), dU/dT(SOC)"),
    MeasuredRecord("lgm50_rate_2C_T25", "bench", LGM50, 5.0, BENCH | RESTS_AT_ZERO, "R_e(T), dU/dT(SOC)"),
    MeasuredRecord("melasta_5Ah5_pouch_still", "bench", MELASTA, 5.5, BENCH | RESTS_AT_ZERO, "R_e(T), R_e(SOC)"),
)
