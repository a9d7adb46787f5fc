"""Requests: heads are short, since only a head that was read tells who may come in; bodies have whole characters."""

import json
from collections.abc import Callable
from http.client import LineTooLong
from http.server import BaseHTTPRequestHandler
from typing import Any, BinaryIO, Final

MOST_BYTES: Final = 16_384
"""Of a head: a browser sends one or two thousand. The library takes a hundred lines of 64 KiB."""


class _Lines:
    """Reads a connection, and lets no head have more lines than `MOST_BYTES` hold.

    Parameters
    ----------
    raw : file
    answers : callable
        Is told with `begins=False` when a body is waited for, and with `begins=True` when it has come.
    """

    def __init__(self, raw: BinaryIO, answers: Callable[..., None]) -> None:
        self._raw, self._answers = raw, answers
        self._left: int | None = None

    def begin(self) -> None:
        """Begin a head: its first line, which names what is asked for, has a limit of its own."""
        self._left = None

    def readline(self, most: int = -1) -> bytes:
        """Read a line.

        Raises
        ------
        LineTooLong
            The head is.
        """
        line = self._raw.readline(most if self._left is None else self._left + 1)
        self._left = MOST_BYTES if self._left is None else self._left - len(line)
        if self._left < 0:
            raise LineTooLong("head")
        return line

    def read(self, most: int = -1) -> bytes:
        """Read a part of a body; who sends it byte by byte is as idle as who sends nothing."""
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
        """Hear that the answer to a request begins, or ends or waits for more of the request."""

    def handle_one_request(self) -> None:
        """Read a request and answer it."""
        self.rfile.begin()
        super().handle_one_request()


def body_of(sent: bytes) -> Any:
    r"""Give the document of a body in JSON.

    Raises
    ------
    ValueError
        It is no JSON, or has half a character, such as ``"\ud800"``, which no file and no answer can hold.
    RecursionError

    Examples
    --------
    >>> body_of(b'{"a": "\\u00b0C"}')
    {'a': '°C'}
    """
    document = json.loads(sent or b"{}")
    json.dumps(document, ensure_ascii=False).encode()
    return document
