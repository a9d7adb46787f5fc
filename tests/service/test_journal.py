import logging
import os
import socket

import pytest

from bms_gateway.service.journal import FREE, NOTICE, WINDOW_S, Throttle, start_logging
from bms_gateway.service.notify import notify, reloading, watchdog_s


def record(text, code=None, line=1):
    made = logging.LogRecord("bms_gateway.x", logging.WARNING, "x.py", line, text, None, None)
    if code:
        made.code = code
    return made


def test_a_flood_of_one_kind_is_cut_told_of_once_and_leaves_others_alone():
    now = [0.0]
    throttle = Throttle(lambda: now[0])
    assert [throttle.filter(record("a", "sensor")) for _ in range(FREE + 3)] == [True] * FREE + [False] * 3
    assert throttle.filter(record("b", "bus"))
    assert throttle.filter(record("c", line=2))
    now[0] = WINDOW_S
    late = record("a", "sensor")
    assert throttle.filter(late)
    assert late.getMessage() == "a (3 more like this in between)"
    assert throttle.filter(quiet := record("a", "sensor"))
    assert quiet.getMessage() == "a"


@pytest.mark.parametrize(("journal", "expected"), [(True, "<5>core of cell 3 is hot\n"), (False, "NOTICE  core of")])
def test_lines_carry_their_weight_for_journald_and_are_readable_elsewhere(journal, expected, monkeypatch, capsys):
    if journal:
        monkeypatch.setenv("JOURNAL_STREAM", "1:2")
    else:
        monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    package = logging.getLogger("bms_gateway")
    before = package.handlers[:], package.level, package.propagate
    try:
        start_logging()
        logging.getLogger("bms_gateway.engine").log(NOTICE, "core of cell %d is hot", 3)
        logging.getLogger("bms_gateway.engine").debug("unseen")
    finally:
        package.handlers[:], package.propagate = before[0], before[2]
        package.setLevel(before[1])
    err = capsys.readouterr().err
    assert expected in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("abstract", [False, True])
def test_notify_reaches_the_socket_that_systemd_names(abstract, tmp_path, monkeypatch):
    name = f"@bms-gateway-test-{os.getpid()}" if abstract else str(tmp_path / "n")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind("\0" + name[1:] if abstract else name)
        monkeypatch.setenv("NOTIFY_SOCKET", name)
        assert notify("READY=1", "STATUS=x")
        assert sock.recv(100) == b"READY=1\nSTATUS=x"
        assert reloading()
        assert sock.recv(100).startswith(b"RELOADING=1\nMONOTONIC_USEC=")
    assert not notify("READY=1")
    monkeypatch.delenv("NOTIFY_SOCKET")
    assert not notify("READY=1")


def test_the_watchdog_interval_is_only_ours_if_it_names_this_process(monkeypatch):
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    monkeypatch.setenv("WATCHDOG_USEC", "2500000")
    assert watchdog_s() == 2.5
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    assert watchdog_s() == 2.5
    monkeypatch.setenv("WATCHDOG_PID", "1")
    assert watchdog_s() is None
    monkeypatch.delenv("WATCHDOG_PID")
    monkeypatch.setenv("WATCHDOG_USEC", "")
    assert watchdog_s() is None
