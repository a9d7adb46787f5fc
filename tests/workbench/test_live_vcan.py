"""The live page on a real interface: what it shows, and that it only listens."""

import http.client
import json
import subprocess
import sys
from urllib.parse import urlsplit

import numpy as np
import pytest

from bms_gateway.bus.replay import SocketCanSender
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.config import shipped
from tests.support.vehicle_traffic import traffic
from tests.workbench.browser import come
from tests.workbench.conftest import served

pytestmark = pytest.mark.vcan

PATIENCE_S = 60


@pytest.fixture
def vehicle():
    """A pack's traffic on vcan0, in its own time, until the test ends."""
    process = subprocess.Popen([sys.executable, "-c", SENDER])
    yield process
    process.kill()
    process.wait(PATIENCE_S)


SENDER = """
from bms_gateway.bus.replay import SocketCanSender, replay
from tests.support.vehicle_traffic import traffic
replay([traffic(300.0)], SocketCanSender("vcan0"))
"""


def pictures(url):
    """What the page is sent, one after the other."""
    connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=PATIENCE_S)
    connection.request("GET", "/api/watch?view=test")
    response = connection.getresponse()
    assert response.status == 200
    while line := response.readline():
        if line.startswith(b"data: "):
            yield json.loads(line.removeprefix(b"data: "))


def test_sixty_cells_of_a_live_bus_and_nothing_sent(vehicle, tmp_path):
    listener = SocketCanPort("vcan0")
    config = shipped("deploy/example/gateway.toml")  # which says transmit = true
    with served(tmp_path, "--live", "vcan0", "--config", config) as url:
        stream = pictures(url)
        shown = next(p for p in stream if p["ticks"] > 5)
        more = [next(stream) for _ in range(5)]
    cells = [x for s in shown["strings"] for x in s["core"]]
    assert len(cells) == 60
    assert all(x is not None and 0.0 < x < 90.0 for x in cells)
    assert shown["bus"]["link"] == "up"
    assert shown["bus"]["load"] > 0.5
    assert [p["at"] for p in more] == sorted(p["at"] for p in more)
    sent = set(np.unique(traffic(2.0).can_id).tolist())
    heard = set(np.unique(listener.drain().can_id).tolist())
    listener.close()
    assert heard
    assert heard <= sent


def test_an_interface_that_is_missing_is_told_and_awaited(tmp_path):
    subprocess.run(["ip", "link", "del", "vcan0"], check=True)
    try:
        with served(tmp_path, "--live", "vcan0", "--config", shipped("deploy/example/gateway.toml")) as url:
            stream = pictures(url)
            first = next(stream)
            assert first["ticks"] == 0
            assert first["link"] != "up"
            subprocess.run("ip link add vcan0 type vcan && ip link set vcan0 up", shell=True, check=True)
            sender = SocketCanSender("vcan0")
            frames = traffic(4.0)
            come(lambda: _send(sender, frames) and next(stream)["ticks"] > 1, "frames after the interface came")
            sender.close()
    finally:
        subprocess.run("ip link add vcan0 type vcan; ip link set vcan0 up", shell=True, check=True)


def _send(sender, frames) -> bool:
    sender.send(frames[:40])
    return True
