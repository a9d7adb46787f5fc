"""Places current and voltage of the pack in a proposal: sign, scale, and the number of cells in series."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from bms_gateway.setup.find_both_ways import BothWays
from bms_gateway.setup.find_charge import SAID
from bms_gateway.setup.find_chemistry import chemistries, count_cells
from bms_gateway.setup.find_electrical import ADDS_UP, CELL_OHM, Electrical, Scored
from bms_gateway.setup.groups import Member
from bms_gateway.setup.proposal import Proposal, Proposed
from bms_gateway.setup.readable import Rights
from bms_gateway.setup.signal_words import CHARGING, DISCHARGE, OTHER_THINGS, has, named
from bms_gateway.thermal import Floats
from bms_gateway.thermal.cells import Chemistry

CLEAR: Final = 2.0
"""Least lead over the next candidate at which a choice is sure."""
AGAINST: Final = "the pack's voltage and the SOC contradict each other about the sign of the current"
LEAST_A: Final = 1.0
"""Least range of a current of a vehicle that drives."""
SLIPS: Final = (1e-3, 0.1, 1e-2, 10.0, 1e3)
"""Factors by which a scale may be wrong, the likeliest first: thousandths for whole units."""


def put(proposal: Proposal, p: Proposed, strings: Sequence[int]) -> None:
    """Assign a signal to the whole pack, or to the given strings of the model."""
    if not strings:
        proposal.signals.append(p)
    for string in strings:
        halves = tuple(replace(h, overrides=dict(h.overrides)) for h in p.halves)
        own = replace(p, string=string, why=list(p.why), overrides=dict(p.overrides), against=[], halves=halves)
        proposal.signals.append(own)


def place_current(
    proposal: Proposal, e: Electrical, rights: Rights, strings: Sequence[int], by_charge: float | None
) -> bool:
    """Assign the current; return whether the SOC contradicts its sign."""
    c = e.current
    if c is None or c.score < 1.5:
        return False
    why = list(c.why)
    scale = _signed(proposal, e, c, by_charge, why)
    info = c.series.info
    one_way = c.both_ways is None and c.series.low * c.factor >= 0 and info.raw_limits[0] >= 0 and info.offset == 0
    called = one_way and has(named(info), DISCHARGE) != has(named(info), CHARGING)
    if one_way and c.maybe_other is not None:
        why.append(
            f"it never goes below 0: {c.maybe_other} may be the current in the other direction, as the two never flow "
            f"at once, but nothing confirms it; both together: current.discharge and current.charge in gateway.toml"
        )
    elif one_way:
        why.append("it never goes below 0: current in the other direction is not measured")
    if called:
        why.append("its name says one direction: look for the signal of the other")
    sure = c.unit is not None and c.score > 3.5 and e.lead > CLEAR and not c.series.constant and not called
    sure = sure and not (one_way and c.maybe_other) and not (c.both_ways is not None and c.both_ways.confirmed)
    moves = np.ptp(c.values) >= LEAST_A
    if not moves:
        why.append(f"it moves by less than {LEAST_A:g} A in this log")
    against = e.told and by_charge is not None and by_charge != e.sign
    if against:
        why.append(AGAINST)
    sure = sure and bool(moves) and not against and (e.told or by_charge is not None)
    sure = sure and math.isclose(abs(scale), abs(c.factor))  # the factor by which a scale is wrong is a guess
    p = Proposed("current", c.series, scale, 0.0, sure=sure, why=why)
    if c.both_ways is None:
        tell_rights(p, rights)
    else:
        p.halves = _halves(c.both_ways, scale)
        for half in p.halves:
            tell_rights(half, rights)
            p.sure = p.sure and not half.overrides
        if p.halves[0].path != c.both_ways.discharge.path:
            p.sure = False
            p.why.append("the data say that the names of the two directions are exchanged")
    put(proposal, p, strings)
    return against


def _halves(pair: BothWays, scale: float) -> tuple[Proposed, ...]:
    """Both signals of a current, the discharge first; each has its own direction as positive."""
    found = []
    for s, factor in ((pair.discharge, scale * pair.out), (pair.charge, scale * pair.into)):
        discharges = (factor > 0.0) == (s.low + s.high >= 0.0)
        way, own = ("discharge", factor) if discharges else ("charge", -factor)
        found.append(Proposed("current", s, own, 0.0, way=way))
    return tuple(sorted(found, key=lambda half: half.way == "charge"))


def place_voltage(
    proposal: Proposal, e: Electrical, cells: list[Member], factor: float, rights: Rights, strings: Sequence[int]
) -> None:
    """Assign the voltage, and determine the number of cells in series."""
    middle = factor * float(np.median([m.series.middle for m in cells])) if cells else e.cell_V
    total = factor * float(np.sum([m.series.middle for m in cells])) if len(cells) > 1 else np.nan
    if e.voltage is None or e.voltage.score <= 0.5:
        if np.isfinite(total):
            proposal.series_cells = len(cells)
        return
    adds = bool(np.isfinite(total) and abs(e.voltage.middle / total - 1) < ADDS_UP)
    proposal.series_cells = len(cells) if adds else max(round(e.voltage.middle / middle), 1)
    sure = e.voltage.unit is not None and (adds or e.told) and e.voltage.score > 3.0
    sure = sure and not has(named(e.voltage.series.info), OTHER_THINGS)
    p = Proposed("voltage", e.voltage.series, e.voltage.factor, 0.0, sure=sure, why=list(e.voltage.why))
    if not adds and proposal.series_cells > 1:
        known = not cells and not e.cells_of
        proposal.series_guessed |= not known
        told = _series_told(proposal.series_cells, e.voltage.middle, middle, e, bool(cells))
        p.why.append(told)
        if not known and not any("cells in series is a guess" in r for r in proposal.remarks):
            proposal.remarks.append(told)
    tell_rights(p, rights)
    put(proposal, p, strings)


def _series_told(count: int, pack_V: float, cell_V: float, e: Electrical, singly: bool) -> str:
    """Say how many cells in series there are, and how that was found."""
    each = f"{pack_V:.4g} V at {cell_V:.3g} V each"
    if singly:
        return f"that there are {count} cells in series is a guess: {each}; no voltages of single cells add up to it"
    if not e.cells_of:
        return f"there are {count} cells in series: {each}, by the signals of the greatest and least cell voltage"
    about = (
        f"about {count} cells in series" if e.chemistry_told else f"that there are {count} cells in series is a guess"
    )
    return f"{about}: {each}, of {e.cells_of}"


def count_in_series(
    e: Electrical, charge: list[Scored], extreme_V: float | None, edges: Floats, chemistry: Chemistry | None
) -> None:
    """Find the voltage of one cell: by the extremes of the cell voltages, else by pack voltage, SOC and chemistry."""
    if extreme_V is not None or e.voltage is None:
        e.cell_V = extreme_V or e.cell_V
        return
    found = None
    if e.current is not None and charge and charge[0].score >= SAID:
        I, V, soc = (c.factor * c.series.on_grid(edges) + c.shift for c in (e.current, e.voltage, charge[0]))  # noqa: E741
        found = chemistries(I, V, soc, float(np.median(np.diff(edges))))
    counted = count_cells(e.voltage.middle, found, chemistry)
    e.cell_V, e.cells_of, e.chemistry_told = counted.cell_V, counted.why, counted.told


def _signed(proposal: Proposal, e: Electrical, c: Scored, by_charge: float | None, why: list[str]) -> float:
    """Factor to A (discharge positive), and the reasons; the pack's resistance, if the voltage determines the sign."""
    scale, told = e.sign * c.factor, True
    if e.told and e.ohm is not None:
        falls = "falls" if e.sign > 0 else "rises"
        why.append(f"the pack's voltage {falls} as it rises (correlation of their steps {e.ohm.correlation:+.2f})")
    elif by_charge is not None:
        scale = by_charge * c.factor
        why.append(f"the SOC {'falls' if by_charge > 0 else 'rises'} as it counts up")
    else:
        told = False
        why.append("the data do not show its sign: positive is assumed to be discharge")
    if told and scale * c.factor < 0:
        why.append("so it is positive on charge, and its sign is turned")
    if e.told and e.ohm is not None:
        scale *= _slipped(abs(e.ohm.resistance) / (proposal.series_cells or 1), c, why)
        # counts of an unknown scale give no resistance
        counts = c.unit is None and not c.series.low <= 0.0 <= c.series.high
        if e.ohm.fine and abs(e.ohm.correlation) > 0.4 and not counts:
            proposal.resistance = abs(e.ohm.resistance * c.factor / scale)
    return scale


