"""A disk that refuses, and files that are not what they should be: the last good state stays, and nobody hangs."""

import errno
import hashlib
import os
import subprocess
import tracemalloc
from contextlib import contextmanager

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bms_gateway.errors import StateError
from bms_gateway.store import StateStore
from bms_gateway.store import state as state_module
from tests.support.states import GOOD, saved

FRESH = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=150)


def test_a_disk_that_is_full_at_any_byte_keeps_the_last_good_state(tmp_path, monkeypatch):
    store, real = saved(tmp_path), os.write
    new = {"generation": 3, "fill": "z" * 300}
    for room in range(460):
        left = [room]

        def write(handle, data, left=left):
            if not left[0]:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            n = real(handle, memoryview(data)[: left[0]])  # the part that fits is written, as the kernel does
            left[0] -= n
            return n

        with monkeypatch.context() as m:
            m.setattr(os, "write", write)
            problem = store.save(new, wall_ns=3)
        if problem is None:
            break
        assert "No space left" in str(problem)
        assert "\n" not in str(problem)
        assert StateStore(tmp_path).load() == store.load()
        assert store.load().state == GOOD
    assert problem is None
    assert 400 < room < 460
    assert store.load().state == new


CHANGING = ("open", "write", "fsync", "replace", "unlink", "mkdir")


@pytest.mark.parametrize("code", [errno.EIO, errno.EROFS, errno.EACCES, errno.EDQUOT, errno.ENOSPC])
def test_an_error_of_any_call_keeps_the_last_good_state(tmp_path, monkeypatch, code):
    refused = 0
    for fails_at in range(40):
        store = saved(tmp_path / str(fails_at))
        count = [0]

        def failing(real, count=count, fails_at=fails_at):
            def call(*args, **more):
                count[0] += 1
                if count[0] == fails_at + 1:
                    raise OSError(code, os.strerror(code))
                return real(*args, **more)

            return call

        with monkeypatch.context() as m:
            for name in CHANGING:
                m.setattr(os, name, failing(getattr(os, name)))
            problem = store.save({"generation": 3}, wall_ns=3)
        done = count[0] <= fails_at
        refused += problem is not None
        found = StateStore(tmp_path / str(fails_at)).load()
        assert found.problems == ()
        assert found.state["generation"] in (2, 3)
        assert found.state["generation"] == 3 or problem is not None
        assert store.save({"generation": 4}, wall_ns=4) is None
        assert store.load().state == {"generation": 4}
        if done:
            break
    assert done
    assert refused >= 7


def test_reading_that_fails_is_told_and_falls_back(tmp_path, monkeypatch):
    store, real = saved(tmp_path), os.read
    broken = [True]

    def read(handle, n):
        if broken and os.readlink(f"/proc/self/fd/{handle}").endswith("/state"):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return real(handle, n)

    monkeypatch.setattr(os, "read", read)
    found = store.load()
    assert found.state["generation"] == 1
    assert "Input/output error" in str(found.problems[0])
    assert store.save({"generation": 3}, wall_ns=3) is None
    broken.clear()
    assert store.load().state == {"generation": 3}


@contextmanager
def small_disk(folder, *options):
    """A real file system of 64 KiB."""
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", ",".join(("size=64k", *options)), "none", str(folder)]
    if subprocess.run(words, capture_output=True).returncode:
        pytest.skip("nothing may be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_a_real_full_disk_keeps_the_last_good_state_and_recovers(tmp_path):
    with small_disk(tmp_path / "disk") as disk:
        store = saved(disk)
        (disk / "filler").write_bytes(bytes(os.statvfs(disk).f_bavail * os.statvfs(disk).f_bsize))
        problem = store.save({"generation": 3, "fill": "z" * 3000}, wall_ns=3)
        assert "No space left" in str(problem)
        assert store.load().state == GOOD
        (disk / "filler").unlink()
        assert store.save({"generation": 4}, wall_ns=4) is None
        assert store.load().state == {"generation": 4}


def test_a_real_read_only_disk_is_a_value_and_is_read(tmp_path):
    with small_disk(tmp_path / "disk") as disk:
        store = saved(disk)
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        assert "Read-only" in str(store.save({"generation": 3}, wall_ns=3))
        assert store.lock() is None  # no right to write is needed
        store.unlock()
        assert store.load().state == GOOD
        subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True)


