"""How many connections the page's server keeps open, for each has a thread and a descriptor.

A connection more takes the place of the one that has been idle longest: idle is one on which no request is being
answered. A browser opens it again when it needs it.
"""

import socket
import threading
from contextlib import suppress
from typing import Final

MOST: Final = 64
"""A browser keeps six for a page, and each tab's stream of events is one of them."""


class Clients:
    """Open connections, those first that have been idle longest."""

    def __init__(self) -> None:
        self._idle: dict[socket.socket, bool] = {}
        self._lock = threading.Lock()

    def come(self, client: socket.socket) -> bool:
        """Take in a connection; whether there is room: all others are being answered where there is none."""
        with self._lock:
            if len(self._idle) >= MOST:
                oldest = next((other for other, idle in self._idle.items() if idle), None)
                if oldest is None:
                    return False
                del self._idle[oldest]
                with suppress(OSError):  # it has just gone
                    oldest.shutdown(socket.SHUT_RDWR)  # its thread reads the end, and closes it
            self._idle[client] = True
            return True

    def answer(self, client: socket.socket, *, begins: bool) -> None:
        """Note that a request begins or ends."""
        with self._lock:
            if self._idle.pop(client, None) is not None:
                self._idle[client] = not begins  # the last in the order

    def go(self, client: socket.socket) -> None:
        """Forget a connection."""
        with self._lock:
            self._idle.pop(client, None)
