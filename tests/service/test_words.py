"""What the service says of itself, word by word: notices, lines of the journal, the line and the object of now."""

import logging
import os
import socket
from math import inf, nan
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.bus.port import Link
from bms_gateway.engine.events import Level
from bms_gateway.service import journal, memory, notify
from bms_gateway.service.journal import FREE, NOTICE, JournalHandler, Throttle, start_logging
from bms_gateway.service.lines import write
from bms_gateway.service.summary import estimates, status
from bms_gateway.service.tally import LATENESS_S, Histogram, Tally


def record(text="a", *, level=logging.WARNING, line=1, **about):
    made = logging.LogRecord("bms_gateway.x", level, "x.py", line, text, None, None, func="f")
    made.__dict__.update(about)
    return made


def test_the_bounds():
    assert (FREE, journal.WINDOW_S, journal.MOST_BYTES, NOTICE) == (5, 60.0, 16_384, 25)
    assert LATENESS_S == (0.005, 0.01, 0.02, 0.05, 0.1, 0.5, 1.0, 5.0)
    assert memory.FIRST_TO_GO == "1000"  # the most that the kernel takes


# journal


def test_lines_of_one_kind_are_cut_per_minute_and_told_how_many_once():
    now = [100.0]
    throttle = Throttle(lambda: now[0])

    def said(count, **about):
        lines = [record("%s %s", **about) for _ in range(count)]
        for line in lines:
            line.args = ("a", "b")
        return [line.getMessage() for line in lines if throttle.filter(line)]

    assert said(FREE) == ["a b"] * FREE
    assert (said(1), throttle.held) == ([], 1)
    now[0] += 59.9
    assert (said(2), throttle.held) == ([], 3)
    now[0] += 0.1
    assert said(FREE + 1) == ["a b (3 more like this in between)"] + ["a b"] * (FREE - 1)
    now[0] += 60.0
    assert said(FREE) == ["a b (1 more like this in between)"] + ["a b"] * (FREE - 1)
    now[0] += 60.0
    assert said(1) == ["a b"]  # nothing was held back
    assert throttle.held == 4


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ({"kind": "k", "code": "a"}, {"kind": "k", "code": "b"}, True),
        ({"code": "a"}, {"code": "a", "line": 2}, True),
        ({"code": "a"}, {"code": "b"}, False),
        ({}, {"line": 2}, False),
        ({}, {}, True),
    ],
)
def test_what_is_of_one_kind(one, other, same):
    throttle = Throttle(lambda: 0.0)
    for _ in range(FREE):
        throttle.filter(record(**one))
    assert throttle.filter(record(**other)) is not same


class Others(logging.Handler):
    def __init__(self):
        super().__init__()
        self.took = []

    def emit(self, record):
        self.took.append(record.getMessage())