@pytest.mark.parametrize("name", ["state", "state.new"])
@pytest.mark.parametrize("kind", ["directory", "pipe", "link in a ring", "link to nowhere"])
def test_what_is_no_file_neither_hangs_nor_stops(tmp_path, name, kind):
    store = saved(tmp_path)
    (tmp_path / name).unlink(missing_ok=True)
    if kind == "directory":
        (tmp_path / name).mkdir()
    elif kind == "pipe":
        os.mkfifo(tmp_path / name)
    else:
        (tmp_path / name).symlink_to(name if kind == "link in a ring" else tmp_path / "nowhere")
    found = store.load()
    assert found.state["generation"] == (1 if name == "state" else 2)
    problem = store.save({"generation": 3}, wall_ns=3)
    assert not (tmp_path / "nowhere").exists()
    assert store.load().state["generation"] == (found.state["generation"] if problem else 3)


def test_a_file_that_promises_too_much_is_not_read_into_memory(tmp_path):
    head = b"bms-gateway-state 1 %s %d\n" % (b"0" * 64, 1 << 40)
    with (tmp_path / "state").open("wb") as f:
        f.write(head)
        f.truncate(1 << 34)  # 16 GiB of hole
    store = StateStore(tmp_path)
    tracemalloc.start()
    found = store.load()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.state is None
    assert "claims" in str(found.problems[0])
    assert peak < 1 << 20


def test_a_nest_deeper_than_any_state_is_foreign(tmp_path):
    body = b'{"saved_ns":1,"state":' + b"[" * 200_000
    head = b"bms-gateway-state 1 %s %d\n" % (hashlib.sha256(body).hexdigest().encode(), len(body))
    (tmp_path / "state").write_bytes(head + body)
    assert "not a state" in str(StateStore(tmp_path).load().problems[0])


def tidy(folder):
    """Remove what another example has left of a kind that is never written over."""
    for kept in folder.glob("*.too-new*"):
        kept.unlink()


@FRESH
@given(st.data())
def test_flipped_cut_and_spliced_bytes_give_a_good_generation_and_a_reason(tmp_path, data):
    tidy(tmp_path)
    store = saved(tmp_path)
    raw = (tmp_path / "state").read_bytes()
    other = (tmp_path / "state.previous").read_bytes()
    for name in data.draw(st.sampled_from([("state",), ("state.previous",), ("state", "state.previous")])):
        spoilt = bytearray(raw if name == "state" else other)
        for _ in range(data.draw(st.integers(1, 4))):
            at = data.draw(st.integers(0, len(spoilt)))
            kind = data.draw(st.sampled_from(["flip", "cut", "splice", "insert", "delete", "zero"]))
            if kind == "flip" and at < len(spoilt):
                spoilt[at] ^= data.draw(st.integers(1, 255))
            elif kind == "cut":
                del spoilt[at:]
            elif kind == "splice":
                spoilt[at:] = (other if name == "state" else raw)[data.draw(st.integers(0, len(other))) :]
            elif kind == "insert":
                spoilt[at:at] = data.draw(st.binary(max_size=40))
            elif kind == "delete":
                del spoilt[at : at + data.draw(st.integers(1, 50))]
            elif at < len(spoilt):
                spoilt[at : at + 64] = bytes(len(spoilt[at : at + 64]))
        (tmp_path / name).write_bytes(spoilt)
    found = store.load()
    assert found.state in (None, GOOD, {"generation": 1, "fill": "x" * 300})
    assert all(isinstance(p, StateError) and "\n" not in str(p) for p in found.problems)
    if found.state is None:
        assert len(found.problems) == 2
    assert len(os.listdir(tmp_path)) <= 8  # what is set aside has few names
    assert store.save(GOOD, wall_ns=5) is None
    assert store.load().state == GOOD


