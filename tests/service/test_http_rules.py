"""The rules of the page's server one by one: who is let go, what each request is answered, and when the page is new."""

import asyncio
import logging
import socket

import pytest

from bms_gateway.service import http
from bms_gateway.service.http import HEAD_BYTES, SLOTS, MetricsServer
from tests.support.live_service import come

GET = b"GET /metrics HTTP/1.1\r\n\r\n"


def made(page=lambda: b"page\n", host="127.0.0.1", port=0):
    return MetricsServer(host, port, page, "text/x")


def beside(server, part):
    """Run a coroutine function beside a server that listens; gives the server."""

    async def both():
        task = asyncio.ensure_future(server.run())
        await come(lambda: server.address)
        await part(server.address)
        task.cancel()
        await asyncio.wait([task])

    asyncio.run(both())
    return server


async def ask(address, *parts):
    """Send a request in parts, and give the whole answer."""
    reader, writer = await asyncio.open_connection(*address)
    for part in parts:
        writer.write(part)
        await writer.drain()
        await asyncio.sleep(0.02)
    answer = await reader.read()
    writer.close()
    return answer


def test_the_bounds():
    bounds = (SLOTS, http.QUEUE, http.DEADLINE_S, HEAD_BYTES, http.PAUSE_S, http.FRESH_S, http.RETRY_S)
    assert bounds == (8, 16, 3.0, 4096, 0.01, 0.2, 10.0)


