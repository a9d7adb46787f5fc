"""Where tests run that need more than Python: a CAN interface, systemd as process 1.

Without them they are skipped, saying what to do. In the stage that exists for them (`CANVM_REQUIRED=1`, or CI inside
the guest of `tests/canvm`) a missing `vcan0` is a failure: tests that are never run must not look like tests that pass.
"""

import gc
import logging
import os
import socket
import sys
from functools import cache
from pathlib import Path

import pytest
from hypothesis import settings
from xdist.remote import Producer

from tests.support.by_file import ByFile
from tests.support.tables import PREFIX, Tables

# as the program does: on one thread, where two workers on two cores would spin four (read when numpy is loaded)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Compiled modules are kept: otherwise each worker compiles all tests, and each process that a test starts the package
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# no test fails because a machine is slow
settings.register_profile("any-machine", deadline=None)
settings.load_profile("any-machine")

# Tables of parsed DBC files are kept for this run alone, in its workers and in what tests start. The process that began
# the run makes and removes them: a worker may end without any clean-up.
_tables = None
if not Path(os.environ.get("CACHE_DIRECTORY", "")).name.startswith(PREFIX):
    _tables = Tables()
    os.environ["CACHE_DIRECTORY"] = str(_tables.folder)


def pytest_collection_finish() -> None:
    """Search what every test needs to the end for garbage once, and not once more in each test."""
    gc.collect()
    gc.freeze()


def pytest_unconfigure() -> None:
    if _tables is not None:
        _tables.close()


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


@pytest.hookimpl(tryfirst=True)  # before `-m` chooses
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Make the further cases of tests with `plain_cases` slow."""
    counts: dict[str, int] = {}
    for item in items:
        marker = item.get_closest_marker("plain_cases")
        if marker is not None:
            name = item.nodeid.partition("[")[0]
            counts[name] = counts.get(name, 0) + 1
            if counts[name] > marker.args[0]:
                item.add_marker(pytest.mark.slow)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """Half as many workers again as cores: a worker often waits for a process or a clock."""
    if config.option.numprocesses != "auto" or "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    return workers(len(os.sched_getaffinity(0)))


def workers(cores: int) -> int:
    return cores + cores // 2


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> ByFile | None:
    return ByFile(config, log) if config.getvalue("dist") == "loadgroup" else None


def pytest_runtest_setup(item: pytest.Item) -> None:
    for marker, why_not in (("vcan", why_no_vcan), ("systemd", why_no_systemd)):
        if item.get_closest_marker(marker) and (why := why_not()) is not None:
            if required():
                pytest.fail(why, pytrace=False)
            pytest.skip(why)


@pytest.fixture(autouse=True)
def _log_as_before():
    """A command that a test runs in this process sets the package's logger up: the next test finds it as it was."""
    logger = logging.getLogger("bms_gateway")
    before = logger.handlers[:], logger.level, logger.propagate
    yield
    for handler in logger.handlers:
        if handler not in before[0]:
            handler.close()
    logger.handlers[:], logger.propagate = before[0], before[2]
    logger.setLevel(before[1])
