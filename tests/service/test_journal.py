import logging
import os
import socket

import pytest

from bms_gateway.service.journal import ASKED, FREE, NOTICE, WINDOW_S, Throttle, start_logging
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


def test_who_asks_is_answered_each_time_up_to_once_a_second():
    now = [0.0]
    throttle = Throttle(lambda: now[0])

    def answer():
        made = record("reloaded", "reload")
        made.asked = True
        return made

    assert [throttle.filter(answer()) for _ in range(ASKED + 2)] == [True] * ASKED + [False] * 2
    assert (throttle.held, ASKED) == (2, 60)
    now[0] = WINDOW_S
    assert throttle.filter(late := answer())
    assert late.getMessage() == "reloaded (2 more like this in between)"


def to_journal(monkeypatch):
    """Make standard error look as systemd leaves it."""
    stat = os.fstat(2)
    monkeypatch.setenv("JOURNAL_STREAM", f"{stat.st_dev}:{stat.st_ino}")


class Journald:
    """The other end of the native protocol, as its description has it."""

    def __init__(self, path):
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.sock.bind(str(path))
        self.sock.settimeout(30)

    def entry(self):
        data, fields = self.sock.recv(1 << 20), {}
        while data:
            line, data = data.split(b"\n", 1)
            name, equals, value = line.partition(b"=")
            if not equals:
                size = int.from_bytes(data[:8], "little")
                value, data = data[8 : 8 + size], data[9 + size :]
            fields[name.decode()] = value.decode()
        return fields


@pytest.fixture
def journald(tmp_path, monkeypatch, capfd):
    to_journal(monkeypatch)
    journald = Journald(tmp_path / "journal")
    yield journald
    journald.sock.close()


def test_lines_go_to_journald_with_fields_to_filter_by(package, journald, tmp_path, capfd):
    start_logging(journal=str(tmp_path / "journal"))
    log = logging.getLogger("bms_gateway.engine")
    log.log(NOTICE, "core of cell %d is hot", 3, extra={"code": "core", "string": "string_2", "cell": 3})
    log.debug("unseen")
    first = journald.entry()
    assert (
        first.items()
        >= {
            "MESSAGE": "core of cell 3 is hot",
            "PRIORITY": "5",
            "SYSLOG_IDENTIFIER": "bms-gateway",
            "LOGGER": "bms_gateway.engine",
            "CODE_FILE": __file__,
            "CODE_FUNC": "test_lines_go_to_journald_with_fields_to_filter_by",
            "BMS_CODE": "core",
            "BMS_STRING": "string_2",
            "BMS_CELL": "3",
        }.items()
    )
    log.warning("no string, no cell\nand =two= lines \udcff")
    second = journald.entry()
    assert second["MESSAGE"] == "no string, no cell\nand =two= lines \\udcff"
    assert not {"BMS_STRING", "BMS_CELL", "BMS_CODE"} & set(second)
    try:
        raise ZeroDivisionError("deep")
    except ZeroDivisionError:
        log.exception("a bug")
    assert "ZeroDivisionError: deep" in journald.entry()["MESSAGE"]
    assert capfd.readouterr().err == ""


def test_a_busy_journald_costs_lines_that_are_counted_and_no_time(package, journald, tmp_path):
    handler = start_logging(journal=str(tmp_path / "journal"))
    handler.filters.clear()
    for k in range(2_000):  # nobody reads: the socket's queue fills
        logging.getLogger("bms_gateway.engine").warning("line %d", k)
    assert handler.lost > 0
    assert journald.entry()["MESSAGE"] == "line 0"


def test_without_its_socket_lines_reach_journald_by_standard_error(package, tmp_path, monkeypatch, capfd):
    to_journal(monkeypatch)
    start_logging(journal=str(tmp_path / "absent"))
    logging.getLogger("bms_gateway.engine").log(NOTICE, "core of cell %d is hot", 3)
    assert capfd.readouterr().err == "<5>core of cell 3 is hot\n"


@pytest.mark.parametrize("stream", [None, "1:2"])
def test_elsewhere_lines_are_readable_even_below_a_service_of_another(package, stream, monkeypatch, capfd):
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    if stream:  # inherited from a service whose standard error is not ours
        monkeypatch.setenv("JOURNAL_STREAM", stream)
    start_logging()
    logging.getLogger("bms_gateway.engine").log(NOTICE, "core of cell %d is hot", 3)
    logging.getLogger("bms_gateway.engine").debug("unseen")
    err = capfd.readouterr().err
    assert "NOTICE  core of cell 3 is hot\n" in err
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
