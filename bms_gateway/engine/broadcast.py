"""What our node says on the bus each tick: layouts and columns looked up once, then numpy arrays per cycle."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from bms_gateway import __version__
from bms_gateway.engine.estimate import Estimators, StringEstimator
from bms_gateway.engine.plan import Plan
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.database import Database
from bms_gateway.frames.encode import Encoder
from bms_gateway.frames.own import (
    GATEWAY_INFO,
    GATEWAY_STATUS,
    PARAMETER_MUX,
    core_message,
    health_message,
    parameters_message,
    summary_message,
)
from bms_gateway.frames.quality import Quality
from bms_gateway.identify.contract import FIXED, IDENTIFIED, LEARNING
from bms_gateway.thermal import KINDS, Floats


class State(IntEnum):
    """Value table `GatewayState` of our DBC."""

    STARTING = 0
    RUNNING = 1
    DEGRADED = 2
    SILENT = 3


STATUS_CODES = {LEARNING: 0, IDENTIFIED: 1, FIXED: 3}
NOT_IDENTIFIABLE = 2  # its text goes on with the reason, so it is the code of every other status


@dataclass(frozen=True, slots=True)
class Counts:
    """What the status frames tell: frames and rejected samples of this tick, frames lost and seconds since start."""

    frames: int
    rejected: int
    dropped: int
    uptime_s: float


@dataclass(frozen=True, slots=True)
class _String:
    """Rows and columns of one string's messages."""

    cores: NDArray[np.intp]
    core_columns: tuple[int, int, int, int]
    summary: int
    parameters: NDArray[np.intp]
    health: int


class Broadcast:
    """Frames of our node for a plan.

    Parameters
    ----------
    plan : Plan
    database : Database
        Must hold our DBC.

    Attributes
    ----------
    cycles : dict of int to int
        Identifiers that we send and their cycles, ns: the only ones that a port may put on the bus for us.
    """

    def __init__(self, plan: Plan, database: Database) -> None:
        numbers = [s.number for s in plan.strings]
        parts = (core_message, summary_message, parameters_message, health_message)
        names = [part(k) for k in numbers for part in parts]
        names += [GATEWAY_STATUS, GATEWAY_INFO]
        self._encoder = Encoder(database, names)
        self._cycle = {name: database.message(name).cycle_ns or plan.tick_ns for name in names}
        self.cycles = {database.message(name).can_id: self._cycle[name] for name in names}
        self._numbers = numbers
        self._strings = [self._layout(s.number, s.model.cells) for s in plan.strings]
        self._status, self._info = self._encoder.row(GATEWAY_STATUS), self._encoder.row(GATEWAY_INFO)

    def _layout(self, number: int, cells: int) -> _String:
        row, column = self._encoder.row, self._encoder.column
        cores = [row(core_message(number), k) for k in range(1, cells + 1)]
        first = cores[0]
        names = ("core_01", "core_sd_01", "surface_01", "quality_01")
        a, b, c, d = (column(first, name) for name in names)
        return _String(
            np.array(cores, np.intp),
            (a, b, c, d),
            row(summary_message(number)),
            np.array([row(parameters_message(number), mux) for mux in PARAMETER_MUX.values()], np.intp),
            row(health_message(number)),
        )

    def encode(self, t1: int, estimators: Estimators, state: State, counts: Counts) -> FrameBatch:
        """Frames that are due at the tick `t1`, stamped with it, in the order of the strings."""
        rows: list[NDArray[np.intp]] = []
        values: list[Floats] = []
        for number, layout, s in zip(self._numbers, self._strings, estimators.strings, strict=True):
            for message, part in (
                (core_message(number), self._cores),
                (summary_message(number), self._summary),
                (parameters_message(number), self._parameters),
                (health_message(number), self._health),
            ):
                if t1 % self._cycle[message] == 0:
                    r, v = part(layout, s)
                    rows.append(r)
                    values.append(v)
        for message, (r, v) in (
            (GATEWAY_STATUS, self._gateway(state, counts)),
            (GATEWAY_INFO, self._about(counts)),
        ):
            if t1 % self._cycle[message] == 0:
                rows.append(r)
                values.append(v)
        if not rows:
            return FrameBatch.empty()
        can_id, length, data = self._encoder.encode(np.concatenate(rows), np.concatenate(values))
        return FrameBatch(np.full(len(can_id), t1, np.int64), can_id, length, data)

    def _blank(self, rows: NDArray[np.intp]) -> Floats:
        return np.full((len(rows), self._encoder.width), np.nan)

    def _one(self, row: int, **signals: float) -> tuple[NDArray[np.intp], Floats]:
        rows = np.array([row], np.intp)
        v = self._blank(rows)
        for name, value in signals.items():
            v[0, self._encoder.column(row, name)] = value
        return rows, v

    def _cores(self, layout: _String, s: StringEstimator) -> tuple[NDArray[np.intp], Floats]:
        v = self._blank(layout.cores)
        core, sd, surface, quality = layout.core_columns
        v[:, core], v[:, sd], v[:, surface], v[:, quality] = s.core, s.core_sd, s.surface, s.quality
        v[s.quality == Quality.NEVER, quality] = np.nan
        return layout.cores, v

    def _summary(self, layout: _String, s: StringEstimator) -> tuple[NDArray[np.intp], Floats]:
        if not np.isfinite(s.core).any():
            return self._one(layout.summary)
        k = int(np.nanargmax(s.core))
        return self._one(
            layout.summary,
            hottest_core=s.core[k],
            hottest_cell=k + 1,
            hottest_sd=s.core_sd[k],
            hottest_quality=float(s.quality[k]),
            coldest_core=float(np.nanmin(s.core)),
        )

    def _parameters(self, layout: _String, s: StringEstimator) -> tuple[NDArray[np.intp], Floats]:
        v = self._blank(layout.parameters)
        for i, name in enumerate(PARAMETER_MUX):
            row = int(layout.parameters[i])
            estimate = next((e for e in s.estimates if e.name == name), None)
            if estimate is None:
                continue
            to_si = KINDS[name].to_si
            v[i, self._encoder.column(row, name)] = estimate.value / to_si
            v[i, self._encoder.column(row, f"{name}_sd")] = estimate.sd / to_si
            code = STATUS_CODES.get(estimate.status, NOT_IDENTIFIABLE)
            v[i, self._encoder.column(row, f"{name}_status")] = code
        return layout.parameters, v

    def _health(self, layout: _String, s: StringEstimator) -> tuple[NDArray[np.intp], Floats]:
        return self._one(
            layout.health,
            R_e_flag=s.ageing.flag.level if s.ageing.commissioned else np.nan,
            R_e_growth=100.0 * s.ageing.growth,
            R_e_growth_sd=100.0 * s.ageing.growth_sd,
            innovation=s.mismatch.excess**0.5,
            mismatch_flag=float(s.mismatch.flag.level),
        )

    def _gateway(self, state: State, counts: Counts) -> tuple[NDArray[np.intp], Floats]:
        return self._one(
            self._status,
            state=float(state),
            frame_rate=counts.frames,
            rejected_samples=counts.rejected,
            dropped_frames=counts.dropped,
        )

    def _about(self, counts: Counts) -> tuple[NDArray[np.intp], Floats]:
        major, minor, patch = (float(part) for part in __version__.split("."))
        return self._one(
            self._info, version_major=major, version_minor=minor, version_patch=patch, uptime=counts.uptime_s
        )
