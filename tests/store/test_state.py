"""The stored state is never lost and never garbage, whatever happened to the files."""

import errno
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bms_gateway.errors import StateError
from bms_gateway.store import StateStore

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=20,
)
FRESH = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)


@FRESH
@given(state=st.dictionaries(st.text(), JSON, max_size=5), ns=st.integers(-(2**63), 2**63 - 1))
def test_what_is_saved_comes_back_exactly(tmp_path, state, ns):
    store = StateStore(tmp_path)
    assert store.save(state, wall_ns=ns) is None
    found = store.load()
    assert (found.state, found.saved_ns, found.problems) == (state, ns, ())


def test_nothing_stored_is_a_fresh_start_without_a_problem(tmp_path):
    found = StateStore(tmp_path / "not made yet").load()
    assert (found.state, found.saved_ns, found.problems) == (None, None, ())


def two_generations(folder):
    store = StateStore(folder)
    store.save({"generation": 1, "fill": "x" * 200}, wall_ns=1)
    store.save({"generation": 2, "fill": "y" * 200}, wall_ns=2)
    return store


@FRESH
@given(at=st.integers(0, 10_000), flip=st.integers(1, 255))
def test_one_damaged_byte_anywhere_falls_back_to_the_generation_before(tmp_path, at, flip):
    store = two_generations(tmp_path)
    raw = bytearray((tmp_path / "state").read_bytes())
    raw[at % len(raw)] ^= flip
    (tmp_path / "state").write_bytes(raw)
    found = store.load()
    # Only white space between the words of the first line may differ and still mean the same.
    assert found.state["generation"] == (1 if found.problems else 2)
    if found.problems:
        assert not (tmp_path / "state").exists()


@FRESH
@given(cut=st.integers(0, 10_000))
def test_a_truncated_file_falls_back_to_the_generation_before(tmp_path, cut):
    store = two_generations(tmp_path)
    raw = (tmp_path / "state").read_bytes()
    (tmp_path / "state").write_bytes(raw[: cut % len(raw)])
    found = store.load()
    assert found.state["generation"] == 1
    assert len(found.problems) == 1
    assert isinstance(found.problems[0], StateError)
    assert "\n" not in str(found.problems[0])


@pytest.mark.parametrize(
    ("content", "aside", "says"),
    [
        (b"", "state.corrupt", "empty"),
        (b"SQLite format 3\0" * 50, "state.foreign", "not a state of this program"),
        (b'{"saved_ns": 1}', "state.foreign", "not a state of this program"),
        (b"\xff" * 5000, "state.foreign", "not a state of this program"),
        (b"bms-gateway-state 7 abc 3\nnew", "state.too-new", "format 7"),
        (b"bms-gateway-state 1 abc 3\nold", "state.corrupt", "check sum"),
        (b"bms-gateway-state 1\n", "state.corrupt", "first line"),
        (b"bms-gateway-state\n", "state.corrupt", "first line"),
    ],
)
def test_what_is_not_ours_is_set_aside_with_the_reason(tmp_path, content, aside, says):
    (tmp_path / "state").write_bytes(content)
    store = StateStore(tmp_path)
    found = store.load()
    assert found.state is None
    assert says in str(found.problems[0])
    assert (tmp_path / aside).read_bytes() == content
    assert store.load().problems == ()
    assert store.save({"a": 1}, wall_ns=5) is None
    assert store.load().state == {"a": 1}


@pytest.mark.parametrize(
    "content", [b"[]", b"no JSON", b'{"saved_ns":1}', b'{"saved_ns":"x","state":{}}', b'{"state":[]}']
)
def test_sound_check_sum_with_another_content_is_foreign(tmp_path, content):
    import hashlib

    head = b"bms-gateway-state 1 %s %d\n" % (hashlib.sha256(content).hexdigest().encode(), len(content))
    (tmp_path / "state").write_bytes(head + content)
    assert StateStore(tmp_path).load().state is None
    assert (tmp_path / "state.foreign").exists()


def test_killed_between_any_two_steps_of_saving_a_complete_generation_is_found(tmp_path, monkeypatch):
    # Each system call that changes the directory fails once, as if the process had died there.
    import pathlib

    for dies_at in range(4):
        folder = tmp_path / str(dies_at)
        store = two_generations(folder)
        count = 0

        def counted(real, dies_at=dies_at):
            def call(*args):
                nonlocal count
                count += 1
                if count > dies_at:
                    raise KeyboardInterrupt
                return real(*args)

            return call

        with monkeypatch.context() as m:
            m.setattr(os, "fsync", counted(os.fsync))
            m.setattr(pathlib.Path, "replace", counted(pathlib.Path.replace))
            with pytest.raises(KeyboardInterrupt):
                store.save({"generation": 3}, wall_ns=3)
        found = StateStore(folder).load()
        assert found.state["generation"] in (2, 3)
        assert found.problems == ()
        assert store.save({"generation": 4}, wall_ns=4) is None
        assert StateStore(folder).load().state["generation"] == 4


