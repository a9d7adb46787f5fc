"""Signals of a new vehicle that measure something; where the data contradict the DBC, bits are read as the data say."""

from bms_gateway.setup.bit_contradictions import read_right
from bms_gateway.setup.find_temperatures import is_temperature
from bms_gateway.setup.multiplexing import jumps_with
from bms_gateway.setup.proposal import Proposal
from bms_gateway.setup.signal_series import Series, all_series
from bms_gateway.setup.signal_words import OTHER_THINGS, has, named, unit_of
from bms_gateway.setup.vehicle_logs import Traffic

Rights = dict[str, tuple[dict[str, float | str | bool], list[str]]]
"""By signal: what a config has to say against the DBC, and why."""


def readable(traffic: Traffic, proposal: Proposal) -> tuple[list[Series], Rights, list[Series]]:
    """All series that measure something, with their bits read as the data say, and those that never do."""
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
    """Whether another reading of the bits is worth telling: of what the gateway could use."""
    unit = unit_of(s.info.unit)
    if unit is not None and unit.family == "current":
        return True  # of a shunt, a charger, an inverter: each may be the pack's
    return not has(named(s.info), OTHER_THINGS) and (unit is None or unit.family != "other")
