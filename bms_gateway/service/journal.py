"""Lines for people and journald: one line per event, with its priority, and never a flood of lines.

Under systemd a line goes to journald by its own protocol, with fields for filters: ``journalctl BMS_STRING=string_2``,
``BMS_CODE=alert-sensor``, ``BMS_CELL=7`` besides the usual PRIORITY and CODE_FILE. If the socket refuses it, the line
goes to standard error with its syslog level in front (``<4>…``), which journald removes.

A few lines per minute of the same origin (logger and code) are written; the rest is counted, and one line gives the
count. If journald is busy, a line is lost and counted, but never a frame.
"""

import logging
import os
import socket
import sys
import time
from collections.abc import Callable
from typing import Final

FREE: Final = 5  # lines of one kind per WINDOW_S: enough for the same line from five strings
ASKED: Final = 60  # the same for answers: a person waits for them
WINDOW_S: Final = 60.0
NOTICE: Final = 25  # between INFO and WARNING, as syslog has it
JOURNAL: Final = "/run/systemd/journal/socket"
MOST_BYTES: Final = 16_384  # of a message: a traceback fits, a datagram holds it
IDENTIFIER: Final = "bms-gateway"

_SYSLOG = {logging.DEBUG: 7, logging.INFO: 6, NOTICE: 5, logging.WARNING: 4, logging.ERROR: 3, logging.CRITICAL: 2}


class Throttle(logging.Filter):
    """Passes `FREE` lines of a kind per `WINDOW_S`; the first line after that states how many were suppressed.

    Of records with the attribute `asked`, which answer a person, `ASKED` are passed. The kind is the attribute `kind`
    or `code` of the record if there is one, else the place in the code.

    Attributes
    ----------
    held : int
        Number of suppressed lines.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._since: dict[str, tuple[float, int]] = {}
        self.held = 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Decide on one line."""
        kind = getattr(record, "kind", None) or getattr(record, "code", None) or f"{record.pathname}:{record.lineno}"
        now, free = self._clock(), ASKED if getattr(record, "asked", False) else FREE
        since, count = self._since.get(kind, (now, 0))
        if now - since >= WINDOW_S:
            if count > free:
                record.msg = f"{record.getMessage()} ({count - free} more like this in between)"
                record.args = None
            since, count = now, 0
        self._since[kind] = (since, count + 1)
        self.held += count >= free
        return count < free


class _Lines(logging.Formatter):
    def __init__(self, *, journal: bool) -> None:
        super().__init__("%(message)s" if journal else "%(asctime)s %(levelname)-7s %(message)s", "%H:%M:%S")
        self._journal = journal

    def format(self, record: logging.LogRecord) -> str:
        text = super().format(record)
        return f"<{_SYSLOG.get(record.levelno, 6)}>{text}" if self._journal else text


class JournalHandler(logging.Handler):
    """Sends records to journald's socket.

    Parameters
    ----------
    path : str
        The socket.
    otherwise : logging.Handler
        Gets the lines that the socket refuses: it does not exist, or the line is too long.

    Attributes
    ----------
    lost : int
        Lines that journald was too busy to accept.
    sock : socket.socket
    """

    def __init__(self, path: str, otherwise: logging.Handler) -> None:
        super().__init__()
        self._path, self._otherwise = path, otherwise
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self.sock.setblocking(False)
        self._plain = logging.Formatter("%(message)s")
        self.lost = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Send one line with its fields."""
        try:
            self.sock.sendto(self._entry(record), self._path)
        except BlockingIOError:
            self.lost += 1
        except OSError:  # journald is being restarted, or the text is too long: standard error leads there too
            self._otherwise.handle(record)

    def close(self) -> None:
        """Close the socket."""
        self.sock.close()
        super().close()

    def _entry(self, record: logging.LogRecord) -> bytes:
        fields = {
            "MESSAGE": self._plain.format(record)[:MOST_BYTES],
            "PRIORITY": _SYSLOG.get(record.levelno, 6),
            "SYSLOG_IDENTIFIER": IDENTIFIER,
            "LOGGER": record.name,
            "CODE_FILE": record.pathname,
            "CODE_LINE": record.lineno,
            "CODE_FUNC": record.funcName,
            "BMS_CODE": getattr(record, "code", None),
            "BMS_STRING": getattr(record, "string", None),
            "BMS_CELL": getattr(record, "cell", None),
        }
        return b"".join(_field(name, str(value)) for name, value in fields.items() if value is not None)


def _field(name: str, value: str) -> bytes:
    r"""Return one field of an entry; a value with several lines is preceded by its length.

    Examples
    --------
    >>> _field("A", "b"), _field("A", "b\nc")
    (b'A=b\n', b'A\n\x03\x00\x00\x00\x00\x00\x00\x00b\nc\n')
    """
    data = value.encode("utf-8", "backslashreplace")
    if b"\n" not in data:
        return b"%s=%s\n" % (name.encode(), data)
    return b"%s\n%s%s\n" % (name.encode(), len(data).to_bytes(8, "little"), data)


def leads_to_journal() -> bool:
    """Whether standard error is the stream that systemd connected to journald, by its device and inode."""
    try:
        stat = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError, AttributeError):  # closed, or replaced by something without a descriptor
        return False
    return os.environ.get("JOURNAL_STREAM", "") == f"{stat.st_dev}:{stat.st_ino}"


def start_logging(level: int = logging.INFO, *, journal: str = JOURNAL) -> logging.Handler:
    """Send the package's lines to journald if standard error leads there, else to standard error.

    Parameters
    ----------
    level : int
    journal : str
        Journald's socket.

    Returns
    -------
    logging.Handler
    """
    logging.addLevelName(NOTICE, "NOTICE")
    to_journal = leads_to_journal()
    handler: logging.Handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Lines(journal=to_journal))
    if to_journal:
        handler = JournalHandler(journal, handler)
    handler.addFilter(Throttle())
    package = logging.getLogger("bms_gateway")
    package.handlers[:] = [handler]
    package.setLevel(level)
    package.propagate = False
    return handler
