"""A forecast and its score as documents for machines and as words for people."""

from collections.abc import Iterator, Mapping
from math import hypot, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine import Forecast
from bms_gateway.engine.forecast_result import FOR_S
from bms_gateway.frames.quality import Quality
from bms_gateway.observe.ahead import AT_ENDS, CENTRE, CORE, HORIZONS_S, Ahead, first_crossing
from bms_gateway.report.forecast_score import ACTUAL, HELD, SCORED, STAYS, Row
from bms_gateway.report.show import text_table


def of_string(f: Forecast | None, quality: NDArray[np.uint8]) -> dict[str, Any]:
    """Return the forecast of one string as a document for machines; None if nothing is known.

    Parameters
    ----------
    f : Forecast or None
    quality : ndarray of uint8 (n,)
        Present quality of the cells' cores.
    """
    if f is None:
        return {"load_A": None, "cells": [], "first": None, "discharge_A": None, "charge_A": None}
    first = f.first
    return {
        "load_A": _n(f.load),
        "steady": f.steady,
        "first": None if first is None else {"cell": first + 1, "in_s": _n(f.limit_s[first])},
        "discharge_A": {d: _n(x) for d, x in zip(FOR_S, f.discharge.tolist(), strict=True)},
        "charge_A": {d: _n(x) for d, x in zip(FOR_S, f.charge.tolist(), strict=True)},
        "cells": [
            {
                "cell": k + 1,
                "quality": Quality(int(quality[k])).name.lower(),
                "centre_now_C": _n(f.course[0, k]),
                "in_s": _n(f.limit_s[k]),
                "soonest_s": _n(f.soonest_s[k]),
                "latest_s": _n(f.latest_s[k]),
                "ahead": [
                    {
                        "horizon_s": HORIZONS_S[h],
                        "core_C": _n(f.core[h, k]),
                        "core_sd_K": _n(f.core_sd[h, k]),
                        "centre_C": _n(f.centre[h, k]),
                        "centre_sd_K": _n(f.centre_sd[h, k]),
                        "any_load_core_sd_K": _n(hypot(f.core_sd[h, k], f.load_sd[CORE, h, k])),
                        "any_load_centre_sd_K": _n(hypot(f.centre_sd[h, k], f.load_sd[CENTRE, h, k])),
                    }
                    for h in SCORED
                ],
            }
            for k in range(f.core.shape[1])
        ],
    }


def of_plan(ahead: Ahead, j: int, limit_C: float, now: Forecast | None) -> dict[str, Any]:
    """Return the forecast of a group's string `j` under a profile as a document for machines."""
    none = np.zeros(ahead.phi.shape[0])
    T, sd = ahead.under(none)[:, :, j], ahead.sd(none)[:, :, j]
    at_s = first_crossing(T[CENTRE], limit_C)
    if now is not None:  # a cell with an unknown core has no forecast
        unknown = np.isnan(now.core[-1])
        T, sd, at_s = np.where(unknown, np.nan, T), np.where(unknown, np.nan, sd), np.where(unknown, np.inf, at_s)
    ends = T[:, AT_ENDS]
    return {
        "cells": [
            {
                "cell": k + 1,
                "in_s": _n(at_s[k]),
                "ahead": [
                    {
                        "horizon_s": HORIZONS_S[h],
                        "core_C": _n(ends[CORE, h, k]),
                        "core_sd_K": _n(sd[CORE, h, k]),
                        "centre_C": _n(ends[CENTRE, h, k]),
                        "centre_sd_K": _n(sd[CENTRE, h, k]),
                    }
                    for h in SCORED
                ],
            }
            for k in range(T.shape[2])
        ]
    }


