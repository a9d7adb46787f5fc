"""`replay` hands the log to the bus in order and says what it did."""

import errno
import json

import numpy as np
import pytest

from bms_gateway.bus import replay as bus_replay
from bms_gateway.bus.logfile import read_log, write_log
from bms_gateway.cli.main import main
from bms_gateway.frames.batch import FrameBatch


class Recorder:
    """In place of an interface."""

    def __init__(self, channel):
        self.channel, self.parts, self.closed = channel, [], False
        Recorder.last = self

    def send(self, frames):
        self.parts.append(frames)

    def close(self):
        self.closed = True


@pytest.fixture
def log(tmp_path):
    n = 300
    rng = np.random.default_rng(0)
    frames = FrameBatch(
        np.arange(n, dtype=np.int64) * 1_000_000 + 5_000_000_000,
        rng.integers(0, 0x7FF, n).astype(np.uint32),
        np.full(n, 8, np.uint8),
        rng.integers(0, 255, (n, 8)).astype(np.uint8),
    )
    write_log(tmp_path / "a.log", [frames])
    return tmp_path / "a.log"


@pytest.mark.parametrize("speed", ["max", "1", "10"])
def test_all_frames_arrive_in_order_and_the_result_is_told(log, monkeypatch, capsys, speed):
    monkeypatch.setattr(bus_replay, "SocketCanSender", Recorder)
    assert main(["replay", str(log), "--to", "vcan0", "--speed", speed, "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["frames"], told["to"]) == (300, "vcan0")
    assert told["log_s"] == pytest.approx(0.299)
    sent, wanted = FrameBatch.concat(Recorder.last.parts), FrameBatch.concat(list(read_log(log)))
    assert np.array_equal(sent.can_id, wanted.can_id)
    assert np.array_equal(sent.data, wanted.data)
    assert Recorder.last.closed


def test_a_broken_line_is_mentioned_not_fatal(log, monkeypatch, capsys):
    monkeypatch.setattr(bus_replay, "SocketCanSender", Recorder)
    lines = log.read_text().splitlines()
    log.write_text("\n".join([*lines[:3], "no frame at all", *lines[3:]]) + "\n")
    assert main(["replay", str(log), "--to", "vcan0", "--speed", "max"]) == 0
    out, err = capsys.readouterr()
    assert "300 frames" in out
    assert "1 damaged lines skipped, the first is line 4" in err


def test_frames_that_are_not_sent_are_mentioned(log, monkeypatch, capsys):
    monkeypatch.setattr(bus_replay, "SocketCanSender", Recorder)
    log.write_text(log.read_text() + "(9.000000) can0 123#R\n")
    assert main(["replay", str(log), "--to", "vcan0", "--speed", "max"]) == 0
    assert "1 remote and 0 error frames skipped" in capsys.readouterr().err


def test_a_missing_log_or_interface_is_one_line(tmp_path, log, monkeypatch, capsys):
    assert main(["replay", str(log), "--to", "no_such_can"]) == 2
    assert "no_such_can" in capsys.readouterr().err
    monkeypatch.setattr(bus_replay, "SocketCanSender", Recorder)
    assert main(["replay", str(tmp_path / "b.log"), "--to", "vcan0"]) == 2
    assert "no such log" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "says"),
    [(OSError(errno.EAFNOSUPPORT, "x"), "this system has no SocketCAN"), (OSError(errno.ENODEV, "x"), "sudo ip link")],
)
def test_advice_fits_what_the_system_lacks(log, monkeypatch, capsys, error, says):
    def refuse(*_):
        raise error

    monkeypatch.setattr(bus_replay.socket, "socket", refuse)
    assert main(["replay", str(log), "--to", "vcan0"]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1


def test_the_log_is_looked_at_before_the_interface(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bus_replay, "SocketCanSender", None)
    (tmp_path / "a.log").write_text("\n")
    assert main(["replay", str(tmp_path / "a.log"), "--to", "vcan0"]) == 2
    assert "a.log: no data frames in it" in capsys.readouterr().err
    (tmp_path / "a.log").write_text("nothing like it\n")
    assert main(["replay", str(tmp_path / "a.log"), "--to", "vcan0"]) == 2
    assert "line 1: not a .log log" in capsys.readouterr().err
