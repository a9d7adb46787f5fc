"""Who is answered, and what may be sent: asked over real sockets, without a browser."""

import http.client
import json
import socket
import threading
import time
from contextlib import suppress
from urllib.parse import urlsplit

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.cli.main import main
from bms_gateway.config import shipped
from bms_gateway.errors import UsageError
from bms_gateway.workbench import clients, doors
from bms_gateway.workbench import site as sites
from bms_gateway.workbench.clients import MOST
from bms_gateway.workbench.doors import Door, names, refusal
from bms_gateway.workbench.grafana import dashboard_address
from bms_gateway.workbench.server import Server
from bms_gateway.workbench.site import Site
from tests.support.doors import ask, serving
from tests.workbench.conftest import served as started

JSON = {"Content-Type": "application/json"}


@pytest.fixture(scope="module")
def server():
    with serving() as server:
        yield server


@pytest.fixture(scope="module")
def desk(server):
    status, body, _ = ask(server, "POST", "/api/desk", "{}", **JSON)
    assert status == 200
    return json.loads(body)["desk"]


def test_a_name_that_merely_leads_here_is_not_answered(server):
    status, body, _ = ask(server, "GET", "/", Host="evil.example:8420")
    assert status == 403
    assert b"evil.example" in body


def test_another_site_can_neither_read_nor_start_anything(server, desk):
    port = server.server_address[1]
    assert ask(server, "GET", f"/api/state?desk={desk}", Origin="http://evil.example")[0] == 403
    assert ask(server, "GET", f"/api/state?desk={desk}", **{"Sec-Fetch-Site": "cross-site"})[0] == 403
    assert ask(server, "POST", f"/api/undo?desk={desk}", "{}", **JSON, Origin=f"https://127.0.0.1:{port}")[0] == 403
    # what a form of another page can send without asking
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data"):
        assert ask(server, "POST", f"/api/undo?desk={desk}", "{}", **{"Content-Type": kind})[0] == 403
    assert ask(server, "POST", f"/api/cancel?desk={desk}", "{}", **JSON, Origin=f"http://127.0.0.1:{port}")[0] == 200


@settings(deadline=None)
@given(st.text(max_size=40))
def test_only_our_own_names_pass(host):
    known = names("127.0.0.1", 8420)
    assert bool(refusal("GET", {"host": host}, known)) == (host.lower() not in known)


def test_the_page_forbids_itself_all_but_its_own_files(server):
    status, body, headers = ask(server, "GET", "/")
    assert status == 200
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert b"http" not in body.replace(b"http-equiv", b"")  # nothing is fetched from elsewhere
    for path in ("/page/../server.py", "/page/%2e%2e/server.py", "/page/nothing.js", "/etc/passwd"):
        assert ask(server, "GET", path)[0] == 404


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("open", "no json"),
        ("open", "[1]"),
        ("open", '{"tables": "x"}'),
        ("open", '{"tables": [], "model": "m"}'),
        ("open", '{"tables": ["t"], "model": ""}'),
        ("open", '{"tables": [1], "model": "m"}'),
        ("add", '{"words": "x"}'),
        ("add", '{"words": ["x"]}'),
        ("diagnose", "{}"),
        ("undo", "{}"),
        ("nonsense", "{}"),
        ("undo", "[" * 30_000),
        ("open", '{"tables": ["a\\u0000b"], "model": "m"}'),
        ("open", '{"tables": ["t"], "model": "\\ud800"}'),
        ("open", '{"tables": ["t"], "model": "m", "string": "\\ud800"}'),
        ("track", '{"record": 0, "column": "\\ud800"}'),
    ],
)
def test_what_cannot_be_done_is_one_line(server, desk, path, body):
    status, answer, _ = ask(server, "POST", f"/api/{path}?desk={desk}", body, **JSON)
    assert status == 400
    told = json.loads(answer)["error"]
    assert told
    assert "\n" not in told


@pytest.mark.parametrize("length", ["9" * 5_000, "9" * 20, "-1", "x", "\u00b2", ""])
def test_a_length_that_is_none_is_one_line(server, desk, length):
    with socket.create_connection(server.server_address, timeout=60) as sock:
        host = f"127.0.0.1:{server.server_address[1]}"
        head = f"POST /api/undo?desk={desk} HTTP/1.1\r\nHost: {host}\r\nContent-Type: application/json\r\n"
        sock.sendall(f"{head}Content-Length: {length}\r\n\r\n".encode("latin-1"))
        answer = b"".join(iter(lambda: sock.recv(4096), b""))
    assert answer.startswith(b"HTTP/1.1 400 ")
    assert b"too large" in answer


