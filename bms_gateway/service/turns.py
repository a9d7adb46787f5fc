"""When the loop of the service looks at its port: after the first frame, while frames come, and at each deadline.

Asleep until the first frame comes (or, on ports that cannot be waited for, polling); then frames gather, as long as the
port has room for, and the port is drained, while traffic flows. A full bus costs some ten wake-ups a second, a silent
one none. One timer serves the engine's next deadline: it drains the port too, and the last drain before it comes
shortly before it, so that how long frames gather adds nothing to the time from a deadline to what is sent for it.
"""

import asyncio
from typing import Final, Protocol

from bms_gateway.bus.port import Port
from bms_gateway.service.engine import LiveEngine

DRAIN_S: Final = 0.01  # what is read at a deadline gathered no longer; nor do others beside the first after a silence
SETTLE_NS: Final = 2_000_000  # from the kernel's stamp to the socket it takes some µs, on a loaded machine up to 1 ms
ROUNDING_S: Final = 0.0002  # two clocks are in play: rather a little later than once too early


def pause(gather_s: float, left_s: float | None) -> float:
    """How long frames gather from now, s.

    Parameters
    ----------
    gather_s : float
        As long as the port has room for.
    left_s : float or None
        Until the next deadline: a drain falls `DRAIN_S` before it, if that is sooner.

    Examples
    --------
    >>> pause(0.1, None), pause(0.1, 0.5), round(pause(0.1, 0.07), 3), pause(0.1, 0.009)
    (0.1, 0.1, 0.06, 0.1)
    """
    return gather_s if left_s is None or left_s <= DRAIN_S else min(gather_s, left_s - DRAIN_S)


class Service(Protocol):
    """What the turns must know of the service that they belong to."""

    engine: LiveEngine
    port: Port

    @property
    def stopping(self) -> bool:
        """Whether nothing new is begun any more."""
        ...

    def step(self) -> int:
        """Drain the port once and do what is due; returns the number of frames."""
        ...


class Turns:
    """Calls `step` of the service whenever it is time.

    Parameters
    ----------
    service : Service
        Its engine may be another one after a reload.
    """

    def __init__(self, service: Service) -> None:
        self._service = service
        self._drained = False
        self._asleep = False
        self._deadline: int | None = None
        self._timer: asyncio.TimerHandle | None = None

    def begin(self) -> None:
        """Drain, and again when it is time; to be called in the event loop."""
        service = self._service
        fileno = service.port.fileno()
        if service.stopping:
            return
        loop = asyncio.get_running_loop()
        if service.step() or fileno < 0:
            due = service.engine.next_deadline()
            left_s = None if due is None else (due - service.port.now_ns()) / 1e9
            loop.call_later(pause(service.port.gather_s, left_s), self.begin)
        else:
            self._asleep = True
            loop.add_reader(fileno, self._on_readable)

    def drained(self) -> None:
        """Note that the service has drained its port, and set the timer to the engine's next deadline."""
        self._drained = True
        self.arm()

    def arm(self) -> None:
        """Set the timer to the engine's next deadline."""
        due = self._service.engine.next_deadline()
        if due == self._deadline:
            return
        self._deadline = due
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if due is not None:
            wait_s = max(0.0, (due + SETTLE_NS - self._service.port.now_ns()) / 1e9)
            self._timer = asyncio.get_running_loop().call_later(wait_s + ROUNDING_S, self._on_deadline)

    def move(self) -> bool:
        """Whether the port was drained since this was asked last, or its first frame is waited for."""
        drained, self._drained = self._drained, False
        return drained or self._asleep

    def end(self) -> None:
        """Wait for nothing any more."""
        if self._asleep:
            asyncio.get_running_loop().remove_reader(self._service.port.fileno())
        if self._timer is not None:
            self._timer.cancel()

    def _on_readable(self) -> None:
        """First frame after a pause: let some gather."""
        loop = asyncio.get_running_loop()
        loop.remove_reader(self._service.port.fileno())
        self._asleep = False
        loop.call_later(DRAIN_S, self.begin)

    def _on_deadline(self) -> None:
        self._deadline = None
        self._service.step()
