"""A simulated pack whose sensors can be broken: its traffic and the truth, second by second."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from bms_gateway.bus.traffic import SECOND, Key, Series, Traffic
from bms_gateway.bus.virtual import SEGMENT_S, SENSOR_NOISE_K, PackFault, VirtualPack
from bms_gateway.engine.plan import Plan
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.database import Database
from bms_gateway.thermal import Floats

Change = Callable[[Floats, Floats], Floats]
CYCLE = "us06"  # the current must change as on the road: a stuck sensor shows no fault while the current is constant
NOISY = ("surface", "coolant_inlet")


@dataclass(frozen=True, slots=True)
class Sensed(Series):
    """The readings of a sensor: a series with noise, and with the fault between `start_s` and `end_s`.

    Attributes
    ----------
    noise : ndarray, drawn anew by `rng` for every reading.
    change : callable or None
    start_s, end_s : float
        Of the fault.
    """

    noise: float = 0.0
    rng: np.random.Generator | None = None
    change: Change | None = None
    start_s: float = 0.0
    end_s: float = 0.0

    def at(self, t: Floats) -> Floats:
        """Read at the instants `t` (N,)."""
        value = Series.at(self, t)
        if self.rng is not None:
            value = value + self.noise * self.rng.standard_normal(len(t))
        broken = (t >= self.start_s) & (t < self.end_s)
        if self.change is None or not broken.any():
            return value
        value = value.copy()
        # a fault that keeps a reading keeps one from the time when the sensor broke
        value[broken] = self.change(t[broken], value[broken])
        return value


@dataclass(frozen=True, slots=True)
class Second:
    """Frames of one second of bench time, stamped with it from 0 on, and the true cores at its end."""

    frames: FrameBatch
    truth: Floats


@dataclass(frozen=True, slots=True)
class Incident:
    """What happens to a pack on the road.

    Attributes
    ----------
    changes : mapping of (quantity, cell) to callable
        Faults of the sensors of the first string.
    fault_s : (float, float)
        Begin and end of the faults.
    rest_s : (float, float), optional
        Begin and end of a time without current.
    fault : PackFault, optional
        Fault of the pack itself.
    """

    changes: Mapping[Key, Change] = field(default_factory=dict)
    fault_s: tuple[float, float] = (0.0, 0.0)
    rest_s: tuple[float, float] | None = None
    fault: PackFault | None = None


NOTHING: Final = Incident()


class Drive:
    """The simulated pack of a plan on a drive.

    Parameters
    ----------
    plan : Plan
    database : Database
    seed : int
    incident : Incident
    cycle : str
        Of `thermal.cycles.CYCLES`.
    """

    def __init__(
        self,
        plan: Plan,
        database: Database,
        seed: int = 0,
        *,
        incident: Incident = NOTHING,
        cycle: str = CYCLE,
    ) -> None:
        self._pack = VirtualPack(plan, seed, cycle=cycle)
        self._traffic = Traffic(plan, database)
        self._incident = incident
        self._rng = np.random.default_rng([seed, 0xC4])

    def seconds(self, count: int, at_once: int = SEGMENT_S) -> Iterator[Second]:
        """Generate seconds of traffic in blocks of a given length, which is short where the bus is full."""
        for segments in self._pack.segments(count, rest_s=self._incident.rest_s, fault=self._incident.fault):
            t = segments[0].time_s
            feeds = [
                {key: self._sensed(index, key, series) for key, series in s.series.items()}
                for index, s in enumerate(segments)
            ]
            truth = np.concatenate([s.core_C for s in segments], axis=1)
            for k in range(0, len(t) - 1, at_once):
                whole = np.arange(k, min(k + at_once, len(t) - 1) + 1)
                edges_ns = (int(t[0]) + whole) * SECOND
                frames = self._traffic.between(feeds, int(edges_ns[0]), int(edges_ns[-1]))
                edges = np.searchsorted(frames.time_ns, edges_ns).tolist()
                for j, a, b in zip(whole[1:].tolist(), edges, edges[1:], strict=False):
                    yield Second(frames[a:b], truth[j])

    def _sensed(self, string: int, key: Key, series: Series) -> Sensed:
        noise = SENSOR_NOISE_K if key[0] in NOISY else 0.0
        change = self._incident.changes.get(key) if string == 0 else None
        return Sensed(
            series.time_s,
            series.value,
            series.hole_s,
            series.blanks,
            series.coarse,
            noise,
            self._rng if noise else None,
            change,
            *self._incident.fault_s,
        )
