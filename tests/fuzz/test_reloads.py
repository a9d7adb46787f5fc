"""A live reload on a real vcan0 of files that are spoilt at random."""

import random

import pytest

from tests.fuzz.reloads import Reloads

COUNT = 8  # 500 by `python -m tests.benchmarks.fuzz --reload 500`


@pytest.mark.vcan
def test_no_spoilt_file_ends_the_service_that_runs(tmp_path):
    with Reloads(tmp_path) as service:
        found = service.spoil(COUNT, random.Random(0))
        service.restore()
        assert service.reload() == "reloaded"
        assert found.taken + found.refused == COUNT + 1
        assert found.child_MiB > 0.0
        assert service.stop() == 0
