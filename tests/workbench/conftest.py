"""The workbench as a user starts it, and a browser; started once for a file of tests."""

import os
import re
import subprocess
import sys
import zipfile
from contextlib import contextmanager

import pytest

from tests.workbench.browser import Driver, why_none

AXE = "axe-playwright-python==0.1.8"
"""Ships axe-core's script; nothing else of it is used."""


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


@pytest.fixture(scope="session")
def axe(tmp_path_factory):
    """Text of axe-core, fetched anew: foreign code is not kept here."""
    folder = tmp_path_factory.mktemp("axe")
    command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", str(folder), AXE]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    wheel = next(folder.glob("*.whl"), None)
    if wheel is None:
        why = f"axe-core cannot be fetched: {found.stderr.strip().splitlines()[-1:]}"
        (pytest.fail if os.environ.get("CI") == "true" else pytest.skip)(why)
    with zipfile.ZipFile(wheel) as z:
        return z.read("axe_playwright_python/axe.min.js").decode()
