"""Who is answered, and what may be sent: asked over real sockets, without a browser."""

import http.client
import json
import threading
from contextlib import contextmanager
from urllib.parse import quote, urlsplit

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.cli.main import main
from bms_gateway.config import shipped
from bms_gateway.errors import UsageError
from bms_gateway.workbench import server as served
from bms_gateway.workbench import site as sites
from bms_gateway.workbench.doors import names, refusal
from bms_gateway.workbench.server import Server
from bms_gateway.workbench.site import Site, safe_name

JSON = {"Content-Type": "application/json"}


@contextmanager
def serving(site=None, host="127.0.0.1"):
    server = Server(site or Site(), host, 0)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    try:
        yield server
    finally:
        server.site.close()
        server.shutdown()
        thread.join()
        server.server_close()


def ask(server, method, path, body=None, **headers):
    port = server.server_address[1]
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    try:
        connection.request(method, path, body, {"Host": f"127.0.0.1:{port}"} | headers)
        response = connection.getresponse()
        return response.status, response.read(), dict(response.getheaders())
    finally:
        connection.close()


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


def test_uploads_are_bounded_and_stay_in_their_folder(server, desk, monkeypatch):
    kind = {"Content-Type": "application/octet-stream"}
    name = quote("../../evil.csv")
    status, body, _ = ask(server, "POST", f"/api/upload?desk={desk}&name={name}", b"a,b\n", **kind)
    assert (status, json.loads(body)) == (200, {"name": "evil.csv"})
    folder = server.site.desk(desk).folder
    assert [p.name for p in folder.iterdir()] == ["evil.csv"]
    monkeypatch.setattr(served, "LARGEST_UPLOAD", 10)
    status, body, _ = ask(server, "POST", f"/api/upload?desk={desk}&name=b.csv", b"x" * 11, **kind)
    assert status == 400
    assert b"too large" in body
    monkeypatch.setattr(sites, "PER_DESK", 12)
    status, body, _ = ask(server, "POST", f"/api/upload?desk={desk}&name=c.csv", b"x" * 10, **kind)
    assert status == 400
    assert [p.name for p in folder.iterdir()] == ["evil.csv"]


@settings(deadline=None)
@given(st.text(max_size=60))
def test_a_safe_name_is_one_part_and_not_hidden(name):
    safe = safe_name(name)
    assert "/" not in safe
    assert "\\" not in safe
    assert not safe.startswith(".")


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
    ],
)
def test_what_cannot_be_done_is_one_line(server, desk, path, body):
    status, answer, _ = ask(server, "POST", f"/api/{path}?desk={desk}", body, **JSON)
    assert status == 400
    told = json.loads(answer)["error"]
    assert told
    assert "\n" not in told


def test_an_unknown_tab_is_told_so(server):
    status, body, _ = ask(server, "GET", "/api/state?desk=nobody")
    assert (status, json.loads(body)["error"]) == (400, "this tab is not known (any more): reload the page")


def test_paths_are_taken_on_the_machine_itself_only(tmp_path):
    site = Site(given=None)
    with serving(site) as server:
        site.local = False  # as where --host is another address
        desk = site.new_desk()
        body = json.dumps({"tables": ["/etc/passwd"], "model": "/etc/hostname"})
        status, answer, _ = ask(server, "POST", f"/api/open?desk={desk.name}", body, **JSON)
        assert status == 400
        assert b"upload it" in answer


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
    assert urlsplit(server.url).netloc in server.known


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
