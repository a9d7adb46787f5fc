"""Requests: heads must be short, because only a complete head decides on access; bodies have complete characters."""

import json
from collections.abc import Callable
from http.client import LineTooLong
from http.server import BaseHTTPRequestHandler
from typing import Any, BinaryIO, Final

MOST_BYTES: Final = 16_384
"""Greatest length of a head: a browser sends one or two thousand bytes. The library allows a hundred lines of 64
KiB."""


class _Lines:
    """Reads a connection, and limits the lines of a head to `MOST_BYTES` in total.

    Parameters
    ----------
    raw : file
    answers : callable
        Called with `begins=False` while a body is awaited, and with `begins=True` when it has come.
    """

    def __init__(self, raw: BinaryIO, answers: Callable[..., None]) -> None:
        self._raw, self._answers = raw, answers
        self._left: int | None = None

    def begin(self) -> None:
        """Begin a head: its first line, the request line, has a limit of its own."""
        self._left = None

    def readline(self, most: int = -1) -> bytes:
        """Read a line.

        Raises
        ------
        LineTooLong
            The head is too long.
        """
        line = self._raw.readline(most if self._left is None else self._left + 1)
        self._left = MOST_BYTES if self._left is None else self._left - len(line)
        if self._left < 0:
            raise LineTooLong("head")
        return line

    def read(self, most: int = -1) -> bytes:
        """Read a part of a body; a client that sends it byte by byte counts as idle."""
        self._answers(begins=False)
        try:
            return self._raw.read(most)
        finally:
            self._answers(begins=True)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._raw, name)


class ShortHeads(BaseHTTPRequestHandler):
    """Answers a head that is too long with 431, and closes the connection."""

    def setup(self) -> None:
        """Prepare the connection."""
        super().setup()
        self.rfile: Any = _Lines(self.rfile, self.answers)

    def answers(self, *, begins: bool) -> None:
        """Note that the answer to a request begins, or that it ends or waits for more of the request."""

    def handle_one_request(self) -> None:
        """Read a request and answer it."""
        self.rfile.begin()
        super().handle_one_request()


def body_of(sent: bytes) -> Any:
    r"""Return the document of a body in JSON.

    Raises
    ------
    ValueError
        It is not JSON, or has half a character, such as ``"\ud800"``, which no file and no answer can contain.
    RecursionError

    Examples
    --------
    >>> body_of(b'{"a": "\\u00b0C"}')
    {'a': '°C'}
    """
    document = json.loads(sent or b"{}")
    json.dumps(document, ensure_ascii=False).encode()
    return document
