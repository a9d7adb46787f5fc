"""Carries out requests of a person, made by `bms-gateway baseline --reset` and `acknowledge`, beside the gateway."""

import asyncio
import logging
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final, Protocol

from bms_gateway.errors import ConfigError
from bms_gateway.service.task_thread import Worker
from bms_gateway.store.requests import BaselineReset, Wish, asked

log = logging.getLogger(__name__)

PERIOD_S: Final = 2.0
KEPT_S: Final = 180.0  # three times what a power cut may cost: by then the result of a request has been saved


class ResettableEngine(Protocol):
    """Methods of the engine that are needed."""

    def reset_baseline(self, string: str, cell: int | None, reason: str, *, time_ns: int) -> bool:
        """Make a new baseline; return whether this request is new."""
        ...

    def acknowledge(self, string: str | None, reason: str) -> bool:
        """End alarms that only a person can end; return whether there were any."""
        ...


class BaselineRequests:
    """Requests in the state directory.

    Parameters
    ----------
    directory : Path
    engine : callable
        Returns the present engine.

    Notes
    -----
    A request is removed only after the state that contains its result has been saved. After an earlier power cut, the
    request is found again at the next start and carried out on the earlier state. After a later one, the saved state
    contains it already.

    The disk is accessed in a thread, so that a disk that hangs delays requests but no frame.
    """

    def __init__(self, directory: Path, engine: Callable[[], ResettableEngine]) -> None:
        self._directory, self._engine = directory, engine
        self._done: dict[Path, float] = {}

    async def run(self) -> None:
        """Check every two seconds, until cancelled."""
        worker = Worker("wishes")
        while True:
            found = await worker.submit(self._found)
            if over := self._take(found, asyncio.get_running_loop().time()):
                await worker.submit(partial(self._remove, over))
            await asyncio.sleep(PERIOD_S)

    def look(self, now_s: float) -> None:
        """Carry out new requests and remove old ones: one round of `run`."""
        self._remove(self._take(self._found(), now_s))

    def _found(self) -> list[tuple[Path, Wish | OSError | None]]:
        try:
            return list(asked(self._directory))
        except OSError as e:  # the directory cannot be listed now; perhaps at the next look
            return [(self._directory, e)]

    def _take(self, found: Sequence[tuple[Path, Wish | OSError | None]], now_s: float) -> list[Path]:
        """Carry out new requests; return those that are done."""
        over = []
        for path, wish in found:
            if isinstance(wish, OSError):  # it may be a request: it stays, and is tried again
                log.warning("%s: cannot be read: %s; tried again", path, wish.strerror, extra={"code": "baseline"})
            elif path not in self._done:
                self._carry_out(path, wish)
                self._done[path] = now_s
            elif now_s - self._done[path] >= KEPT_S:
                over.append(path)
        return over

    def _carry_out(self, path: Path, wish: Wish | None) -> None:
        if wish is None:
            log.warning("%s: not a request; it is removed", path.name, extra={"code": "baseline"})
            return
        if not isinstance(wish, BaselineReset):
            self._engine().acknowledge(wish.string, wish.reason)
            return
        try:
            self._engine().reset_baseline(wish.string, wish.cell, wish.reason, time_ns=wish.time_ns)
        except ConfigError as e:
            log.warning("%s: %s; it is removed", path.name, e, extra={"code": "baseline"})

    def _remove(self, paths: Sequence[Path]) -> None:
        for path in paths:
            try:
                path.unlink(missing_ok=True)
            except OSError as e:
                log.warning("%s: cannot be removed: %s", path, e.strerror, extra={"code": "baseline"})
            else:
                del self._done[path]
