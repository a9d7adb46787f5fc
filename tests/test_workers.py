"""A run of the tests on several workers: what it begins with, and what it leaves behind."""

import os
import subprocess
import sys
from collections import OrderedDict
from pathlib import Path
from unittest.mock import Mock

import pytest

from tests.support.by_file import LONGEST, ByFile

ROOT = Path(__file__).parents[1]
SHORT = ("tests/frames/test_e2e.py", "tests/frames/test_packed.py", "tests/health/test_confirm.py")


PARALLEL = ("-n", "2", "--dist", "loadgroup")


@pytest.mark.parametrize("more", [(), PARALLEL, (*PARALLEL, "-p", "tests.support.killed_workers")])
def test_no_tables_are_left_behind(tmp_path, more):
    env = {k: v for k, v in os.environ.items() if not k.startswith(("PYTEST_", "CACHE_DIRECTORY"))}
    env["TMPDIR"] = str(tmp_path)
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *more, *SHORT]
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert not list(tmp_path.glob("bms-gateway-tables-*"))


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


def test_the_files_that_take_longest_are_there():
    assert [file for file in LONGEST if not (ROOT / "tests" / file).is_file()] == []
