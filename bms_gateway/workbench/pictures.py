"""Figures of the page: those of the reports, with the series of each step stored separately.

A figure contains what does not depend on the model. The curves of a step are a document by roles: `model`, `each` and
`mean` residual, `low` and `high` edge of a band.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bms_gateway.diagnosis.compare import Comparison, Variant
from bms_gateway.diagnosis.core_band import BAND_SD, CoreBand, at_every_step, at_times, half_width_K
from bms_gateway.diagnosis.core_check import CoreCheck
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.diagnosis.regimes import seconds_of
from bms_gateway.frames.vocabulary import INPUTS, Quantity
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.report.core_text import UNKNOWN_K
from bms_gateway.report.html_figures import STEPS, SURFACE, axis, cores, drive, layout, overlay
from bms_gateway.report.html_series import (
    Clock,
    Trace,
    breaks_of,
    broken,
    clock,
    envelope,
    extent,
    missing_in,
    smooth,
    traces_of,
)
from bms_gateway.report.page import Figure, numbers
from bms_gateway.thermal import Floats
from bms_gateway.thermal.centre import probe_lever
from bms_gateway.workbench.series import Shelf, columns

HEIGHT = 380
PREVIEW_POINTS = 12_000
"""Points of all curves of one effect together: they are drawn when the pointer is on it, and many effects are kept."""
SIGMAS = 2.0
"""Half width of the band around a model, in sd of one reading."""
FEW = 2
"""Points of what the reports' figures are asked for where the whole series is kept instead."""
ROW_PX, LEAST_PX, MOST_PX = 16, 90, 640
ABOVE_MAP_PX, BELOW_MAP_PX = 80, 42
"""Edges of a map. Above it stands the bar of its colours; what room it has not there, it takes from the map."""
COLORBAR = {
    "orientation": "h",
    "thickness": 8,
    "lenmode": "pixels",
    "len": 160,
    "tickangle": 0,
    "title": {"text": ""},  # else plotly moves the titles of the axes for a title that is not there
    "x": 1.0,
    "xanchor": "right",
    "y": 1.0,
    "yanchor": "bottom",
}
FAINTEST = 0.99
"""Quantile of the residual at which the colours of a map end."""
SCATTER = 2.5
"""Reach of the residual's axis beyond its mean, in sd of a reading."""

OF_THE_DRIVE: tuple[Quantity, ...] = ("current", "coolant_inlet")
"""First curves of the picture of the drive."""

Figures = dict[str, Figure]
Probes = Sequence[Mapping[int, tuple[Floats, Floats]]]
"""Time, s since a record began, and reading, °C, of the thermocouples in cores: by record, by cell from 1."""
Drawn = dict[str, dict[str, Any]]
"""Curves of one step, by the name of the figure."""


def readings(
    records: Sequence[Measured],
    shelf: Shelf,
    rows: Sequence[tuple[Columns, float]],
    nominal_m3_s: float | None = None,
) -> Figures:
    """Draw readings and drive before any fit: the first picture for a person.

    Parameters
    ----------
    records : sequence of Measured
    shelf : Shelf
    rows : sequence of (Columns, float)
        For the same records, and the start of each on its clock, s. If a record contains means of rows, every plausible
        row of surfaces, current and inlet is kept.
    nominal_m3_s : float, optional
        Nominal flow of the coolant, because records contain shares of it; without it no flow is drawn.
    """
    found: Figures = {}
    for r, (m, file) in enumerate(zip(records, rows, strict=True)):
        t = seconds_of(m)
        time = clock(float(t.max()))
        for j, (_, cell) in enumerate(m.channels):
            mine = m.channel == j
            if mine.any():
                trace = Trace(r, cell, t[mine], m.y[mine], (), float(m.sigma[mine][0]), breaks_of(m))
                spec = overlay(trace, (), m, time, FEW, HEIGHT)
                spec["layout"]["yaxis"]["title"]["text"] = f"cell {trace.cell}: {SURFACE}"
                samples = _every(file, "surface", cell, m, (trace.time_s, trace.measured))
                spec["data"] = [_shelved(spec["data"][0], shelf, *_open(m, time, samples))]
                spec["span"] = {"yaxis": _span(samples[1])}
                found[f"surface-{r}-{cell}"] = {**spec, "seconds": time.seconds}
        spec = drive(m, time, m.drive.N, nominal_m3_s)
        drawn = [(_floats(d["x"]), _floats(d["y"])) for d in spec["data"]]
        for i, quantity in enumerate(OF_THE_DRIVE):
            x, y = drawn[i]
            samples = _every(file, quantity, None, m, (x * time.seconds, y))
            drawn[i] = _open(m, time, samples, held=spec["data"][i]["line"].get("shape") == STEPS)
        last = time.around(0.0, time.seconds * max(float(x.max()) for x, _ in drawn))[1]
        spec["layout"]["xaxis"]["range"][1] = max(spec["layout"]["xaxis"]["range"][1], last)
        spec["data"] = [_shelved(d, shelf, *one) for d, one in zip(spec["data"], drawn, strict=True)]
        found[f"drive-{r}"] = {**spec, "seconds": time.seconds}
    return found