@FRESH
@given(
    st.binary(max_size=400),
    st.sampled_from([b"", b"bms-gateway-state ", b"bms-gateway-state 1 ", b"bms-gateway-state 2 "]),
)
def test_any_bytes_are_set_aside_with_a_reason(tmp_path, tail, lead):
    (tmp_path / "state").write_bytes(lead + tail)
    found = StateStore(tmp_path).load()
    assert found.state is None
    assert len(found.problems) == 1
    assert isinstance(found.problems[0], StateError)


@pytest.mark.parametrize(("claimed", "says"), [(1 << 26, "3 of 67108864 bytes are there"), ((1 << 26) + 1, "at most")])
def test_a_state_may_claim_64_mib_and_not_a_byte_more(tmp_path, claimed, says):
    head = f"bms-gateway-state 1 {hashlib.sha256(b'abc').hexdigest()} {claimed}\n"
    (tmp_path / "state").write_bytes(head.encode() + b"abc")
    assert says in str(StateStore(tmp_path).load().problems[0])


def test_what_comes_after_a_state_makes_it_none(tmp_path):
    saved(tmp_path)
    for more in (b"x", b"x" * 1000):
        StateStore(tmp_path).save(GOOD, wall_ns=3)
        with (tmp_path / "state").open("ab") as f:
            f.write(more)
        assert "it is too long" in str(StateStore(tmp_path).load().problems[0])


def test_a_store_that_has_read_nothing_misses_nothing(tmp_path):
    assert StateStore(tmp_path).unread == ""


def test_a_later_format_is_told_even_where_nothing_else_stands_there(tmp_path):
    (tmp_path / "state").write_bytes(b"bms-gateway-state 2\n")
    assert "it has format 2, this version knows 1; set aside as state.too-new" in str(
        StateStore(tmp_path).load().problems[0]
    )


def test_a_sound_check_sum_makes_no_state_of_a_million_lists(tmp_path):
    body = b'{"saved_ns":1,"state":{"a":[' + b"[]," * 1_000_000 + b"[]]}}"
    head = f"bms-gateway-state 1 {hashlib.sha256(body).hexdigest()} {len(body)}\n"
    (tmp_path / "state").write_bytes(head.encode() + body)
    assert "it has far more values than a state of this program" in str(StateStore(tmp_path).load().problems[0])


def test_what_is_damaged_when_the_next_is_saved_is_kept_aside(tmp_path):
    saved(tmp_path)
    damaged = (tmp_path / "state").read_bytes()[:-1]
    (tmp_path / "state").write_bytes(damaged)
    assert StateStore(tmp_path).save({"generation": 3}, wall_ns=3) is None
    assert (tmp_path / "state.corrupt").read_bytes() == damaged
    assert StateStore(tmp_path).load().state == {"generation": 3}


def test_a_refused_state_that_could_not_be_set_aside_is_set_aside_with_the_next_save(tmp_path, monkeypatch):
    store = saved(tmp_path)
    refused = (tmp_path / "state").read_bytes()

    def use(state):
        raise StateError("not for us")

    def replace(*_):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    def unsettled():
        with monkeypatch.context() as m:
            m.setattr(type(tmp_path), "replace", replace)
            assert "cannot be set aside: Read-only file system" in str(store.load(use).problems[0])

    unsettled()
    assert store.load().state == GOOD  # taken up after all
    assert store.save({"generation": 3}, wall_ns=3) is None
    assert (tmp_path / "state.previous").read_bytes() == refused
    refused = (tmp_path / "state").read_bytes()
    unsettled()
    assert store.save({"generation": 4}, wall_ns=4) is None
    assert (tmp_path / "state.refused").read_bytes() == refused


def test_a_state_of_64_mib_is_saved_and_not_one_of_a_byte_more(tmp_path, monkeypatch):
    monkeypatch.setattr(state_module, "MAX_BYTES", len('{"saved_ns":3,"state":{"fill":"1234"}}'))
    assert StateStore(tmp_path).save({"fill": "1234"}, wall_ns=3) is None
    assert "the state is not saved: 39 bytes, at most 38" in str(
        StateStore(tmp_path).save({"fill": "12345"}, wall_ns=3)
    )
