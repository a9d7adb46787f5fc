"""Figures of the page: those of the reports, with the band of the model, and the readings alone while it is fitted."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bms_gateway.diagnose.compare import Comparison, CoreCheck
from bms_gateway.diagnose.regimes import seconds_of
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.report.html_figures import STYLES, cores, drive, faint, overlay
from bms_gateway.report.html_series import (
    Clock,
    Trace,
    broken,
    clock,
    envelope,
    numbers,
    points_each,
    smooth,
    traces_of,
)
from bms_gateway.report.page import Figure
from bms_gateway.thermal import Floats

NAMES = ("from its file", "refitted")
"""What the page calls the two models of a comparison; also the legend groups by which it shows one of them."""
HEIGHT = 380
PREVIEW_POINTS = 12_000
"""Of all curves of one effect together: they are drawn on pointing at it, and many effects are kept."""
MANY_CELLS = 24
"""Cells up to which every core has its figure; of longer strings those with a sensor have."""
SIGMAS = 2.0
"""Half width of the band around a model, in sd of one reading."""

Figures = dict[str, Figure]


def readings(records: Sequence[Measured]) -> Figures:
    """Draw readings and drive before anything is fitted: the first picture that a person sees."""
    found: Figures = {}
    points = points_each(sum(len(m.channels) for m in records))
    for r, m in enumerate(records):
        t = seconds_of(m)
        time = clock(float(t.max()))
        for j, (_, cell) in enumerate(m.channels):
            mine = m.channel == j
            if mine.any():
                trace = Trace(r, cell, t[mine], m.y[mine], (), float(m.sigma0[j]), ())
                found[f"surface-{r}-{cell}"] = overlay(trace, (), m, time, points, HEIGHT)
        found[f"drive-{r}"] = drive(m, time, points)
    return found


def compared(c: Comparison) -> Figures:
    """Draw readings and both models of a comparison, and the cores."""
    fits = (c.filed.fit, c.refitted.fit)
    traces = traces_of(fits)
    points = points_each(7 * len(traces))
    records = fits[0].problem.records
    found: Figures = {}
    for t in traces:
        m = records[t.record]
        time = _clock(traces, t.record)
        spec = overlay(t, NAMES, m, time, points, HEIGHT)
        spec["data"] = _bands(t, time, points) + spec["data"]
        found[f"surface-{t.record}-{t.cell}"] = spec
    for r, m in enumerate(records):
        time = _clock(traces, r)
        found[f"drive-{r}"] = drive(m, time, points)
        both = (c.filed.cores[r], c.refitted.cores[r])
        n = both[0].T_c.shape[1]
        shown = range(1, n + 1) if n <= MANY_CELLS else [cell for _, cell in m.channels]
        for k in shown:
            found[f"core-{r}-{k}"] = cores(both, NAMES, k, m, time, _thermocouple(c.refitted.core_checks, r, k))
    return found


def preview(fit: MapFit) -> dict[str, dict[str, Any]]:
    """Draw what another fit of the same records makes of each sensor, to be laid over the plot."""
    traces = traces_of((fit,))
    points = max(PREVIEW_POINTS // max(len(traces), 1), 60)
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


def _bands(t: Trace, time: Clock, points: int) -> list[dict[str, Any]]:
    """Fill what a reading may lie off each model by its sensor's noise."""
    data: list[dict[str, Any]] = []
    for name, model, (color, _) in zip(NAMES, t.models, STYLES, strict=True):
        x, y = broken(*envelope(t.time_s, model, points), t.breaks_s)
        edge: Mapping[str, Any] = {
            "type": "scatter",
            "mode": "lines",
            "line": {"width": 0},
            "hoverinfo": "skip",
            "showlegend": False,
            "legendgroup": name,
            "name": name,
        }
        half = SIGMAS * t.sigma_K
        data.append({**edge, "x": time(x), "y": numbers(np.asarray(y - half))})
        fill = {"fill": "tonexty", "fillcolor": faint(color)}
        data.append({**edge, **fill, "x": time(x), "y": numbers(np.asarray(y + half))})
    return data


def _thermocouple(checks: Sequence[CoreCheck], record: int, cell: int) -> tuple[Floats, Floats] | None:
    return next(((c.time_s, c.measured) for c in checks if c.record == record and c.cell == cell), None)
