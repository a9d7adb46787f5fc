"""Logs of one drive in the order of their times."""

import pytest

from bms_gateway.bus.logfile import write_log
from bms_gateway.errors import UsageError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.records.once import in_order
from tests.support.vehicle_traffic import traffic

SECOND = 1_000_000_000
TODAY_NS = 1_750_000_000 * SECOND


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """Three logs of one drive, in order."""
    frames, folder = traffic(9.0), tmp_path_factory.mktemp("logs")
    paths = []
    for k in range(3):
        some = frames[(frames.time_ns >= 3 * k * SECOND) & (frames.time_ns < 3 * (k + 1) * SECOND)]
        paths.append(folder / f"{k}.log")
        write_log(paths[-1], [FrameBatch(some.time_ns + TODAY_NS, some.can_id, some.length, some.data)])
    return paths


def test_logs_in_another_order_are_refused_with_the_right_one(parts):
    """They gave a warning about the clock, and then a cell that heats by itself."""
    in_order(parts)
    in_order(parts[:1])
    a, b, c = parts
    for given in ([b, a, c], [a, c, b], [c, b, a]):
        with pytest.raises(UsageError, match="give the logs in order of time") as told:
            in_order(given)
        assert str(told.value).endswith(f"{a} {b} {c}")
    with pytest.raises(UsageError, match="begins 3 s before"):
        in_order([b, a])


def test_stamps_that_count_from_the_start_of_a_recording_have_no_order(tmp_path):
    frames = traffic(3.0)
    write_log(tmp_path / "a.log", [frames[frames.time_ns > SECOND]])
    write_log(tmp_path / "b.log", [frames])
    in_order([tmp_path / "a.log", tmp_path / "b.log"])
