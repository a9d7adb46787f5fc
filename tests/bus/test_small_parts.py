"""Small parts of the bus by their rules: kernel filters, what is received, a bus inside the process, whole files."""

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from bms_gateway.bus import filters
from bms_gateway.bus.access import LISTEN, Access
from bms_gateway.bus.filters import group_filters, join_filters
from bms_gateway.bus.in_process import MemoryBus
from bms_gateway.bus.port import GATHER_S, Counters, Link
from bms_gateway.whole import whole, whole_text
from tests.bus.frames import make, rows

EXTENDED, REMOTE = 1 << 31, 1 << 30


def passes(pairs, can_id):
    """What the kernel does, as can(7) says it."""
    return any(can_id & mask == wanted & mask for wanted, mask in pairs)


# filters


def test_the_bounds():
    assert (filters.LIMIT, filters.MOST_GROUPS, GATHER_S) == (512, 256, 0.01)


@pytest.mark.parametrize("count", [1, 511, 512])
def test_up_to_the_limit_every_identifier_has_its_own_filter(count):
    wanted = [3 * k for k in range(count // 2)] + [EXTENDED | 0x1F000 + 7 * k for k in range(count - count // 2)]
    pairs = join_filters(wanted)
    assert sorted(c for c, _ in pairs) == sorted(wanted)
    assert {mask for c, mask in pairs if not c & EXTENDED} <= {EXTENDED | REMOTE | 0x7FF}
    assert {mask for c, mask in pairs if c & EXTENDED} == {EXTENDED | REMOTE | 0x1FFFFFFF}


def test_beyond_the_limit_as_few_low_bits_are_dropped_as_will_do():
    pairs = join_filters([*range(0, 1024, 2), 1])
    assert pairs == [(c, EXTENDED | REMOTE | 0x7FE) for c in range(0, 1024, 2)]
    assert join_filters([0x100, 0x101, 0x102, 0x200], 2) == [
        (0x100, EXTENDED | REMOTE | 0x7FC),
        (0x200, EXTENDED | REMOTE | 0x7FC),
    ]
    every = [0, 0x7FF, EXTENDED, EXTENDED | 0x1FFFFFFF]
    assert join_filters(every, 2) == [(0, EXTENDED | REMOTE), (EXTENDED, EXTENDED | REMOTE)]
    for can_id in every:
        assert passes(join_filters(every, 2), can_id)
        assert not passes(join_filters(every, 2), can_id | REMOTE)
    assert not passes(join_filters([0x123]), EXTENDED | 0x123)
    assert not passes(join_filters([EXTENDED | 0x123]), 0x123)


def test_a_group_passes_from_every_address_and_with_every_priority():
    broadcast, to_one = EXTENDED | 0x18FEF156, EXTENDED | 0x0CEF2117
    pairs = group_filters([broadcast, to_one])
    assert len(pairs) == 2
    for priority in range(8):
        for address in (0, 0x56, 0xFF):
            assert passes(pairs, EXTENDED | priority << 26 | 0xFEF100 | address)
            assert passes(pairs, EXTENDED | priority << 26 | 0xEF0000 | address << 8 | 0x33)
    for other in (0xFEF256, 0xFFF156, 0xEE2117, 1 << 24 | 0xFEF156, 1 << 25 | 0xFEF156):
        assert not passes(pairs, EXTENDED | 6 << 26 | other)
    assert not passes(pairs, broadcast | REMOTE)
    assert not passes(pairs, broadcast & 0x7FF)
    assert len(group_filters([broadcast, broadcast & ~0xFF])) == 1


# access


def test_our_own_identifiers_are_received_beside_those_that_are_wanted():
    assert LISTEN.received is None
    assert Access(own={5: 1}).received is None
    assert Access(wanted=[1, 2], own={5: 1}).received == {1, 2, 5}
    assert Access(wanted=[]).received == set()


def test_a_port_counts_what_cannot_be_and_what_went_wrong():
    counters = Counters()
    for _ in range(2):
        counters.note_impossible()
        counters.note_error("bus-off")
    counters.note_error()
    assert (counters.malformed, counters.errors) == (2, {"bus-off": 2, "other": 1})
    names = [
        "received",
        "sent",
        "dropped",
        "remote",
        "stale",
        "overflow",
        "limited",
        "impostors",
        "outages",
        "clock_steps",
        "misdated",
    ]
    assert [getattr(counters, name) for name in names] == [0] * len(names)


# a bus inside the process


def frame(time_ns, can_id):
    return make((time_ns, can_id, b"\1"))


def test_every_port_but_the_sender_has_the_frames_once():
    bus = MemoryBus()
    a, b, c = (bus.port() for _ in range(3))
    assert (a.now_ns(), a.fileno(), a.link, a.emptied, a.gather_s, a.pump()) == (0, -1, Link.UP, True, GATHER_S, None)
    a.send(frame(50, 1))
    b.send(frame(20, 2))
    b.send(frame(0, 0)[:0])
    assert bus.now_ns() == 50
    assert (rows(a.drain()), rows(b.drain())) == ([(20, 2, b"\1")], [(50, 1, b"\1")])
    assert rows(c.drain()) == [(50, 1, b"\1"), (20, 2, b"\1")]
    assert rows(c.drain()) == []
    assert [(p.counters.sent, p.counters.received) for p in (a, b, c)] == [(1, 1), (1, 1), (0, 2)]
    c.close()
    a.send(frame(60, 3))
    assert (rows(c.drain()), len(b.drain()), c.counters.received) == ([], 1, 2)


def test_a_bus_with_a_clock_stamps_what_is_sent():
    now = SimpleNamespace(ns=7)
    bus = MemoryBus(lambda: now.ns)
    a, b = bus.port(), bus.port()
    a.send(frame(50, 1))
    now.ns = 9
    assert rows(b.drain()) == [(7, 1, b"\1")]
    assert (a.now_ns(), bus.now_ns()) == (9, 9)


# files that come to be as a whole


def left(folder):
    return sorted(p.name for p in folder.iterdir())


def test_a_file_takes_its_place_when_all_went_well(tmp_path):
    target = tmp_path / "a.txt"
    with whole(target) as file:
        file.write(b"new")
        (beside,) = left(tmp_path)
        assert beside.startswith(".a.txt.")
    assert (target.read_text(), left(tmp_path)) == ("new", ["a.txt"])
    target.chmod(0o640)
    (tmp_path / "link").symlink_to(target)
    with whole_text(tmp_path / "link") as text:
        text.write("newer")
        assert target.read_text() == "new"
    assert (target.read_text(), target.stat().st_mode & 0o7777) == ("newer", 0o640)
    assert (tmp_path / "link").is_symlink()
    with whole(tmp_path / ("n" * 255)) as file:
        file.write(b"x")
    assert left(tmp_path) == ["a.txt", "link", "n" * 255]


@pytest.mark.parametrize("begun", [True, False])
def test_a_file_stays_as_it_was_when_something_went_wrong(tmp_path, begun):
    target = tmp_path / "a.txt"
    target.write_text("old")

    def fail():
        with whole_text(target) as file:
            if begun:
                file.write("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert (target.read_text(), left(tmp_path)) == ("old", ["a.txt"])


def test_what_is_no_plain_file_is_written_in_place(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    for name in ("pipe", "link"):
        reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
        with whole(tmp_path / name) as file:
            file.write(name.encode())
        assert os.read(reader, 100) == name.encode()
        os.close(reader)
    with whole(Path("/dev/null")) as file:
        file.write(b"nothing")
    with pytest.raises(IsADirectoryError), whole(tmp_path):
        pass
    assert left(tmp_path) == ["link", "pipe"]