def test_a_request_for_no_address_is_one_line(server):
    assert ask(server, "GET", "http://[")[0] == 400


def sent(server, raw):
    """Give what comes back for some bytes, until the connection is closed or nothing comes."""
    with socket.create_connection(server.server_address[:2], timeout=20) as s:
        with suppress(OSError):
            s.sendall(raw)
        got = b""
        with suppress(OSError):
            while part := s.recv(65536):
                got += part
        return got


@pytest.mark.parametrize(("lines", "size"), [(1, 65_000), (97, 65_000), (99, 400), (1, 16_384)])
def test_a_head_that_is_too_long_is_refused_before_it_is_kept(server, lines, size):
    """64 connections with 6 MB of head each took 575 MiB, without a token."""
    head = b"".join(b"x%d: %s\r\n" % (k, b"a" * size) for k in range(lines))
    told = sent(server, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n" + head + b"\r\n")
    assert told == b"" or told.startswith(b"HTTP/1.1 431 ")


def test_the_limit_of_a_head_is_that_of_each_request_and_no_body_counts(server, desk):
    connection = http.client.HTTPConnection(*server.server_address[:2], timeout=20)
    name = f"127.0.0.1:{server.server_address[1]}"
    for _ in range(4):
        connection.request("GET", f"/api/state?desk={desk}", headers={"Host": name, "X": "a" * 10_000})
        answer = connection.getresponse()
        assert (answer.status, bool(answer.read())) == (200, True)
    body = json.dumps({"nothing": "a" * 30_000})
    connection.request("POST", f"/api/cancel?desk={desk}", body, {"Host": name, **JSON})
    answer = connection.getresponse()
    assert (answer.status, bool(answer.read())) == (200, True)
    connection.close()


def test_those_who_send_a_request_byte_by_byte_lock_nobody_out(server, desk):
    """Their requests have begun, so they counted as being answered, for as long as they liked."""
    head = b"POST /api/undo?desk=%s HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nContent-Type: application/json\r\n"
    head = head % (desk.encode(), server.server_address[1]) + b"Content-Length: 60000\r\n\r\n{"
    slow = [socket.create_connection(server.server_address) for _ in range(MOST)]
    try:
        for one in slow:
            one.sendall(head)
        time.sleep(0.5)  # until all are waited for
        for one in slow:
            one.sendall(b" ")
        assert ask(server, "GET", f"/api/state?desk={desk}")[0] == 200
    finally:
        for one in slow:
            one.close()


def test_an_unknown_tab_is_told_so(server):
    status, body, _ = ask(server, "GET", "/api/state?desk=nobody")
    assert (status, json.loads(body)["error"]) == (400, "this tab is not known (any more): reload the page")


def test_more_tabs_than_are_kept_end_the_oldest(monkeypatch):
    monkeypatch.setattr(sites, "MOST_DESKS", 1)
    site = Site()
    first = site.new_desk()
    second = site.new_desk()
    assert list(site.desks) == [second.name]
    with pytest.raises(UsageError, match="reload the page"):
        site.desk(first.name)
    site.close()


def test_an_address_in_use_is_one_line(server):
    with pytest.raises(UsageError, match=r"--port \d+: cannot be used"):
        Server(Site(), "127.0.0.1", server.server_address[1])


def test_the_address_told_is_the_one_that_answers(server):
    assert urlsplit(server.door.url).netloc in server.door.known


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--live", "can0"], "--live needs --config"),
        (["x.csv"], "--model is needed"),
        (["x.csv", "--model", "m.toml"], "x.csv: no such file"),
        (["--model", "m.toml"], "--model goes with a TABLE"),
        (["--bitrate", "0"], "--bitrate 0: must be above 0"),
        (["--live", "drive.lgo", "--config", "CONFIG"], "drive.lgo: no such log"),
    ],
)
def test_bad_words_are_one_line(words, told, capsys, monkeypatch):
    monkeypatch.setattr("signal.signal", lambda *_: None)  # of the tests' own process
    words = [str(shipped("deploy/example/gateway.toml")) if w == "CONFIG" else w for w in words]
    assert main(["workbench", *words]) == 2
    err = capsys.readouterr().err
    assert told in err
    assert err.count("\n") == 1


