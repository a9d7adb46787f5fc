"""The parts of a config into which faults can be injected: the sensors of its first string, and the protection."""

from dataclasses import dataclass

import numpy as np

from bms_gateway.bus.virtual import VirtualPack
from bms_gateway.chaos.simulated_pack import CYCLE
from bms_gateway.engine.plan import Channel, Plan
from bms_gateway.frames.database import Database
from bms_gateway.frames.signal_info import MessageInfo
from bms_gateway.frames.vocabulary import Quantity


@dataclass(frozen=True, slots=True)
class Facts:
    """The first string of a plan on a simulated drive.

    Attributes
    ----------
    plan : Plan
    database : Database
    seed : int
    peak_A : float
        Largest current of the drive.
    """

    plan: Plan
    database: Database
    seed: int
    peak_A: float

    @classmethod
    def of(cls, plan: Plan, database: Database, seed: int = 0) -> "Facts":
        """Collect the facts of a plan; its pack is driven for ten minutes."""
        first = next(iter(VirtualPack(plan, seed, cycle=CYCLE).segments(600)))[0]
        return cls(plan, database, seed, float(np.abs(first.series["current", None].value).max()))

    def channel(self, quantity: Quantity) -> Channel | None:
        """First channel of a quantity that comes from the bus."""
        found = (c for c in self.plan.strings[0].channels if c.quantity == quantity and c.signal is not None)
        return next(found, None)

    def message(self, quantity: Quantity) -> MessageInfo | None:
        """Message that carries the first channel of a quantity."""
        channel = self.channel(quantity)
        if channel is None:
            return None
        return self.database.message(self.database.resolve(channel.signal or "").message)

    @property
    def sensed(self) -> int:
        """First cell with a thermocouple, from 1."""
        channel = self.channel("surface")
        return 1 if channel is None or channel.cell is None else channel.cell

    def lacks(self, *quantities: Quantity) -> str:
        """Say which of these the bus does not carry; empty where it carries all."""
        missing = [q.replace("_", " ") for q in quantities if self.channel(q) is None]
        return f"the config has no {' and no '.join(missing)} from the bus" if missing else ""
