"""Core temperatures of arrays by the engine that runs in the vehicle: `Observer`.

The arrays become frames of a DBC made for them, at the cycle times of a usual one, and the engine estimates from these
frames: what `encode` and `analyze` do with a table. So the engine's own rules hold here too: a sensor that stands still
is not believed, parameters are identified on the way, and each value has a quality.
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from bms_gateway.bus.traffic import SECOND, Traffic, feed_of
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.engine import Channel, Engine, Estimated, Notice, Plan, StringPlan, drive
from bms_gateway.errors import DataError, UsageError, did_you_mean
from bms_gateway.frames.bits import Place
from bms_gateway.frames.database import Database
from bms_gateway.frames.signal_info import MessageInfo, SignalInfo
from bms_gateway.frames.vocabulary import INPUTS, Quantity
from bms_gateway.identify import Estimate
from bms_gateway.identify.sensor_noise import resolution
from bms_gateway.thermal import Disturbance, Floats, StringModel

__all__ = ["Cores", "Observer"]

STRING: Final = "string"
"""Name of the one string in events."""
ELECTRICAL: Final = "electrical"
"""Message of current and voltage, which belong to the same instant; every other quantity has a message of its own."""
FIRST_ID: Final = 0x100
METHODS: Final = ("window", "rls", "off")


LATEST_S = 9e9
"""s; inside, stamps are 64-bit integers of nanoseconds."""


@dataclass(frozen=True, slots=True)
class Cores:
    """Temperatures of n cells at T seconds. A value that is not available is NaN.

    Attributes
    ----------
    time_s : ndarray (T,)
        Ends of the seconds, on the clock of the columns.
    core_C, core_sd_K : ndarray (T, n)
        Core (mean of the jelly roll) and its standard deviation, which includes all unknowns of the gateway.
    surface_C : ndarray (T, n)
    centre_C, centre_sd_K : ndarray (T, n)
        Hottest point of each cell.
    heat_W, heat_sd_W : ndarray (T, n)
        Heat that no current makes.
    quality : ndarray of uint8 (T, n)
        `frames.quality.Quality` of each value.
    notices : tuple of Notice
        Sentences for a person, with their time: sensors refused, cores not proven.
    """

    time_s: Floats
    core_C: Floats
    core_sd_K: Floats
    surface_C: Floats
    centre_C: Floats
    centre_sd_K: Floats
    heat_W: Floats
    heat_sd_W: Floats
    quality: NDArray[np.uint8]
    notices: tuple[Notice, ...]


class Observer:
    """The estimator of one string, for arrays.

    Parameters
    ----------
    model : StringModel
    identify : {"window", "rls", "off"}
        How parameters are identified during the run; "off" keeps those of the model.
    disturbance : Disturbance, optional
        What is unknown: heat, inlet, noise of the readings.

    Examples
    --------
    >>> from bms_gateway.library.models import cell_model
    >>> t = np.arange(601.0)
    >>> current, inlet = np.full(601, 15.0), np.full(601, 25.0)
    >>> surface = 25.0 + 18.0 * (1.0 - np.exp(-t / 400.0)) + 0.03 * np.sin(t)
    >>> drive = Columns(time_s=t, current_A=current, coolant_inlet_C=inlet, surface_C={1: surface})
    >>> cores = Observer(cell_model("21700 5Ah 69g 25mOhm")).run(drive)
    >>> cores.core_C.shape, bool((cores.core_C[-1] > cores.surface_C[-1]).all()), bool((cores.core_sd_K[-1] < 12).all())
    ((600, 1), True, True)
    """

    def __init__(
        self,
        model: StringModel,
        *,
        identify: Literal["window", "rls", "off"] = "window",
        disturbance: Disturbance | None = None,
    ) -> None:
        if not isinstance(model, StringModel):
            raise UsageError(f"model: {type(model).__name__}: not a StringModel")
        if identify not in METHODS:
            raise UsageError(f"identify '{identify}': unknown{did_you_mean(identify, METHODS)}")
        self._model, self._identify = model, identify
        self._disturbance = disturbance or Disturbance()
        self._engine: Engine | None = None
        self._traffic: Traffic | None = None
        self._last_s = -np.inf

    @property
    def parameters(self) -> tuple[Estimate, ...]:
        """Parameters known now: name, value and sd in SI, status. None before the first run."""
        return () if self._engine is None else self._engine.strings[0].estimates

    @property
    def flags(self) -> tuple[str, ...]:
        """Faults that are found now: of a sensor, of the cooling, growth of resistance."""
        return () if self._engine is None else tuple(self._engine.strings[0].flags)

    def run(self, rows: Columns) -> Cores:
        """Estimate the cores; goes on from where the last run ended, with a gap in between where there is one.

        Parameters
        ----------
        rows : Columns
            Measurements with the surface of each sensor of the model. All runs must have the quantities of the first.

        Returns
        -------
        Cores

        Raises
        ------
        DataError
            Time does not increase, or the surface of a sensor is missing.
        """
        self._check(rows)
        if self._engine is None or self._traffic is None:
            plan, database = self._wire(rows)
            self._engine, self._traffic = Engine(plan, database), Traffic(plan, database)
        string = self._engine.plan.strings[0]
        start, stop = (round(float(t) * SECOND) for t in rows.time_s[[0, -1]])
        ticks: list[Estimated] = []
        notices: list[Notice] = []
        for event in drive(self._engine, self._traffic.stream([feed_of(rows, string)], start, stop + 1)):
            if isinstance(event, Estimated):
                ticks.append(event)
            elif isinstance(event, Notice):
                notices.append(event)
        self._last_s = float(rows.time_s[-1])
        n = self._model.cells

        def column(name: str) -> Floats:
            return np.array([getattr(e, name) for e in ticks], np.float64).reshape(-1, n)

        return Cores(
            time_s=np.array([e.time_ns * 1e-9 for e in ticks], np.float64),
            core_C=column("core"),
            core_sd_K=column("core_sd"),
            surface_C=column("surface"),
            centre_C=column("centre"),
            centre_sd_K=column("centre_sd"),
            heat_W=column("heat"),
            heat_sd_W=column("heat_sd"),
            quality=np.array([e.quality for e in ticks], np.uint8).reshape(-1, n),
            notices=tuple(notices),
        )

    def _check(self, rows: Columns) -> None:
        t = rows.time_s
        if len(t) < 2:
            raise DataError(f"{rows.source}: {len(t)} rows: an observer needs at least two")
        if not (np.abs(t) < LATEST_S).all():
            raise DataError(f"{rows.source}: time_s: from {t.min():g} to {t.max():g}: seconds are expected")
        if not (np.diff(t, prepend=self._last_s) > 0.0).all():
            raise DataError(f"{rows.source}: time_s does not increase, or does not follow the run before")
        missing = [k for k in self._model.sensors if k not in rows.surface_C]
        if missing:
            raise DataError(f"{rows.source}: no surface of cell {missing[0]}, a sensor of the model")

    def _wire(self, rows: Columns) -> tuple[Plan, Database]:
        """Say which quantity is in which signal, and make the DBC that has these signals."""
        cells = range(1, self._model.cells + 1)
        given: dict[tuple[Quantity, int | None], Floats] = {
            (quantity, cell): x
            for quantity, cell, x in rows.given()
            if cell is None or cell in (self._model.sensors if quantity == "surface" else cells)
        }
        signals: dict[str, dict[str, SignalInfo]] = {}
        channels = []
        for (quantity, cell), x in given.items():
            name = quantity if cell is None else f"{quantity}_{cell}"
            message = ELECTRICAL if INPUTS[quantity].electrical else name
            among = signals.setdefault(message, {})
            can_id = FIRST_ID + list(signals).index(message)
            step = resolution(x[np.isfinite(x)]) if INPUTS[quantity].kind == "temperature" else 0.0
            among[name] = _signal(message, name, can_id, 64 * len(among), step)
            channels.append(Channel(quantity, cell, f"{message}.{name}"))
        messages = [
            MessageInfo("arrays", m, next(iter(s.values())).can_id, 8 * len(s), (), None, None, "", s)
            for m, s in signals.items()
        ]
        string = StringPlan(STRING, 1, self._model, tuple(channels), self._identify)
        return Plan((string,), transmit=False, disturbance=self._disturbance), Database(messages)


def _signal(message: str, name: str, can_id: int, start: int, step: float) -> SignalInfo:
    """Describe a signal of 64 bits: whole steps if the sensor has steps, a float otherwise."""
    return SignalInfo(
        database="arrays",
        message=message,
        name=name,
        place=Place(start, 64, signed=True),
        is_float=not step,
        scale=step or 1.0,
        offset=0.0,
        minimum=None,
        maximum=None,
        unit="",
        comment="",
        choices={},
        mux=(),
        is_multiplexer=False,
        start_raw=None,
        j1939=False,
        can_id=can_id,
        cycle_ns=None,
    )