def _slipped(per_cell: float, c: Scored, why: list[str]) -> float:
    """Factor by which a unit is wrong, if the resistance of the cells were impossible; otherwise 1."""
    if CELL_OHM[0] <= per_cell <= CELL_OHM[1]:
        return 1.0
    # a current too large by a factor makes the resistance too small by the same factor
    fitting = [f for f in SLIPS if 3 * CELL_OHM[0] <= per_cell / f <= CELL_OHM[1] / 3]
    if not fitting:
        return 1.0
    stated, factor = c.series.info.unit or "no unit", fitting[0]
    cells = ", ".join(f"times {f:g} they have {1e3 * per_cell / f:.2g} mΩ" for f in fitting)
    why.append(f"the DBC's scale contradicts the data: {stated} would give cells of {1e3 * per_cell:.2g} mΩ; {cells}")
    return factor


def tell_rights(p: Proposed, rights: Rights) -> None:
    """Add the corrections of the DBC for a signal, and the samples left out; a corrected signal is not sure."""
    overrides, why = rights.get(p.path, ({}, []))
    p.overrides.update(overrides)
    p.why += why
    p.why += [f"{n} of {p.series.seen} samples left out: {reason}" for reason, n in p.series.dropped.items()]
    if overrides:
        p.sure = False
