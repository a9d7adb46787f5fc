"""The workbench as a user starts it, and a browser; started once for a file of tests."""

import os
import re
import subprocess
import sys
from contextlib import contextmanager

import pytest

from tests.workbench.browser import Driver, why_none


@contextmanager
def served(folder, *words):
    """The program on a free port; gives its address."""
    command = [sys.executable, "-m", "bms_gateway", "workbench", "--port", "0", *map(str, words)]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with (folder / "workbench.err").open("w+") as err:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=err, text=True, env=environment)
        try:
            found = re.search(r"http://\S+", process.stdout.readline())
            err.seek(0)
            assert found, err.read()
            yield found[0]
        finally:
            process.terminate()
            process.wait(60)
            process.stdout.close()
            err.seek(0)
            assert "Traceback" not in (told := err.read()), told


@pytest.fixture(scope="session")
def driver(tmp_path_factory):
    why = why_none()
    if why and os.environ.get("CI") == "true":
        pytest.fail(why, pytrace=False)
    if why:
        pytest.skip(why)
    driver = Driver(tmp_path_factory.mktemp("browser"))
    yield driver
    driver.close()


@pytest.fixture
def window(driver):
    """Opens pages; they are closed after the test."""
    yield driver.window
    while driver.windows:
        driver.windows.pop().close()
