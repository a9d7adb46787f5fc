"""From a record to the input of a fit: a grid coarse enough for the size of the string, starts, noise."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from bms_gateway.diagnosis.record import Record
from bms_gateway.identify.coordinates import Channel, Measured
from bms_gateway.thermal import Floats, StringModel
from bms_gateway.thermal.drive import Drive, Span

START_S = 45.0
"""Time at the start of a span whose readings give its surfaces: cells hardly warm in it, and noise averages out."""
UNSEEN_SD = 0.2
"""K: sd of the start of a surface without a sensor about the line between its sensed neighbours."""
LEAST_START_SD = 0.02
WORK = 12_000
"""Most cells times intervals of a ranking; beyond it, intervals are joined, and their means stay exact."""
COARSEST_S = 5.0
HIDDEN = 0.15
"""Largest error of joining, as a share of a sensor's noise."""


def measured(record: Record, model: StringModel, *, join: int | None = None, core: bool = False) -> Measured:
    """Make a record ready for a fit.

    Parameters
    ----------
    record : Record
    model : StringModel
    join : int, optional
        Number of intervals joined into one; by default, chosen by the amount of work.
    core : bool
        Whether to use the thermocouples in the cores too (calibration), with nothing held out.
    """
    join = join or joined(record, model)
    spans, drives, first_row = [], [], []
    row, at = 0, 0
    bounds = _spans(record)
    for span in bounds:
        blocks = max(len(span) // join, 1)
        size = min(join, len(span))
        drives.append(_join(record.drive, span.first, blocks, size))
        spans.append(Span(at, at + blocks))
        first_row.append(row)
        at += blocks
        row += blocks + 1
    drive = _concatenate(record.drive, drives, join)
    channels: list[Channel] = [("surface", k) for k in record.cells]
    sources = [(record.surface, record.held, 0)]
    sigma, step = record.noise.sigma, record.noise.step
    if core:
        channels += [("probe", k) for k in record.core.cells]
        sources = [(record.surface, np.zeros_like(record.held), 0)]
        sources.append((record.core, np.zeros(len(record.core.y), np.bool_), len(record.cells)))
        sigma = np.concatenate([sigma, np.full(len(record.core.cells), float(np.mean(sigma)))])
        step = np.concatenate([step, np.zeros(len(record.core.cells))])
    channel, rows, share, y, used = [], [], [], [], []
    for readings, held, offset in sources:
        for i, span in enumerate(bounds):
            size = min(join, len(span))
            end = span.first + len(spans[i]) * size
            mine = np.flatnonzero((readings.left >= span.first) & (readings.left < end))
            place = (readings.left[mine] - span.first + readings.share[mine]) / size
            base = np.minimum(place.astype(np.int64), len(spans[i]) - 1)
            channel.append(readings.sensor[mine] + offset)
            rows.append(base + first_row[i])
            share.append(place - base)
            y.append(readings.y[mine])
            used.append(~held[mine])
    start, start_sd = zip(*(_start(record, span, model.cells) for span in bounds), strict=True)
    order = np.lexsort((np.concatenate(rows), np.concatenate(channel)))
    return Measured(
        drive,
        tuple(spans),
        tuple(channels),
        np.concatenate(channel)[order],
        np.concatenate(rows)[order],
        np.concatenate(share)[order],
        np.concatenate(y)[order],
        np.concatenate(used)[order],
        sigma,
        step,
        start,
        start_sd,
        record.source,
        {str(quantity): said for quantity, said in record.assumed.items()},
    )


def joined(record: Record, model: StringModel) -> int:
    """Choose how many intervals a ranking joins: as many as the size requires and the noise hides.

    Within an interval the heat counts as constant and the temperature as linear. A surface's second derivative is at
    most q / (C_c R_c C_s), so the error is an eighth of this times dt².
    """
    wanted = int(np.ceil(model.cells * record.drive.N / WORK))
    p = model.nominal
    bend = float(np.quantile(record.drive.I2, 0.95) * np.mean(p.R_e / (p.C_c * p.R_c * p.C_s)))
    hidden = np.sqrt(8.0 * HIDDEN * float(np.min(record.noise.total)) / max(bend, 1e-12))
    return max(1, min(wanted, int(min(COARSEST_S, hidden) / record.drive.dt)))


def _spans(record: Record) -> list[Span]:
    edges = [*record.segments, record.drive.N + 1]
    return [Span(a, b - 1) for a, b in pairwise(edges) if b - 1 > a]


def _join(u: Drive, first: int, blocks: int, size: int) -> dict[str, Floats]:
    def mean(x: Floats) -> Floats:
        return np.asarray(x[first : first + blocks * size].reshape(blocks, size).mean(axis=1))

    return {name: mean(getattr(u, name)) for name in _INPUTS}


def _concatenate(u: Drive, parts: Sequence[dict[str, Floats]], join: int) -> Drive:
    joined = {name: np.concatenate([p[name] for p in parts]) for name in _INPUTS}
    return Drive(dt=u.dt * join, known=u.known, **joined)


_INPUTS = ("I", "I2", "I_abs", "T_in", "flow", "soc", "V", "IV", "hours")


def _start(record: Record, span: Span, cells: int) -> tuple[Floats, Floats]:
    """Find the surfaces at the start of a span and their sd: by a parabola through each sensor's first readings."""
    dt = record.drive.dt
    at, value, sd = [], [], []
    for j, k in enumerate(record.cells):
        mine = (record.sensor == j) & (record.left >= span.first) & (record.left < span.last)
        t = (record.left[mine] + record.share[mine] - span.first) * dt
        y = record.y[mine]
        early = t <= max(START_S, 5 * dt)
        if not early.any():
            early = np.arange(len(t)) < 5
        if not len(t):
            continue
        sigma = float(record.noise.total[j])
        if early.sum() >= 8:
            line, level = (float(np.polyfit(t[early], y[early], degree)[-1]) for degree in (1, 2))
            # a surface follows its load within seconds: the curvature of the parabola shows the remaining error
            error = float(np.hypot(3.0 * sigma / np.sqrt(early.sum()), level - line))
        else:
            level, error = float(np.median(y[early])), sigma / np.sqrt(early.sum())
        at.append(k)
        value.append(float(level))
        sd.append(float(np.hypot(max(error, LEAST_START_SD), record.noise.step[j] / np.sqrt(12.0))))
    if not at:
        return np.full(cells, float(record.drive.T_in[span.first])), np.full(cells, 1.0)
    start = np.interp(np.arange(1, cells + 1), at, value)
    start_sd = np.full(cells, UNSEEN_SD)
    start_sd[np.array(at) - 1] = sd
    return start, start_sd
