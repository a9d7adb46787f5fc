"""The page of metrics: read by Prometheus' own parser, bounded in size and cost, and harmless to the frames."""

import asyncio
import http.client
import re
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from bms_gateway.bus.port import Link
from bms_gateway.config.schema import Metrics
from bms_gateway.errors import StateError
from bms_gateway.service import http as server_module
from bms_gateway.service import live
from bms_gateway.service.exposition import CONTENT_TYPE, Family, page
from bms_gateway.service.http import HEAD_BYTES, SLOTS, MetricsServer
from bms_gateway.service.live import Gateway
from bms_gateway.service.metrics import Page
from tests.service.engine import TICK_NS, TickEngine
from tests.service.pack import Pack
from tests.support.live_service import PATIENCE_S, Bus, come, run, traffic

UNITS = ("seconds", "bytes", "celsius", "kelvin", "ratio", "total", "info")


def read(text):
    """Samples by (name, labels), and families by name."""
    families = {f.name: f for f in text_string_to_metric_families(text.decode())}
    samples = {(s.name, *sorted(s.labels.items())): s.value for f in families.values() for s in f.samples}
    return families, samples


def made(pack):
    return Page(pack.gateway, lambda: pack.engine, pack.watch)


def test_prometheus_own_parser_reads_the_page_and_finds_the_state_in_it():
    pack = Pack(12)
    pack.drive(8)
    pack.port.counters.errors["bus-off"] = 2
    pack.port.counters.stale = 3
    pack.port.link = Link.BUS_OFF
    _, samples = read(made(pack)())
    core, centre = pack.engine.strings[0].core, pack.engine.strings[0].centre
    expected = {
        ("bms_gateway_core_max_celsius", ("string", "string_1")): core.max(),
        ("bms_gateway_core_max_cell", ("string", "string_1")): core.argmax() + 1,
        ("bms_gateway_hottest_point_celsius", ("string", "string_1")): centre.max(),
        ("bms_gateway_hottest_point_sd_kelvin", ("string", "string_1")): pack.engine.strings[0].centre_sd[
            centre.argmax()
        ],
        ("bms_gateway_hottest_point_cell", ("string", "string_1")): centre.argmax() + 1,
        ("bms_gateway_cells", ("quality", "good"), ("string", "string_1")): 2,
        ("bms_gateway_cells", ("quality", "estimated"), ("string", "string_1")): 2,
        ("bms_gateway_bus_up",): 0,
        ("bms_gateway_bus_state", ("state", "bus-off")): 1,
        ("bms_gateway_bus_state", ("state", "up")): 0,
        ("bms_gateway_bus_errors_total", ("class", "bus-off")): 2,
        ("bms_gateway_bus_errors_total", ("class", "protocol")): 0,
        ("bms_gateway_frames_unsent_total", ("reason", "stale")): 3,
        ("bms_gateway_frames_used_total",): pack.engine.frames,
        ("bms_gateway_ticks_total",): 8,
        ("bms_gateway_tick_lateness_seconds_count",): 8,
        ("bms_gateway_tick_lateness_seconds_bucket", ("le", "+Inf")): 8,
        ("bms_gateway_flag_level", ("flag", "ageing"), ("string", "string_2")): 0,
        ("bms_gateway_state",): 0,
    }
    assert {key: samples.get(key) for key in expected} == pytest.approx(expected)
    rss = samples[("process_resident_memory_bytes",)]
    assert 1e6 < rss < 1e10


def test_names_units_types_and_help_are_as_prometheus_wants_them():
    pack = Pack(4)
    pack.drive(3)
    families, samples = read(made(pack)())
    assert len(families) > 35
    for name, family in families.items():
        assert re.fullmatch(r"(bms_gateway|process)_[a-z0-9_]+", name), name
        assert family.documentation.endswith("."), name
        assert family.type in ("gauge", "counter", "histogram"), name
        for sample in family.samples:
            assert sample.name.endswith("_total") is (family.type == "counter"), sample.name
    timed = {n for n in families if re.search(r"second|byte|celsius|kelvin|ratio", n)}
    assert all(n.endswith(UNITS) for n in timed)
    assert len({(s[0], *s[1:]) for s in samples}) == len(samples)


