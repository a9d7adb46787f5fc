"""The record of recent signals: exact, bounded, and whatever happens to its files no garbage and no lost block."""

import errno
import json
import os
import random
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bms_gateway.engine import Decoded, Engine
from bms_gateway.errors import DataError, StateError
from bms_gateway.records.recent_signals import Stretch, write_recent
from bms_gateway.store.recent import Recent, read_recent
from bms_gateway.store.rows import excerpt
from tests.engine.packs import database, plan
from tests.store.disk import Recorder, build
from tests.store.ring import recorded

FRESH = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=80)


def samples(folder, problems=None):
    """All samples of the ring as (input, time_us, value)."""
    found = []
    for block in read_recent(folder, [] if problems is None else problems):
        for i, (time, value) in block.samples.items():
            found += zip([i] * len(time), time.tolist(), value.tolist(), strict=True)
    return found


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ring") / "recent"
    return folder, recorded(folder)


def test_every_sample_comes_back_with_its_time_and_value(ring):
    folder, events = ring
    wanted = [
        (i, t // 1000, float(np.float32(v)))
        for e in events
        for i, t, v in zip(e.input.tolist(), e.sample_ns.tolist(), e.value.tolist(), strict=True)
    ]
    assert len(wanted) > 5000
    assert sorted(samples(folder)) == sorted(wanted)


def test_nothing_is_written_before_the_flush_and_then_in_one_call(tmp_path):
    recorder = Recorder(tmp_path)
    with recorder.watching():
        recorded(tmp_path / "recent", seconds=61, every=1000)
    assert recorder.calls.count("write") == 1


def test_the_ring_stays_within_its_room_and_keeps_the_newest(tmp_path):
    folder = tmp_path / "recent"
    events = []
    for k in range(6):
        events = recorded(folder, seconds=150, every=2, megabytes=0.1, shift_ns=k * 150 * 10**9, seed=k)
        assert sum(p.stat().st_size for p in folder.iterdir()) <= 100_000
    found = list(read_recent(folder, []))
    assert found[-1].last_us == int(events[-1].sample_ns.max()) // 1000
    times = [b.first_us for b in found]
    assert times == sorted(times)
    assert len(found) > 10
    assert found[0].place[0] > 1  # the oldest segments went


@FRESH
@given(st.data())
def test_damage_costs_the_blocks_that_it_hits_and_no_other(tmp_path_factory, ring, data):
    folder, _ = ring
    (segment,) = folder.iterdir()
    raw = bytearray(segment.read_bytes())
    blocks = list(read_recent(folder, []))
    starts = [b.place[1] for b in blocks] + [len(raw)]
    at = data.draw(st.integers(0, len(raw) - 1))
    length = data.draw(st.integers(1, 300))
    kind = data.draw(st.sampled_from(["flip", "zero", "delete", "insert", "cut", "splice"]))
    end = min(at + length, len(raw))
    if kind == "flip":
        raw[at] ^= data.draw(st.integers(1, 255))
        end = at + 1
    elif kind == "zero":
        raw[at:end] = bytes(end - at)
    elif kind == "delete":
        del raw[at:end]
    elif kind == "insert":
        raw[at:at] = data.draw(st.binary(min_size=1, max_size=300))
        end = at + 1
    elif kind == "splice":
        raw[at:end] = raw[: end - at]
    else:
        del raw[at:]
        end = starts[-1]
    spoilt = tmp_path_factory.mktemp("spoilt")
    (spoilt / segment.name).write_bytes(raw)
    problems: list[StateError] = []
    got = list(read_recent(spoilt, problems))
    whole = [b for b, a, z in zip(blocks, starts, starts[1:], strict=False) if z <= at or a >= end]
    kept = [b.first_us for b in got]
    assert [t for t in kept if t in {b.first_us for b in blocks}] == kept
    assert set(kept) >= {b.first_us for b in whole}
    assert all("\n" not in str(p) for p in problems)


@FRESH
@given(st.binary(max_size=300), st.sampled_from([b"", b"bmsrec1\n", b"bmsrec1\n\x05\0\0\0"]))
def test_any_bytes_are_left_out_in_silence_or_with_a_line(tmp_path_factory, tail, lead):
    folder = tmp_path_factory.mktemp("any")
    (folder / "recent-00000001").write_bytes(lead + tail)
    problems: list[StateError] = []
    assert list(read_recent(folder, problems)) == []
    assert len(problems) <= 1


def test_files_of_others_and_torn_tails(tmp_path, ring):
    (segment,) = ring[0].iterdir()
    raw = segment.read_bytes()
    folder = tmp_path / "recent"
    folder.mkdir()
    (folder / "recent-00000001").write_bytes(raw[:-5])  # power failed
    (folder / "recent-00000002").write_bytes(b"SQLite format 3\0" * 10)
    (folder / "recent-00000003").mkdir()
    (folder / "notes.txt").write_text("not of the ring")
    (folder / "recent-00000004").write_bytes(raw)
    problems: list[StateError] = []
    n = len(list(read_recent(ring[0], [])))
    assert len(list(read_recent(folder, problems))) == 2 * n - 1
    assert len(problems) == 2
    assert "recent-00000002: 160 of 160 bytes" in str(problems[0])
    assert "recent-00000003: is no file" in str(problems[1])


def test_a_torn_tail_is_written_on_after(tmp_path):
    folder = tmp_path / "recent"
    recorded(folder, seconds=130, strings=1)
    (segment,) = folder.iterdir()
    segment.write_bytes(segment.read_bytes()[:-7])
    before = len(list(read_recent(folder, [])))
    recorded(folder, seconds=65, strings=1, shift_ns=500 * 10**9)
    assert len(list(folder.iterdir())) == 1
    problems: list[StateError] = []
    assert len(list(read_recent(folder, problems))) > before
    assert "damaged" in str(problems[0])


def test_every_cut_leaves_all_blocks_that_were_said_to_be_written(tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    recorder = Recorder(disk)
    rng = random.Random(1)
    with recorder.watching():
        events = recorded(disk / "recent", seconds=240, every=60, strings=1)
    wanted = sorted((t // 1000) for e in events for t in e.sample_ns.tolist())
    done, points = 0, 0
    calls = [c for c, _ in recorder.after]
    flushed = [k for k, c in enumerate(calls) if c == "fsync"]
    for k, (_, state) in enumerate(recorder.after):
        # a block is safe once its file, and at the first one its name, is synced
        done = sum(1 for f in flushed if f <= k) - 2 if k >= flushed[2] else 0
        for cut in state.states(sector=512):
            points += 1
            folder = tmp_path / f"cut{points}"
            build(cut, folder)
            problems: list[StateError] = []
            blocks = list(read_recent(folder / "recent", problems))
            assert len(blocks) >= done
            got = [t for b in blocks for time, _ in b.samples.values() for t in time.tolist()]
            assert set(got) <= set(wanted)
            if rng.random() < 0.02:  # and it is written on after any of them
                before = len(blocks)
                recorded(folder / "recent", seconds=61, strings=1, shift_ns=900 * 10**9)
                assert len(list(read_recent(folder / "recent", []))) > before
    print(f"{points} crash points")
    assert points > 50


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO, errno.EROFS])
def test_a_disk_that_refuses_costs_what_was_to_be_written_and_nothing_else(tmp_path, monkeypatch, code):
    folder = tmp_path / "recent"
    events = recorded(folder, seconds=130, strings=1)
    before = samples(folder)
    real = os.write

    def write(handle, data):
        if len(data) > 100:
            return real(handle, memoryview(data)[:100])
        raise OSError(code, os.strerror(code))

    with monkeypatch.context() as m:
        m.setattr(os, "write", write)
        ring = Recent(folder, 1.0)
        ring.add(events[-1], Stub())
        problem = ring.flush()
    assert os.strerror(code) in str(problem)
    assert ring.flush() is None
    assert samples(folder) == before


class Stub:
    """An engine without strings."""

    wires: tuple = ()

    class plan:
        strings: tuple = ()


def test_an_excerpt_counts_from_the_newest_sample(ring):
    folder, events = ring
    found = excerpt(folder, 60.0)
    rows = list(found.rows("string_1"))
    last = max(int(e.sample_ns.max()) for e in events) // 1000
    times = [float(r[0]) for r in rows]
    assert times[0] >= last * 1e-6 - 60.0
    assert times[0] < last * 1e-6 - 59.0
    assert times == sorted(set(times))
    assert found.columns["string_1"][:2] == ["current_A", "coolant_inlet_C"]


def test_after_the_clock_went_back_only_what_came_later_is_one_table(tmp_path):
    folder = tmp_path / "recent"
    recorded(folder, seconds=130)
    later = recorded(folder, seconds=130, shift_ns=-1000 * 10**9)
    found = excerpt(folder, 7200.0)
    assert found.turned_back
    times = [float(r[0]) for r in found.rows("string_2")]
    assert times == sorted(set(times))
    assert times[-1] < max(int(e.sample_ns.max()) for e in later) * 1e-9 + 1e-3
    assert times[0] >= min(int(e.sample_ns.min()) for e in later if len(e.sample_ns)) * 1e-9 - 1e-3


def test_an_empty_ring_is_one_line(tmp_path):
    with pytest.raises(DataError, match="no recent signals are recorded there"):
        excerpt(tmp_path / "nowhere", 60.0)


def test_a_full_bus_of_wanted_samples_waits_in_half_its_bytes_and_is_packed_little_by_little(tmp_path):
    """A minute of a full bus on which every frame is wanted: some million samples."""
    rng, engine = np.random.default_rng(0), Engine(plan(1), database())
    each, ticks, second = 17_000, 60, 10**9
    ring, begun = Recent(tmp_path / "recent", 64.0), 1_700_000_000 * second

    def tick(k):
        at = np.sort(rng.integers(0, second, each)) + begun + (k - 1) * second
        return Decoded(begun + k * second, at, rng.integers(0, 5, each), rng.normal(25.0, 1.0, each))

    tracemalloc.start()
    try:
        for k in range(ticks):
            ring.add(tick(k), engine)
        waiting, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        assert ring.flush() is None
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert waiting < 13.0 * each * ticks  # of 24 as they came
    assert most - waiting < 6e6
    assert len(samples(tmp_path / "recent")) == each * ticks


BLOCK = {"start_us": 1_700_000_000_000_000, "inputs": [0], "counts": [1], "strings": {"s": {"current_A": 0}}}


def laid(folder, line):
    """Write a ring of one block with a sound check sum, as anybody can who may write there."""
    text = line if isinstance(line, bytes) else json.dumps(line).encode()
    content = zlib.compress(text + b"\n" + bytes(8), 6)
    size = struct.pack("<I", len(content))
    folder.mkdir()
    check = struct.pack("<I", zlib.crc32(content, zlib.crc32(size)))
    (folder / "recent-00000001").write_bytes(b"bmsrec1\n" + size + check + content)
    return folder


def test_the_sound_one_of_these_is_read(tmp_path):
    assert samples(laid(tmp_path / "recent", BLOCK)) == [(0, BLOCK["start_us"], 0.0)]


@pytest.mark.parametrize(
    "strings",
    [
        {"s": {"current_A": [1]}},
        {"s": {"current_A": {"a": 1}}},
        {"s": {"current_A": "x"}},
        {"s": {"current_A": None}},
        {"s": {"current_A": True}},
        {"s": {"soc": float("nan")}},
        {"s": [[1, 0]]},
        {"s": {"a,b\n=1": 0}},
        {"s/../../etc": {"current_A": 0}},
        {"": {"current_A": 0}},
        {"s" * 201: {"current_A": 0}},
        [["s", {"current_A": 0}]],
    ],
)
def test_a_block_whose_layout_is_none_is_left_out(tmp_path, strings):
    """Root reads what the service's user may have written: each of these was a traceback, or went into the table."""
    problems = []
    assert samples(laid(tmp_path / "recent", {**BLOCK, "strings": strings}), problems) == []
    assert "are damaged or not of this program" in str(problems[0])


def test_strings_without_a_sample_are_told(tmp_path):
    ring = laid(tmp_path / "recent", {**BLOCK, "inputs": [1]})
    with pytest.raises(DataError, match="no signal of any string was recorded in this time"):
        write_recent(tmp_path / "a.csv", ring.parent, Stretch(60.0), None, "export", print)


@pytest.mark.parametrize(
    ("item", "count"),
    [(b"[]", 5 << 20), (b"[]", 21 << 20), (b"1", 7 << 20)],
)
def test_a_block_of_some_kilobytes_does_not_fill_the_memory(tmp_path, item, count):
    """64 kB of empty lists took 1.7 GB and 22 s."""
    ring, problems = laid(tmp_path / "recent", b'{"a":[' + (item + b",") * count + item + b"]}"), []
    assert (ring / "recent-00000001").stat().st_size < 100_000
    tracemalloc.start()
    assert samples(ring, problems) == []
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 64 << 20
    assert len(problems) == 1
