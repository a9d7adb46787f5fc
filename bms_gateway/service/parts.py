"""What runs in the event loop of the service besides the estimates: metrics, MQTT, requests for a baseline."""

import asyncio
import logging
from collections.abc import Callable, Coroutine
from typing import Any

from bms_gateway.service.tally import Tally

log = logging.getLogger(__name__)


class Parts(dict[str, Callable[[], Coroutine[Any, Any, None]]]):
    """Coroutine functions by name, added before the service runs.

    A part that fails is reported, counted and left off: estimates do not depend on it.

    Parameters
    ----------
    tally : Tally
        Stores the reasons.
    """

    def __init__(self, tally: Tally) -> None:
        self._tally = tally
        self._tasks: list[asyncio.Task[None]] = []

    def start(self) -> None:
        """Start them all; to be called in the event loop."""
        for name, part in self.items():
            task = asyncio.get_running_loop().create_task(part(), name=name)
            task.add_done_callback(self._ended)
            self._tasks.append(task)

    async def end(self, most_s: float, *more: "asyncio.Task[None]") -> None:
        """Cancel them and other tasks, and wait at most this time for their end, s."""
        tasks = [*self._tasks, *more]
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks, timeout=most_s)

    def _ended(self, task: "asyncio.Task[None]") -> None:
        if not task.cancelled() and (error := task.exception()) is not None:
            name = task.get_name()
            self._tally.failed_parts[name] = f"{type(error).__name__}: {error}"
            log.error("%s has failed and is off until a restart; estimates go on", name, exc_info=error)
