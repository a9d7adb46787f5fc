"""Signals of a new vehicle that measure something; where data and DBC disagree, the data decide how bits are read."""

from bms_gateway.setup.bit_contradictions import read_right
from bms_gateway.setup.find_temperatures import is_temperature
from bms_gateway.setup.multiplexing import jumps_with
from bms_gateway.setup.proposal import Proposal
from bms_gateway.setup.signal_series import Series, all_series
from bms_gateway.setup.signal_words import OTHER_THINGS, has, named, unit_of
from bms_gateway.setup.vehicle_logs import Traffic

Rights = dict[str, tuple[dict[str, float | str | bool], list[str]]]
"""By signal: keys of a config that correct the DBC, and the reasons."""


def readable(traffic: Traffic, proposal: Proposal) -> tuple[list[Series], Rights, list[Series]]:
    """Give all series that measure something, bits read as the data require, and the signals that never measure."""
    kept: list[Series] = []
    rights: Rights = {}
    dead: list[Series] = []
    for given in all_series(traffic):
        s = given
        unit = unit_of(s.info.unit)
        matters = unit is not None and unit.family != "other"
        matters |= unit is None and (is_temperature(s) or s.info.place.size >= 8)
        if not len(s.x):
            if matters:
                proposal.unused.append((s.path, f"never a measurement: {', '.join(s.dropped)}"))
                dead.append(s)
            continue
        if not matters or s.info.is_multiplexer:
            continue
        s, overrides, why = read_right(traffic, s)
        if why and not (set(overrides) and _likely(s)):
            s, overrides, why = given, {}, []
        rights[s.path] = overrides, why
        if (jumpy := jumps_with(traffic, given)) is not None:
            proposal.unused.append((s.path, jumpy))
            if (unit is not None or is_temperature(s)) and _likely(s):
                proposal.remarks.append(f"{s.path}: {jumpy}")
            continue
        if s.counts and (unit is None or unit.family != "temperature"):
            proposal.unused.append((s.path, "a counter or a clock: it goes up by the same step each time"))
            continue
        if s.staircase:
            why_not = "a counter or a clock: it goes up by the same step each time, and back at once"
            proposal.unused.append((s.path, why_not))
            continue
        kept.append(s)
    return kept, rights, dead


def _likely(s: Series) -> bool:
    """Whether another reading of the bits is worth a report: only for signals that the gateway could use."""
    unit = unit_of(s.info.unit)
    if unit is not None and unit.family == "current":
        return True  # a current of a shunt, a charger or an inverter may be the pack's
    return not has(named(s.info), OTHER_THINGS) and (unit is None or unit.family != "other")
