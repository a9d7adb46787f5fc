"""The state is saved beside the event loop, so that a disk that does not answer delays nothing else."""

import asyncio
import logging
from collections.abc import Callable, Mapping
from functools import partial

from bms_gateway.errors import GatewayError
from bms_gateway.service.tally import Tally
from bms_gateway.service.task_thread import Worker

log = logging.getLogger(__name__)

State = Mapping[str, object]


class Saves:
    """Saves of the state, one at a time, in a thread of their own.

    Parameters
    ----------
    save : callable
        Gets a snapshot. A `GatewayError` or `OSError` from it is reported and has no other effect.
    snapshot : callable
        Returns the present snapshot.
    tally : Tally
        Counts the saves.
    """

    def __init__(self, save: Callable[[State], None], snapshot: Callable[[], State], tally: Tally) -> None:
        self._save, self._snapshot, self._tally = save, snapshot, tally
        self._worker = Worker("saves")
        self._going: asyncio.Future[None] | None = None
        self._taken_s = 0.0

    def begin(self) -> None:
        """Begin to save the present state; to be called in the event loop."""
        now_s = asyncio.get_running_loop().time()
        if self._going is not None and not self._going.done():  # only one save at a time: the disk may not answer
            self._failed(f"the disk has not answered for {now_s - self._taken_s:.0f} s")
            return
        self._taken_s = now_s
        self._going = self._worker.submit(partial(self._save, self._snapshot()))
        self._going.add_done_callback(partial(self._ended, self._taken_s))

    async def last(self, most_s: float) -> None:
        """Save the state at the end; wait for it `most_s` seconds at most."""
        try:
            await asyncio.wait_for(self._worker.submit(partial(self._save, self._snapshot())), most_s)
        except TimeoutError:
            text = "the state is not saved at the end: the disk has not answered for %g s"
            log.error(text, most_s)  # noqa: TRY400 (one line for a person, no traceback)
        except (GatewayError, OSError) as error:
            log.error("%s", error)  # noqa: TRY400 (as above)

    def _ended(self, taken_s: float, done: "asyncio.Future[None]") -> None:
        if done.cancelled():
            return
        error = done.exception()
        if error is None:
            self._tally.saves += 1
            self._tally.saved_s, self._tally.save_problem = taken_s, ""
        elif isinstance(error, (GatewayError, OSError)):
            self._failed(str(error))
        else:
            raise error

    def _failed(self, why: str) -> None:
        self._tally.saves_failed += 1
        self._tally.save_problem = why
        log.warning("%s", why, extra={"code": "save"})
