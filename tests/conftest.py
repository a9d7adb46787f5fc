"""Where tests run that need more than Python: a CAN interface, systemd as process 1.

Without them they are skipped, saying what to do. In the stage that exists for them (`CANVM_REQUIRED=1`, or CI inside
the guest of `tests/canvm`) a missing `vcan0` is a failure: tests that are never run must not look like tests that pass.
"""

import os
import socket
import tempfile
from functools import cache
from pathlib import Path

import pytest
from hypothesis import settings
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling

# as the program does: on one thread, where two workers on two cores would spin four (read when numpy is loaded)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# no test fails because a machine is slow
settings.register_profile("any-machine", deadline=None)
settings.load_profile("any-machine")

# tables of parsed DBC files are kept for this run alone, here and in what tests start
_tables = tempfile.TemporaryDirectory(prefix="bms-gateway-tables-")
os.environ["CACHE_DIRECTORY"] = _tables.name


def required() -> bool:
    in_guest_of_ci = os.environ.get("CI") == "true" and os.environ.get("CANVM") == "1"
    return os.environ.get("CANVM_REQUIRED") == "1" or in_guest_of_ci


@cache
def why_no_vcan() -> str | None:
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as sock:
            sock.bind(("vcan0",))
    except (OSError, AttributeError) as error:
        return f"no vcan0 here ({error}): tests/canvm/canvm python -m pytest -m vcan"
    return None


@cache
def why_no_systemd() -> str | None:
    if Path("/proc/1/comm").read_text().strip() != "systemd" or os.geteuid() != 0:
        return "systemd is not process 1, or this is not root: CANVM_MODE=systemd tests/canvm/canvm … -m systemd"
    return why_no_vcan()


@cache
def shares_vcan0(file: Path) -> bool:
    text = file.read_text(encoding="utf-8")
    return "mark.vcan" in text or "mark.systemd" in text


class ByFile(LoadScopeScheduling):
    """Keeps a file's tests on one worker, for its fixtures, and all files that share the one vcan0 on one.

    xdist's own groups are words put behind a test's id, which pytest 9.2 does not take any more.
    """

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        return "vcan0" if shares_vcan0(Path(self.config.rootpath) / file) else file


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> ByFile | None:
    return ByFile(config, log) if config.getvalue("dist") == "loadgroup" else None


def pytest_runtest_setup(item: pytest.Item) -> None:
    for marker, why_not in (("vcan", why_no_vcan), ("systemd", why_no_systemd)):
        if item.get_closest_marker(marker) and (why := why_not()) is not None:
            if required():
                pytest.fail(why, pytrace=False)
            pytest.skip(why)
