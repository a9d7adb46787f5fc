"""Records of real cells with a thermocouple in the core, as a user brings them: the surface, data-sheet priors.

The core goes beside the record and is never given to what is tested.
"""

import csv
from functools import cache

import numpy as np

from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.record import make_record
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.thermal import Prior, StringModel
from tests.data import need

A123 = ({"R_e": 0.012, "R_c": 3.0, "R_u": 4.8, "C_c": 76.0, "C_s": 5.5}, 2.3)
LFP = ({"R_e": 0.007, "R_c": 1.1, "R_u": 2.2, "C_c": 204.0, "C_s": 12.0}, 4.4)
KNOWN = {"R_e": 0.6, "R_c": 0.6, "R_u": 0.6, "C_c": 0.1, "C_s": 0.25}
CELLS = {"a123_26650_hev2": A123, "lfp_32113_insulated_1": LFP, "lfp_32113_uninsulated_2": LFP}


def data_sheet(name, **scaled):
    """Model of the cell in a record; `C_c=0.8` scales a nominal number."""
    values, capacity = CELLS[name]
    priors = {k: Prior(v * scaled.get(k, 1.0), KNOWN[k]) for k, v in values.items()}
    return StringModel(1, (1,), "single", priors, capacity_Ah=capacity)


@cache
def columns(path):
    with path.open(newline="") as f:
        rows = list(csv.DictReader(f))
    return {k: np.array([float(r[k]) for r in rows]) for k in rows[0]}


def bench(name, **how):
    """Model, readings and the core (K,) at the record's instants; see `bench_record`."""
    model, record, core = bench_record(name, **how)
    return model, measured(record, model), core


def bench_record(name, *, voltage=False, every=1, share=1.0, noise=0.0, **scaled):
    """Model, record and the core (K,) at its instants; the files count charging positive."""
    slow = columns(need("core_surface", f"{name}.csv"))
    model = data_sheet(name, **scaled)
    t = slow["t_s"]
    surface = slow["T_surf_C"] + noise * np.random.default_rng(7).standard_normal(len(t))
    end = t[0] + share * (t[-1] - t[0])
    kept = (np.arange(len(t)) % every == 0) & (t <= end)
    fast, t_fast = slow, t
    if name == "a123_26650_hev2":  # its table was interpolated: the mean square lives in the raw stamps
        fast = columns(need("core_surface", f"{name}_raw_current.csv"))
        t_fast = fast["t_s"]
    stamps = np.unique(np.concatenate([t[kept], t_fast[t_fast <= end] if t_fast is not t else t[kept]]))

    def at(own, x):
        out = np.full(len(stamps), np.nan)
        place = np.searchsorted(stamps, own)
        there = (place < len(stamps)) & (stamps[np.minimum(place, len(stamps) - 1)] == own)
        out[place[there]] = x[there]
        return out

    record = make_record(
        Columns(
            time_s=stamps,
            current_A=-at(t_fast, fast["I_A"]),
            coolant_inlet_C=at(t[kept], slow["T_amb_C"][kept]),
            voltage_V=at(t_fast, fast["V_V"]) if voltage else None,
            surface_C={1: at(t[kept], surface[kept])},
            source=name,
        ),
        model,
    )
    core = np.interp(record.instants, t, slow["T_core_C"])
    return model, record, core