def opened(url):
    """Status and headers of an address as it was printed."""
    parts = urlsplit(url)
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=60)
    try:
        connection.request("GET", f"{parts.path}?{parts.query}")
        response = connection.getresponse()
        return response.status, dict(response.getheaders())
    finally:
        connection.close()


def answered(port, host, cookie):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    try:
        connection.request("GET", "/", headers={"Host": host, "Cookie": cookie})
        return connection.getresponse().status
    finally:
        connection.close()


@pytest.fixture
def reached(monkeypatch):
    """A server as where others than this machine reach it, and what it has told."""
    monkeypatch.setattr(doors, "is_loopback", lambda _: False)
    told = []
    with serving(tell=told.append) as server:
        server.told = told
        yield server


def token_of(server):
    return urlsplit(server.door.url).query


def test_from_afar_nothing_is_answered_without_the_token(reached):
    for method, path in (("GET", "/"), ("GET", "/api/site"), ("GET", "/page/main.js"), ("POST", "/api/desk")):
        for more in ({}, {"Cookie": "bms-gateway-1=x"}, {"Cookie": "\xff; ;=;"}):
            status, body, _ = ask(reached, method, path, "{}" if method == "POST" else None, **JSON, **more)
            assert status == 403
            assert b"token" in body
    for query in ("token=", "token=x", "token=%FF%00", "x=1", token_of(reached)[:-1]):
        assert ask(reached, "GET", f"/?{query}")[0] == 403
    assert ask(reached, "POST", f"/?{token_of(reached)}", "{}", **JSON)[0] == 403
    assert not reached.told


def test_the_token_lets_one_browser_in_and_the_next_one_has_its_own(reached):
    query = token_of(reached)
    status, _, headers = ask(reached, "GET", f"/?{query}")
    assert (status, headers["Location"]) == (303, "/")
    assert "HttpOnly; SameSite=Strict" in headers["Set-Cookie"]
    cookie = {"Cookie": "theme=dark; " + headers["Set-Cookie"].partition(";")[0]}
    assert ask(reached, "GET", "/", **cookie)[0] == 200
    assert ask(reached, "POST", "/api/desk", "{}", **JSON, **cookie)[0] == 200
    assert ask(reached, "GET", "/", Host="evil.example", **cookie)[0] == 403
    assert ask(reached, "GET", f"/?{query}")[0] == 403
    assert token_of(reached) != query
    assert reached.told == [f"for one more browser: {reached.door.url}"]
    assert ask(reached, "GET", f"/?{token_of(reached)}")[0] == 303


def test_the_printed_address_answers_wherever_it_listens(tmp_path):
    """0.0.0.0 answered 403 to everybody, by whichever name."""
    with started(tmp_path, "--host", "0.0.0.0", "--name", "bench.example", "--name", "proxy.example:99") as url:
        port = urlsplit(url).port
        status, headers = opened(url)
        assert status == 303
        cookie = headers["Set-Cookie"].partition(";")[0]
        for host in (f"127.0.0.1:{port}", f"localhost:{port}", f"bench.example:{port}", "proxy.example:99"):
            assert answered(port, host, cookie) == 200
        for host in ("evil.example", f"evil.example:{port}", f"10.255.255.1:{port}", f"bench.example:{port + 1}"):
            assert answered(port, host, cookie) == 403
        assert answered(port, f"127.0.0.1:{port}", "") == 403


def test_one_address_of_this_machine_is_printed_as_it_is(tmp_path):
    """127.0.0.1 was printed, where nothing listened."""
    mine = doors.own_address("0.0.0.0")
    if not mine[0].isdigit():
        pytest.skip("this machine has no address but loopback")
    with started(tmp_path, "--host", mine) as url:
        assert urlsplit(url).hostname == mine
        assert opened(url)[0] == 303


