"""The config is read again on request, beside the event loop; the present engine continues meanwhile."""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Final, Protocol

from bms_gateway.errors import GatewayError
from bms_gateway.service.engine_protocol import LiveEngine
from bms_gateway.service.notify import reloading
from bms_gateway.service.tally import Tally

log = logging.getLogger(__name__)
ANSWER: Final = {"code": "reload", "asked": True}


class Service(Protocol):
    """What reloads need of the service whose engine they replace."""

    tally: Tally

    @property
    def stopping(self) -> bool:
        """Whether the service is ending, so that nothing new begins."""
        ...

    def go_on_with(self, engine: LiveEngine) -> None:
        """Use another engine."""

    def tell_status(self, *before: str) -> None:
        """Send systemd the status after other lines, if it knows that the service is ready."""


class Reloads:
    """Reads of the config, one at a time; requests during a read cause one more read after it.

    Parameters
    ----------
    service : Service
    read : coroutine function
        Returns the new engine. A `GatewayError` is reported, and the present engine is kept.

    Attributes
    ----------
    going : asyncio.Task or None
        The read in progress.
    """

    def __init__(self, service: Service, read: Callable[[], Awaitable[LiveEngine]]) -> None:
        self._service, self._read = service, read
        self._again = False
        self.going: asyncio.Task[None] | None = None

    def begin(self) -> None:
        """Start a read; if one is in progress, read once more after it. Call this in the event loop."""
        if self.going is not None:
            self._again = True
            return
        reloading()
        self.going = asyncio.get_running_loop().create_task(self._reload())
        self.going.add_done_callback(self._ended)

    async def _reload(self) -> None:
        tally = self._service.tally
        try:
            engine = await self._read()
        except GatewayError as error:
            tally.reloads_refused += 1
            text = "not reloaded, going on as before: %s"
            log.error(text, error, extra=ANSWER)  # noqa: TRY400 (one line for a person, no traceback)
        else:
            tally.reloads += 1
            tally.fit_problems.clear()  # failed fits of the earlier engine say nothing about this one
            log.info("reloaded", extra=ANSWER)
            self._service.go_on_with(engine)

    def _ended(self, done: "asyncio.Task[None]") -> None:
        self.going = None
        if done.cancelled() or self._service.stopping:
            return
        if (error := done.exception()) is not None:
            raise error  # a bug
        if self._again:
            self._again = False
            self.begin()
        else:
            self._service.tell_status("READY=1")