def test_what_is_not_known_is_left_out_and_not_zero():
    pack = Pack(1)
    _, samples = read(made(pack)())
    assert not any(
        key[0]
        in ("bms_gateway_core_max_celsius", "bms_gateway_hottest_point_celsius", "bms_gateway_resistance_growth_ratio")
        for key in samples
    )
    assert b"NaN" not in made(pack)()


def test_the_page_stays_small_whatever_the_bus_does():
    pack = Pack(30)
    pack.drive(12)  # the first forecasts have come
    size = len(made(pack)())
    for k in range(30):
        pack.port.counters.note_error()
        pack.drive(1 if k < 20 else 0, without=["string_1_electrical"] if k % 2 else [])
    assert size < 24_000
    assert len(made(pack)()) < 1.2 * size


def test_odd_names_and_values_do_not_break_the_format():
    odd = 'a"b\\c\nd'
    text = page(
        iter([Family("x", "gauge", "One\nline \\ only.", (("", {"l": odd}, float("inf")), ("", {"l": "n"}, -1.5)))])
    )
    families, samples = read(text)
    assert samples == {("x", ("l", odd)): float("inf"), ("x", ("l", "n")): -1.5}
    assert families["x"].documentation == "One\nline \\ only."


def test_the_address_in_the_config_is_checked():
    assert Metrics().address == ("127.0.0.1", 9105)
    assert Metrics(listen="[::1]:80").address == ("::1", 80)
    assert Metrics(listen="off").address is None
    for wrong in ("", "9105", "localhost:9105", "127.0.0.1", "127.0.0.1:0", "127.0.0.1:70000", "127.0.0.1:x"):
        with pytest.raises(ValueError, match=r'as "127\.0\.0\.1:9105", or "off"'):
            Metrics(listen=wrong)


