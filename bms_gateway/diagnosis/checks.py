"""Quick checks of a record before any statistics: what the record cannot show, and what looks wrong in it.

The checks of length, readings and surface sensors are in this file, those of the inputs in `input_checks.py`.

The thresholds are wide on purpose: a person who looks at the plot would agree with each finding.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import ceil

import numpy as np

from bms_gateway.diagnosis.geometry import odd_declared
from bms_gateway.diagnosis.input_checks import (
    ACTIVE,
    REST,
    above_share,
    check_charge,
    check_current,
    check_inlet,
    check_loop,
    check_missing_current,
    check_rest,
    check_rows,
    check_sign,
)
from bms_gateway.diagnosis.known_values import mean_of_known, median_of_known
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.diagnosis.together import along, cells_in_words, span, unread_sentence, unused_sentence
from bms_gateway.errors import counted
from bms_gateway.thermal import StringModel, StringParameters, continuous, discretize, simulate

SHORTEST_S = 300.0
"""Core and surface exchange heat in tens of seconds, surface and coolant in minutes; a shorter record shows neither."""
FEWEST_READINGS, FEWEST_HELD = 12, 3
"""Least number for one sensor, because the structure of a residual is computed over up to eight readings
(`residuals.LAGS`); and for the held-out parts, which test a fit."""
RISE = 4.0
"""Least change of temperatures in multiples of the error of one reading."""
STILL = 0.05
"""The same below which a temperature is said to stand still."""
SOAK_S = 60.0
"""Least rest at the start after which constant temperatures can be compared."""
STILL_S, STILL_COARSE_S, COARSE_K = 120.0, 1800.0, 0.1
"""A fine sensor that shows the same number for this time under current is stuck; a coarse one may for half an hour."""
MUST_MOVE = 3.0
"""Multiple of the sensor's step or noise by which the model must expect a surface to change; its resistance may be half
as large."""
MISSING = 0.25
"""Share of the readings."""


def check_record(record: Record, model: StringModel) -> tuple[Finding, ...]:
    """Check one record.

    Returns
    -------
    tuple of Finding
        The worst first, then in a fixed order. With a "stop", the data are insufficient for any verdict.
    """
    checks = (
        _format,
        _length,
        _readings,
        check_current,
        _rise,
        check_rest,
        _soak,
        _stuck,
        check_sign,
        check_inlet,
        _along,
        check_loop,
        check_charge,
        _sampling,
        check_missing_current,
        check_rows,
    )
    found = [f for check in checks for f in check(record, model)]
    return tuple(sorted(found, key=lambda f: ("stop", "warn", "note").index(f.severity)))


def _format(_: Record, model: StringModel) -> Iterator[Finding]:
    """Check whether the numbers of the model fit the cell that it names."""
    for odd in odd_declared(model):
        yield Finding("cell_format", "warn", f"Model file: {odd.says}")


def _length(r: Record, model: StringModel) -> Iterator[Finding]:
    seconds = r.drive.N * r.drive.dt
    p = model.nominal
    slow = float(np.median((p.C_c + p.C_s) * (p.R_u + p.R_c)))
    if seconds < SHORTEST_S:
        yield Finding("too_short", "stop", f"The record lasts {seconds:.0f} s; {SHORTEST_S:.0f} s are the least.")
    elif seconds < 2.0 * slow:
        yield Finding(
            "short",
            "warn",
            f"The record lasts {int(seconds / 60)} min. Twice the time in which the cells of this model warm up is "
            f"{ceil(2.0 * slow / 60)} min: in less, what acts slowly is hard to see.",
        )


def _readings(r: Record, _: StringModel) -> Iterator[Finding]:
    if r.unused:
        yield Finding("unused_readings", "warn", unused_sentence(r.unused))
    for cell, why in r.refused.items():
        yield Finding("refused_sensor", "warn", f"The readings of cell {cell} are not fitted: {why.rstrip('.')}.")
    for what, cells in r.unread.items():
        yield Finding("no_readings", "warn", unread_sentence(what, cells))
    fitted = max(int(np.sum(~r.held & (r.sensor == j))) for j in range(len(r.cells)))
    held = int(np.sum(r.held))
    if fitted >= FEWEST_READINGS and held < FEWEST_HELD:
        yield Finding(
            "too_few",
            "stop",
            f"The parts of the record that are held out have {counted(held, 'reading')}, {FEWEST_HELD} are the least: "
            "cut the record to where there are readings.",
        )
    if fitted < FEWEST_READINGS:
        yield Finding(
            "too_few",
            "stop",
            f"Outside the parts of the record that are held out, no sensor has more than {counted(fitted, 'reading')}, "
            f"{FEWEST_READINGS} are the least: cut the record to where there are readings.",
        )


def _rise(r: Record, _: StringModel) -> Iterator[Finding]:
    best = 0.0
    for j in range(len(r.cells)):
        y = r.y[r.sensor == j]
        width = max(len(y) // 100, 1)
        calm = np.convolve(y, np.full(width, 1.0 / width), "valid")
        best = max(best, float(np.ptp(calm)) / float(r.noise.total[j]))
    if best < RISE:
        far = f" by more than {best:.1f} times the error of a reading" if best >= STILL else ""
        yield Finding(
            "little_heat",
            "stop",
            f"No surface temperature moves{far}: nothing can be learnt of the cells. "
            "Drive more current, or for longer.",
        )


def _soak(r: Record, model: StringModel) -> Iterator[Finding]:
    d = r.drive
    loaded = np.flatnonzero(above_share(d, REST))
    end = int(loaded[0]) if len(loaded) else d.N
    start = r.grid[: end + 1]
    if end * d.dt < SOAK_S or not np.isfinite(start).any(axis=0).all():
        return
    level = np.nanmedian(start, axis=0)
    third = max(len(start) // 3, 1)
    drift = np.abs(mean_of_known(start[-third:]) - mean_of_known(start[:third]))
    noise = r.noise.total
    if (drift > 0.1 + 3.0 * noise / np.sqrt(third)).any():
        yield Finding("no_soak", "note", "The record starts while temperatures still move: offsets cannot be read off.")
        return
    apart = level - float(np.median(d.T_in[:end]))
    allowed = 2.0 * (model.tolerances["surface_offset_K"] + model.tolerances["inlet_offset_K"])
    odd = np.abs(apart) > np.maximum(allowed, r.noise.step)
    for sign, side in ((1.0, "above"), (-1.0, "below")):
        size = {
            k: abs(off) for k, off, x in zip(r.cells, apart.tolist(), odd.tolist(), strict=True) if x and sign * off > 0
        }
        if not size:
            continue
        goes = along(size)
        if not goes and max(size.values()) - min(size.values()) > allowed:
            goes = f", cell {max(size, key=size.__getitem__)} the most"
        yield Finding(
            "soak_offset",
            "warn",
            f"At rest at the start {_surfaces(list(size), 'reads', 'read')} {span(size.values())} K {side} the inlet"
            f"{goes}: a sensor has an offset, or the pack was not yet at the coolant's temperature.",
        )


def _stuck(r: Record, model: StringModel) -> Iterator[Finding]:
    d = r.drive
    t = r.surface.at(r.instants)
    work = np.append(0.0, np.cumsum(above_share(d, ACTIVE) * d.dt))
    stuck: dict[int, tuple[float, float, float]] = {}
    for j, cell in enumerate(r.cells):
        mine = r.sensor == j
        y, left = r.y[mine], r.left[mine]
        edges = np.flatnonzero(np.diff(y, prepend=np.nan, append=np.nan) != 0.0)
        held = work[left[edges[1:] - 1]] - work[left[edges[:-1]]]
        limit = STILL_S if r.noise.step[j] < COARSE_K else STILL_COARSE_S
        k = int(np.argmax(held))
        if held[k] > limit and _must_move(r, model, cell, int(left[edges[k]]), int(left[edges[k + 1] - 1])):
            stuck[cell] = float(y[edges[k]]), held[k] / 60, float(t[mine][edges[k]] - r.instants[0]) / 60
    if stuck:
        at, held_min, from_min = zip(*stuck.values(), strict=True)
        yield Finding(
            "stuck_sensor",
            "warn",
            f"{_surfaces(list(stuck), 'stands', 'stand').capitalize()} still at {span(at, 'g')} °C for "
            f"{span(held_min, '.1f')} min under current, {'the first ' if len(stuck) > 1 else ''}from "
            f"{min(from_min):.1f} min on: {'are their sensors' if len(stuck) > 1 else 'is its sensor'} stuck?",
        )
    if len(stuck) == len(r.cells):
        yield Finding("all_stuck", "stop", "Every surface sensor stands still under current.")


def _must_move(r: Record, model: StringModel, cell: int, first: int, last: int) -> bool:
    """Whether, by the model's numbers, a surface must have changed in intervals in which its reading is constant.

    A slow charge warms a cell by less than a step of its sensor, and a steady current does not warm a warm cell
    further.
    """
    d, p = r.drive, model.nominal
    q = np.nan_to_num(d.I2)[:, None] * p.R_e
    inlet = np.append(d.T_in, d.T_in[-1])
    x = simulate(discretize(continuous(_passable(p)), d.dt), np.full(2 * p.cells, inlet[0]), q, inlet)
    expected = x[first : last + 2, 2 * cell - 1]
    reads = max(float(r.noise.step[r.cells.index(cell)]), float(r.noise.total[r.cells.index(cell)]))
    return float(np.ptp(expected)) > MUST_MOVE * reads


def _passable(p: StringParameters) -> StringParameters:
    """Use the exact coolant exchange if the bulk node would overshoot."""
    return replace(p, coolant="ntu") if np.isfinite(p.C_f) else p


def _along(r: Record, model: StringModel) -> Iterator[Finding]:
    """Check whether the cells get warmer along the coolant path, as they must."""
    if not model.has_coolant_path or len(r.cells) < 2:
        return
    half = r.grid[len(r.grid) // 2 :]
    rise = median_of_known(half - np.append(r.drive.T_in[0], r.drive.T_in)[len(r.grid) // 2 :, None])
    first, last = float(rise[0]), float(rise[-1])
    if first - last > max(1.0, 0.3 * abs(first)):
        yield Finding(
            "coolant_backwards",
            "warn",
            f"Cell {r.cells[0]} runs {first - last:.1f} K warmer than cell {r.cells[-1]}: does the coolant enter at "
            "the other end?",
        )


def _sampling(r: Record, _: StringModel) -> Iterator[Finding]:
    t = r.surface.at(r.instants)
    seconds = float(r.drive.N * r.drive.dt)
    lost = []
    for j in range(len(r.cells)):
        gaps = np.diff(t[r.sensor == j])
        lost.append(1.0 - (len(gaps) + 1) * float(np.median(gaps)) / seconds)
    if few := [cell for cell, share in zip(r.cells, lost, strict=True) if share > MISSING]:
        yield Finding(
            "readings_missing",
            "note",
            f"Up to {100 * max(lost):.0f} % of the readings of {cells_in_words(few)} are missing.",
        )
    if coarse := [cell for cell, q in zip(r.cells, r.noise.step.tolist(), strict=True) if q >= COARSE_K]:
        yield Finding(
            "coarse_sensor",
            "note",
            f"The surface of {cells_in_words(coarse)} is measured in steps of {r.noise.step.max():g} K.",
        )


def _surfaces(cells: Sequence[int], one: str, several: str) -> str:
    """Name the surfaces of cells, with the singular or plural verb."""
    return f"the surface{'s' if len(cells) > 1 else ''} of {cells_in_words(cells)} {several if len(cells) > 1 else one}"