def test_a_full_disk_is_reported_and_costs_nothing_stored(tmp_path, monkeypatch):
    store = two_generations(tmp_path)

    def full(fd):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as m:
        m.setattr(os, "fsync", full)
        problem = store.save({"generation": 3}, wall_ns=3)
    assert isinstance(problem, StateError)
    assert "No space left" in str(problem)
    assert store.load().state["generation"] == 2


def test_an_unwritable_directory_is_a_value_not_an_exception(tmp_path):
    (tmp_path / "file").write_text("in the way")
    problem = StateStore(tmp_path / "file" / "below").save({}, wall_ns=1)
    assert isinstance(problem, StateError)


def test_a_spoilt_file_does_not_push_out_the_good_previous_one(tmp_path):
    store = two_generations(tmp_path)
    (tmp_path / "state").write_bytes(b"garbage")
    assert store.save({"generation": 3}, wall_ns=3) is None
    (tmp_path / "state").write_bytes(b"garbage again")
    assert store.load().state["generation"] == 1


def test_the_file_is_readable_by_people(tmp_path):
    StateStore(tmp_path).save({"R_e": 0.0035}, wall_ns=1)
    assert json.loads((tmp_path / "state").read_text().split("\n", 1)[1]) == {"saved_ns": 1, "state": {"R_e": 0.0035}}


def test_what_the_engine_refuses_is_set_aside_and_the_generation_before_is_tried(tmp_path):
    store = two_generations(tmp_path)
    used = []

    def use(state):
        if state["generation"] == 2:
            raise StateError("its core is 5000 °C")
        used.append(state["generation"])

    found = store.load(use)
    assert (found.state["generation"], used) == (1, [1])
    assert "5000 °C; set aside as state.refused" in str(found.problems[0])
    assert (tmp_path / "state.refused").exists()
    assert store.load().problems == ()


READ = """
import sys
from pathlib import Path
from bms_gateway.store import StateStore
from tests.memory import peak_mib
begun = peak_mib()
found = StateStore(Path(sys.argv[1])).load()
print(found.state, *found.problems, peak_mib() - begun, sep="|")
"""


@pytest.mark.parametrize("unit", [b"[],", b"0,", b'"ab",', b'{"a":1},'])
def test_a_state_of_a_million_small_things_is_refused_before_it_takes_memory(tmp_path, unit):
    """47 MB of empty lists with a sound check sum took 516 MB and 12 s of a start."""
    body = b'{"saved_ns":1,"state":{"a":[' + unit * (47_000_000 // len(unit)) + b"0]}}"
    head = b"bms-gateway-state 1 %s %d\n" % (hashlib.sha256(body).hexdigest().encode(), len(body))
    (tmp_path / "state").write_bytes(head + body)
    words = [sys.executable, "-c", READ, tmp_path]
    done = subprocess.run(words, capture_output=True, text=True, cwd=Path(__file__).resolve().parents[2], check=True)
    state, problem, more_mib = done.stdout.split("|")
    assert state == "None"
    assert "far more values than a state" in problem
    assert float(more_mib) < 3 * len(body) / 1024**2
    assert (tmp_path / "state.foreign").exists()


def test_what_could_not_be_read_again_is_not_saved(tmp_path):
    store = StateStore(tmp_path)
    assert store.save({"a": 1}, wall_ns=1) is None
    assert "too many values" in str(store.save({"a": [[]] * 1_100_000}, wall_ns=2))
    assert store.load().state == {"a": 1}


def test_a_state_on_disk_is_read_by_later_versions(tmp_path):
    """Byte by byte, as vehicles have it: a change of the format must leave this readable, and call itself another."""
    body = b'{"saved_ns":7,"state":{"strings":5}}'
    digest = hashlib.sha256(body).hexdigest().encode()
    content = b"bms-gateway-state 1 %s 36\n%s" % (digest, body)
    (tmp_path / "state").write_bytes(content)
    found = StateStore(tmp_path).load()
    assert (found.state, found.saved_ns, found.problems) == ({"strings": 5}, 7, ())
    assert StateStore(tmp_path / "other").save({"strings": 5}, wall_ns=7) is None
    assert (tmp_path / "other" / "state").read_bytes() == content
