"""Time for which the service was off, measured by a clock that cannot be set.

Bus time does not follow when the wall clock is set (`bus.clock`), but a starting service begins with the present wall
clock. A crash after the clock was set forward by an hour would therefore count as an hour parked. So a state records by
how much bus time was ahead of the time since boot. Within the same boot, the time of the state is moved onto the new
line.
"""

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bms_gateway.bus.clock import boot_ns

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
BOOT_ID_GIVEN = "BMS_GATEWAY_BOOT_ID"
"""Variable that holds the boot's identifier where `BOOT_ID` is hidden, as in our unit."""


def boot_id() -> str:
    """Name of this boot, different for each; empty if the system has none."""
    try:
        return os.environ.get(BOOT_ID_GIVEN) or BOOT_ID.read_text().strip()
    except OSError:
        return ""


def noted(bus_ns: int) -> dict[str, Any]:
    """Return the field `clock` of a state at bus time `bus_ns`."""
    return {"boot": boot_id(), "ahead_ns": bus_ns - boot_ns()}


def on_this_line(state: Mapping[str, Any]) -> tuple[Mapping[str, Any], bool]:
    """Convert a stored state's time to the bus time that begins now.

    Parameters
    ----------
    state : mapping
        State of an engine, with the result of `noted` as `clock`, or without it.

    Returns
    -------
    state : mapping
    sure : bool
        Whether it is of this boot: its age is then known, for any wall clock.
    """
    clock, tick_end_ns = state.get("clock"), state.get("tick_end_ns")
    if not (isinstance(clock, Mapping) and isinstance(tick_end_ns, int)):
        return state, False
    boot, ahead_ns = clock.get("boot"), clock.get("ahead_ns")
    if not boot or boot != boot_id() or not isinstance(ahead_ns, int):
        return state, False
    moved = time.time_ns() - boot_ns() - ahead_ns
    return {**state, "tick_end_ns": max(0, tick_end_ns + moved)}, True
