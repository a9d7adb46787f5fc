"""Quick checks of a record before any statistics: what the record cannot show, and what looks wrong in it.

The thresholds are wide on purpose: a person who looks at the plot would agree with each finding.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bms_gateway.diagnosis.coarse_rows import HOPELESS, doubt
from bms_gateway.diagnosis.geometry import odd_declared
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.together import along, cells_in_words, span, unread_sentence, unused_sentence
from bms_gateway.errors import counted
from bms_gateway.thermal import Floats, StringModel, StringParameters, continuous, discretize, simulate
from bms_gateway.thermal.drive import Drive

Severity = Literal["stop", "warn", "note"]
"""Nothing can be learnt; something is probably wrong; a limit worth knowing."""

SHORTEST_S = 300.0
"""Core and surface exchange heat in tens of seconds, surface and coolant in minutes; a shorter record shows neither."""
FEWEST_READINGS, FEWEST_HELD = 12, 3
"""Least number for one sensor, because the structure of a residual is computed over up to eight readings
(`residuals.LAGS`); and for the held-out parts, which test a fit."""
RISE = 4.0
"""Least change of temperatures in multiples of the error of one reading."""
ACTIVE, REST = 0.1, 0.03
"""Shares of the greatest current, above which a string works and below which it rests."""
REST_S, PAUSE_S = 30.0, 10.0
"""Least total rest for which the current at rest is reported, and least length of one rest: a current that passes
through zero is no rest."""
SOAK_S = 60.0
"""Least rest at the start after which constant temperatures can be compared."""
STILL_S, STILL_COARSE_S, COARSE_K = 120.0, 1800.0, 0.1
"""A fine sensor that shows the same number for this time under current is stuck; a coarse one may for half an hour."""
MUST_MOVE = 3.0
"""Multiple of the sensor's step or noise by which the model must expect a surface to change; its resistance may be half
as large."""
INLET_K = 0.5
INLET_LOST_S = 120.0
"""An inlet that is missing for this time may have gone anywhere: the coolant of a pack changes within minutes."""
STILL_INLET_S = 300.0
"""Least time under current for which an otherwise moving inlet is constant before this is reported."""
LOST_S, LOST = 30.0, 0.1
"""A current that is missing for this time at once, or for this share of the record, leaves visible heat unknown."""
SOC_SPAN = 0.2
ABSURD_K = 1000.0
"""A predicted warming that no record can contain, because cells would burn before."""
STEADY = 0.05
"""Scatter of the squared current, relative to its mean, below which the current counts as constant."""
MISSING = 0.25
"""Share of the readings."""
LOOP = 0.8
"""Least correlation of flow with temperature at which a fan seems to follow the temperature."""
SWAPPED_K, SATURATED = 0.5, 0.02
LEVELS = 0.05
"""Share of the time at exactly the greatest current that is not by chance, for this number of levels per interval."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding.

    Attributes
    ----------
    kind : str
        Fixed word for programs.
    severity : {"stop", "warn", "note"}
    sentence : str
        For people.
    """

    kind: str
    severity: Severity
    sentence: str


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
        _current,
        _rise,
        _rest,
        _soak,
        _stuck,
        _sign,
        _inlet,
        _along,
        _loop,
        _charge,
        _sampling,
        _missing_current,
        _rows,
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
            f"The record lasts {seconds / 60:.0f} min, less than twice the {slow / 60:.0f} min in which the cells of "
            "this model warm up: what acts slowly is hard to see.",
        )


def _readings(r: Record, _: StringModel) -> Iterator[Finding]:
    if r.unused:
        yield Finding("unused_readings", "warn", unused_sentence(r.unused))
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


def _current(r: Record, model: StringModel) -> Iterator[Finding]:
    d, p = r.drive, model.nominal
    peak = float(np.sqrt(d.I2.max()))
    if peak < 1e-3:
        yield Finding("no_current", "stop", "No current flows: there is no heat to explain.")
        return
    rms = float(np.sqrt(np.mean(d.I2)))
    if (warming := float(rms**2 * np.min(p.R_e * (p.R_u + p.R_c)))) > ABSURD_K:
        yield Finding(
            "current_unit",
            "stop",
            f"A current of {rms:.3g} A rms would warm the cells of this model by {warming:.0f} K: is it in mA, "
            "or R_e of the model in another unit? A table takes A.",
        )
    if float(np.std(d.I2)) < STEADY * float(np.mean(d.I2)):
        said = f"The current is {float(np.median(d.I)):.3g} A all along"
        if float(np.ptp(d.I)) > peak:
            said = f"The current is {rms:.3g} A all along, now one way and now the other"
        yield Finding(
            "constant_current",
            "warn",
            f"{said}: resistance, drift and everything that depends on the current's size look alike. Drive pulses "
            "and rests.",
        )
    for way, one, other in (("discharged", d.I, "charging"), ("charged", -d.I, "discharging")):
        if float(one.min()) > -REST * peak:
            sentence = f"The cells are only {way}, or the signal cuts {other} off: nothing is learnt of it."
            yield Finding("one_direction", "note", sentence)
    level = float(np.abs(d.I).max())
    at_end = float(np.mean(np.abs(d.I) >= (1.0 - 1e-6) * level))
    # a profile with few levels is always at one of them
    if at_end > SATURATED and len(np.unique(np.round(d.I / level, 4))) > LEVELS * d.N:
        yield Finding(
            "current_saturated",
            "note",
            f"The current stands at its greatest value, {level:.4g} A, for {100 * at_end:.0f} % of the time: a limit "
            "of the drive, or of the sensor?",
        )


def _rise(r: Record, _: StringModel) -> Iterator[Finding]:
    best = 0.0
    for j in range(len(r.cells)):
        y = r.y[r.sensor == j]
        width = max(len(y) // 100, 1)
        calm = np.convolve(y, np.full(width, 1.0 / width), "valid")
        best = max(best, float(np.ptp(calm)) / float(r.noise.total[j]))
    if best < RISE:
        yield Finding(
            "little_heat",
            "stop",
            f"No surface temperature moves by more than {best:.1f} times the error of a reading: nothing can be "
            "learnt of the cells. Drive more current, or for longer.",
        )


def _rest(r: Record, _: StringModel) -> Iterator[Finding]:
    """Check the reading of the current sensor at rest: a level that is constant to its last digits."""
    d = r.drive
    peak = float(np.sqrt(d.I2.max()))
    steady = (np.abs(d.I) < REST * peak) & (np.sqrt(np.maximum(d.I2 - d.I**2, 0.0)) < 0.003 * peak)
    rests = [d.I[a:b] for a, b in _runs(steady) if (b - a) * d.dt >= PAUSE_S]
    if sum(len(x) for x in rests) * d.dt < REST_S:
        return
    levels = np.concatenate(rests)
    level = float(np.median(levels))
    spread = 1.4826 * float(np.median(np.abs(levels - level)))
    apart = float(np.ptp([np.median(x) for x in rests]))
    if abs(level) > max(0.003 * peak, 0.02) and max(spread, apart) < 0.5 * abs(level):
        yield Finding(
            "current_at_rest",
            "note",
            f"At rest the current reads {level:.3g} A: an offset of its sensor, or a current that never stops.",
        )


def _soak(r: Record, model: StringModel) -> Iterator[Finding]:
    d = r.drive
    loaded = np.flatnonzero(_above(d, REST))
    end = int(loaded[0]) if len(loaded) else d.N
    start = r.grid[: end + 1]
    if end * d.dt < SOAK_S or not np.isfinite(start).any(axis=0).all():
        return
    level = np.nanmedian(start, axis=0)
    third = max(len(start) // 3, 1)
    drift = np.abs(_mean(start[-third:]) - _mean(start[:third]))
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
    work = np.append(0.0, np.cumsum(_above(d, ACTIVE) * d.dt))
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


def _sign(r: Record, _: StringModel) -> Iterator[Finding]:
    d = r.drive
    if "voltage" in d.known and (against := _correlation(np.diff(d.I), np.diff(d.V))) > 0.3:
        yield Finding(
            "current_sign",
            "warn",
            f"The voltage rises with the current (correlation {against:+.2f}): discharge must be positive. Flip it "
            "with --columns current_A=-COLUMN.",
        )
    elif "soc" in d.known:
        block = max(round(60.0 / d.dt), 1)
        count = d.N // block
        if count >= 5:
            soc = d.soc[: count * block : block]
            moved = d.I[: (count - 1) * block].reshape(count - 1, block).mean(axis=1)
            if (with_charge := _correlation(moved, np.diff(soc))) > 0.3:
                yield Finding(
                    "current_sign",
                    "warn",
                    f"The SOC rises with the current (correlation {with_charge:+.2f}): discharge must be "
                    "positive. Flip it with --columns current_A=-COLUMN.",
                )


def _inlet(r: Record, _: StringModel) -> Iterator[Finding]:
    d = r.drive
    span = float(np.ptp(d.T_in))
    if (lost_s := r.sampling.inlet_missing_s) >= INLET_LOST_S:
        yield Finding(
            "inlet_missing",
            "warn",
            f"The inlet is missing for {lost_s:.0f} s: what the cells do meanwhile may look like a missing effect.",
        )
    yield from _still_inlet(r)
    if span < INLET_K:
        yield Finding(
            "inlet_constant",
            "note",
            f"The inlet moves by {span:.2f} K only: a delay of the coolant, losses to the surroundings and offsets of "
            "sensors cannot be told from other effects.",
        )
    warm = np.append(False, _above(d, ACTIVE))
    warm[: len(warm) // 2] = False
    gap = r.grid[warm] - np.append(d.T_in[0], d.T_in)[warm, None]
    if np.isfinite(gap).any() and (most := float(np.nanmax(_median(gap)))) < -SWAPPED_K:
        yield Finding(
            "inlet_warmer",
            "warn",
            f"Under current every surface is at least {-most:.1f} K colder than the coolant inlet: is the outlet or "
            "another sensor mapped as inlet?",
        )


def _still_inlet(r: Record) -> Iterator[Finding]:
    """Find a time under current with a constant inlet that otherwise changes from reading to reading."""
    d, (first, last) = r.drive, r.sampling.inlet_still_s
    within = (r.instants[:-1] >= first) & (r.instants[:-1] < last)
    if float((_above(d, ACTIVE) & within).sum()) * d.dt >= STILL_INLET_S:
        yield Finding(
            "inlet_stuck",
            "warn",
            f"The inlet reads {float(d.T_in[within].mean()):.1f} °C for {(last - first) / 60:.0f} min, from "
            f"{(first - r.instants[0]) / 60:.0f} min on, and moves all the other time: is its sensor stuck?",
        )


def _along(r: Record, model: StringModel) -> Iterator[Finding]:
    """Check whether the cells get warmer along the coolant path, as they must."""
    if not model.has_coolant_path or len(r.cells) < 2:
        return
    half = r.grid[len(r.grid) // 2 :]
    rise = _median(half - np.append(r.drive.T_in[0], r.drive.T_in)[len(r.grid) // 2 :, None])
    first, last = float(rise[0]), float(rise[-1])
    if first - last > max(1.0, 0.3 * abs(first)):
        yield Finding(
            "coolant_backwards",
            "warn",
            f"Cell {r.cells[0]} runs {first - last:.1f} K warmer than cell {r.cells[-1]}: does the coolant enter at "
            "the other end?",
        )


def _loop(r: Record, _: StringModel) -> Iterator[Finding]:
    d = r.drive
    if "flow" not in d.known or float(np.ptp(d.flow)) < 0.05:
        return
    hottest = np.where(np.isfinite(r.grid), r.grid, -np.inf).max(axis=1)[:-1]
    seen = np.isfinite(hottest)
    if (together := _correlation(hottest[seen], d.flow[seen])) > LOOP:
        yield Finding(
            "flow_follows_temperature",
            "warn",
            f"The coolant flow follows the temperature (correlation {together:.2f}), as a controlled fan does: cause "
            "and effect are hard to part. A run at fixed flow would tell more.",
        )


def _charge(r: Record, _: StringModel) -> Iterator[Finding]:
    d = r.drive
    if "soc" not in d.known:
        yield Finding("no_soc", "note", "Without an SOC nothing that depends on it can be found.")
    elif (span := float(np.ptp(d.soc))) < SOC_SPAN:
        yield Finding(
            "soc_span",
            "note",
            f"The SOC moves by {100 * span:.0f} % only: what depends on it looks constant.",
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


def _missing_current(r: Record, _: StringModel) -> Iterator[Finding]:
    lost = r.sampling
    seconds = float(r.drive.N * r.drive.dt)
    if lost.longest_s < LOST_S and lost.missing_s < LOST * seconds:
        return
    yield Finding(
        "current_missing",
        "warn",
        f"The current is missing for {lost.missing_s:.0f} s of {seconds:.0f} s, at the longest for "
        f"{lost.longest_s:.0f} s: the heat there is a guess between the readings before and after it.",
    )


def _rows(r: Record, _: StringModel) -> Iterator[Finding]:
    if (share := doubt(r)) > 0.0:
        what = "nothing can be named" if share > HOPELESS else "only what stands out of that is named"
        yield Finding(
            "current_coarse",
            "warn",
            f"The current jumps between its rows, {r.sampling.seconds:.3g} s apart: a minute's heat is known to "
            f"± {100.0 * share:.0f} % (1 sd) only, and {what}. Log it every second or faster.",
        )


def _runs(on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """List the runs of intervals that are on: the first interval of each, and the one after it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(np.int8))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def _surfaces(cells: Sequence[int], one: str, several: str) -> str:
    """Name the surfaces of cells, with the singular or plural verb."""
    return f"the surface{'s' if len(cells) > 1 else ''} of {cells_in_words(cells)} {several if len(cells) > 1 else one}"


def _above(d: Drive, share: float) -> NDArray[np.bool_]:
    """Intervals whose effective current is above a share of the greatest one."""
    effective = np.sqrt(d.I2)
    return np.asarray(effective > share * effective.max())


def _correlation(a: Floats, b: Floats) -> float:
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both], b[both]
    if len(a) < 5 or np.std(a) == 0.0 or np.std(b) == 0.0:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def _mean(y: Floats) -> Floats:
    """Mean of each column over its known values; NaN without any."""
    known = np.isfinite(y)
    count = known.sum(axis=0)
    return np.asarray(np.where(known, y, 0.0).sum(axis=0) / np.where(count > 0, count, np.nan))


def _median(y: Floats) -> Floats:
    return np.array([np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else np.nan for c in y.T])
