"""Proposes the role of each signal of an unknown vehicle, from names, units and data."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.own_dbc import MAX_CELLS
from bms_gateway.frames.vocabulary import INPUTS
from bms_gateway.setup.bit_contradictions import range_of
from bms_gateway.setup.cell_numbers import MOST_EACH
from bms_gateway.setup.find_charge import charges, sign_by_charge
from bms_gateway.setup.find_electrical import (
    ADDS_UP,
    CELL_V,
    Electrical,
    Scored,
    cell_voltages,
    currents,
    extreme_cell_V,
    pack_voltages,
    together,
    while_on,
)  # fmt: skip
from bms_gateway.setup.find_lone import lone_temperatures
from bms_gateway.setup.find_statistics import of_several
from bms_gateway.setup.find_temperatures import Surfaces, flows, inlet_of_each, inlets, surfaces
from bms_gateway.setup.groups import Member, alike
from bms_gateway.setup.guessed_dbc import GUESS
from bms_gateway.setup.intervals import edges_of
from bms_gateway.setup.lumps import NOT_KNOWN, place_lumps
from bms_gateway.setup.multiplexing import told_of_selectors
from bms_gateway.setup.overlaps import leave_out_overlaps
from bms_gateway.setup.own_traffic import own_signals
from bms_gateway.setup.place_electrical import AGAINST, count_in_series, place_current, place_voltage, put, tell_rights
from bms_gateway.setup.proposal import Proposal, Proposed, Role, fits
from bms_gateway.setup.readable import Rights, readable
from bms_gateway.setup.signal_series import Series
from bms_gateway.setup.signal_words import OTHER_THINGS, around, has, named, unit_of
from bms_gateway.setup.strings import Strings, own_strings
from bms_gateway.setup.vehicle_logs import Traffic
from bms_gateway.setup.witnessed import hear_witnesses, measure_heat
from bms_gateway.thermal.cells import Chemistry

LONG_S: Final = 120.0
LEAST_S: Final = 60.0
"""In a shorter log no choice is sure."""
_FIRST: Final[tuple[Role, ...]] = ("current", "voltage", "soc")
ORDER: Final = (*_FIRST, *(q for q in INPUTS if q not in _FIRST))
"""Order of the roles in a proposal: signals of the pack, then those of cells."""
NOTHING: Final[Mapping[str, Role]] = MappingProxyType({})
NO_ROLE: Final = "its name and its values fit no role"


def propose(traffic: Traffic, refused: Mapping[str, Role] = NOTHING, chemistry: Chemistry | None = None) -> Proposal:
    """Find the signals of the pack's current, voltage, SOC, coolant, thermocouples and cell voltages.

    Parameters
    ----------
    traffic : Traffic
        Traffic with a DBC; messages that are not in the DBC are ignored.
    refused : mapping of signal to role
        Roles that a person has refused for a signal: the next best signal is proposed.
    chemistry : Chemistry or None
        Of the cells, where a person has named them: it gives their number in series, if no cell voltage does.

    Returns
    -------
    Proposal
        A role is `sure` only if name, unit and data agree and no other signal has a similar score.
    """
    proposal = Proposal(remarks=[*traffic.remarks, *told_of_selectors(traffic)])
    edges = edges_of(traffic.frames.time_ns, 1.0 if traffic.seconds > LONG_S else 0.5, 1.0)
    if traffic.own:
        own_signals(traffic, proposal)
        hear_witnesses(proposal, edges)
        return proposal
    series, rights, dead = readable(traffic, proposal)
    series = [s for s in series if s.path not in refused]
    proposal.unused += [(path, f"refused as {role}") for path, role in refused.items()]
    cells, factor = cell_voltages(series)
    voltages = [v for v in pack_voltages(series, cells, factor) if fits("voltage", v.series.info)]
    candidates = [c for c in currents(series) if fits("current", c.series.info) and c.score > 0]
    warm = surfaces(series)
    taken = {m.series.path for m in warm.members} if warm else set()
    strings = own_strings(warm.members, series, candidates, voltages, cells, edges) if warm else None
    inlet, flow = inlets(series, taken), flows(series)
    contradicted = False
    placed = _place(proposal, warm, strings, cells, rights, traffic.seconds) if warm is not None else {}
    if warm is not None:
        _not_fitted(proposal, warm, dead)
    if strings is not None:
        _count_each(strings, series, edges, chemistry)
        _strings(proposal, strings, factor, rights, placed, edges)
        electrical = next(iter(strings.own.values())).electrical
    else:
        electrical = together(candidates, voltages, edges)
        charge = charges(series, electrical, edges)
        count_in_series(electrical, charge, extreme_cell_V(series), edges, chemistry)
        sign = _by_charge(charge, electrical, edges)
        place_voltage(proposal, electrical, cells, factor, rights, ())
        contradicted = place_current(proposal, electrical, rights, (), sign)
        if len(placed) > 1 and not _in_series(proposal, cells, factor):
            _doubt(
                proposal,
                f"one current and one voltage serve {len(placed)} groups of thermocouples: right where their "
                "cells are in series, wrong where they are strings in parallel",
            )
    if warm is not None:
        for p in of_several(proposal, warm):
            tell_rights(p, rights)
            proposal.signals.append(p)
    parts = _parts(proposal)
    _cell_voltages(proposal, cells, factor, rights, parts)
    place_lumps(proposal, warm.members if warm is not None else [], cells, series, edges)
    if next(proposal.of("soc"), None) is None:
        _single(proposal, "soc", charges(series, electrical, edges), rights, against=contradicted)
    own_inlets = inlet_of_each(inlet, warm.members) if warm is not None else {}
    for part, own in own_inlets.items():
        _single(proposal, "coolant_inlet", [own], rights, placed[part])
    if not own_inlets:
        _single(proposal, "coolant_inlet", inlet, rights)
    _single(proposal, "coolant_flow", flow, rights)
    _lone(proposal, warm, series)
    leave_out_overlaps(proposal, traffic)
    hear_witnesses(proposal, edges)
    measure_heat(proposal, edges)
    _ranges(proposal)
    _long_enough(proposal, traffic.seconds)
    _guesses(proposal)
    proposal.signals.sort(key=lambda p: ORDER.index(p.role))
    _rest(proposal, series, candidates, voltages)
    return proposal


def _lone(proposal: Proposal, warm: Surfaces | None, series: list[Series]) -> None:
    """Say what the single temperatures of the battery are that have no role."""
    has_role = {p.path for p in proposal.signals}
    lone = [] if warm is None else [x for x in lone_temperatures(warm, series) if x[0].path not in has_role]
    proposal.unused += [(s.path, why) for s, why in lone]
    proposal.remarks += [f"{s.path}: {why}" for s, why in lone]


def _place(
    proposal: Proposal,
    warm: Surfaces,
    strings: Strings | None,
    cells: list[Member],
    rights: Rights,
    seconds: float,
) -> dict[int, list[int]]:
    """Assign the thermocouples; if the strings have currents of their own, by string."""
    volted: dict[int, int] = {}
    if strings is not None:
        warm.members = strings.members
        volted = {part: len(own.cells) for part, own in strings.own.items()}
    elif len({m.part for m in warm.members}) == 1:
        volted = {warm.members[0].part: len(cells)}
    return _surfaces(proposal, warm, rights, seconds, volted)


def _count_each(
    strings: Strings, series: list[Series], edges: NDArray[np.float64], chemistry: Chemistry | None
) -> None:
    """Find the voltage of one cell of each string."""
    for own in strings.own.values():
        charge = own.charge or charges(series, own.electrical, edges)
        count_in_series(own.electrical, charge, extreme_cell_V(series), edges, chemistry)


def _strings(
    proposal: Proposal,
    strings: Strings,
    factor: float,
    rights: Rights,
    placed: dict[int, list[int]],
    edges: NDArray[np.float64],
) -> None:
    """Assign current, voltage and SOC of each string."""
    resistances = []
    for part, own in strings.own.items():
        sign = _by_charge(own.charge, own.electrical, edges)
        place_voltage(proposal, own.electrical, own.cells, factor, rights, placed[part])
        against = place_current(proposal, own.electrical, rights, placed[part], sign)
        resistances.append(proposal.resistance)
        _single(proposal, "soc", own.charge, rights, placed[part], against)
    measured = [r for r in resistances if r is not None]
    proposal.resistance = float(np.median(measured)) if measured else None
    if strings.remark:
        _doubt(proposal, strings.remark)


def _by_charge(charge: list[Scored], e: Electrical, edges: NDArray[np.float64]) -> float | None:
    return sign_by_charge(charge, e.current, edges) if e.current is not None else None


def _long_enough(proposal: Proposal, seconds: float) -> None:
    """Mark every role as not sure if the log is short."""
    if seconds < LEAST_S:
        proposal.remarks.append(f"the log is {seconds:.3g} s long: no proposal is sure below {LEAST_S:g} s")
        for p in proposal.signals:
            p.sure = False


def _guesses(proposal: Proposal) -> None:
    """Mark the signals of a guessed DBC as not sure."""
    guessed = [p for p in proposal.signals if p.series.info.message.startswith(GUESS)]
    for p in guessed:
        p.sure = False
        p.why.append("its place, scale and offset are guesses")
    if guessed:
        proposal.remarks.append(
            f"{len(guessed)} signals are guesses from the traffic: no core of theirs is to be trusted"
        )


def _doubt(proposal: Proposal, remark: str) -> None:
    """Mark current, voltage and SOC as not sure, with the reason."""
    proposal.remarks.append(remark)
    for p in proposal.signals:
        if p.role in ("current", "voltage", "soc"):
            p.sure = False
            p.why.append(remark)


def _in_series(proposal: Proposal, cells: list[Member], factor: float) -> bool:
    """Whether the voltages of all cells add up to that of the pack."""
    total = factor * float(np.sum([m.series.middle for m in cells]))
    return any(
        len(cells) > 1 and abs(p.factor * while_on(p.series) / total - 1) < ADDS_UP for p in proposal.of("voltage")
    )


def _surfaces(
    proposal: Proposal, warm: Surfaces, rights: Rights, seconds: float, volted: dict[int, int]
) -> dict[int, list[int]]:
    """Assign the thermocouples; return the strings of the model for each part of them.

    `volted` tells how many cells of each part have a voltage: where the numbers of the thermocouples leave out some of
    1 … so many, they are the cells' numbers.
    """
    placed: dict[int, list[int]] = {}
    parts = sorted({m.part for m in warm.members})
    for part in parts:
        mine = [m for m in warm.members if m.part == part]
        for first in range(0, len(mine), _chunk(len(mine))):
            chunk = mine[first : first + _chunk(len(mine))]
            count = _by_name(chunk, volted.get(part, 0)) if len(chunk) == len(mine) else None
            proposal.cells.append(count or len(chunk))
            if count:
                proposal.numbered.add(len(proposal.cells))
            placed.setdefault(part, []).append(len(proposal.cells))
            for k, m in enumerate(chunk, 1):
                s = m.series
                p = Proposed("surface", s, warm.factor, warm.shift, len(proposal.cells), k, why=list(warm.why))
                if count:
                    p.index = m.number
                p.statistic = warm.statistic
                slow = _slow(s, warm.factor)
                p.sure = warm.said and slow and len(warm.members) > 1 and not s.constant
                if slow and not s.constant:
                    p.why.append("slow, as cells are")
                elif s.constant:
                    p.why.append(f"stands at {warm.factor * s.x[0] + warm.shift:.4g} °C for all of {seconds:.0f} s")
                tell_rights(p, rights)
                proposal.signals.append(p)
    proposal.unused += [(s.path, why) for s, why in (*warm.refused, *warm.passed)]
    proposal.refused |= {s.path for s, _ in warm.refused}
    if warm.passed:
        others = ", ".join(s.path for s, _ in warm.passed[:4]) + (" …" if len(warm.passed) > 4 else "")
        proposal.remarks.append(f"{len(warm.passed)} more temperatures may be of cells, and are not used: {others}")
    return placed


def _by_name(members: list[Member], volted: int) -> int | None:
    """Count the cells if the names number them with gaps and as many voltages confirm the count."""
    numbers = [m.number for m in members]
    gaps = len(numbers) < volted <= min(MAX_CELLS, MOST_EACH * len(numbers))
    return (
        volted if gaps and len(set(numbers)) == len(numbers) and 1 <= min(numbers) <= max(numbers) <= volted else None
    )


def _not_fitted(proposal: Proposal, warm: Surfaces, dead: list[Series]) -> None:
    """Count channels named like the thermocouples that never measure as refused thermocouples."""
    mine = {m.series.path for m in warm.members}
    for group in alike([*(m.series for m in warm.members), *dead]):
        paths = {m.series.path for m in group}
        if paths & mine:
            proposal.refused |= paths - mine


def _chunk(cells: int) -> int:
    """Split rows with more cells than the gateway's own DBC allows into equal rows."""
    rows = -(-cells // MAX_CELLS)
    return -(-cells // rows)


def _slow(s: Series, factor: float) -> bool:
    gaps = np.diff(s.t)
    rate = np.abs(factor * np.diff(s.x))[gaps > 0] / np.maximum(gaps[gaps > 0], 1.0)
    return bool(len(rate) == 0 or np.quantile(rate, 0.9) < max(1.0, 1.01 * abs(factor) * s.step))


def _parts(proposal: Proposal) -> dict[int, int]:
    """Cells by string that have a thermocouple."""
    return dict(enumerate(proposal.cells, 1))


def _cell_voltages(
    proposal: Proposal, cells: list[Member], factor: float, rights: Rights, parts: dict[int, int]
) -> None:
    """Assign the cells' voltages to the strings if there is one for each thermocouple; otherwise to none."""
    sound = [m for m in cells if CELL_V[0] < factor * m.series.middle < CELL_V[1]]
    matched = len(cells) == sum(parts.values()) and len(sound) == len(cells)
    place = [(string, k) for string, n in parts.items() for k in range(1, n + 1)]
    for k, m in enumerate(cells, 1):
        if m not in sound:
            proposal.unused.append((m.series.path, f"no voltage of a cell: about {factor * m.series.middle:.3g} V"))
            continue
        string, index = place[k - 1] if matched else (None, m.number or k)
        why = [f"one of {len(cells)} called alike, {factor * m.series.low:.3f} to {factor * m.series.high:.3f} V"]
        if not matched:
            why.append(NOT_KNOWN)
        p = Proposed("cell_voltage", m.series, factor, 0.0, string, index, why=why)
        p.sure = len(cells) > 1 and unit_of(m.series.info.unit) is not None and not m.series.constant
        tell_rights(p, rights)
        proposal.signals.append(p)


def _single(
    proposal: Proposal,
    role: Role,
    ranked: list[Scored],
    rights: Rights,
    strings: Sequence[int] = (),
    against: bool = False,
) -> None:
    usable = [c for c in ranked if fits(role, c.series.info) and c.score > 0.5]
    if not usable:
        return
    best = usable[0]
    lead = best.score - usable[1].score if len(usable) > 1 else 9.0
    p = Proposed(role, best.series, best.factor, best.shift, why=list(best.why))
    p.sure = best.unit is not None and best.score >= 4.0 and lead > 1.0 and len(best.series.x) >= 10
    if against:
        p.sure = False
        p.why.append(AGAINST)
    if lead < 1.0:
        p.why.append(f"{usable[1].series.path} is nearly as likely")
    tell_rights(p, rights)
    put(proposal, p, strings)


def _ranges(proposal: Proposal) -> None:
    for p in (half for whole in proposal.signals for half in (whole.halves or (whole,))):
        low, high = INPUTS[p.role].plausible
        if p.factor == 0.0:
            continue
        ends = sorted(((low - p.shift) / p.factor, (high - p.shift) / p.factor))
        found = range_of(p.series, (ends[0], ends[1]))
        if found is not None:
            p.overrides.update(found[0])
            p.why.append(found[1])


def _rest(proposal: Proposal, series: list[Series], candidates: list[Scored], voltages: list[Scored]) -> None:
    """Note the reason for each other signal that was considered and is not used."""
    used = {half.path for p in proposal.signals for half in p.single} | {path for path, _ in proposal.unused}
    ranked = {c.series.path: c for c in (*candidates, *voltages)}
    for s in series:
        if s.path in used:
            continue
        if has(named(s.info), OTHER_THINGS) or has(around(s.info), OTHER_THINGS):
            why = "by its name it belongs to something else than the cells"
        elif s.constant:
            why = f"stands at {s.x[0]:g} {s.info.unit}".rstrip() + " in this log"
        elif s.path in ranked:
            why = "another signal is more likely"
        else:
            why = NO_ROLE
        proposal.unused.append((s.path, why))
