"""Stamps of any kind: memory follows the frames and not the time, and what is told is as from the same drive."""

import gzip
import re
import warnings

import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log
from bms_gateway.cli.main import main
from bms_gateway.config import shipped
from bms_gateway.errors import DataError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.setup import settle
from bms_gateway.setup.intervals import edges_of, silences
from bms_gateway.setup.propose import propose
from bms_gateway.setup.resting import surroundings
from bms_gateway.setup.vehicle_logs import read_traffic
from bms_gateway.setup.without_dbc import guess
from tests.setup.parked_vehicle import parked
from tests.setup.vehicles import write

DBC = shipped("deploy/worked/vehicle.dbc")
BEGIN_S = 1.7e9
YEAR_S = 365 * 86_400.0


@pytest.fixture(scope="module")
def drive():
    """Times of a drive of a quarter of an hour, s, and what follows each in the log."""
    lines = gzip.decompress(shipped("deploy/worked/drive.log.gz").read_bytes()).decode().splitlines()
    cut = [line.split(" ", 1) for line in lines]
    return np.array([float(t.strip("()")) for t, _ in cut]), [rest for _, rest in cut]


def log_of(times, rests, path):
    path.write_text("".join(f"({t:.6f}) {rest}\n" for t, rest in zip(times, rests, strict=True)))
    return path


def found(log):
    p = propose(read_traffic([log], [DBC]))
    told = [(s.role, s.path, s.written, s.sure) for s in p.signals]
    guesses = guess(read_traffic([log], []).frames)
    return told, p.series_cells, [(g.role, g.field.place, g.scale, g.offset) for g in guesses]


@pytest.mark.parametrize(
    ("moved", "told"),
    [
        (lambda t: np.where(np.arange(len(t)) < 1000, 10.0 + t, 1_732_600_000.0 + t), "no frame for 55 years"),
        (lambda t: BEGIN_S + t + 6 * 3600.0 * (np.arange(len(t)) > 5400), "no frame for 6 h"),
        (lambda t: BEGIN_S + t + 6 * YEAR_S * (np.arange(len(t)) > 5400), "no frame for 5.9[0-9] years|no frame for 6"),
        (lambda t: BEGIN_S + t - 6 * YEAR_S * (np.arange(len(t)) > 5400), "clock set back 1×"),
        (lambda t: BEGIN_S + t + 6 * YEAR_S * (np.arange(len(t)) == 5400), "1 frames dropped"),
    ],
    ids=["from 1970", "6 hours", "6 years", "back", "one stamp"],
)
@pytest.mark.plain_cases(2)
def test_a_clock_that_was_set_changes_nothing_but_is_told(moved, told, drive, tmp_path):
    plain = found(log_of(BEGIN_S + drive[0], drive[1], tmp_path / "plain.log"))
    log = log_of(moved(drive[0]), drive[1], tmp_path / "moved.log")
    signals, cells, guesses = found(log)
    assert (signals, cells) == plain[:2]
    assert [g[0] for g in guesses] == [g[0] for g in plain[2]]
    assert guesses[0] == plain[2][0]
    remarks = [r for r in read_traffic([log], []).remarks if "moved.log" in r]
    assert len(remarks) == 1
    assert re.search(told, remarks[0])


def test_intervals_are_those_with_frames():
    times = np.array([0, 100, 10**9, 55 * 31_557_600 * 10**9])
    assert len(edges_of(times, 0.5, 0.5)) < 5 * len(times)
    even = np.arange(0, 60 * 10**9, 10**8)
    assert edges_of(even, 0.5, 0.5).tolist() == np.arange(0.0, even[-1] * 1e-9 + 0.5, 0.5).tolist()


def test_a_log_that_is_always_slow_has_no_silence():
    assert not silences(np.arange(100) * 61 * 10**9).any()


def test_a_silence_is_no_rest(tmp_path):
    """The car rests for less than three minutes; that its clock was set in between makes no longer rest of it."""
    log, dbc = write(parked(rest=100.0), tmp_path)
    times, rests = zip(*(line.split(" ", 1) for line in log.read_text().splitlines()), strict=True)
    t = np.array([float(x.strip("()")) for x in times])
    log_of(np.where(t - t[0] > 50.0, t + 3600.0, t), rests, log)
    assert not surroundings(propose(read_traffic([log], [dbc])), 1).rest


def frames_of(drive, times):
    """The first frames of the drive at other times, s."""
    rows = [rest.split()[1].split("#") for rest in drive[1][: len(times)]]
    data = np.array([list(bytes.fromhex(d.ljust(16, "0"))) for _, d in rows], np.uint8)
    ids = np.array([int(i, 16) for i, _ in rows], np.uint32)
    stamps = np.rint(np.asarray(times) * 1e9).astype(np.int64)
    return FrameBatch(stamps, ids, np.full(len(times), 8, np.uint8), data)