@pytest.fixture
def journald(tmp_path):
    """A handler, what takes its lines otherwise, and the socket of journald."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind(str(tmp_path / "socket"))
        sock.settimeout(30.0)
        others = Others()
        handler = JournalHandler(str(tmp_path / "socket"), others)
        yield handler, others, sock
        handler.close()


@pytest.mark.parametrize(
    ("level", "priority"),
    [
        (logging.DEBUG, 7),
        (logging.INFO, 6),
        (NOTICE, 5),
        (logging.WARNING, 4),
        (logging.ERROR, 3),
        (logging.CRITICAL, 2),
        (33, 6),
    ],
)
def test_an_entry_has_the_priority_of_its_level_and_only_the_fields_that_it_has(journald, level, priority):
    handler, others, sock = journald
    handler.emit(record("x", level=level, line=7, cell=0))
    assert sock.recv(1 << 20) == (
        b"MESSAGE=x\nPRIORITY=%d\nSYSLOG_IDENTIFIER=bms-gateway\nLOGGER=bms_gateway.x\nCODE_FILE=x.py\nCODE_LINE=7\n"
        b"CODE_FUNC=f\nBMS_CELL=0\n" % priority
    )
    assert (others.took, handler.lost) == ([], 0)


def test_a_message_is_cut_to_what_a_datagram_holds_and_one_of_several_lines_goes_by_its_length(journald):
    handler, _, sock = journald
    handler.emit(record("y" * 16_385))
    assert sock.recv(1 << 20).startswith(b"MESSAGE=" + b"y" * 16_384 + b"\n")
    handler.emit(record("a\nbc"))
    assert sock.recv(1 << 20).startswith(b"MESSAGE\n\4\0\0\0\0\0\0\0a\nbc\nPRIORITY=")


def test_a_line_that_journald_does_not_take_goes_elsewhere_unless_it_is_busy(journald, monkeypatch):
    handler, others, sock = journald

    def fails(error):
        def sendto(*_):
            raise error

        monkeypatch.setattr(handler, "sock", SimpleNamespace(sendto=sendto, close=lambda: None))
        handler.emit(record("a"))
        return others.took, handler.lost

    handler.sock.close()
    assert fails(BlockingIOError()) == ([], 1)
    assert fails(OSError(90, "Message too long")) == (["a"], 1)
    assert sock.fileno() > 0


def test_the_socket_does_not_block_and_is_let_go(journald):
    handler, _, _ = journald
    ours = handler.sock
    assert not ours.getblocking()
    assert not os.get_inheritable(ours.fileno())
    handler.close()
    assert ours.fileno() == -1


def test_lines_go_to_one_place_only_cut_and_from_the_level_that_is_asked_for(package, monkeypatch):
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    handler = start_logging(logging.WARNING)
    handler = start_logging(logging.DEBUG)
    assert (package.handlers, package.level, package.propagate) == ([handler], logging.DEBUG, False)
    assert [type(f) for f in handler.filters] == [Throttle]
    assert logging.getLevelName(NOTICE) == "NOTICE"


def test_a_line_for_people_has_its_time_and_level_and_one_for_journald_its_priority(package, monkeypatch, capfd):
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    text = start_logging().format(record("x", level=NOTICE))
    assert text[2] == text[5] == ":"
    assert text[8:] == " NOTICE  x"
    stat = os.fstat(2)
    monkeypatch.setenv("JOURNAL_STREAM", f"{stat.st_dev}:{stat.st_ino}")
    handler = start_logging(journal="/nowhere")
    assert isinstance(handler, JournalHandler)
    handler.emit(record("x", level=33))
    assert capfd.readouterr().err == "<6>x\n"


def test_a_closed_standard_error_leads_nowhere(monkeypatch):
    for stderr in (None, SimpleNamespace(fileno=lambda: (_ for _ in ()).throw(ValueError("closed")))):
        monkeypatch.setattr(journal.sys, "stderr", stderr)
        assert not journal.leads_to_journal()


@pytest.mark.parametrize(
    ("level", "number"), [(Level.WARNING, logging.WARNING), (Level.NOTICE, NOTICE), (Level.INFO, logging.INFO)]
)
def test_a_notice_is_a_line_of_its_level_with_what_it_is_about(caplog, level, number):
    log = logging.getLogger("bms_gateway.test")
    caplog.set_level(logging.DEBUG, "bms_gateway.test")
    write(log, SimpleNamespace(level=level, text="50 % hot", code="c", string="s1", cell=4))
    write(log, SimpleNamespace(level=level, text="all is well", code="d", string=None, cell=None))
    assert caplog.messages == ["50 % hot [s1]", "all is well"]
    assert [(r.levelno, r.code, r.string, r.cell) for r in caplog.records] == [
        (number, "c", "s1", 4),
        (number, "d", None, None),
    ]


# systemd


def test_the_reload_is_told_with_the_microseconds_of_the_kernels_clock(monkeypatch):
    told = []
    monkeypatch.setattr(notify, "notify", lambda *lines: told.append(lines) or True)
    monkeypatch.setattr(notify.time, "monotonic_ns", lambda: 1_234_567_899)
    assert notify.reloading()
    assert told == [("RELOADING=1", "MONOTONIC_USEC=1234567")]


@pytest.mark.parametrize(
    ("usec", "seconds"), [("1", 1e-6), ("3000000", 3.0), ("0", None), ("-1", None), ("x", None), ("1.5", None)]
)
def test_the_watchdog_wants_a_sign_of_life_within_what_systemd_says(monkeypatch, usec, seconds):
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    monkeypatch.setenv("WATCHDOG_USEC", usec)
    assert notify.watchdog_s() == seconds
    monkeypatch.delenv("WATCHDOG_USEC")
    assert notify.watchdog_s() is None


def test_a_busy_systemd_stops_nobody(tmp_path, monkeypatch):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind(str(tmp_path / "n"))
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "n"))
        answers = [notify.notify("WATCHDOG=1") for _ in range(2_000)]  # nobody reads
    assert answers[0]
    assert not answers[-1]


def test_a_child_asks_to_be_the_first_to_go_and_does_without_where_it_may_not(monkeypatch):
    written = []
    monkeypatch.setattr(Path, "write_text", lambda self, text: written.append((str(self), text)))
    memory.first_to_go()
    assert written == [("/proc/self/oom_score_adj", "1000")]

    def forbidden(*_):
        raise PermissionError(13, "x")

    monkeypatch.setattr(Path, "write_text", forbidden)
    memory.first_to_go()


# counters


def test_a_value_on_a_bound_counts_below_it():
    counted = Histogram((1.0, 2.0))
    for value in (0.5, 1.0, 2.0, 2.5, 9.0):
        counted.note(value)
    assert (counted.cumulative(), counted.total) == ([2, 3, 5], 15.0)


def test_a_tally_begins_with_nothing():
    tally = Tally()
    numbers = ("ticks", "wakes", "jobs", "jobs_late", "jobs_failed", "saves", "saves_failed", "reloads")
    assert {getattr(tally, name) for name in (*numbers, "reloads_refused")} == {0}
    assert (tally.lateness.total, set(tally.lateness.cumulative())) == (0.0, {0})


# the line and the object of now


def forecast(**other):
    centre = np.arange(12.0).reshape(4, 3) + 40.126
    made = {
        "hottest": 2,
        "first": 1,
        "load": -12.345,
        "centre": centre,
        "centre_sd": centre / 100.0,
        "limit_s": np.array([inf, 77.77, inf]),
        "discharge": np.array([300.04, 200.0, 100.0]),
        "charge": np.array([-30.06, -20.0, -10.0]),
    }
    return SimpleNamespace(**made | other)


def string(name, core, growth=nan, ahead=None, conditions=()):
    core = np.array(core)
    return SimpleNamespace(
        plan=SimpleNamespace(name=name),
        core=core,
        core_sd=core / 10.0,
        centre=core[::-1] + 5.0,
        centre_sd=core[::-1] / 20.0,
        forecast=ahead,
        health=SimpleNamespace(
            ageing=SimpleNamespace(growth=growth, growth_sd=growth / 4.0),
            conditions=lambda: [SimpleNamespace(code=c, level=level, cell=cell) for c, level, cell in conditions],
        ),
    )


S1 = string(
    "s1", [30.0, 41.256, 20.126], 0.123456, forecast(), [("ageing", 2, None), ("ageing", 3, 4), ("inlet", 1, None)]
)
S2 = string("s2", [10.0, 11.0, 60.0])
NONE = string("s3", [nan] * 3, ahead=forecast(hottest=None))


def now(*strings, link=Link.UP, deadline=1, raised=()):
    gateway = SimpleNamespace(port=SimpleNamespace(link=link))
    alerts = SimpleNamespace(line="OK", raised=raised, severity=SimpleNamespace(name="OK"))
    return gateway, SimpleNamespace(alerts=alerts), SimpleNamespace(strings=strings, next_deadline=lambda: deadline)


@pytest.mark.parametrize(
    ("told", "line"),
    [
        (now(S1, S2), "OK: hottest point 65.0 ± 3.0 °C, core 10.0 ± 1.0 °C (s2, cell 1)"),
        (now(S2, S1, NONE), "OK: hottest point 65.0 ± 3.0 °C, core 10.0 ± 1.0 °C (s2, cell 1)"),
        (now(NONE), "OK: no core temperature yet"),
        (now(S1, deadline=None), "OK: the bus is silent"),
        (now(S1, deadline=None, link=Link.DOWN), "OK: hottest point 46.3 ± 2.1 °C, core 41.3 ± 4.1 °C (s1, cell 2)"),
        (now(S1, raised=["x"]), "OK"),
    ],
)
def test_the_line_of_now(told, line):
    assert status(*told) == line


def test_the_object_of_now_is_rounded_and_none_where_nothing_is_known():
    found = estimates(*now(S1, NONE))
    assert (found["state"], found["bus"], found["awake"]) == ("OK", "up", True)
    assert not estimates(*now(deadline=None))["awake"]
    assert found["strings"] == {
        "s1": {
            "hottest_point_C": 46.26,
            "hottest_point_sd_K": 2.06,
            "hottest_point_cell": 2,
            "core_max_C": 41.26,
            "core_max_sd_K": 4.13,
            "core_max_cell": 2,
            "core_min_C": 20.13,
            "resistance_growth": 0.1235,
            "resistance_growth_sd": 0.0309,
            "forecast": {
                "cell": 3,
                "load_A": -12.3,
                "point_C": {"60": 45.13, "300": 48.13, "600": 51.13},
                "point_sd_K": {"60": 0.45, "300": 0.48, "600": 0.51},
                "limit_in_s": 77.8,
                "discharge_A": {"10": 300.0, "60": 200.0, "600": 100.0},
                "charge_A": {"10": -30.1, "60": -20.0, "600": -10.0},
            },
            "flags": {"ageing": 2, "inlet": 1},
        },
        "s3": {
            **dict.fromkeys(("hottest_point_C", "hottest_point_sd_K", "hottest_point_cell"), None),
            **dict.fromkeys(("core_max_C", "core_max_sd_K", "core_max_cell", "core_min_C"), None),
            **dict.fromkeys(("resistance_growth", "resistance_growth_sd", "forecast"), None),
            "flags": {},
        },
    }
    s4 = string("s4", [1.0], ahead=forecast(first=None))
    assert estimates(*now(s4))["strings"]["s4"]["forecast"]["limit_in_s"] is None
    assert estimates(*now(S2))["strings"]["s2"]["forecast"] is None
