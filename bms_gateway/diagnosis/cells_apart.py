"""R_e of each cell of a string from one record: with all surfaces sensed, as at commissioning, or with some."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from bms_gateway.diagnosis.record import Record
from bms_gateway.errors import ConfigError, DataError
from bms_gateway.identify.cell_live import FLOW_MOVED, CellJob, CellResult
from bms_gateway.identify.cell_prior import CellSettings
from bms_gateway.identify.electrical import ElectricalResistance, ElectricalSums
from bms_gateway.identify.resistance_by_cell import CellRecord
from bms_gateway.thermal import Disturbance, StringModel

LEAST_S = 600.0
"""One slow time constant of a cell; a shorter record shows no difference between cells."""


def sensed_everywhere(model: StringModel) -> StringModel:
    """Return the string with a surface sensor on each cell, for a run with more sensors than the vehicle.

    Raises
    ------
    ConfigError
        Single cells of this model cannot be identified.
    """
    if model.cells == 1:
        raise ConfigError("--cells tells the cells of a string apart; this model has one cell")
    if model.effects:
        named = ", ".join(e.key for e in model.effects)
        raise ConfigError(f"--cells knows no effects yet; this model has {named}: take the model without")
    return replace(model, sensors=tuple(range(1, model.cells + 1)))


def tell_apart(
    model: StringModel, record: Record, settings: CellSettings, disturbance: Disturbance
) -> tuple[CellResult, tuple[str, ...]]:
    """Find R_e of each cell from the priors and one uninterrupted part of a record.

    Parameters
    ----------
    model : StringModel
    record : Record
        Made for `sensed_everywhere`.
    settings : CellSettings
    disturbance : Disturbance

    Returns
    -------
    CellResult
    notes : tuple of str
        Parts that were left out.

    Raises
    ------
    DataError
        The record is too short.
    """
    u, notes = record.drive, []
    spans = [(a, b - 1) for a, b in pairwise((*record.segments, u.N + 1))]
    first, end = max(spans, key=lambda span: span[1] - span[0])
    seconds = (end - first) * u.dt
    if seconds < LEAST_S:
        raise DataError(f"{record.source}: {seconds:.0f} s without a gap; --cells needs {LEAST_S:.0f} s at least")
    if len(spans) > 1:
        notes.append(f"Gaps part this record: the longest part of it, {seconds / 60.0:.0f} min, tells the cells apart.")
    flow = np.log(u.flow[first:end])
    if np.ptp(flow) > 2.0 * FLOW_MOVED:
        notes.append("The coolant flow moves within the record; its mean is used, which errs where cooling follows it.")
    job = CellJob(
        model.unfitted,
        _thermal(record, model.cells, first, end),
        _electrical(record, model.cells, first, end),
        None,
        settings,
        disturbance,
        {},
        float(np.exp(flow.mean())),
        over=True,
    )
    return job.run(), tuple(notes)


def _thermal(record: Record, cells: int, first: int, end: int) -> CellRecord:
    """Intervals `first` … `end` − 1 as steps; a step's readings are those after its first instant."""
    u, r, K = record.drive, record.surface, end - first
    n = cells
    at_instant = r.share <= 1e-9
    step = r.left - at_instant - first
    age = np.where(at_instant, 0.0, (1.0 - r.share) * u.dt)
    surface, late = np.full((K, n), np.nan), np.zeros((K, n))
    for j, cell in enumerate(r.cells):
        mine = (r.sensor == j) & (step >= 0) & (step < K)
        count = np.bincount(step[mine], minlength=K)
        there = count > 0
        for out, x in ((surface, r.y), (late, age)):
            out[there, cell - 1] = np.bincount(step[mine], x[mine], K)[there] / count[there]
    inside = (u.T_in[first : end - 1] + u.T_in[first + 1 : end]) / 2.0
    ends = [u.T_in[first] - (inside[0] - u.T_in[first]), u.T_in[end - 1] + (u.T_in[end - 1] - inside[-1])]
    inlet = np.concatenate([ends[:1], inside, ends[1:]])
    return CellRecord(u.I2[first:end], inlet, surface, late, u.dt)


def _electrical(record: Record, cells: int, first: int, end: int) -> ElectricalResistance:
    sums = ElectricalSums(cells)
    if record.voltages is not None:
        pairs = record.voltages.over(record.instants[first : end + 1], cells)
        for pair, current in zip(pairs, record.drive.I[first:end].tolist(), strict=True):
            sums.update(pair, current, record.drive.dt)
    return sums.result(record.drive.dt)
