"""What runs in the event loop of the service beside the estimates: metrics, MQTT, a baseline that is asked for."""

import asyncio
import logging
from collections.abc import Callable, Coroutine
from typing import Any

from bms_gateway.service.tally import Tally

log = logging.getLogger(__name__)


class Parts(dict[str, Callable[[], Coroutine[Any, Any, None]]]):
    """Coroutine functions by name, added before the service runs.

    One that fails is told, counted and left off: estimates do not depend on who looks at them.

    Parameters
    ----------
    tally : Tally
        Keeps the reasons.
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
        """Cancel them and other tasks, and wait so long for their farewell, s."""
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