def _every(
    file: tuple[Columns, float], quantity: Quantity, cell: int | None, m: Measured, used: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Return time, s since the record began, and value of every plausible row; the fit's values if no row has one."""
    y = file[0].of(quantity, cell)
    if y is None:
        return used
    found = _plausible(file, quantity, y, m)
    return found if len(found[0]) else used


def _plausible(file: tuple[Columns, float], quantity: Quantity, y: Floats, m: Measured) -> tuple[Floats, Floats]:
    """Return time, s since the record began, and value of the plausible rows of a column within a record."""
    columns, began = file
    low, high = INPUTS[quantity].plausible
    t, (first, last) = columns.time_s - began, extent(m)
    mine = (t >= first) & (t <= last) & (y >= low) & (y <= high)
    return t[mine], y[mine]


def probes_of(records: Sequence[Measured], rows: Sequence[tuple[Columns, float]]) -> Probes:
    """Return every plausible row of the thermocouples in cores: by record, by cell from 1."""
    return [
        {cell: _plausible(file, "surface", y, m) for cell, y in file[0].core_C.items()}
        for m, file in zip(records, rows, strict=True)
    ]


def _open(m: Measured, time: Clock, samples: tuple[Floats, Floats], *, held: bool = False) -> tuple[Floats, Floats]:
    """Interrupt a line where the record does and where rows are missing; its times in the unit of the axis."""
    t, y = broken(*samples, sorted({*breaks_of(m), *missing_in(samples[0][np.isfinite(samples[1])], held=held)}))
    return t / time.seconds, y


def frames_of_cores(c: Comparison, shelf: Shelf, probes: Probes) -> Figures:
    """Draw the figure of each core without a model: axes, and every row of its thermocouple if there is one."""
    found: Figures = {}
    records = c.refitted.fit.problem.records
    for r, m in enumerate(records):
        n = c.refitted.cores[r].T_c.shape[1]
        time = clock(float(seconds_of(m).max()))
        for k in range(1, n + 1):
            probe = _thermocouple(c.refitted.core_checks, r, k)
            spec = cores((), r, k, m, time, probe)
            if probe is not None:
                samples = probes[r].get(k, probe)
                spec["data"] = [_shelved(spec["data"][0], shelf, *_open(m, time, samples))]
                spec["span"] = {"yaxis": _span(samples[1])}
            found[f"core-{r}-{k}"] = {**spec, "seconds": time.seconds}
    return found


def step(v: Variant, shelf: Shelf) -> Drawn:
    """Draw one model into the figures of surfaces and cores."""
    traces = traces_of((v.fit,))
    found: Drawn = {}
    for t in traces:
        time = _clock(traces, t.record)
        (model,) = t.models
        half = SIGMAS * t.sigma_K

        def kept(y: Floats, t: Trace = t, time: Clock = time) -> dict[str, Any]:
            at, line = broken(t.time_s, y, t.breaks_s)
            return {"kept": shelf.keep(at / time.seconds, line)}

        at, mean = broken(*smooth(t.time_s, t.measured - model, t.breaks_s), t.breaks_s)
        reach = SCATTER * t.sigma_K
        found[f"surface-{t.record}-{t.cell}"] = {
            "model": kept(model),
            "each": kept(t.measured - model),
            "mean": {"kept": shelf.keep(at / time.seconds, mean)},
            "low": kept(model - half),
            "high": kept(model + half),
            "span": {"yaxis": _span(model), "yaxis2": _span(mean - reach, mean + reach)},
        }
    known = half_width_K(v.cores) <= UNKNOWN_K
    for r, thin in enumerate(v.cores):
        time, band, m = _clock(traces, r), at_every_step(thin, v.fit), v.fit.problem.records[r]
        for k in range(band.T_c.shape[1]):
            name = f"core-{r}-{k + 1}"
            half_K = BAND_SD * band.total_K[:, k]
            edges = {"model": band.T_c[:, k], "low": band.T_c[:, k] - half_K, "high": band.T_c[:, k] + half_K}
            if not known[k]:  # its band shows how little is known, and no curve looks like a result
                del edges["model"]
            drawn = {role: _open(m, time, (band.time_s, y)) for role, y in edges.items()}
            found[name] = {role: {"kept": shelf.keep(*one)} for role, one in drawn.items()}
            found[name]["span"] = {"yaxis": _span(edges["low"], edges["high"])}
            outside = _outside(v, band, k + 1)
            if outside is not None:
                found[name]["outside"] = {"kept": shelf.keep(outside[0] / time.seconds, outside[1])}
    return found


def _outside(v: Variant, band: CoreBand, cell: int) -> tuple[Floats, Floats] | None:
    """Return the readings of a thermocouple in a core outside the model's band, with gaps; None if there are none."""
    probe = _thermocouple(v.core_checks, band.record, cell)
    if probe is None:
        return None
    t, y = probe
    read, sd = at_times(band, cell, t, probe_lever(v.fit.problem.model))
    beyond = np.abs(y - read) > BAND_SD * np.maximum(sd, 1e-9)
    return (t, np.where(beyond, y, np.nan)) if beyond.any() else None


def frames_of_maps(records: Sequence[Measured]) -> Figures:
    """Draw the axes of a map of all sensors of a record over time; for a single sensor there is none."""
    found: Figures = {}
    for r, m in enumerate(records):
        cells = [str(cell) for _, cell in m.channels]
        if len(cells) > 1:
            time = clock(float(seconds_of(m).max()))
            rows = axis("cell", type="category", categoryarray=cells, autorange="reversed", showgrid=False)
            height = min(max(ROW_PX * len(cells), LEAST_PX), MOST_PX) + ABOVE_MAP_PX + BELOW_MAP_PX
            spec = layout(height, m, time, yaxis=rows, coloraxis={"colorbar": COLORBAR})
            spec["hovermode"] = "closest"
            spec["margin"] |= {"t": ABOVE_MAP_PX, "b": BELOW_MAP_PX}
            found[f"map-{r}"] = {"data": [], "layout": spec}
    return found


def maps(fit: MapFit, shelf: Shelf) -> Drawn:
    """Draw the residual of all sensors over time as a map of each record, with one range of colours for all of it."""
    found: Drawn = {}
    traces = traces_of((fit,))
    for r in sorted({t.record for t in traces}):
        mine = [t for t in traces if t.record == r]
        time = _clock(traces, r)
        left = [broken(t.time_s, t.measured - t.models[0], t.breaks_s) for t in mine]
        rows = [(at / time.seconds, error) for at, error in left]
        most = float(np.nanquantile(np.abs(columns(rows, None)[1]), FAINTEST))
        found[f"map-{r}"] = {
            "map": {"y": [str(t.cell) for t in mine], "columns": [shelf.keep(*row) for row in rows]},
            "span": {"coloraxis": (-most, most)},
        }
    return found


def preview(fit: MapFit, most: int = PREVIEW_POINTS) -> dict[str, dict[str, Any]]:
    """Draw each sensor by another fit of the same records, as an addition to the plot; thinned to `most`."""
    traces = traces_of((fit,))
    points = max(most // max(len(traces), 1), 60)
    found = {}
    for t in traces:
        time = _clock(traces, t.record)
        (model,) = t.models
        x, y = broken(*envelope(t.time_s, model, points), t.breaks_s)
        at, mean = broken(*smooth(t.time_s, t.measured - model, t.breaks_s), t.breaks_s)
        found[f"surface-{t.record}-{t.cell}"] = {
            "x": time(x),
            "y": numbers(y),
            "at": time(at),
            "residual": numbers(mean),
        }
    return found


def _clock(traces: Sequence[Trace], record: int) -> Clock:
    return clock(max(float(t.time_s.max()) for t in traces if t.record == record))


def _shelved(trace: Mapping[str, Any], shelf: Shelf, x: Floats, y: Floats) -> dict[str, Any]:
    return {**{k: v for k, v in trace.items() if k not in ("x", "y")}, "kept": shelf.keep(x, y)}


def _floats(x: Sequence[float | None]) -> Floats:
    return np.array(x, np.float64)


def _span(*ys: Floats) -> tuple[float, float]:
    return float(min(np.nanmin(y) for y in ys)), float(max(np.nanmax(y) for y in ys))


def _thermocouple(checks: Sequence[CoreCheck], record: int, cell: int) -> tuple[Floats, Floats] | None:
    return next(((c.time_s, c.measured) for c in checks if c.record == record and c.cell == cell), None)