def test_an_address_of_another_machine_is_refused_in_one_line(capsys, monkeypatch):
    monkeypatch.setattr("signal.signal", lambda *_: None)
    assert main(["workbench", "--host", "203.0.113.77", "--port", "0"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("host", ["", " "])
def test_an_empty_host_does_not_open_the_page_to_every_network(host, capsys, monkeypatch):
    monkeypatch.setattr("signal.signal", lambda *_: None)
    monkeypatch.setattr(Server, "serve_forever", lambda *_, **__: pytest.fail("it serves"))
    assert main(["workbench", "--host", host, "--port", "0"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("host", ["0", "0x0", "0.0.0.0", "::", "0::"])
def test_whichever_way_all_addresses_are_written_the_one_that_is_printed_can_be_opened(host):
    """`--host 0` printed http://0:8420/."""
    every = "::" if ":" in host else "0.0.0.0"
    door = Door(host, every, 8420)
    assert urlsplit(door.url).hostname == doors.own_address(every).lower()
    assert door.refusal("GET", {"host": urlsplit(door.url).netloc.lower()}, "127.0.0.1") == ""
    assert not door.local


@pytest.mark.parametrize(
    ("host", "port", "more", "known"),
    [
        ("::1", 8420, [], "[::1]:8420"),
        ("127.0.0.1", 80, [], "localhost"),
        ("0.0.0.0", 8420, ["Bench"], "bench:8420"),
    ],
)
def test_names_are_as_browsers_write_them(host, port, more, known):
    door = Door(host, host, port, more)
    assert door.refusal("GET", {"host": known}, host) == ""
    assert urlsplit(door.url).port == port


def test_the_number_at_which_it_was_reached_is_a_name_of_it():
    door = Door("::", "::", 8420)
    assert door.refusal("GET", {"host": "198.51.100.7:8420"}, "::ffff:198.51.100.7") == ""
    assert door.refusal("GET", {"host": "198.51.100.8:8420"}, "::ffff:198.51.100.7") != ""


def test_idle_connections_keep_nobody_out_and_take_no_threads_without_end(server, desk):
    """Each had a thread and a descriptor for two minutes; a browser that is being answered keeps its connection."""
    port = server.server_address[1]
    stream = socket.create_connection(("127.0.0.1", port), timeout=60)
    stream.sendall(f"GET /api/events?desk={desk} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
    first = stream.recv(65_536)
    before = threading.active_count()
    idle = [socket.create_connection(("127.0.0.1", port), timeout=60) for _ in range(3 * clients.MOST)]
    try:
        assert first.startswith(b"HTTP/1.1 200")
        assert ask(server, "GET", "/api/site")[0] == 200
        patience = time.monotonic() + 60.0  # threads of connections that were shut end one after the other
        while threading.active_count() > before + clients.MOST and time.monotonic() < patience:
            time.sleep(0.05)
        assert threading.active_count() <= before + clients.MOST
        assert idle[0].recv(1) == b""  # closed: it had been idle longest
        stream.settimeout(0.5)
        with suppress(TimeoutError):
            while stream.recv(65_536):
                pass
            pytest.fail("the stream was cut")
    finally:
        for one in (stream, *idle):
            one.close()


def test_what_cannot_be_taken_away_is_not_there():
    with serving() as server:
        desk = json.loads(ask(server, "POST", "/api/desk", "{}", **JSON)[1])["desk"]
        status, body, _ = ask(server, "GET", f"/api/take?desk={desk}&what=nope")
        assert status == 404
        assert json.loads(body)["error"] == "take: 'nope' is not one of model, report, session"
        assert ask(server, "GET", f"/api/take?desk={desk}")[0] == 404
        for what in ("figure?name=a&from=1&to=inf", "figure?name=a&from=1&to=x", "measures?a=nan&b=1"):
            status, body, _ = ask(server, "GET", f"/api/{what}&desk={desk}")
            assert status == 400, what
            assert "must be numbers" in json.loads(body)["error"]


@pytest.mark.parametrize(
    "address", ["grafana.example", "ftp://x/", "https://", "javascript:alert(1)", "http://x:99999/", "https://a b/"]
)
def test_a_dashboard_has_an_address(address):
    with pytest.raises(UsageError, match=r"--grafana .*expected an address such as https://grafana\.example/"):
        dashboard_address(address)


def test_a_dashboard_tells_no_password_and_is_one_of_the_live_page(capsys):
    with pytest.raises(UsageError, match="leave the user out"):
        dashboard_address("https://me:secret@grafana.example/")
    assert main(["workbench", "--grafana", "https://grafana.example/"]) == 2
    assert "--grafana goes with --live" in capsys.readouterr().err