@pytest.mark.parametrize(
    "times",
    [
        np.zeros(10_800),
        np.zeros(8),
        np.arange(10_800) * 1e-6,
        np.arange(100) * 1e-6,
        np.repeat(np.arange(540) * 1.0, 20),
        np.repeat([0.0, 1e-6, 1.7e9], 3600),
    ],
    ids=["one time", "eight frames", "microseconds", "few microseconds", "bursts", "three times"],
)
def test_guesses_stand_all_times(times, drive):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        guess(frames_of(drive, times))


def test_an_identifier_all_of_whose_frames_stand_at_one_time_is_no_signal(drive):
    """Its bits move like a current of the drive; it has no rate."""
    times = drive[0].copy()
    other = frames_of(drive, np.full(len(times), times[-1] / 2))
    both = FrameBatch.concat([frames_of(drive, times), FrameBatch(other.time_ns, other.can_id + 1, *_rest(other))])
    order = np.argsort(both.time_ns, kind="stable")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        guesses = guess(FrameBatch(both.time_ns[order], both.can_id[order], both.length[order], both.data[order]))
    assert guesses
    assert {g.field.can_id for g in guesses} <= {0x121, 0x122, 0x191}


def _rest(f):
    return f.length, f.data


def test_slow_frames_alone_need_no_grid():
    """Seven weeks of one message every three seconds: nothing in it is fast enough for a current."""
    n = 3000
    level = (3600 + 50 * np.sin(np.arange(n) / 9)).astype(int)
    data = np.zeros((n, 8), np.uint8)
    data[:, 0], data[:, 1] = level >> 8, level & 255
    times = np.arange(n, dtype=np.int64) * 1_500 * 10**9
    assert guess(FrameBatch(times, np.full(n, 0x123, np.uint32), np.full(n, 8, np.uint8), data)) == []


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ("", "no data frames"),
        ("(1.0) can0 121#0011\n", "1 frame at one time show"),
        ("(1.0) can0 121#0011\n(1.001) can0 191#0022\n", "2 frames within 0.001 s show no movement"),
        ("(1.0) can0 121#0011\n" * 500, "500 frames at one time"),
        (
            "".join(f"({k / 10:.6f}) can0 121#0011\n" for k in range(600)),
            "no bit of 600 frames of 1 identifier changes",
        ),
        (
            "".join(f"({100 - k / 10:.6f}) can0 121#00{k % 99:02}\n" for k in range(600)),
            "its time stamps run backwards",
        ),
    ],
    ids=["empty", "one", "two", "one time", "constant", "backwards"],
)
@pytest.mark.parametrize("dbc", [[], ["--dbc", str(DBC)]], ids=["no dbc", "dbc"])
def test_a_useless_log_is_refused_in_one_line(lines, told, dbc, tmp_path, capsys):
    log = tmp_path / "a.log"
    log.write_text(lines)
    assert main(["init", str(log), *dbc, "--out", str(tmp_path / "out"), "--yes"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert str(log) in err
    assert told in err
    assert not (tmp_path / "out").exists()


def test_of_a_shuffled_log_no_more_than_an_hour_is_estimated(drive, tmp_path, monkeypatch):
    """Each step back of a stamp moves all that follow: weeks of ticks, of which `init` went through each."""
    assert settle.MOST_TICKS <= 3600
    monkeypatch.setattr(settle, "MOST_TICKS", 100)
    order = np.random.default_rng(1).permutation(len(drive[0]))
    log = log_of(BEGIN_S + drive[0][order], [drive[1][k] for k in order], tmp_path / "shuffled.log")
    traffic = read_traffic([log], [DBC])
    assert traffic.frames.time_ns[-1] - traffic.frames.time_ns[0] > 100_000 * 10**9
    found = settle.settle(propose(traffic), traffic, tmp_path / "v", cell=None, logs=[log])
    assert found.cores.last.time_ns - traffic.frames.time_ns[0] < 10_000 * 10**9
    assert any(f"are of the first {100 / 3600:g} h of the log" in text for text in found.notes)


def test_logs_that_last_for_centuries_together_are_refused(tmp_path):
    logs = []
    for k in range(6):
        path = tmp_path / f"{k}.log"
        logs.append(log_of([1.0, 2.0, 1.7e9, 1.7e9 + 1], [f"can0 121#0{j}" for j in range(4)], path))
    with pytest.raises(DataError, match="last for centuries"):
        read_traffic(logs, [])
    assert len(read_traffic(logs[:5], []).frames) == sum(len(b) for log in logs[:5] for b in read_log(log))
