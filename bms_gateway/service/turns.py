"""When the loop of the service reads its port: after the first frame, while frames come, and at each deadline.

The loop sleeps until the first frame comes (or polls, for ports that cannot be waited for). Then frames gather as long
as the port has room for, and the port is drained, while traffic flows. A full bus costs some ten wake-ups a second, a
silent one none. One timer serves the engine's next deadline and drains the port too. The last drain before it comes
shortly before the deadline, so that the gathering does not delay the output of the deadline.
"""

import asyncio
from typing import Final, Protocol

from bms_gateway.bus.port import Port
from bms_gateway.service.engine_protocol import LiveEngine

DRAIN_S: Final = 0.01  # time from the last drain to a deadline, and of gathering after a silence
SETTLE_NS: Final = 2_000_000  # from the kernel's stamp to the socket it takes some µs, on a loaded machine up to 1 ms
ROUNDING_S: Final = 0.0002  # two clocks are used: a little late is better than too early


def pause(gather_s: float, left_s: float | None) -> float:
    """Time for which frames gather from now, s.

    Parameters
    ----------
    gather_s : float
        Time for which the port has room.
    left_s : float or None
        Time until the next deadline: a drain comes `DRAIN_S` before it, if that is sooner.

    Examples
    --------
    >>> pause(0.1, None), pause(0.1, 0.5), round(pause(0.1, 0.07), 3), pause(0.1, 0.009)
    (0.1, 0.1, 0.06, 0.1)
    """
    return gather_s if left_s is None or left_s <= DRAIN_S else min(gather_s, left_s - DRAIN_S)


class Service(Protocol):
    """What the turns need of the service."""

    engine: LiveEngine
    port: Port

    @property
    def stopping(self) -> bool:
        """Whether the service is ending, so that nothing new begins."""
        ...

    def step(self) -> int:
        """Drain the port once and do what is due; return the number of frames."""
        ...


class Turns:
    """Calls `step` of the service whenever it is time.

    Parameters
    ----------
    service : Service
        A reload may replace its engine.
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
        """Return whether the port was drained since the last call, or the service waits for a first frame."""
        drained, self._drained = self._drained, False
        return drained or self._asleep

    def end(self) -> None:
        """Stop waiting."""
        if self._asleep:
            asyncio.get_running_loop().remove_reader(self._service.port.fileno())
        if self._timer is not None:
            self._timer.cancel()

    def _on_readable(self) -> None:
        """Let some frames gather after the first one."""
        loop = asyncio.get_running_loop()
        loop.remove_reader(self._service.port.fileno())
        self._asleep = False
        loop.call_later(DRAIN_S, self.begin)

    def _on_deadline(self) -> None:
        self._deadline = None
        self._service.step()
