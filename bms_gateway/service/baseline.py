"""Beside the gateway: takes up what a person asks for by `bms-gateway baseline --reset`."""

import asyncio
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Final, Protocol

from bms_gateway.errors import ConfigError
from bms_gateway.store.requests import BaselineReset, asked

log = logging.getLogger(__name__)

PERIOD_S: Final = 2.0
KEPT_S: Final = 180.0  # three times what a power cut may cost: by then what came of a wish has been saved


class ResettableEngine(Protocol):
    """What the engine must know."""

    def reset_baseline(self, string: str, cell: int | None, reason: str, *, time_ns: int) -> bool:
        """Make a new baseline; whether this wish is new."""
        ...


class BaselineRequests:
    """Wishes in the state directory.

    Parameters
    ----------
    directory : Path
    engine : callable
        Gives the engine of now.

    Notes
    -----
    A wish is removed only when the state that it led to has surely been saved. Where power was cut before, it is found
    again at the next start and carried out on the state of before; where after, the state knows it already.
    """

    def __init__(self, directory: Path, engine: Callable[[], ResettableEngine]) -> None:
        self._directory, self._engine = directory, engine
        self._done: dict[Path, float] = {}

    async def run(self) -> None:
        """Look every two seconds, for ever."""
        while True:
            self.look(asyncio.get_running_loop().time())
            await asyncio.sleep(PERIOD_S)

    def look(self, now_s: float) -> None:
        """Carry out what is new; remove what is old."""
        for path, wish in asked(self._directory):
            if path not in self._done:
                self._carry_out(path, wish)
                self._done[path] = now_s
            elif now_s - self._done[path] >= KEPT_S:
                self._remove(path)

    def _carry_out(self, path: Path, wish: BaselineReset | None) -> None:
        if wish is None:
            log.warning("%s: not a request to reset a baseline; it is removed", path.name, extra={"code": "baseline"})
            return
        try:
            self._engine().reset_baseline(wish.string, wish.cell, wish.reason, time_ns=wish.time_ns)
        except ConfigError as e:
            log.warning("%s: %s; it is removed", path.name, e, extra={"code": "baseline"})

    def _remove(self, path: Path) -> None:
        try:
            path.unlink(missing_ok=True)
        except OSError as e:
            log.warning("%s: cannot be removed: %s", path, e.strerror, extra={"code": "baseline"})
            return
        del self._done[path]
