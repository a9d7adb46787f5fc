"""One page over HTTP for Prometheus. No client can delay the gateway with it.

There is no web framework and no stream per client, but one socket and `SLOTS` clients at a time. Each client has
`DEADLINE_S` for everything and `HEAD_BYTES` for its request, and there is a pause between two clients. A further client
takes the place of the one that has been idle longest; a scrape sends its request at once, so it is never idle. The page
is renewed at most every `FRESH_S`.
"""

import asyncio
import logging
import socket
import time
from collections.abc import Callable
from typing import Final

log = logging.getLogger(__name__)

SLOTS: Final = 8  # Prometheus is one or two
QUEUE: Final = 16
DEADLINE_S: Final = 3.0  # a scrape over loopback takes milliseconds
HEAD_BYTES: Final = 4096  # Prometheus sends 300
PAUSE_S: Final = 0.01  # at most a hundred clients a second
FRESH_S: Final = 0.2
RETRY_S: Final = 10.0  # time until an address in use is tried again


class MetricsServer:
    """Serves ``GET /metrics``.

    Parameters
    ----------
    host, port : str, int
        Numeric address.
    page : callable
        Makes the page.
    content_type : str

    Attributes
    ----------
    address : tuple of str and int, or None
        Address of the socket; None before it listens.
    clients : dict of Task to bool
        Present clients, the oldest first, and whether their request has arrived.
    refused : int
        Clients without an answer: too slow, disconnected, or with too long a request.
    """

    def __init__(self, host: str, port: int, page: Callable[[], bytes], content_type: str) -> None:
        self._host, self.port = host, port
        self._page, self._type = page, content_type
        self._made: tuple[float, bytes] | None = None
        self.clients: dict[asyncio.Task[None], bool] = {}
        self.address: tuple[str, int] | None = None
        self.refused = 0

    async def run(self) -> None:
        """Serve until cancelled; an address in use is reported once and tried again."""
        sock = await self._listen()
        try:
            await self._accept(sock)
        finally:
            sock.close()
            for client in self.clients:
                client.cancel()

    async def _listen(self) -> socket.socket:
        told = False
        while True:
            sock = socket.socket(socket.AF_INET6 if ":" in self._host else socket.AF_INET, socket.SOCK_STREAM)
            try:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                sock.setblocking(False)
                sock.bind((self._host, self.port))
                sock.listen(QUEUE)
            except OSError as error:
                sock.close()
                if not told:
                    where = f"{self._host}:{self.port}"
                    log.warning("no metrics at %s: %s; trying again, estimates go on", where, error.strerror)
                    told = True
                await asyncio.sleep(RETRY_S)
            else:
                self.address = sock.getsockname()[:2]
                log.info("metrics at http://%s:%d/metrics", *self.address)
                return sock

    async def _accept(self, sock: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                client, _ = await loop.sock_accept(sock)
            except OSError:  # disconnected before it was accepted, or no descriptor left: the next one may succeed
                self.refused += 1
            else:
                if len(self.clients) >= SLOTS:
                    self.let_go()
                task = loop.create_task(self.serve(client))
                self.clients[task] = False
                task.add_done_callback(self.on_served)
            await asyncio.sleep(PAUSE_S)

    def let_go(self) -> None:
        """Close the oldest client without a complete request; if all are complete, the oldest."""
        oldest = next((task for task, asked in self.clients.items() if not asked), next(iter(self.clients)))
        del self.clients[oldest]
        self.refused += 1
        oldest.cancel()

    def on_served(self, task: "asyncio.Task[None]") -> None:
        """Remove a client that is done, and report a page that could not be made."""
        self.clients.pop(task, None)
        if not task.cancelled() and (bug := task.exception()) is not None:
            self.refused += 1
            log.error("the page of metrics cannot be made; estimates go on", exc_info=bug)

    async def serve(self, client: socket.socket) -> None:
        """Read the request of a client and answer it within its time."""
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(DEADLINE_S):
                head = await self._head(client)
                self.has_asked(asyncio.current_task())
                await loop.sock_sendall(client, self.answer(head))
        except (TimeoutError, OSError):
            self.refused += 1
        finally:
            client.close()

    def has_asked(self, task: "asyncio.Task[None] | None") -> None:
        """Note that the whole request has arrived: idle clients are closed first."""
        if task in self.clients:
            self.clients[task] = True

    async def _head(self, client: socket.socket) -> bytes:
        head = b""
        while b"\r\n\r\n" not in head and len(head) <= HEAD_BYTES:
            part = await asyncio.get_running_loop().sock_recv(client, HEAD_BYTES)
            if not part:
                raise ConnectionError("gone before it had asked")
            head += part
        return head

    def answer(self, head: bytes) -> bytes:
        """Answer a request by its head."""
        if len(head) > HEAD_BYTES:
            self.refused += 1
            return _response("431 Request Header Fields Too Large", b"")
        words = head.split(b"\r\n", 1)[0].split(b" ")
        if len(words) != 3 or not words[2].startswith(b"HTTP/1."):
            return _response("400 Bad Request", b"")
        method, path = words[0], words[1].split(b"?", 1)[0]
        if path != b"/metrics":
            return _response("404 Not Found", b"metrics are at /metrics\n")
        if method not in (b"GET", b"HEAD"):
            return _response("405 Method Not Allowed", b"", "Allow: GET, HEAD\r\n")
        body = self.fresh()
        return _response("200 OK", body, f"Content-Type: {self._type}\r\n", head_only=method == b"HEAD")

    def fresh(self) -> bytes:
        """Return the page, made again once it is older than `FRESH_S`."""
        now = time.monotonic()
        if self._made is None or now - self._made[0] > FRESH_S:
            self._made = (now, self._page())
        return self._made[1]


def _response(status: str, body: bytes, headers: str = "", *, head_only: bool = False) -> bytes:
    head = f"HTTP/1.1 {status}\r\n{headers}Content-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    return head.encode() + (b"" if head_only else body)