def last_lines(document: Mapping[str, Any]) -> Iterator[str]:
    """Write the forecast for the cell of each string that will be hottest."""
    rows, said = [], []
    for name, s in document["strings"].items():
        known = [c for c in s["cells"] if c["ahead"][-1]["centre_C"] is not None]
        unknown = [str(c["cell"]) for c in s["cells"] if c["ahead"][-1]["centre_C"] is None]
        if unknown:
            said.append(f"{name}: no forecast of cells whose core is not known: {', '.join(unknown)}")
        doubtful = [str(c["cell"]) for c in s["cells"] if c["quality"] == "doubtful"]
        if doubtful:
            said.append(f"{name}: cores not proven, their forecasts are doubtful: cells {', '.join(doubtful)}")
        if not known:
            continue
        for load, of in (("load of now", known), ("profile", s.get("planned", {}).get("cells", []))):
            there = [c for c in of if c["ahead"][-1]["centre_C"] is not None]
            if not there:
                continue
            c = max(there, key=lambda c: c["ahead"][-1]["centre_C"])
            first = min((x for x in there if x["in_s"] is not None), key=lambda x: x["in_s"], default=None)
            now = next(x["centre_now_C"] for x in known if x["cell"] == c["cell"])
            what = f"{load}, {s['load_A']:.1f} A" if load == "load of now" else load
            ahead = [f"{a['centre_C']:.1f} ± {a['centre_sd_K']:.1f}" for a in c["ahead"]]
            limit = "not in 10 min" if first is None else f"{first['in_s']:.0f} s (cell {first['cell']})"
            rows.append([name, what, c["cell"], f"{now:.1f}", *ahead, limit])
    headers = ["string", "load", "cell", "now °C", "1 min", "5 min", "10 min", f"{document['limit_C']:g} °C in"]
    yield f"hottest points from {document['time_s']:.0f} s on"
    yield text_table(headers, rows)
    limits = [
        [name, *(f"{s['discharge_A'][d]:.0f} / {s['charge_A'][d]:.0f}" if s["discharge_A"][d] is not None else "unknown"
                 for d in FOR_S)]
        for name, s in document["strings"].items() if s["discharge_A"] is not None
    ]  # fmt: skip
    if limits:
        below = f"below {document['limit_C']:g} °C"
        yield f"constant current, discharge / charge, A, that keeps every hottest point {below}"
        yield text_table(["string", "10 s", "1 min", "10 min"], limits)
    yield from said


def score_lines(document: Mapping[str, Any]) -> Iterator[str]:
    """State the errors of the forecasts of cores."""
    score = document["score"]
    rows = []
    for name, loads in score["strings"].items():
        for load in (ACTUAL, HELD, STAYS):
            for horizon, x in loads.get(load.replace(" ", "_"), {}).items():
                if x["forecasts"]:
                    inside = "–" if load == STAYS else f"{100 * x['inside_2sd']:.1f} %"
                    band = "–" if load == STAYS else f"{x['mean_sd_K']:.2f}"
                    rows.append(
                        [name, load, f"{float(horizon) / 60:g} min", x["forecasts"], f"{x['rms_K']:.2f}", inside, band,
                         f"{x['crps_K']:.2f}"]
                    )  # fmt: skip
    if not rows:
        yield "no forecast could be held against what came: the log is shorter than a minute after the first one"
        return
    alike = "" if score["against"] == "truth" else ", which err as the model does (--truth gives the true cores)"
    yield f"forecasts of cores held against {score['against']}{alike}, one every {score['every_s']:g} s"
    yield text_table(["string", "load", "ahead", "forecasts", "rms K", "inside 2 sd", "sd K", "CRPS K"], rows)


def row_text(r: Row) -> str:
    """Write a row of the table of forecasts."""
    numbers = [r.load_A, r.core, r.core_sd, r.centre, r.centre_sd, r.surface, r.surface_sd, r.came]
    told = ",".join(f"{x:.3f}" if isfinite(x) else "" for x in numbers)
    head, _, last = told.partition(",")
    at = f"{r.time_ns * 1e-9:.3f},{r.string},{r.cell},{r.horizon_s:g},{r.load},{head}"
    return f"{at},{last},{r.quality}"


def _n(x: float) -> float | None:
    return round(float(x), 3) if isfinite(x) else None
