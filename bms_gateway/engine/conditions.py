"""What is wrong with inputs and strings at a tick, in sentences for people.

Conditions are derived from the present state and not collected from notices. A flag that was raised before a restart is
therefore raised again after it. Where one cause explains others, only the cause is reported: while the bus is quiet, no
sensor is reported.
"""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from bms_gateway.engine.input_news import Fault
from bms_gateway.engine.inputs import Inputs
from bms_gateway.engine.reasons import HELD, WRONG_SIGN
from bms_gateway.engine.string_estimator import StringEstimator, unproven
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.vocabulary import OPTIONAL
from bms_gateway.health.alerts import Condition, Severity

NAMED: Final = 6  # cells that a sentence names; further cells are counted
WATCH: Final = ("ageing",)
"""Flags with the levels watch, warning, alarm; the other flags have warning (suspected) and alarm (confirmed)."""
REMEDIES: Final = {
    Quality.STALE: "check its sender and the wiring of the bus",
    Quality.OUT_OF_RANGE: "check the sensor, and scale and offset in the config",
    Quality.NOT_AVAILABLE: "check the sensor at its sender",
    Quality.ERROR: "check the sensor at its sender",
    Quality.STUCK: "check the sensor and its amplifier",
    Quality.OPEN: "check its wire and plug",
    Quality.SHORT: "check its wire and insulation",
    Quality.JUMPY: "check its contact and shielding",
    Quality.COUNTER: "look for a second sender of the same identifier",
    Quality.CRC: "look for a second sender of the same identifier, or a DBC of another version",
}
MISREAD_K: Final = 1.0
"""Constant error of a thermocouple that is told: more than twice what is usual."""
CONTRADICTED: Final = "check its seat, wire and plug, and watch the cell: heat of its own would show so too"


def of_inputs(inputs: Inputs, strings: Sequence[StringEstimator]) -> Iterator[Condition]:
    """List faulty inputs of a bus that is not quiet, and strings of which no core is known."""
    yield from _sensors(inputs.faults())
    for string, missing in inputs.missed().items():
        text = f"never received: {missing}: check the names in the config, the DBC, and the sender"
        yield Condition("unheard", Severity.WARNING, text, string)
    for string, channel, meter in inputs.compared():
        if meter.reversed:
            yield Condition("current_sign", Severity.WARNING, f"{WRONG_SIGN} ({channel.source})", string)
    if len(strings) and np.isnan(strings[0].newest.core).any():
        for s in strings:
            if np.isnan(s.core).all():
                text = "no core temperature is known to 12 K: see the string's other alerts and its model file"
                yield Condition("estimate", Severity.WARNING, text, s.plan.name)
            elif dark := contradicted(s):
                what = f"core of {cells(dark)} not known to 12 K: the thermocouple" + ("s" if len(dark) > 1 else "")
                text = f"{what} left what model, current and coolant explain: {CONTRADICTED}"
                one = dark[0] if len(dark) == 1 else None
                yield Condition("estimate", Severity.WARNING, text, s.plan.name, one, part="surface")


def of_strings(strings: Sequence[StringEstimator]) -> Iterator[Condition]:
    """List the flags of the strings' health, and the strings whose cores are not proven."""
    for s in strings:
        name = s.plan.name
        for flag in s.health.conditions():
            grave = flag.level >= (3 if flag.code in WATCH else 2)
            severity = Severity.ALARM if grave else Severity.WARNING
            yield Condition(flag.code, severity, flag.text, name, flag.cell, settled=True, facts=flag.facts)
        if s.constant is not None and (wrong := np.flatnonzero(np.abs(s.constant) >= MISREAD_K).tolist()):
            named = {f.cell for f in s.health.conditions() if f.code == "thermocouple"}
            for k in wrong:
                if k + 1 not in named:
                    text = _misread(k + 1, float(s.constant[k]))
                    yield Condition("thermocouple", Severity.WARNING, text, name, k + 1, settled=True)
        if s.doubts:
            yield Condition("unproven", Severity.WARNING, unproven(s.doubts), name, settled=True)


def _sensors(faults: Sequence[Fault]) -> Iterator[Condition]:
    """Make one condition per string and quantity, for any number of cells: one fault may show in several ways."""
    found: dict[tuple[str, str], dict[str, list[Fault]]] = {}
    for f in faults:
        found.setdefault((f.string, f.channel.quantity), {}).setdefault(f.why, []).append(f)
    for (string, quantity), ways in found.items():
        clauses = [_fault(quantity, alike) for alike in ways.values()]
        at = [f.channel.cell for alike in ways.values() for f in alike]
        severity = Severity.ALARM if quantity == "current" else Severity.WARNING
        one = at[0] if len(at) == 1 else None
        minor = quantity in OPTIONAL
        yield Condition("sensor", severity, "; ".join(clauses), string, one, part=quantity, minor=minor)


def _fault(quantity: str, alike: Sequence[Fault]) -> str:
    first = alike[0]
    at = [f.channel.cell for f in alike if f.channel.cell is not None]
    what = quantity.replace("_", " ") + (f" of {cells(at)}" if at else "")
    remedy = REMEDIES[first.quality]
    if first.quality is Quality.STUCK and quantity == "surface":
        remedy = "check that the thermocouple is fixed to its cell, and check its amplifier"
    elif first.why == HELD:
        remedy = "check that it is fixed to its cell, and check its wire and plug"
    return f"{what} not used: {first.why} ({first.channel.source}): {remedy}"


def _misread(cell: int, error: float) -> str:
    too = "more" if error > 0.0 else "less"
    return (
        f"the thermocouple of cell {cell} reads about {abs(error):.1f} K {too} than the others and the model explain, "
        "all along: it reads wrong, or its cell is unlike the others: check its seat and calibration, also at rest"
    )


def contradicted(s: StringEstimator) -> list[int]:
    """Cells, from 1, that are dark because of their own thermocouple, without those that a finding names."""
    named = {f.cell for f in s.health.conditions()}
    return [k + 1 for k in np.flatnonzero(s.newest.contradicted[s.mine]).tolist() if k + 1 not in named]


def cells(of: Sequence[int]) -> str:
    """Name cells: ``cell 3``, ``cells 1, 2``, and from the seventh on how many more."""
    named = ", ".join(map(str, of[:NAMED]))
    more = f" and {len(of) - NAMED} more" if len(of) > NAMED else ""
    return f"cell{'s' if len(of) > 1 else ''} {named}{more}"