@pytest.mark.parametrize(
    ("request_line", "answer"),
    [
        (
            b"GET /metrics HTTP/1.1",
            b"HTTP/1.1 200 OK\r\nContent-Type: text/x\r\nContent-Length: 5\r\nConnection: close\r\n\r\npage\n",
        ),
        (
            b"HEAD /metrics?a?b HTTP/1.0",
            b"HTTP/1.1 200 OK\r\nContent-Type: text/x\r\nContent-Length: 5\r\nConnection: close\r\n\r\n",
        ),
        (
            b"PUT /metrics HTTP/1.1",
            b"HTTP/1.1 405 Method Not Allowed\r\nAllow: GET, HEAD\r\nContent-Length: 0\r\nConnection: close\r\n\r\n",
        ),
        (
            b"GET / HTTP/1.1",
            b"HTTP/1.1 404 Not Found\r\nContent-Length: 24\r\nConnection: close\r\n\r\nmetrics are at /metrics\n",
        ),
        (b"GET /metrics HTTP/2", b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"),
        (b"GET /metrics", b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"),
        (b"GET /metrics HTTP/1.1 x", b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"),
    ],
)
def test_what_a_request_is_answered(request_line, answer):
    server = made()
    assert server.answer(request_line + b"\r\nHost: x y\r\n\r\n") == answer
    assert server.refused == 0


def test_a_request_of_just_the_bytes_allowed_is_answered_and_one_more_is_refused():
    room = HEAD_BYTES - len(GET) - len(b"X: \r\n")
    found = []

    async def two(address):
        for more in (0, 1):
            request = GET[:-2] + b"X: " + b"a" * (room + more) + b"\r\n\r\n"
            found.append(await ask(address, request[:-1], request[-1:]))

    server = beside(made(), two)
    assert [answer.split(b" ")[1] for answer in found] == [b"200", b"431"]
    assert server.refused == 1


def test_a_request_may_come_in_parts():
    found = []

    async def one(address):
        found.append(await ask(address, GET[:9], GET[9:-1], GET[-1:]))

    server = beside(made(), one)
    assert found[0].endswith(b"page\n")
    assert server.refused == 0
    assert server.clients == {}


def test_a_client_that_says_nothing_is_closed_at_its_deadline_and_one_that_goes_at_once(monkeypatch):
    monkeypatch.setattr(http, "DEADLINE_S", 0.1)
    told = []

    async def both(address):
        reader, writer = await asyncio.open_connection(*address)
        told.append(await reader.read())
        writer.close()
        told.append(server.refused)
        monkeypatch.setattr(http, "DEADLINE_S", 3600.0)
        _, writer = await asyncio.open_connection(*address)
        writer.close()
        await come(lambda: server.refused == 2)

    server = made()
    beside(server, both)
    assert told == [b"", 1]
    assert (server.refused, server.clients) == (2, {})


def test_the_page_is_made_anew_once_it_is_older_than_its_time(monkeypatch):
    now, pages = [0.0], iter([b"1", b"2", b"3"])
    monkeypatch.setattr(http.time, "monotonic", lambda: now[0])
    server, found = made(lambda: next(pages)), []
    for now[0] in (0.0, 0.1, 0.2, 0.201, 0.3, 0.41):
        found.append(server.fresh())
    assert found == [b"1", b"1", b"1", b"2", b"2", b"3"]


class Client:
    """A task of a client that notes its end."""

    def __init__(self):
        self.ended = False

    def cancel(self):
        self.ended = True


def test_the_oldest_that_has_not_asked_is_let_go_and_where_all_have_the_oldest():
    server, clients = made(), [Client() for _ in range(3)]
    server.clients = dict(zip(clients, (True, False, False), strict=True))
    for ended in ([False, True, False], [False, True, True], [True, True, True]):
        server.let_go()
        assert [c.ended for c in clients] == ended
    assert (server.clients, server.refused) == ({}, 3)


def test_one_client_fewer_than_the_slots_costs_nobody_its_place(monkeypatch):
    monkeypatch.setattr(http, "DEADLINE_S", 3600.0)
    seen = []

    async def full(address):
        idle = [socket.create_connection(address) for _ in range(SLOTS)]
        await come(lambda: len(server.clients) == SLOTS)
        assert set(server.clients.values()) == {False}
        seen.append(server.refused)
        idle.append(socket.create_connection(address))
        await come(lambda: server.refused)
        seen.append((server.refused, len(server.clients)))
        for sock in idle:
            sock.close()

    server = made()
    beside(server, full)
    assert seen == [0, (1, SLOTS)]


def test_a_client_that_has_asked_is_not_idle(monkeypatch):
    """One that was let go while its request came in takes no place again."""
    server = made()

    async def asks():
        ours, theirs = socket.socketpair()
        ours.setblocking(False)  # as asyncio gives what it accepts
        theirs.sendall(GET)
        task = asyncio.ensure_future(server.serve(ours))
        server.clients[task] = False
        asked = []
        monkeypatch.setattr(server, "answer", lambda head: asked.append(dict(server.clients)) or b"x")
        await task
        assert asked == [{task: True}]
        other = asyncio.ensure_future(asyncio.sleep(0))
        server.has_asked(other)
        await other
        assert other not in server.clients
        assert theirs.recv(10) == b"x"
        assert theirs.recv(10) == b""
        theirs.close()

    asyncio.run(asks())


def test_a_bug_in_the_page_is_told_with_its_place_and_what_was_let_go_is_no_bug(caplog):
    def broken():
        raise ZeroDivisionError("x")

    found = []

    async def two(address):
        found.append(await ask(address, GET))

    server = beside(made(broken), two)
    (told,) = [r for r in caplog.records if r.levelno == logging.ERROR]
    assert found == [b""]
    assert told.exc_info[1].args == ("x",)
    assert server.refused == 1

    async def let_go():
        task = asyncio.ensure_future(asyncio.sleep(3600))
        task.add_done_callback(server.on_served)
        server.clients[task] = False
        await asyncio.sleep(0)
        task.cancel()
        await asyncio.wait([task])

    asyncio.run(let_go())
    assert (server.refused, server.clients) == (1, {})


def test_a_client_that_cannot_be_taken_is_counted_and_the_next_is_answered():
    found = []

    async def two(address):
        loop = asyncio.get_running_loop()
        real = loop.sock_accept
        failures = [OSError(24, "no descriptor left")] * 2

        async def accept(sock):
            if failures:
                raise failures.pop()
            return await real(sock)

        loop.sock_accept = accept
        found.append(await ask(address, GET))  # by the call that waits already
        found.append(await ask(address, GET))

    server = beside(made(), two)
    assert all(answer.endswith(b"page\n") for answer in found)
    assert server.refused == 2


def test_between_two_clients_there_is_a_pause(monkeypatch):
    monkeypatch.setattr(http, "PAUSE_S", 3600.0)

    async def two(address):
        assert (await ask(address, GET)).endswith(b"page\n")
        with socket.create_connection(address) as second:
            second.sendall(GET)
            await asyncio.sleep(0.1)
            second.setblocking(False)
            with pytest.raises(BlockingIOError):
                second.recv(1)

    beside(made(), two)


def test_an_address_of_ip_6_is_listened_to():
    found = []

    async def one(address):
        found.append((address[0], await ask(address, GET)))

    beside(made(host="::1"), one)
    assert found[0][0] == "::1"
    assert found[0][1].endswith(b"page\n")


def test_an_address_that_is_taken_is_told_once_and_no_try_leaves_its_socket(monkeypatch, caplog):
    monkeypatch.setattr(http, "RETRY_S", 0.01)
    caplog.set_level(logging.INFO)
    opened = []

    class Counted(socket.socket):
        def bind(self, address):
            opened.append(self)
            super().bind(address)

    monkeypatch.setattr(http.socket, "socket", Counted)
    with socket.create_server(("127.0.0.1", 0)) as other:
        opened.clear()
        server = made(port=other.getsockname()[1])

        async def tries():
            task = asyncio.ensure_future(server.run())
            await come(lambda: len(opened) >= 4)
            assert server.address is None
            task.cancel()
            await asyncio.wait([task])

        asyncio.run(tries())
    assert all(sock.fileno() == -1 for sock in opened[:3])
    where = f"127.0.0.1:{server.port}"
    assert caplog.messages == [f"no metrics at {where}: Address already in use; trying again, estimates go on"]


def test_where_it_listens_is_told_and_the_end_closes_every_client_at_once(monkeypatch, caplog):
    monkeypatch.setattr(http, "DEADLINE_S", 3600.0)
    caplog.set_level(logging.INFO)
    server = made()

    async def ends():
        task = asyncio.ensure_future(server.run())
        await come(lambda: server.address)
        reader, writer = await asyncio.open_connection(*server.address)
        await come(lambda: server.clients)
        task.cancel()
        await asyncio.wait([task])
        assert await asyncio.wait_for(reader.read(), 30.0) == b""
        writer.close()
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection(*server.address)

    asyncio.run(ends())
    assert caplog.messages == [f"metrics at http://127.0.0.1:{server.address[1]}/metrics"]


def test_the_next_start_has_the_address_though_connections_of_the_last_one_linger_in_the_kernel():
    found = []

    async def one(address):
        found.append((address, await ask(address, GET)))

    port = beside(made(), one).address[1]
    beside(made(port=port), one)
    assert found[0] == found[1]
