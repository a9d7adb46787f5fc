"""Identifiers that a port receives from its bus, and those that it may send."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Final

from bms_gateway.bus.pace import BURST, RATE


@dataclass(frozen=True, slots=True)
class Access:
    """Identifiers that a port receives, and those that it may send. By default it receives all and sends none.

    Attributes
    ----------
    wanted : collection of int or None
        Identifiers to receive (`EXTENDED` set for 29-bit ones); None: all.
    any_sender : collection of int
        Those of `wanted` that are parameter groups of J1939; they are received from every source address.
    own : mapping of int to int
        Identifiers that may be sent, each with its cycle, ns; anything else is refused. Empty: listen only. They are
        always received too, so that frames with our identifiers from another sender are seen.
    rate, burst : float, int
        Limits for sending: frames per second, and frames at once.
    """

    wanted: Collection[int] | None = None
    any_sender: Collection[int] = ()
    own: Mapping[int, int] = field(default_factory=dict)
    rate: float = RATE
    burst: int = BURST

    @property
    def received(self) -> set[int] | None:
        """Identifiers to receive, our own among them; None: all."""
        return None if self.wanted is None else {*self.wanted, *self.own}


LISTEN: Final = Access()
"""Whether everything is received and nothing sent."""
