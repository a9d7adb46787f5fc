"""Checks of the inputs of a record: current, voltage, inlet, flow and SOC."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bms_gateway.diagnosis.coarse_rows import HOPELESS, doubt
from bms_gateway.diagnosis.known_values import correlation, median_of_known
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.thermal import Floats, StringModel
from bms_gateway.thermal.drive import Drive

ACTIVE, REST = 0.1, 0.03
"""Shares of the greatest current, above which a string works and below which it rests."""
REST_S, PAUSE_S = 30.0, 10.0
"""Least total rest for which the current at rest is reported, and least length of one rest: a current that passes
through zero is no rest."""
AGAINST = 0.3
"""Correlation of the current with the voltage, or with the change of the SOC, above which its sign is the other one."""
PART_S, LEAST_PART, LEAST_SWING, AGAINST_PART = 450.0, 15, 0.3, 0.6
"""A part of a record whose sign is judged by itself: its length, its least number of values, the least scatter of its
current over that of the record, because a steady current tells nothing, and its correlation."""
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
LOOP = 0.8
"""Least correlation of flow with temperature at which a fan seems to follow the temperature."""
SWAPPED_K, SATURATED = 0.5, 0.02
LEVELS = 0.05
"""Share of the time at exactly the greatest current that is not by chance, for this number of levels per interval."""


def check_current(r: Record, model: StringModel) -> Iterator[Finding]:
    """Check size, direction and variety of the current."""
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
            said = f"The current is {rms:.3g} A all along, in both directions"
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


def check_rest(r: Record, _: StringModel) -> Iterator[Finding]:
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


def check_sign(r: Record, _: StringModel) -> Iterator[Finding]:
    """Check the sign of the current by the voltage, or by the SOC if there is no voltage, as a whole and by parts."""
    d = r.drive
    if "voltage" in d.known:
        yield from _sign(np.diff(d.I), np.diff(d.V), d.dt, "voltage")
    elif "soc" in d.known:
        block = max(round(60.0 / d.dt), 1)
        count = d.N // block
        if count >= 5:
            soc = d.soc[: count * block : block]
            moved = d.I[: (count - 1) * block].reshape(count - 1, block).mean(axis=1)
            yield from _sign(moved, np.diff(soc), block * d.dt, "SOC")


def _sign(current: Floats, witness: Floats, step_s: float, name: str) -> Iterator[Finding]:
    """Judge the current by what must fall as it rises, one value a step."""
    rises = f"The {name} rises with the current"
    if (whole := correlation(current, witness)) > AGAINST:
        yield Finding(
            "current_sign",
            "warn",
            f"{rises} (correlation {whole:+.2f}): discharge must be positive. Flip it with --columns "
            "current_A=-COLUMN.",
        )
        return
    size = max(int(PART_S / step_s), LEAST_PART)
    edges = np.linspace(0, len(current), max(1, round(len(current) / size)) + 1).astype(int)
    told = [correlation(current[i:k], witness[i:k]) for i, k in pairwise(edges)]
    swings = [_scatter(current[i:k]) > LEAST_SWING * _scatter(current) for i, k in pairwise(edges)]
    against = [k for k, (x, swing) in enumerate(zip(told, swings, strict=True)) if swing and x > AGAINST_PART]
    if against and any(x < -AGAINST_PART for x in told):
        minutes = edges * step_s / 60.0
        first, last = minutes[against[0]], minutes[against[-1] + 1]
        total = sum(minutes[k + 1] - minutes[k] for k in against)
        yield Finding(
            "current_sign",
            "warn",
            f"{rises} for {total:.0f} min between {first:.0f} and {last:.0f} min of the record, and falls with it at "
            "other times: there the current has the other sign. Mend the column, or leave this part out.",
        )


def _scatter(x: Floats) -> float:
    known = x[np.isfinite(x)]
    return float(np.std(known)) if len(known) else 0.0


def check_inlet(r: Record, _: StringModel) -> Iterator[Finding]:
    """Check whether the inlet is recorded, moves, and is colder than surfaces under current."""
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
    warm = np.append(False, above_share(d, ACTIVE))
    warm[: len(warm) // 2] = False
    gap = r.grid[warm] - np.append(d.T_in[0], d.T_in)[warm, None]
    if np.isfinite(gap).any() and (most := float(np.nanmax(median_of_known(gap)))) < -SWAPPED_K:
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
    if float((above_share(d, ACTIVE) & within).sum()) * d.dt >= STILL_INLET_S:
        yield Finding(
            "inlet_stuck",
            "warn",
            f"The inlet reads {float(d.T_in[within].mean()):.1f} °C for {(last - first) / 60:.0f} min, from "
            f"{(first - r.instants[0]) / 60:.0f} min on, and moves all the other time: is its sensor stuck?",
        )


def check_loop(r: Record, _: StringModel) -> Iterator[Finding]:
    """Check whether the flow follows the temperature."""
    d = r.drive
    if "flow" not in d.known or float(np.ptp(d.flow)) < 0.05:
        return
    hottest = np.where(np.isfinite(r.grid), r.grid, -np.inf).max(axis=1)[:-1]
    seen = np.isfinite(hottest)
    if (together := correlation(hottest[seen], d.flow[seen])) > LOOP:
        yield Finding(
            "flow_follows_temperature",
            "warn",
            f"The coolant flow follows the temperature (correlation {together:.2f}), as a controlled fan does: cause "
            "and effect are hard to separate. Record a run at fixed flow.",
        )


def check_charge(r: Record, _: StringModel) -> Iterator[Finding]:
    """Check whether there is an SOC, and how far it moves."""
    d = r.drive
    if "soc" not in d.known:
        yield Finding("no_soc", "note", "Without an SOC nothing that depends on it can be found.")
    elif (span := float(np.ptp(d.soc))) < SOC_SPAN:
        yield Finding(
            "soc_span",
            "note",
            f"The SOC moves by {100 * span:.0f} % only: what depends on it looks constant.",
        )


def check_missing_current(r: Record, _: StringModel) -> Iterator[Finding]:
    """Check for how long the current is missing."""
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


def check_rows(r: Record, _: StringModel) -> Iterator[Finding]:
    """Check whether the current is logged often enough for its steps."""
    if (share := doubt(r)) > 0.0:
        what = "nothing can be named" if share > HOPELESS else "only what stands out of that is named"
        yield Finding(
            "current_coarse",
            "warn",
            f"The current jumps between its rows, {r.sampling.seconds:.3g} s apart: a minute's heat is known to "
            f"± {100.0 * share:.0f} % (1 sd) only, and {what}. Log it every second or faster.",
        )


def above_share(d: Drive, share: float) -> NDArray[np.bool_]:
    """Intervals whose effective current is above a share of the greatest one."""
    effective = np.sqrt(d.I2)
    return np.asarray(effective > share * effective.max())


def _runs(on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """List the runs of intervals that are on: the first interval of each, and the one after it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(np.int8))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))
