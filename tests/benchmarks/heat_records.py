"""Real normal records through the watch over heat: nothing is wrong in any of them, and nothing may be called heat.

Models are data sheets and textbooks: heat capacity, film and resistance known to some tens of per cent. The records go
to the watch at one second, a current held from row to row; a hole of minutes is a pause.
"""

import csv
import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bms_gateway.health.heat import HeatWatch
from bms_gateway.health.heat.heat_tick import HeatTick
from bms_gateway.thermal import Prior, StringModel
from tests.data import data_dir

HOLE_S = 300.0
KNOWN = {"C_c": 0.1, "C_s": 0.25, "R_e": 0.6, "R_c": 0.6, "R_u": 0.6, "R_cc": 0.5}
# C_c, C_s [J/K], R_e [Ω], R_c, R_u [K/W]; R_cc [K/W] where there are more cells than one
TYPES = {
    "21700": (62.0, 5.0, 0.025, 2.0, 10.0),
    "lgm50": (62.0, 5.0, 0.03, 2.0, 10.0),
    "leaf_cell": (600.0, 60.0, 0.0015, 0.5, 3.0, 0.6),
    "leaf_pack": (2400.0, 300.0, 0.003, 0.4, 2.0, 3.0),
    "melasta": (100.0, 8.0, 0.004, 0.6, 6.0, 1.0),
    "a123_26650": (76.0, 5.5, 0.012, 3.0, 4.8),
    "lfp_32113": (204.0, 12.0, 0.007, 1.1, 2.2),
    "bmw_i3": (90000.0, 20000.0, 0.09, 0.002, 0.05),
    "dmegc": (40.0, 3.0, 0.04, 2.0, 12.0),
    "k2_26650": (76.0, 5.5, 0.02, 3.0, 6.0),
    "pan18650": (40.0, 3.0, 0.035, 2.0, 12.0),
    "s30q": (42.0, 3.0, 0.022, 2.0, 12.0),
    "s40t": (62.0, 5.0, 0.02, 2.0, 2.0, 4.0),
}


@dataclass(frozen=True)
class Record:
    """A record at one second: square (K,), current, inlet, y (K, n) with NaN between rows, and pauses before rows."""

    name: str
    model: StringModel
    square: np.ndarray
    current: np.ndarray
    inlet: np.ndarray
    y: np.ndarray
    pauses: frozenset[int]
    constant_inlet: bool

    @property
    def hours(self) -> float:
        return len(self.square) / 3600.0


def _columns(path: Path) -> dict[str, np.ndarray]:
    with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as f:
        rows = list(csv.reader(line for line in f if not line.startswith("#")))
    head, table = rows[0], rows[1:]
    return {k: np.array([_number(r[i]) for r in table]) for i, k in enumerate(head)}


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


def model_of(name: str, cells: int) -> StringModel:
    numbers = next(v for k, v in TYPES.items() if name.startswith(k))
    values = dict(zip(("C_c", "C_s", "R_e", "R_c", "R_u", "R_cc"), numbers, strict=False))
    if cells == 1:
        values.pop("R_cc", None)
    condition = "single" if cells == 1 else "natural"
    priors = {k: Prior(x, KNOWN[k]) for k, x in values.items()}
    return StringModel(cells, tuple(range(1, cells + 1)), condition, priors)


def read(path: Path) -> Record:
    c = _columns(path)
    own = "time_s" in c
    t = c["time_s" if own else "t_s"]
    current = c["current_A"] if own else -c["I_A"]
    surfaces = [c[k] for k in c if k.startswith("surface_")] if own else []
    surfaces = surfaces or [c[k] for k in ("T_surf_C", "T_batt_C", "T1_C", "T2_C", "T3_C") if k in c]
    inlet = c.get("coolant_inlet_C", c.get("T_amb_C", np.full(len(t), np.nan)))
    square = c.get("I_ms_A2", current**2)
    keep = np.isfinite(t) & np.isfinite(current)
    t, current, square, inlet = t[keep], current[keep], square[keep], inlet[keep]
    y = np.stack([s[keep] for s in surfaces], axis=1)
    known = np.isfinite(inlet)
    if not known.any():
        inlet = np.full(len(t), float(np.nanmedian(y[:20])))
    steps = np.diff(t, prepend=t[0])
    steps = np.where((steps < 0) | (steps > HOLE_S), np.nan, steps)
    line = np.cumsum(np.where(np.isnan(steps), 1.0, steps))
    second = np.floor(line - line[0]).astype(int)
    K = int(second[-1]) + 1
    last = np.searchsorted(second, np.arange(K), side="right") - 1  # newest row of each second
    count = np.bincount(second, minlength=K)
    mean = np.where(count > 0, np.bincount(second, square, K) / np.maximum(count, 1), square[last])
    amps = np.where(count > 0, np.bincount(second, current, K) / np.maximum(count, 1), current[last])
    out = np.full((K, y.shape[1]), np.nan)
    fresh = np.flatnonzero(count)
    out[fresh] = y[last[fresh]]
    pauses = frozenset(second[np.isnan(steps)].tolist())
    name = path.name.split(".csv")[0]
    still = len(np.unique(inlet[np.isfinite(inlet)])) < 3
    return Record(name, model_of(name, y.shape[1]), mean, amps, inlet[last], out, pauses, still)


def told(r: Record) -> list[tuple[float, str, str]]:
    """What is told of a record: hour, code, text."""
    w = HeatWatch([r.model], 1.0, [r.constant_inlet])
    out, age = [], np.zeros((1, r.y.shape[1]))
    for k in range(len(r.square)):
        if k in r.pauses:
            w.pass_time(None)
        now = (r.square[k : k + 1], r.current[k : k + 1], r.inlet[k : k + 1], r.y[k : k + 1], age)
        out += [(k / 3600.0, f.code, f.text) for _, f in w.add(k * 10**9, HeatTick(*now)) or () if f.level]
    return out


def paths() -> list[Path]:
    """All given normal records."""
    folders = ("bench", "core_surface", "surface_cells", "i3_trips")
    return [p for f in folders for p in sorted((data_dir() / f).glob("*.csv*")) if "raw_current" not in p.name]


if __name__ == "__main__":
    hours = cells = 0.0
    for path in paths():
        r = read(path)
        hours, cells = hours + r.hours, cells + r.hours * r.y.shape[1]
        print(f"{r.name:32s} {r.hours:7.2f} h", *[f"\n    {h:6.2f} {c}: {x[:150]}" for h, c, x in told(r)], flush=True)
    print(f"{hours:.0f} h, {cells:.0f} h of sensors")
