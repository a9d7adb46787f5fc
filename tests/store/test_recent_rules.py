"""The record of recent signals by its own rules, on samples made here: what a block holds, where it goes, who reads."""

import errno
import json
import os
import struct
import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bms_gateway.engine import Decoded
from bms_gateway.errors import StateError
from bms_gateway.store import recent as module
from bms_gateway.store.recent import Recent, layout_of, read_recent

US = 1_000
START_US = 1_700_000_000_000_000
FRESH = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)


def engine(name="string_1", whole=None, cells=None, constants=None):
    """An engine of which only the wires are looked at."""
    wire = SimpleNamespace(
        whole=whole or {"current": 0, "coolant_inlet": 3},
        cells={"surface": np.array(cells or [1, 2])},
        constants=constants or {},
    )
    return SimpleNamespace(plan=SimpleNamespace(strings=[SimpleNamespace(name=name)]), wires=[wire])


ONE = engine()


def event(time_us, offsets_us, inputs=None, values=None):
    """Samples of a tick at `time_us`."""
    n = len(offsets_us)
    inputs = [0] * n if inputs is None else inputs
    values = np.arange(n, dtype=float) if values is None else values
    stamps = (time_us + np.array(offsets_us, np.int64)) * US
    return Decoded(time_us * US, stamps, np.array(inputs, np.intp), np.asarray(values, float))


def noise(n, time_us=START_US, seed=0):
    """A tick of samples that do not pack well."""
    rng = np.random.default_rng(seed)
    return event(time_us, np.sort(rng.integers(-(10**6), 0, n)), rng.integers(0, 4, n), rng.normal(0.0, 1e3, n))


def samples(blocks):
    return [
        (i, t, v)
        for block in blocks
        for i, (time, value) in block.samples.items()
        for t, v in zip(time.tolist(), value.tolist(), strict=True)
    ]


def read(folder):
    problems = []
    return list(read_recent(folder, problems)), [str(p) for p in problems]


ticks = st.lists(
    st.tuples(
        st.integers(0, 3_000_000),  # after the tick before
        st.lists(
            st.tuples(
                st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1), st.floats(allow_nan=False, width=32)
            ),
            max_size=6,
        ),
    ),
    max_size=6,
)


@FRESH
@given(ticks)
def test_what_goes_in_comes_out(tmp_path_factory, story):
    folder, time_us, wanted = tmp_path_factory.mktemp("a") / "recent", START_US, []
    ring = Recent(folder, 64.0)
    for step_us, tick in story:
        time_us += step_us
        if tick and max(o for o, _, _ in tick) - min(o for o, _, _ in tick) > 2**31 - 1:
            tick = tick[:1]  # no tick is longer than half an hour
        offsets, inputs, values = zip(*tick, strict=True) if tick else ((), (), ())
        ring.add(event(time_us, offsets, list(inputs), list(values)), ONE)
        wanted += [(i, time_us + o, v) for o, i, v in tick]
        assert ring.flush() is None
    blocks, problems = read(folder)
    assert sorted(samples(blocks)) == sorted(wanted)
    assert problems == []
    assert folder.exists() == bool(wanted)
    for block in blocks:
        times = [t for time, _ in block.samples.values() for t in time.tolist()]
        assert (block.first_us, block.last_us) == (min(times), max(times))
        assert all((np.diff(time) >= 0).all() for time, _ in block.samples.values())
        assert block.layout == {"string_1": {"current_A": 0, "coolant_inlet_C": 3, "surface_1_C": 1, "surface_2_C": 2}}
    assert [b.place for b in blocks] == sorted({b.place for b in blocks})


