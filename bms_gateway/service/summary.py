"""What is known now, in one line for people and in one object for machines, for those who are far away."""

from typing import Any

import numpy as np

from bms_gateway.bus.port import Link
from bms_gateway.service.live import Gateway
from bms_gateway.service.watch import Watch, WatchedEngine, WatchedString


def status(gateway: Gateway, watch: Watch, engine: WatchedEngine) -> str:
    """Give the state and the hottest core.

    Returns
    -------
    str
        For example ``OK: hottest core 31.2 ± 0.5 °C (string_2, cell 7)``.
    """
    alerts = watch.alerts.line
    if watch.alerts.raised:
        return alerts
    if gateway.port.link is Link.UP and engine.next_deadline() is None:
        return f"{alerts}: the bus is silent"
    known = [(float(s.core[k]), float(s.core_sd[k]), s.plan.name, k + 1) for s, k in _hottest(engine)]
    if not known:
        return f"{alerts}: no core temperature yet"
    core, sd, name, cell = max(known)
    return f"{alerts}: hottest core {core:.1f} ± {sd:.1f} °C ({name}, cell {cell})"


def estimates(gateway: Gateway, watch: Watch, engine: WatchedEngine) -> dict[str, Any]:
    """Give what is known of each string; what is not known is None."""
    hottest = {s.plan.name: k for s, k in _hottest(engine)}
    return {
        "state": watch.alerts.severity.name,
        "bus": gateway.port.link.value,
        "awake": engine.next_deadline() is not None,
        "strings": {s.plan.name: _of_string(s, hottest.get(s.plan.name)) for s in engine.strings},
    }


def _of_string(s: WatchedString, k: int | None) -> dict[str, Any]:
    return {
        "core_max_C": None if k is None else round(float(s.core[k]), 2),
        "core_max_sd_K": None if k is None else round(float(s.core_sd[k]), 2),
        "core_max_cell": None if k is None else k + 1,
        "core_min_C": None if k is None else round(float(np.nanmin(s.core)), 2),
        "resistance_growth": _known(s.health.ageing.growth),
        "resistance_growth_sd": _known(s.health.ageing.growth_sd),
        "flags": {flag.code: flag.level for flag in s.health.conditions() if flag.cell is None},
    }


def _hottest(engine: WatchedEngine) -> list[tuple[WatchedString, int]]:
    return [(s, int(np.nanargmax(s.core))) for s in engine.strings if not np.isnan(s.core).all()]


def _known(value: float) -> float | None:
    return None if value != value else round(value, 4)
