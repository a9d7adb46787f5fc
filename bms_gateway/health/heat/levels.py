"""Levels of evidence, probability, size and time at which a fault of a string is reported or has ended."""

from bms_gateway.health.heat.fault_evidence import Kind

ENOUGH = {Kind.SLOPE: 8.0, Kind.FLOW: 9.0, Kind.INLET: 9.0, Kind.LOAD: 7.0, Kind.STREAM: 9.0}
"""Least ln evidence, instead of `SURE`, of faults of which a false report costs less, or whose consequence is tested
again before the report."""
LOAD_DENIED = 2.0  # the same for missing heat of the current, where the voltage denies the current too
ALONE, ALONE_HEAT = 0.95, 0.998
"""Least probability of a cause that is reported at once. It is higher for heat, because a thermocouple that comes off
while its cell cools looks like heat for a minute."""
WAIT_S = 180.0
"""Time after which a certain fault with several possible causes is reported with the likeliest of them."""
ALIKE = 1.0  # ln: onsets whose evidence differs by less cannot be distinguished
LEAST_SHARE, ALONE_SHARE = 0.1, 3.0
"""Least heat that is a fault besides `LEAST_RATE`, as a share of the heat by the cell's current. The second number
holds for strings in which no other cells show the heat of the current: a cell that is nearly empty or cold makes
several times its usual heat. Without a measured inlet only heat at rest is a fault, because cooling that is switched
off looks like heat."""
LEAST_JUMP, BACK_JUMP = 0.7, 0.4
"""K: a jump of a thermocouple is reported above the first number, and has ended below the second."""
COARSE = 2.5  # least jump of a thermocouple, in steps of its resolution
YOUNG_S = 900.0
"""s since a start, in which cells and thermocouples that differ by more than those of one string do mean that the state
was found with a fault."""
QUIET_SD, QUIET_S = 3.0, 900.0
"""A thermocouple that was set aside is used again if it is within so many sd of its prediction for so long."""