@FRESH
@given(
    st.lists(
        st.tuples(st.sampled_from([0, 1_000_000, 1_799_000_000, 1_800_000_000, 1_800_000_001, -1]), st.integers(1, 12)),
        min_size=1,
        max_size=12,
    ),
    st.data(),
)
def test_a_block_ends_where_it_is_full_or_long_or_the_clock_went_back_or_strings_are_others(
    tmp_path_factory, story, data
):
    folder, time_us = tmp_path_factory.mktemp("a") / "recent", START_US
    engines, expected, begun, layout = [ONE, engine("other")], [], 0, None
    ring = Recent(folder, 64.0)
    with pytest.MonkeyPatch.context() as m:
        m.setattr(module, "MOST_SAMPLES", 10)
        for step_us, n in story:
            time_us += step_us
            which = data.draw(st.sampled_from([0, 0, 0, 1]))
            ring.add(event(time_us, [-5] * n), engines[which])
            fits = expected and expected[-1] < 10 and layout == which and 0 <= time_us - begun <= 1_800_000_000
            if fits:
                expected[-1] += n
            else:
                expected.append(n)
                begun, layout = time_us, which
        assert ring.flush() is None
    blocks, problems = read(folder)
    assert [sum(len(t) for t, _ in b.samples.values()) for b in blocks] == expected
    assert problems == []


def test_bounds_of_a_block_and_of_the_ring():
    assert module.LONGEST_US == 1_800_000_000 < 2**31  # offsets of samples are 32 bits with a sign
    assert module.MOST_SAMPLES == 50_000
    assert (module.MAX_PACKED, module.MAX_BLOCK) == (8_388_608, 16_777_216)
    assert module.SEGMENT_BYTES == (65_536, 4_194_304)
    assert Recent(Path("/nowhere"), 64.0).limit == 64_000_000


