"""From the engine's events to one row per day and string. Days are those of UTC, by the log's own time."""

from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from math import isfinite, nan
from typing import Any

from bms_gateway.engine import Cells, Estimated, Event, Judged, Judgement, Parameters, Plan, StringPlan
from bms_gateway.fleet.residual import REGIMES, CellResidual, Residuals
from bms_gateway.identify import Estimate
from bms_gateway.report.hottest import Hottest, hotter, hottest_core
from bms_gateway.thermal import Floats

DAY_NS = 86_400_000_000_000
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
Row = dict[str, Any]
"""Columns of `columns.SCHEMA` by name; None where not known."""


class _String:
    """What is known of one string on one day."""

    def __init__(self, plan: StringPlan) -> None:
        self.plan = plan
        self.residuals = Residuals(plan.model)
        self.estimates: dict[str, Estimate] = {}
        self.constant: Floats | None = None
        self.last: Judgement | None = None
        self.begin()

    def begin(self) -> None:
        """Start a day; parameters, flags and growth are kept from the day before."""
        self.core: Hottest | None = None
        self.point: Hottest | None = None
        self.excess = nan
        self.flags: set[str] = set()

    def estimated(self, e: Cells) -> None:
        self.core = hotter(self.core, hottest_core(e, e.core))
        self.point = hotter(self.point, hottest_core(e, e.centre))

    def judged(self, time_ns: int, j: Judgement) -> None:
        self.residuals.add(time_ns, j)
        self.last = j
        if j.excess == j.excess and not j.excess <= self.excess:
            self.excess = j.excess
        self.flags.update(j.flags)

    def row(self) -> Row:
        """Columns of this string."""
        core, point = self.core, self.point
        found: Row = {
            "string": self.plan.name,
            "cells": self.plan.model.cells,
            "growth_pct": None if self.last is None else _number(100.0 * self.last.growth),
            "growth_sd_pct": None if self.last is None else _number(100.0 * self.last.growth_sd),
            "worst_core_C": None if core is None else _number(core.core_C),
            "worst_core_sd_K": None if core is None else _number(core.core_sd_K),
            "worst_core_cell": None if core is None else core.cell,
            "worst_core_time_s": None if core is None else core.time_ns * 1e-9,
            "hottest_point_C": None if point is None else _number(point.centre_C),
            "hottest_point_sd_K": None if point is None else _number(point.centre_sd_K),
            "hottest_point_cell": None if point is None else point.cell,
            "mismatch": _number(self.excess),
            "flags": sorted(self.flags),
        }
        for name, column, factor in (("R_e", "mOhm", 1e3), ("R_u", "K_W", 1.0)):
            e = self.estimates.get(name)
            found[f"{name}_{column}"] = None if e is None else _number(factor * e.value)
            found[f"{name}_sd_{column}"] = None if e is None else _number(factor * e.sd)
            found[f"{name}_status"] = None if e is None else e.status
        residuals, seconds = self.residuals.take(self.constant)
        found["residuals"] = [{k: _plain(v) for k, v in asdict(r).items()} for r in residuals]
        return found | _by_regime(residuals, seconds)


class Days:
    """Gathers events into rows.

    Attributes
    ----------
    rows : list of Row
        Of the days that are over, strings in the order of the plan.
    """

    def __init__(self, plan: Plan) -> None:
        self.rows: list[Row] = []
        self._strings = {s.name: _String(s) for s in plan.strings}
        self._tick_s = plan.tick_ns * 1e-9
        self._day: int | None = None
        self._frames = self._frames_before = 0
        self._rejected: Mapping[str, int] = {}
        self._rejected_before: Mapping[str, int] = {}
        self._seconds = 0.0
        self._first_ns = 0

    def take(self, event: Event) -> None:
        """Take in one event of an engine that is judging."""
        if not isinstance(event, Estimated | Judged | Parameters):
            return
        # the tick that ends at midnight belongs to the day before
        day = (event.time_ns - 1) // DAY_NS
        if day != self._day:
            self._turn()
            self._day, self._first_ns = day, event.time_ns
        if isinstance(event, Parameters):
            s = self._strings[event.string]
            s.estimates, s.constant = {e.name: e for e in event.estimates}, event.constant
        elif isinstance(event, Estimated):
            for cells in event.strings():
                self._strings[cells.string].estimated(cells)
        else:
            self._seconds += self._tick_s
            self._frames, self._rejected = event.frames, event.rejected
            for j in event.strings:
                self._strings[j.string].judged(event.time_ns, j)

    def finish(self) -> list[Row]:
        """Close the last day; all rows."""
        self._turn()
        return self.rows

    def _turn(self) -> None:
        if self._day is None:
            return
        counts = {k: n - self._rejected_before.get(k, 0) for k, n in sorted(self._rejected.items())}
        common: Row = {
            "day": (EPOCH + timedelta(days=self._day)).date().isoformat(),
            "start_s": self._first_ns * 1e-9 - self._tick_s,
            "duration_s": self._seconds,
            "frames": self._frames - self._frames_before,
            "rejected": sum(counts.values()),
            "rejected_reasons": {k: n for k, n in counts.items() if n},
        }
        for s in self._strings.values():
            self.rows.append(common | s.row())
            s.begin()
        self._frames_before, self._rejected_before, self._seconds = self._frames, self._rejected, 0.0
        self._day = None


def _by_regime(residuals: tuple[CellResidual, ...], seconds: Floats) -> Row:
    """Size of the errors over all cells of the string, regime by regime."""
    found: Row = {}
    for regime, lasted in zip(REGIMES, seconds.tolist(), strict=True):
        of = [r for r in residuals if r.regime == regime]
        n = sum(r.readings for r in of)
        found[f"seconds_{regime}"] = lasted
        found[f"rms_K_{regime}"] = (sum(r.readings * r.rms_K**2 for r in of) / n) ** 0.5 if n else None
        found[f"normalised_{regime}"] = (sum(r.readings * r.normalised**2 for r in of) / n) ** 0.5 if n else None
    return found


def _number(x: float) -> float | None:
    return x if isfinite(x) else None


def _plain(x: object) -> object:
    return _number(x) if isinstance(x, float) else x
