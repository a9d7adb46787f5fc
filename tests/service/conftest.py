"""The bus of the live service, and the service as it is installed under systemd."""

import logging
import subprocess
import sys

import pytest

from bms_gateway.service import live, reloads
from tests.support.installed_service import CONFIG, LENT, ROOT, drop_in, install, sh
from tests.support.live_service import Bus
from tests.support.live_world import Fits, Saves, World


@pytest.fixture
def bus():
    bus = Bus()
    yield bus
    bus.close()


@pytest.fixture
def world(monkeypatch):
    """What is around the loop of the live service, in time that passes at once."""
    world = World()
    monkeypatch.setattr(live, "Fits", Fits)
    monkeypatch.setattr(live, "Saves", Saves)
    monkeypatch.setattr(live, "notify", world.notify)
    monkeypatch.setattr(reloads, "reloading", lambda: world.notify("RELOADING"))
    monkeypatch.setattr(live, "watchdog_s", lambda: world.watchdog_s)
    yield world
    for port in world.ports:
        port.close()


@pytest.fixture(scope="package")
def installed(tmp_path_factory):
    """The gateway, installed by its own script."""
    folder = tmp_path_factory.mktemp("wheel")
    sh(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", folder, ROOT)
    wheel = next(folder.glob("*.whl"))
    install(wheel)
    # the interpreter looks for its library where it was built, which may be hidden; the system's may be another version
    drop_in("lent", f"Environment=LD_LIBRARY_PATH={LENT}/python/lib")
    return wheel


@pytest.fixture
def pack(installed, tmp_path):
    """Traffic of a simulated pack on vcan0 in real time."""
    log = tmp_path / "pack.log"
    gateway = "/opt/bms-gateway/venv/bin/bms-gateway"
    sh(gateway, "simulate", "--config", CONFIG, "--out", log, "--duration", "600")
    player = subprocess.Popen([gateway, "replay", str(log), "--to", "vcan0"], stdout=subprocess.DEVNULL)
    yield log
    player.kill()
    player.wait()


@pytest.fixture
def package():
    """The package's logger; every test finds it as it was."""
    return logging.getLogger("bms_gateway")