async def ask(address, request=b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n"):
    reader, writer = await asyncio.open_connection(*address)
    writer.write(request)
    answer = await reader.read()
    writer.close()
    return answer


def serve(*tasks, page=lambda: b"page\n"):
    """Run a server beside coroutine functions that get its address; gives the server."""
    server = MetricsServer("127.0.0.1", 0, page, CONTENT_TYPE)

    async def all_of_it():
        task = asyncio.ensure_future(server.run())
        await come(lambda: server.address)
        for part in tasks:
            await part(server.address)
        task.cancel()
        await asyncio.wait([task])

    asyncio.run(all_of_it())
    return server


def test_the_server_answers_a_scrape_and_refuses_the_rest_by_the_book():
    found = {}
    kinds = {
        "scrape": (b"GET /metrics HTTP/1.1", b"200"),
        "query": (b"GET /metrics?x=1 HTTP/1.0", b"200"),
        "head": (b"HEAD /metrics HTTP/1.1", b"200"),
        "post": (b"POST /metrics HTTP/1.1", b"405"),
        "other": (b"GET /../etc/passwd HTTP/1.1", b"404"),
        "nonsense": (b"nonsense", b"400"),
        "huge": (b"GET /metrics HTTP/1.1\r\nX: " + b"a" * HEAD_BYTES, b"431"),
    }

    async def all_kinds(address):
        for kind, (request, _) in kinds.items():
            found[kind] = await ask(address, request + b"\r\n\r\n")

    serve(all_kinds)
    assert {k: a.split(b" ", 2)[1] for k, a in found.items()} == {k: status for k, (_, status) in kinds.items()}
    assert found["scrape"] == found["query"]
    assert found["scrape"] == found["head"] + b"page\n"


def test_a_real_client_reads_the_page_with_its_type_and_length():
    pack = Pack(3)
    pack.drive(2)
    found = {}

    def scrape(address):
        client = http.client.HTTPConnection(*address, timeout=30)
        client.request("GET", "/metrics")
        answer = client.getresponse()
        found["type"], found["page"] = answer.headers["Content-Type"], answer.read()
        client.close()

    async def beside(address):
        await asyncio.get_running_loop().run_in_executor(None, scrape, address)

    serve(beside, page=made(pack))
    assert found["type"] == "text/plain; version=0.0.4; charset=utf-8"
    assert len(read(found["page"])[0]) > 35


def test_a_page_is_made_once_for_many_who_ask_at_once(monkeypatch):
    monkeypatch.setattr(server_module, "FRESH_S", 3600.0)
    calls = []

    async def many(address):
        answers = await asyncio.gather(*(ask(address) for _ in range(20)))
        assert len(answers) == 20

    serve(many, page=lambda: calls.append(1) or b"page\n")
    assert calls == [1]


def test_a_bug_in_the_page_costs_the_answer_and_not_the_server(caplog):
    pages = [ZeroDivisionError("x"), b"sound\n"]

    def page():
        answer = pages.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    answers = []

    async def twice(address):
        answers.append(await ask(address))
        answers.append(await ask(address))

    server = serve(twice, page=page)
    assert answers[0] == b""
    assert answers[1].endswith(b"sound\n")
    assert server.refused == 1
    assert "the page of metrics cannot be made" in caplog.text


def test_an_address_that_is_taken_is_told_and_tried_again(caplog, monkeypatch):
    monkeypatch.setattr(server_module, "RETRY_S", 0.02)
    taken = socket.socket()
    taken.bind(("127.0.0.1", 0))
    taken.listen()
    server = MetricsServer("127.0.0.1", taken.getsockname()[1], lambda: b"", CONTENT_TYPE)

    async def beside():
        task = asyncio.ensure_future(server.run())
        await come(lambda: "Address already in use" in caplog.text)
        taken.close()
        await come(lambda: server.address)
        task.cancel()
        await asyncio.wait([task])

    asyncio.run(beside())
    assert caplog.text.count("no metrics at") == 1
    assert server.address


def test_the_bounds_are_those_of_the_readme():
    text = " ".join((Path(__file__).parents[2] / "deploy" / "README.md").read_text(encoding="utf-8").split())
    assert "Eight clients are served at a time, with three seconds and 4 KiB for each request." in text
    assert (SLOTS, server_module.DEADLINE_S, server_module.HEAD_BYTES) == (8, 3.0, 4096)


def test_the_end_leaves_no_client_and_the_next_start_has_the_address_at_once(monkeypatch):
    """The server closes first, so that its end of the connection lingers in the kernel for a minute."""
    monkeypatch.setattr(server_module, "DEADLINE_S", 3600.0)  # what is idle goes with the end, and not of age
    idle, found = socket.socket(), []

    async def twice():
        address = ("127.0.0.1", 0)
        for _ in range(2):
            server = MetricsServer(*address, lambda: b"page\n", CONTENT_TYPE)
            task = asyncio.ensure_future(server.run())
            await asyncio.sleep(0.05)
            found.append(server.address)
            address = server.address or address
            if len(found) == 1:
                await ask(address)
                idle.connect(address)
                await come(lambda server=server: server.clients)
            task.cancel()
            await asyncio.wait([task])
            await come(lambda: gone(idle))
            assert gone(idle)
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection(address)

    asyncio.run(twice())
    idle.close()
    assert found[0]
    assert found[0] == found[1]


def test_slow_greedy_and_many_clients_delay_no_frame_and_are_let_go(monkeypatch):
    """Half a request held open on every slot, megabytes of headers, and a storm of connections, under traffic."""
    bus, engine = Bus(), TickEngine()
    gateway = Gateway(engine, bus.port)
    server = MetricsServer("127.0.0.1", 0, lambda: b"page\n" * 2_000, CONTENT_TYPE)
    gateway.beside["metrics"] = server.run
    monkeypatch.setattr(server_module, "DEADLINE_S", 0.3)
    held, done = [], []

    def open_one(first):
        sock = socket.socket()
        sock.setblocking(False)
        with suppress(BlockingIOError):
            sock.connect(server.address)
        held.append((sock, first))

    async def storm():
        await come(lambda: server.address)
        for _ in range(60):
            open_one(b"GET /metr")
        for _ in range(5):
            open_one(b"GET /metrics HTTP/1.1\r\nX: " + b"a" * 2_000_000)
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end and not (len(engine.ticks) >= 15 and server.refused >= SLOTS):
            for sock, first in held:
                with suppress(OSError):
                    sock.send(first)
            await asyncio.sleep(0.01)
            assert len(server.clients) <= SLOTS
        for sock, _ in held:
            sock.close()
        answer = b""
        while not answer.endswith(b"page\n"):  # those that are closed free their slots within the deadline
            answer = await ask(server.address)
        done.append(len(answer))

    run(gateway, traffic(bus), storm(), until=lambda: done)
    bus.close()
    assert done
    assert done[0] > 10_000
    assert engine.late == []
    deadlines = [d for d, _ in engine.ticks]
    assert np.all(np.diff(deadlines) == TICK_NS)


def test_idle_sockets_hold_up_no_scrape(monkeypatch):
    """Sixty of them held every slot for the deadline: of ten scrapes none was answered."""
    monkeypatch.setattr(server_module, "DEADLINE_S", 3600.0)  # an answer does not wait for it
    held, answers = [], []

    async def idle(address):
        for _ in range(60):
            held.append(socket.socket())
            held[-1].setblocking(False)
            await asyncio.get_running_loop().sock_connect(held[-1], address)

    async def scrapes(address):
        for _ in range(10):
            answers.append(await asyncio.wait_for(ask(address), PATIENCE_S))

    server = serve(idle, scrapes)
    for sock in held:
        sock.close()
    assert [a.endswith(b"page\n") for a in answers] == [True] * 10
    assert server.refused >= 60 - SLOTS


def test_the_oldest_idle_client_goes_first():
    """Those that have asked stay, however slowly they read."""
    told = []

    async def clients(address):
        greedy = socket.socket()
        greedy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        idle = [socket.socket() for _ in range(SLOTS)]
        greedy.connect(address)
        greedy.sendall(b"GET /metrics HTTP/1.1\r\n\r\n")
        greedy.setblocking(False)
        await come(lambda: begins(greedy))
        for sock in idle:
            sock.connect(address)
            await asyncio.sleep(0.05)
        await come(lambda: gone(idle[0]))
        told.extend(gone(sock) for sock in idle)
        told.append(len(await asyncio.get_running_loop().sock_recv(greedy, 100)))
        for sock in (greedy, *idle):
            sock.close()

    serve(clients, page=lambda: b"page\n" * 4_000_000)
    assert told == [True, *[False] * (SLOTS - 1), 100]


def begins(sock):
    """Whether an answer has begun to come."""
    try:
        return sock.recv(1, socket.MSG_PEEK) != b""
    except BlockingIOError:
        return False


def gone(sock):
    """Whether the other side has closed it."""
    sock.setblocking(False)
    try:
        return sock.recv(1) == b""
    except BlockingIOError:
        return False


def test_a_part_beside_that_fails_is_told_and_the_frames_go_on(caplog):
    bus, engine = Bus(), TickEngine()
    gateway = Gateway(engine, bus.port)

    async def broken():
        raise KeyError("a bug")

    gateway.beside["mqtt"] = broken
    run(gateway, traffic(bus), until=lambda: len(engine.ticks) >= 3)
    bus.close()
    assert len(engine.ticks) >= 3
    assert gateway.tally.failed_parts == {"mqtt": "KeyError: 'a bug'"}
    assert "mqtt has failed and is off until a restart; estimates go on" in caplog.text


def test_saves_jobs_reloads_and_lateness_are_counted(monkeypatch):
    monkeypatch.setattr(live, "SAVE_S", 0.05)
    bus, engine = Bus(), TickEngine()
    answers = [StateError("disk full"), None, StateError("disk full again")]

    def save(_):
        if answers and (answer := answers.pop(0)) is not None:
            raise answer

    gateway = Gateway(engine, bus.port, save=save)
    engine.overdue.add(2)
    engine.job(1, lambda: 1)
    engine.job(2, lambda: 2)
    run(
        gateway,
        traffic(bus),
        until=lambda: gateway.tally.saves >= 2 and len(engine.results) == 2 and len(engine.ticks) >= 3,
    )
    bus.close()
    t = gateway.tally
    assert (t.saves_failed, t.save_problem, t.jobs, t.jobs_late) == (2, "", 2, 1)
    assert t.ticks == t.lateness.cumulative()[-1] >= 3
    assert 0.0 < t.lateness.total / t.ticks < 30.0


def test_what_the_config_does_not_want_is_not_loaded():
    code = (
        "import sys, bms_gateway.service.reporting; "
        "print([m for m in ('prometheus_client', 'aiomqtt', 'bms_gateway.service.metrics', "
        "'bms_gateway.service.http') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"
