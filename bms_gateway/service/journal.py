"""Lines for people and journald: one per thing that happens, with its weight, never a flood.

Under systemd every line begins with its syslog level (``<4>…``), which journald takes off again. Lines of the same
origin (logger and code) are let through a few times per minute; the rest are counted and told of in one line.
"""

import logging
import os
import sys
import time
from collections.abc import Callable
from typing import Final

FREE: Final = 5  # lines of one kind per WINDOW_S: enough for five strings to tell the same
WINDOW_S: Final = 60.0
NOTICE: Final = 25  # between INFO and WARNING, as syslog has it

_SYSLOG = {logging.DEBUG: 7, logging.INFO: 6, NOTICE: 5, logging.WARNING: 4, logging.ERROR: 3, logging.CRITICAL: 2}


class Throttle(logging.Filter):
    """Lets `FREE` lines of a kind through per `WINDOW_S`; the first line after that tells how many were held back.

    The kind is the attribute `code` of the record where there is one, else the place in the code.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._since: dict[str, tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Decide on one line."""
        kind = getattr(record, "code", None) or f"{record.pathname}:{record.lineno}"
        now = self._clock()
        since, count = self._since.get(kind, (now, 0))
        if now - since >= WINDOW_S:
            if count > FREE:
                record.msg = f"{record.getMessage()} ({count - FREE} more like this in between)"
                record.args = None
            since, count = now, 0
        self._since[kind] = (since, count + 1)
        return count < FREE


class _Lines(logging.Formatter):
    def __init__(self, *, journal: bool) -> None:
        super().__init__("%(message)s" if journal else "%(asctime)s %(levelname)-7s %(message)s", "%H:%M:%S")
        self._journal = journal

    def format(self, record: logging.LogRecord) -> str:
        text = super().format(record)
        return f"<{_SYSLOG.get(record.levelno, 6)}>{text}" if self._journal else text


def start_logging(level: int = logging.INFO) -> None:
    """Send the package's lines to standard error, in journald's form where that is what it leads to."""
    logging.addLevelName(NOTICE, "NOTICE")
    handler = logging.StreamHandler(sys.stderr)
    handler.addFilter(Throttle())
    handler.setFormatter(_Lines(journal="JOURNAL_STREAM" in os.environ))
    package = logging.getLogger("bms_gateway")
    package.handlers[:] = [handler]
    package.setLevel(level)
    package.propagate = False
