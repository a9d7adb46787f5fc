"""Everything that the engine is told before the first frame: frozen, checked, without files and clocks."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from bms_gateway.frames.vocabulary import Quantity
from bms_gateway.health.alerts import AlertSettings
from bms_gateway.identify.cell_prior import CellSettings
from bms_gateway.thermal import Disturbance, Floats, StringModel

Statistic = Literal["max", "min", "mean"]


@dataclass(frozen=True, slots=True)
class Channel:
    """One measured quantity of one string, and its source on the bus.

    Attributes
    ----------
    quantity : Quantity
    cell : int or None
        1-based, for an input of cells.
    signal : str or None
        "Message.Signal" of a loaded DBC, or None for a constant.
    constant : float or None
        Used if the bus does not carry the quantity (SI, °C).
    statistic : {"max", "min", "mean"} or None
        For a surface: the reading is the greatest, least or mean surface of the cells `among` (1-based), not that of
        one certain cell.
    scale, offset : float
        Quantity = scale · decoded value + offset; converts the DBC's unit to SI and corrects wrong units in a log.
    charge : Channel or None
        For a current that two signals carry: this channel is the discharge, and `charge` the other direction, negative.
        The current is the sum of both.
    way : {1, -1, 0}
        Direction of a half of such a current: 1 discharge, −1 charge; 0 for every other channel.
    """

    quantity: Quantity
    cell: int | None = None
    signal: str | None = None
    constant: float | None = None
    scale: float = 1.0
    offset: float = 0.0
    statistic: Statistic | None = None
    among: tuple[int, ...] = ()
    charge: "Channel | None" = None
    way: Literal[1, -1, 0] = 0

    @property
    def halves(self) -> tuple["Channel", ...]:
        """The channels of single signals: this one, and that of the charge current where it has a signal of its own."""
        return (self,) if self.charge is None else (self, self.charge)

    @property
    def source(self) -> str:
        """Name for people: the signal, or both signals."""
        return " and ".join(half.signal or "" for half in self.halves)

    def share(self, value: Floats) -> Floats:
        """Give the part of a quantity that this signal carries: of a current its own direction, else all of it."""
        if self.way == 0:
            return value
        return np.maximum(value, 0.0) if self.way > 0 else np.minimum(value, 0.0)

    @property
    def key(self) -> tuple[str, int | None]:
        """Key of the channel in a feed of values: quantity and cell; for several cells `max_surface` and similar."""
        return (self.quantity, self.cell) if self.statistic is None else (f"{self.statistic}_surface", None)


@dataclass(frozen=True, slots=True)
class StringPlan:
    """One string: its name, its number in our DBC (from 1), its model and its channels."""

    name: str
    number: int
    model: StringModel
    channels: tuple[Channel, ...]
    identify: Literal["window", "rls", "off"] = "window"

    @property
    def carried(self) -> tuple[Channel, ...]:
        """Channels that the bus carries, one for each signal: both directions of a current where it has two."""
        return tuple(half for c in self.channels if c.signal is not None for half in c.halves)

    @property
    def of_several(self) -> bool:
        """Whether a reading belongs to one of several cells, so that the model must say to which."""
        return any(c.among for c in self.channels)

    @property
    def spread_read(self) -> bool:
        """Whether readings, some of them of several cells, show that cells differ, but not why."""
        return self.of_several and sum(c.quantity == "surface" for c in self.channels) > 1


@dataclass(frozen=True, slots=True)
class Plan:
    """Everything for the whole gateway.

    Attributes
    ----------
    strings : tuple of StringPlan
    transmit : bool
        False: listen only; nothing is put into the output.
    tick_ns : int
        Period of the estimator, ns of bus time; ticks fall on its multiples.
    silent_after_ns : int
        After this time without a wanted frame the bus counts as asleep: there are no ticks, and nothing is sent. The
        next frame wakes the engine, which then carries its state over the gap in one step.
    disturbance : Disturbance
        What the observers assume that the models do not know.
    cells : CellSettings
        Scatter of the cells, and how exact their voltages are.
    alerts : AlertSettings
        When a condition becomes an alert, and the limits.
    """

    strings: tuple[StringPlan, ...]
    transmit: bool = True
    tick_ns: int = 1_000_000_000
    silent_after_ns: int = 60_000_000_000
    disturbance: Disturbance = field(default_factory=Disturbance)
    cells: CellSettings = field(default_factory=CellSettings)
    alerts: AlertSettings = field(default_factory=AlertSettings)