@FRESH
@given(st.sampled_from([0.004, 0.016, 0.0321, 0.08]), st.lists(st.integers(1, 400), min_size=1, max_size=25), st.data())
def test_the_ring_is_laid_out_in_segments_of_a_sixteenth_and_its_oldest_goes_first(
    tmp_path_factory, megabytes, sizes, data
):
    """Against a plain model of the folder: names and sizes of all files after each block."""
    with pytest.MonkeyPatch.context() as m:
        m.setattr(module, "SEGMENT_BYTES", (1_000, 4_000))
        limit = round(megabytes * 1e6)
        most = min(max(limit // 16, 1_000), 4_000)
        folder = tmp_path_factory.mktemp("a") / "recent"
        ring, model, last = Recent(folder, megabytes), {}, 0
        for k, n in enumerate(sizes):
            alone = tmp_path_factory.mktemp("b")
            for target in (Recent(alone, 64.0), ring):
                target.add(noise(n, seed=k), ONE)
                assert target.flush() is None
            (block,) = (path.stat().st_size for path in alone.iterdir())
            while model and sum(model.values()) + block > limit:
                del model[min(model)]
            if model and model[max(model)] + block <= most:
                model[max(model)] += block
            else:
                last = max(model, default=0) + 1
                model[last] = block
            assert {path.name: path.stat().st_size for path in folder.iterdir()} == {
                f"recent-{number:08d}": size for number, size in model.items()
            }
            if data.draw(st.booleans()):
                ring = Recent(folder, megabytes)  # the service was started again


def test_a_block_that_just_fits_the_segment_or_the_ring_goes_there(tmp_path, monkeypatch):
    ring = Recent(tmp_path / "one", 64.0)
    ring.add(noise(300), ONE)
    ring.flush()
    (path,) = (tmp_path / "one").iterdir()
    block = path.stat().st_size
    for spare, files in ((0, 1), (-1, 2)):  # of the segment
        monkeypatch.setattr(module, "SEGMENT_BYTES", (2 * block + spare, 2 * block + spare))
        ring = Recent(tmp_path / f"segment{files}", 64.0)
        for _ in range(2):
            ring.add(noise(300), ONE)
            ring.flush()
        assert len(list(ring.directory.iterdir())) == files
    monkeypatch.setattr(module, "SEGMENT_BYTES", (1, 1))  # each block a segment of its own
    for spare, files in ((0, 2), (-1, 1)):  # of the ring
        ring = Recent(tmp_path / f"ring{files}", (2 * block + spare + 0.5) * 1e-6)
        for _ in range(2):
            ring.add(noise(300), ONE)
            ring.flush()
        assert len(list(ring.directory.iterdir())) == files


def test_names_are_counted_on_by_number_not_by_letters(tmp_path):
    for number in (9, 99_999_999):
        (tmp_path / f"recent-{number:08d}").write_bytes(b"")
    (tmp_path / "recent-100000000").write_bytes(b"")
    (tmp_path / "recent-0000001").write_bytes(b"too short a number")
    (tmp_path / "recent-00000001x").write_bytes(b"another's")
    ring = Recent(tmp_path, 64.0)
    with pytest.MonkeyPatch.context() as m:
        m.setattr(module, "SEGMENT_BYTES", (1, 1))
        ring = Recent(tmp_path, 64.0)
        ring.add(noise(5), ONE)
        assert ring.flush() is None
    assert (tmp_path / "recent-100000001").stat().st_size > 0
    assert len(read(tmp_path)[0]) == 1


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """Bytes of two blocks."""
    found = []
    for seed in (1, 2):
        folder = tmp_path_factory.mktemp("block")
        ring = Recent(folder, 64.0)
        ring.add(noise(6, START_US + seed, seed), ONE)
        assert ring.flush() is None
        found.append((folder / "recent-00000001").read_bytes())
    return found


def laid(folder, raw):
    folder.mkdir(exist_ok=True)
    (folder / "recent-00000007").write_bytes(raw)
    return read(folder)


def test_a_block_cut_anywhere_is_no_problem_and_costs_no_other(tmp_path, two):
    """It is being written, or power failed."""
    first, second = two
    for cut in range(len(second)):
        blocks, problems = laid(tmp_path, first + second[:cut])
        assert ([b.place for b in blocks], problems) == ([(7, 0)], []), cut


@FRESH
@given(st.lists(st.sampled_from(["first", "second", "junk", "spoilt", "magic"]), max_size=7), st.integers(1, 300))
def test_damage_is_counted_to_the_byte_and_costs_itself_alone(tmp_path_factory, two, story, junk):
    first, second = two
    parts = {
        "first": first,
        "second": second,
        "junk": b"\xff" * junk,
        "spoilt": first[:-1] + bytes([first[-1] ^ 1]),
        "magic": first[:8] + b"\x00" * 8,  # nothing is packed in it
    }
    raw, at, places, damaged = b"".join(parts[name] for name in story), 0, [], 0
    for name in story:
        if name in ("first", "second"):
            places.append((7, at))
        else:
            damaged += len(parts[name])
        at += len(parts[name])
    blocks, problems = laid(tmp_path_factory.mktemp("a"), raw)
    assert [b.place for b in blocks] == places
    assert len(problems) == bool(damaged)
    if damaged:
        assert (
            f"recent-00000007: {damaged} of {len(raw)} bytes are damaged or not of this program; left out"
            in problems[0]
        )


@pytest.mark.parametrize("tail", [b"b", b"bm", b"bmsrec1", b"bmsrec1\n", b"bmsrec1\n\xff\xff\xff\xff"])
def test_a_tail_that_may_become_a_block_is_none_yet(tmp_path, two, tail):
    assert laid(tmp_path, two[0] + tail)[1] == []


@pytest.mark.parametrize("tail", [b"x", b"bn", b"bmsrec2", b"bmsrec2\n\0\0\0\0"])
def test_a_tail_that_can_become_none_is_damage(tmp_path, two, tail):
    assert f"{len(tail)} of {len(two[0]) + len(tail)} bytes" in laid(tmp_path, two[0] + tail)[1][0]


def packed(line, body):
    text = line if isinstance(line, bytes) else json.dumps(line).encode()
    content = zlib.compress(text + b"\n" + body)
    size = struct.pack("<I", len(content))
    return b"bmsrec1\n" + size + struct.pack("<I", zlib.crc32(content, zlib.crc32(size))) + content


SOUND = {"start_us": START_US, "inputs": [4, 2], "counts": [2, 1], "strings": {"s": {"current_A": 4, "soc": 0.5}}}
STEPS = np.array([0, 7, 3], "<u4").view(np.uint8).reshape(3, 4).T.tobytes()
VALUES = np.array([1.5, 2.5, -8.0], "<f4").view(np.uint8).reshape(3, 4).T.tobytes()


def test_a_block_is_read_as_the_text_of_the_module_says(tmp_path):
    (block,), problems = laid(tmp_path, packed(SOUND, STEPS + VALUES))
    assert problems == []
    assert samples([block]) == [(4, START_US, 1.5), (4, START_US + 7, 2.5), (2, START_US + 3, -8.0)]
    assert (block.first_us, block.last_us) == (START_US, START_US + 7)
    assert block.layout == SOUND["strings"]


@pytest.mark.parametrize(
    ("spoilt", "body"),
    [
        ({}, STEPS + VALUES + b"\0"),
        ({}, (STEPS + VALUES)[:-1]),
        ({"counts": [3, 0]}, STEPS + VALUES),
        ({"counts": [4, -1]}, STEPS + VALUES),
        ({"counts": [3]}, STEPS + VALUES),
        ({"counts": [1, 1, 1]}, STEPS + VALUES),
        ({"inputs": [4]}, STEPS + VALUES),
        ({"inputs": [], "counts": []}, b""),
        ({"inputs": [4], "counts": [0]}, b""),
        ({"inputs": ["x", 2]}, STEPS + VALUES),
        ({"counts": ["a", 1]}, STEPS + VALUES),
        ({"counts": [2**70, 1]}, STEPS + VALUES),
        ({"inputs": [4, 2, 1], "counts": [2**63 - 1, 2**63 - 1, 5]}, STEPS + VALUES),
        ({"start_us": None}, STEPS + VALUES),
        ({"start_us": 2**70}, STEPS + VALUES),
        ({"strings": []}, STEPS + VALUES),
        ({"strings": {"s": {"current_A": float("inf")}}}, STEPS + VALUES),
        ({"strings": {"s": {"current_A": True}}}, STEPS + VALUES),
        ({"strings": {"s": {"a b": 1}}}, STEPS + VALUES),
        ({"strings": {"s": {"x" * 201: 1}}}, STEPS + VALUES),
    ],
)
def test_a_block_that_contradicts_itself_is_left_out(tmp_path, spoilt, body):
    raw = packed({**SOUND, **spoilt}, body)
    blocks, problems = laid(tmp_path, raw)
    assert blocks == []
    assert f": {len(raw)} of {len(raw)} bytes are damaged" in problems[0]


def test_columns_that_are_not_ours_are_left_out(tmp_path):
    columns = {"current_A": 4, "time_s": 4, "surface_1000_C": 2, "surface_1001_C": 2, "core_1_C": 4, "x" * 200: 4}
    (block,), _ = laid(tmp_path, packed({**SOUND, "strings": {"s": columns}}, STEPS + VALUES))
    assert block.layout == {"s": {"current_A": 4, "surface_1000_C": 2}}


@pytest.mark.parametrize("missing", sorted(SOUND))
def test_a_block_without_one_of_its_words_is_left_out(tmp_path, missing):
    line = {key: value for key, value in SOUND.items() if key != missing}
    assert laid(tmp_path, packed(line, STEPS + VALUES))[0] == []


@pytest.mark.parametrize("line", [b"[" * 100_000, b"[]", b"7", b"", b"{", b'"\xff"'])
def test_a_line_that_is_none_is_left_out(tmp_path, line):
    assert laid(tmp_path, packed(line, STEPS + VALUES))[0] == []


def test_what_is_packed_but_no_zlib_is_left_out(tmp_path):
    content = b"no zlib at all"
    size = struct.pack("<I", len(content))
    raw = b"bmsrec1\n" + size + struct.pack("<I", zlib.crc32(content, zlib.crc32(size))) + content
    assert laid(tmp_path, raw)[0] == []


@pytest.mark.parametrize(("room", "read_out"), [(0, 1), (-1, 0)])
def test_blocks_up_to_their_bound_are_read_packed_and_unpacked(tmp_path, monkeypatch, room, read_out):
    raw = packed(SOUND, STEPS + VALUES)
    for name, exact in (("MAX_PACKED", len(raw) - 16), ("MAX_BLOCK", len(json.dumps(SOUND)) + 1 + 24)):
        with monkeypatch.context() as m:
            m.setattr(module, name, exact + room)
            assert len(laid(tmp_path, raw)[0]) == read_out, name


def test_a_segment_is_read_up_to_what_a_writer_may_have_made_of_it(tmp_path, monkeypatch, two):
    monkeypatch.setattr(module, "SEGMENT_BYTES", (1, len(two[0])))
    monkeypatch.setattr(module, "MAX_PACKED", len(two[1]))
    blocks, problems = laid(tmp_path, two[0] + two[1] + two[0])
    assert ([b.place[1] for b in blocks], problems) == ([0, len(two[0])], [])


@pytest.mark.parametrize(("code", "says"), [(errno.EIO, "Input/output error"), (errno.EACCES, "Permission denied")])
def test_a_segment_that_cannot_be_read_is_told_and_the_next_is_read(tmp_path, monkeypatch, two, code, says):
    laid(tmp_path, two[0])
    (tmp_path / "recent-00000003").write_bytes(two[1])
    (tmp_path / "recent-00000005").mkdir()
    real = module.read_file

    def read_file(path, most):
        if path.name.endswith("3"):
            raise OSError(code, says)
        return real(path, most)

    monkeypatch.setattr(module, "read_file", read_file)
    blocks, problems = read(tmp_path)
    assert [b.place for b in blocks] == [(7, 0)]
    assert problems == [
        f"{tmp_path}/recent-00000003: cannot be read: {says}; left out",
        f"{tmp_path}/recent-00000005: is no file; left out",
    ]


def test_a_segment_that_goes_while_it_is_read_is_none(tmp_path, monkeypatch, two):
    laid(tmp_path, two[0])
    (tmp_path / "recent-00000003").write_bytes(two[1])
    real = module.read_file

    def read_file(path, most):
        if path.name.endswith("3"):
            path.unlink()
        return real(path, most)

    monkeypatch.setattr(module, "read_file", read_file)
    blocks, problems = read(tmp_path)
    assert ([b.place for b in blocks], problems) == ([(7, 0)], [])


@pytest.mark.parametrize("missing", ["nothing", "file/recent"])
def test_where_no_ring_is_nothing_is_read(tmp_path, missing):
    (tmp_path / "file").write_bytes(b"")
    assert read(tmp_path / missing) == ([], [])


def test_a_disk_that_refuses_costs_what_waits_and_says_why(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    ring = Recent(tmp_path / "file" / "recent", 64.0)
    for its in (ONE, engine("other")):  # two blocks
        ring.add(noise(5), its)
    problem = ring.flush()
    assert isinstance(problem, StateError)
    assert str(problem) == f"{tmp_path}/file/recent: recent signals cannot be kept: Not a directory"
    ring.directory = tmp_path / "recent"  # the disk is there again
    assert ring.flush() is None
    assert not ring.directory.exists()  # what waited is lost, and nothing else
    ring.add(noise(6), ONE)
    assert ring.flush() is None
    assert len(samples(read(ring.directory)[0])) == 6


def test_a_segment_that_somebody_deletes_at_the_same_moment_is_no_failure(tmp_path, monkeypatch):
    real = Path.unlink

    def unlink(path, **how):
        os.unlink(path)
        real(path, **how)

    monkeypatch.setattr(module, "SEGMENT_BYTES", (1, 1))
    monkeypatch.setattr(Path, "unlink", unlink)
    ring = Recent(tmp_path, 0.001)
    for _ in range(4):
        ring.add(noise(40), ONE)
        assert ring.flush() is None
    assert len(samples(read(tmp_path)[0])) % 40 == 0


def test_a_new_segment_is_known_to_the_disk_by_its_name(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(module, "sync_directory", synced.append)
    ring = Recent(tmp_path / "recent", 64.0)
    for _ in range(3):
        ring.add(noise(5), ONE)
        ring.flush()
    assert synced == [tmp_path / "recent"]


def test_columns_of_a_string_are_its_inputs_by_cell_and_constants_where_there_is_none():
    wired = engine(
        "s", {"current": 0, "coolant_inlet": -1, "voltage": 5}, [7, -1, 0], {"coolant_inlet": 25, "voltage": 3.3}
    )
    found = layout_of(wired)
    assert found == {"s": {"current_A": 0, "voltage_V": 5, "surface_1_C": 7, "surface_3_C": 0, "coolant_inlet_C": 25.0}}
    assert isinstance(found["s"]["coolant_inlet_C"], float)  # an int would be an input
