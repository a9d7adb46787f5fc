"""Number of open connections of the page's server, each of which has a thread and a descriptor.

A further connection replaces the one that has been idle longest, that is, without a request being answered. A browser
opens it again when needed.
"""

import socket
import threading
from contextlib import suppress
from typing import Final

MOST: Final = 64
"""A browser keeps six for a page; each tab's stream of events is one of them."""


class Clients:
    """Open connections, the longest idle first."""

    def __init__(self) -> None:
        self._idle: dict[socket.socket, bool] = {}
        self._lock = threading.Lock()

    def come(self, client: socket.socket) -> bool:
        """Add a connection, and return whether there was room: none is closed while a request is answered."""
        with self._lock:
            if len(self._idle) >= MOST:
                oldest = next((other for other, idle in self._idle.items() if idle), None)
                if oldest is None:
                    return False
                del self._idle[oldest]
                with suppress(OSError):  # it may just have closed
                    oldest.shutdown(socket.SHUT_RDWR)  # its thread reads the end, and closes it
            self._idle[client] = True
            return True

    def answer(self, client: socket.socket, *, begins: bool) -> None:
        """Note that a request begins or ends."""
        with self._lock:
            if self._idle.pop(client, None) is not None:
                self._idle[client] = not begins  # moved to the end of the order

    def go(self, client: socket.socket) -> None:
        """Remove a connection."""
        with self._lock:
            self._idle.pop(client, None)
