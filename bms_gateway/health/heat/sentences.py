"""Sentences of the findings of the watch over heat: the likeliest cause, other possible causes, and what to do."""

from typing import TYPE_CHECKING

import numpy as np

from bms_gateway.errors import signed
from bms_gateway.health.heat.fault_evidence import Evidence, Kind
from bms_gateway.health.limit_words import BAND_SD
from bms_gateway.thermal import Floats

if TYPE_CHECKING:
    from bms_gateway.health.heat.finding import Finding

LEAST_SHARE = 0.01
"""Least share of the evidence of another cause that is named."""
TROUBLE = {
    Kind.JUMP: "has jumped by {0} K",
    Kind.SLOPE: "drifts by {0} K/h",
    Kind.LOOSE: "has come loose: {1:.0f} % of the coolant is in its reading",
    Kind.LAG: "follows its cell a minute late or more ({1:.0f} % of its reading): it has come off",
}


def sentence(f: "Finding", cells: int, now_ns: int, *, over: bool = False) -> str:
    """Say what a finding means and what to do.

    Parameters
    ----------
    f : Finding
    cells : int
        Of its string.
    now_ns : int
        Bus time.
    over : bool
        Whether it has ended.
    """
    if over:
        return OVER[f.code].format(cell=f.cell)
    else_ = ""
    if f.others:
        else_ = "; could also be " + ", ".join(f"{name} ({100 * p:.0f} %)" for name, p in f.others)
    if f.code == "unexplained_heat":
        near = [k for k in ((f.cell or 0) - 1, (f.cell or 0) + 1) if 1 <= k <= cells and f.places != (f.place,)]
        beside = f"; it may sit in cell {' or '.join(map(str, near))}, or in several of them" if near else ""
        now = (
            f"{_watts(f.heat, 2)} ± {_watts(BAND_SD * f.heat_sd, 1)} W that no current makes"
            if f.heat > 0.0  # no cell cools by itself
            else f"{_watts(f.size, 2)} W when it was found; none is seen now, but the cell has not cooled"
        )
        return (
            f"cell {f.cell} heats by itself: {now}, since {_how_long(now_ns - f.since_ns)} ({100 * f.sure:.0f} % "
            f"sure{beside}){else_}{_may_be_frozen(f)}: an internal short is likely (or heat from outside, as of sun or "
            "a heater): stop, cool the string and watch the cell"
        )
    if f.code == "missing_heat":
        return (
            f"the cells make {100 * f.size:.0f} % of the heat that the current says{else_}: the current is not "
            "credible, check its sensor, scale and wiring"
        )
    if f.code == "cooling":
        lost = f"(R_u {signed(100 * f.size, 0)} %)"
        return f"heat leaves all cells less well {lost}{else_}: check fan or pump, filter and ducts"
    if f.code == "inlet" and f.still_s:
        return (
            f"the coolant inlet has read exactly the same for {f.still_s / 60.0:.0f} min, and before it moved all the "
            f"time{else_}: its sensor is frozen, check it"
        )
    if f.code == "inlet":
        return (
            f"the coolant inlet reads {signed(-f.size)} K off what the cells feel{else_}: its sensor is frozen "
            "or wrong, check it"
        )
    if f.still_s:
        return (
            f"thermocouple of cell {f.cell} has read exactly the same for {f.still_s / 60.0:.0f} min, much longer than "
            f"before{else_}: it is frozen, check its plug and its amplifier"
        )
    what = TROUBLE[f.kind].format(signed(f.size), 100 * f.size)
    return f"thermocouple of cell {f.cell} {what}{else_}: check its seat, wire and plug"


def _may_be_frozen(f: "Finding") -> str:
    """Say that the thermocouple which shows heat stands unusually still."""
    minutes = f.still_s / 60.0
    return f"; its thermocouple has read exactly the same for {minutes:.0f} min and may be frozen" if minutes else ""


def others(e: Evidence, s: int, share: Floats, of: "Finding") -> tuple[tuple[str, float], ...]:
    """List the other causes of a finding in string `s` by the share (H,) of each fault, the likeliest first."""
    at = e.at
    found: dict[str, float] = {}
    for k, j in zip(e.kinds[share >= LEAST_SHARE].tolist(), np.flatnonzero(share >= LEAST_SHARE).tolist(), strict=True):
        place = int(e.place[j])
        alike = k == of.kind or (Kind.HEAT < k < Kind.FLOW and Kind.HEAT < of.kind < Kind.FLOW)
        if alike and place == of.place:
            continue
        if k == Kind.HEAT and of.kind is Kind.HEAT and abs(int(at.told[s, place] - at.told[s, of.place])) <= 1:
            continue  # the sentence says that the heat may sit beside its cell
        if k == Kind.HEAT:
            name = f"heat in cell {at.told[s, place] + 1}"
        elif k < Kind.FLOW:
            name = f"thermocouple {at.sensors[s, place] + 1}"
        else:
            name = {
                Kind.FLOW: "cooling",
                Kind.INLET: "the coolant inlet",
                Kind.LOAD: "the current",
                Kind.STREAM: "the flow",
            }[Kind(k)]
        found[name] = found.get(name, 0.0) + float(share[j])
    return tuple(sorted(found.items(), key=lambda x: -x[1])[:3])


def _watts(value: float, digits: int) -> str:
    """Write a heat with `digits` significant digits, never with a power of ten."""
    return f"{value:.0f}" if abs(value) >= 9.5 * 10.0 ** (digits - 2) else f"{value:.{digits}g}"


def _how_long(ns: int) -> str:
    """Write a time in minutes or hours."""
    minutes = ns / 60e9
    return f"about {minutes:.0f} min" if minutes < 90.0 else f"about {minutes / 60.0:.1f} h"


OVER = {
    "unexplained_heat": "cell {cell} makes no heat of its own any more",
    "missing_heat": "the cells warm as the current says again",
    "cooling": "heat leaves the cells as before again",
    "inlet": "the coolant inlet agrees with the cells again",
    "thermocouple": "the thermocouple of cell {cell} follows its cell again",
}
