"""Faults that heat, or that look like it: which alert must come within which time, and which must not come.

The times are those of physics: heat shows by the rate at which it warms its cell, W over its heat capacity.
"""

import numpy as np

from bms_gateway.bus.traffic import Key
from bms_gateway.bus.virtual import INLET_C, PackFault
from bms_gateway.chaos.fault_targets import Facts
from bms_gateway.chaos.reaction import Reaction, Told, Untold
from bms_gateway.chaos.scenario import Injection, Scenario
from bms_gateway.chaos.sensors import SOUND_WINDOW_S, Frozen, Slow
from bms_gateway.chaos.simulated_pack import Change
from bms_gateway.health.heat.usual import REFERENCE
from bms_gateway.thermal import Floats

WARM_S = 900.0
"""Time before the fault, in which the watch over heat finds its state."""
MORE_S = 60.0
"""Time for which a fault lasts beyond the limit for its alert."""
WATTS = (1.0, 3.0, 10.0)
SENSED = ((0.03, 120.0), (0.02, 180.0), (0.01, 240.0), (0.005, 720.0), (0.0, 900.0))
BESIDE = ((0.2, 120.0), (0.06, 240.0), (0.02, 1200.0))
"""Rates of warming, K/s, above which a short must be reported within so many seconds: in a cell with a thermocouple,
and in a neighbour of such a cell."""
FAULT_S, SLOW_FAULT_S, MISSING_S = 300.0, 1200.0, 120.0
LOOSE_SHARE = 0.3  # share of the coolant in the reading of a loose thermocouple
FILM_POWER = 0.63  # exponent with which the conductance of the film depends on the flow
FEW = "with fewer than three thermocouples on the string, only heat far above that of the current is told"
FEW_AT_REST = (
    "with fewer than three thermocouples on the string, heat at rest is told in a time that nobody has measured"
)
HEAT, OTHERS = "unexplained_heat", ("missing_heat", "cooling", "inlet")


def heat_scenarios(facts: Facts) -> list[Scenario]:
    """Make all scenarios of this room for a config."""
    return [*_shorts(facts), *_look_alikes(facts)]


def _scenario(
    name: str,
    fault: str,
    expected: tuple[Reaction, ...],
    lasts_s: float,
    injection: Injection,
    unfit: str,
) -> Scenario:
    return Scenario(
        name,
        "heat",
        fault,
        expected,
        lasts_s,
        SOUND_WINDOW_S,
        injection,
        unfit,
        misleads=True,  # before the alert, the bus cannot show the fault
        warm_s=WARM_S,
    )


def _shorts(facts: Facts) -> list[Scenario]:
    model, made = facts.plan.strings[0].model, []
    lacks = facts.lacks("surface", "current")
    few = "" if len(model.sensors) >= REFERENCE else FEW
    sensed = model.sensors[len(model.sensors) // 2] if model.sensors else 1
    beside = next((k for k in (sensed + 1, sensed - 1) if 1 <= k <= model.cells and k not in model.sensors), None)
    p = model.nominal
    for watts in WATTS:
        rate = watts / float(p.C_c[sensed - 1] + p.C_s[sensed - 1])
        slow = f"{watts:g} W beside a thermocouple warms a cell of this pack by {1e3 * rate:.2g} mK/s: undetectable"
        soon = next(s for least, s in SENSED if rate >= least)
        later = next((s for least, s in BESIDE if rate >= least), None)
        places = (
            ("", sensed, "cell {} has a short of {:g} W", soon, few),
            ("-rest", sensed, "at rest, cell {} has a short of {:g} W", soon, few and FEW_AT_REST),
            ("-beside", beside, "cell {}, beside a thermocouple, has a short of {:g} W", later, few),
        )
        for suffix, cell, what, within_s, why in places:
            unfit = lacks or why or ("no cell beside a thermocouple is without one" if cell is None else "")
            unfit = unfit or (slow if within_s is None else "")
            at, limit = cell or sensed, within_s or SLOW_FAULT_S
            expected = Told(HEAT, "heats by itself", limit), Untold.of(*OTHERS, "thermocouple")
            injection = Injection(pack=PackFault((0.0, 0.0), {at: watts}), rests=suffix == "-rest")
            fault = what.format(at, watts)
            made.append(_scenario(f"short-{watts:g}W{suffix}", fault, expected, limit + MORE_S, injection, unfit))
    return made


def _look_alikes(facts: Facts) -> list[Scenario]:
    model = facts.plan.strings[0].model
    few = "" if len(model.sensors) >= REFERENCE else FEW
    cell = model.sensors[len(model.sensors) // 2] if model.sensors else 1
    driven = facts.lacks("surface", "current", "coolant_inlet") or few

    def one(
        name: str, fault: str, code: str, within_s: float, pack: PackFault | None = None, change: Change | None = None
    ) -> Scenario:
        key: Key = ("coolant_inlet", None) if code == "inlet" else ("surface", cell)
        values = {} if change is None else {key: change}
        expected = Told(code, within_s=within_s), Untold.of(HEAT, *(c for c in OTHERS if c != code))
        return _scenario(name, fault, expected, within_s + MORE_S, Injection(values=values, pack=pack), driven)

    nothing = (0.0, 0.0)
    fan = PackFault(nothing, R_u=3.0)
    pump = PackFault(nothing, R_u=5.0**FILM_POWER, flow=0.2)
    idle = PackFault(nothing, current=0.0)
    return [
        one("fan-stopped", "the fan stops: R_u × 3", "cooling", FAULT_S, fan),
        one("pump-stopped", "the pump stops: a fifth of the flow", "cooling", FAULT_S, pump),
        one("inlet-frozen", "the coolant inlet keeps its last value", "inlet", FAULT_S, change=Frozen()),
        one("thermocouple-off", f"cell {cell}: off, follows a minute late", "thermocouple", FAULT_S, change=Slow()),
        one("thermocouple-loose", f"cell {cell}: loose", "thermocouple", SLOW_FAULT_S, change=_loose),
        one("current-without-heat", "the current that is shown does not flow", "missing_heat", MISSING_S, idle),
    ]


def _loose(_t: Floats, value: Floats) -> Floats:
    """Give a reading that contains a share of the coolant temperature."""
    return value + LOOSE_SHARE * (np.float64(INLET_C) - value)
