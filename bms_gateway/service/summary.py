"""The present estimates in one line for people and in one object for machines, for remote readers."""

from typing import Any

import numpy as np

from bms_gateway.bus.port import Link
from bms_gateway.engine.forecast_result import FOR_S, TOLD_S, Forecast
from bms_gateway.service.live import Gateway
from bms_gateway.service.watch import Watch, WatchedEngine, WatchedString
from bms_gateway.thermal.centre import hottest_of


def status(gateway: Gateway, watch: Watch, engine: WatchedEngine) -> str:
    """Return the state and the hottest point.

    Returns
    -------
    str
        For example ``OK: hottest point 33.1 ± 1.2 °C, core 31.2 ± 0.5 °C (string_2, cell 7)``.
    """
    alerts = watch.alerts.line
    if watch.alerts.raised:
        return alerts
    if gateway.port.link is Link.UP and engine.next_deadline() is None:
        return f"{alerts}: the bus is silent"
    known = [(float(s.centre[k]), s, k) for s in engine.strings if (k := hottest_of(s.centre)) is not None]
    if not known:
        return f"{alerts}: no core temperature yet"
    point, s, k = max(known, key=lambda one: one[0])
    core = f"core {float(s.core[k]):.1f} ± {float(s.core_sd[k]):.1f} °C"
    where = f"({s.plan.name}, cell {k + 1})"
    return f"{alerts}: hottest point {point:.1f} ± {float(s.centre_sd[k]):.1f} °C, {core} {where}"


def estimates(gateway: Gateway, watch: Watch, engine: WatchedEngine) -> dict[str, Any]:
    """Return the present results of each string; unknown values are None."""
    return {
        "state": watch.alerts.severity.name,
        "bus": gateway.port.link.value,
        "awake": engine.next_deadline() is not None,
        "strings": {s.plan.name: _of_string(s) for s in engine.strings},
    }


def _of_string(s: WatchedString) -> dict[str, Any]:
    k, point = hottest_of(s.core), hottest_of(s.centre)
    return {
        "hottest_point_C": None if point is None else round(float(s.centre[point]), 2),
        "hottest_point_sd_K": None if point is None else round(float(s.centre_sd[point]), 2),
        "hottest_point_cell": None if point is None else point + 1,
        "core_max_C": None if k is None else round(float(s.core[k]), 2),
        "core_max_sd_K": None if k is None else round(float(s.core_sd[k]), 2),
        "core_max_cell": None if k is None else k + 1,
        "core_min_C": None if k is None else round(float(np.nanmin(s.core)), 2),
        "resistance_growth": _known(s.health.ageing.growth),
        "resistance_growth_sd": _known(s.health.ageing.growth_sd),
        "forecast": _ahead(s.forecast),
        "flags": {flag.code: flag.level for flag in s.health.conditions() if flag.cell is None},
    }


def _ahead(f: Forecast | None) -> dict[str, Any] | None:
    """Return the forecast at the present load; None if nothing is known."""
    if f is None or (k := f.hottest) is None:
        return None
    first = f.first
    return {
        "cell": k + 1,
        "load_A": round(f.load, 1),
        "point_C": {s: round(float(f.centre[h, k]), 2) for h, s in TOLD_S.items()},
        "point_sd_K": {s: round(float(f.centre_sd[h, k]), 2) for h, s in TOLD_S.items()},
        "limit_in_s": None if first is None else round(float(f.limit_s[first]), 1),
        "discharge_A": dict(zip(FOR_S, np.round(f.discharge, 1).tolist(), strict=True)),
        "charge_A": dict(zip(FOR_S, np.round(f.charge, 1).tolist(), strict=True)),
    }


def _known(value: float) -> float | None:
    return None if value != value else round(value, 4)
