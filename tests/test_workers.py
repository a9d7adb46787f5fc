"""A run of the tests on several workers: what it begins with, and what it leaves behind."""

import os
import subprocess
import sys
from collections import OrderedDict
from pathlib import Path
from unittest.mock import Mock

import pytest

from tests.conftest import pytest_collection_modifyitems, pytest_xdist_auto_num_workers
from tests.support.by_file import LONGEST, ByFile

ROOT = Path(__file__).parents[1]
SHORT = ("tests/frames/test_e2e.py", "tests/frames/test_packed.py", "tests/health/test_confirm.py")


PARALLEL = ("-n", "2", "--dist", "loadgroup")


@pytest.mark.parametrize("more", [(*PARALLEL, "-p", "tests.support.killed_workers"), PARALLEL, ()])
@pytest.mark.plain_cases(1)
def test_no_tables_are_left_behind(tmp_path, more):
    env = {k: v for k, v in os.environ.items() if not k.startswith(("PYTEST_", "CACHE_DIRECTORY"))}
    env["TMPDIR"] = str(tmp_path)
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *more, *SHORT]
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert not list(tmp_path.glob("bms-gateway-tables-*"))


START = "import os, tests.conftest; print(os.environ['CACHE_DIRECTORY'], flush=True); input()"


def test_tables_of_a_run_that_was_killed_go_at_the_next_start_and_no_others(tmp_path):
    env = {k: v for k, v in os.environ.items() if k != "CACHE_DIRECTORY"} | {"TMPDIR": str(tmp_path)}

    def started():
        pipe = subprocess.PIPE
        process = subprocess.Popen([sys.executable, "-c", START], cwd=ROOT, env=env, stdin=pipe, stdout=pipe, text=True)
        return process, Path(process.stdout.readline().strip())

    def left():
        return {p for p in tmp_path.iterdir() if p.name.startswith("bms-gateway-tables-")}

    killed, its = started()
    killed.kill()
    killed.communicate()
    assert left() == {its}
    (its / "some.table").write_text("old")
    running, theirs = started()
    assert left() == {theirs}
    last, ours = started()
    assert left() == {theirs, ours}
    for process in (last, running):
        process.communicate("\n", timeout=60)
        assert process.returncode == 0
    assert left() == set()


KEPT = (
    "import sys, gc, tests.conftest as own, subprocess; own.pytest_collection_finish(); "
    "print(sys.dont_write_bytecode, gc.get_freeze_count() > 10_000, flush=True); "
    "subprocess.run([sys.executable, '-c', 'import sys; print(sys.dont_write_bytecode)'], check=True)"
)


def test_modules_are_compiled_once_and_searched_for_garbage_once(tmp_path):
    env = os.environ | {"PYTHONDONTWRITEBYTECODE": "1", "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", KEPT], cwd=ROOT, env=env, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True", "False"]


@pytest.mark.parametrize(("how", "told", "found"), [("auto", "", 3), ("logical", "", None), ("auto", "2", None)])
def test_there_are_half_as_many_workers_again_as_cores_unless_a_person_says_how_many(monkeypatch, how, told, found):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    if told:
        monkeypatch.setenv("PYTEST_XDIST_AUTO_NUM_WORKERS", told)
    assert pytest_xdist_auto_num_workers(Mock(option=Mock(numprocesses=how))) == found


def test_files_that_take_longest_are_handed_out_first():
    handed = []
    node = Mock(send_runtest_some=handed.extend)
    ids = [f"tests/{file}::test" for file in ("house/test_a.py", LONGEST[3], "house/test_b.py", LONGEST[0])]
    by_file = object.__new__(ByFile)
    by_file.workqueue = OrderedDict((i.partition("::")[0], {i: False}) for i in ids)
    by_file.assigned_work, by_file.registered_collections = {}, {node: ids}
    while by_file.workqueue:
        by_file._assign_work_unit(node)
    assert handed == [3, 1, 0, 2]


def test_of_a_test_with_plain_cases_the_further_cases_are_slow():
    def item(name, plain):
        return Mock(nodeid=f"tests/test_a.py::{name}", get_closest_marker=lambda _: plain and Mock(args=(plain,)))

    items = [item("one[a]", 2), item("other[a]", None), item("one[b]", 2), item("one[c]", 2), item("other[b]", None)]
    pytest_collection_modifyitems(items)
    assert [i.nodeid for i in items if i.add_marker.called] == ["tests/test_a.py::one[c]"]
    items[3].add_marker.assert_called_once_with(pytest.mark.slow)


def test_the_files_that_take_longest_are_there():
    assert [file for file in LONGEST if not (ROOT / "tests" / file).is_file()] == []
