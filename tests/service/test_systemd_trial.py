"""A state that ends the installed service, under a real systemd: run as `test_systemd` is."""

import os
import random
import subprocess
import time

import pytest

from tests.support.installed_service import CONFIG, STATE, UNIT, drop_in, journal, own_frames, prop, sh, until

pytestmark = [pytest.mark.systemd, pytest.mark.slow]

POISONED = """
import os, sys, time
from bms_gateway.cli.main import main
from bms_gateway.engine import Engine

def restored(engine, state, *, restore=Engine.restore, **more):
    restore(engine, state, **more)
    Engine._tick = {"abort": lambda *_: os.abort(), "hang": lambda *_: time.sleep(600)}[sys.argv[1]]

Engine.restore = restored
sys.exit(main(["run", "/etc/bms-gateway/gateway.toml"]))
"""


@pytest.fixture
def learnt(installed, pack):
    """A service that has estimated, was stopped and has left one state."""
    for file in STATE.resolve().glob("state*"):
        file.unlink()
    drop_in("test", "TimeoutStartSec=90s")
    sh("systemctl", "start", UNIT)
    until(lambda: len(own_frames(3).get("gateway_status", [])) >= 2, "our own frames on vcan0")
    sh("systemctl", "stop", UNIT)
    (STATE.resolve() / "state.previous").unlink(missing_ok=True)
    yield (STATE.resolve() / "state").read_bytes()
    subprocess.run(["systemctl", "stop", UNIT], check=False)
    subprocess.run(["systemctl", "reset-failed", UNIT], check=False)
    drop_in("test", None)
    drop_in("poisoned", None)


@pytest.mark.parametrize("how", ["abort", "hang"])
def test_a_state_that_ends_the_service_again_and_again_is_set_aside(learnt, how):
    (CONFIG.parent / "poisoned.py").write_text(POISONED)
    python = "/opt/bms-gateway/venv/bin/python"
    drop_in("poisoned", "ExecStart=", f"ExecStart={python} /etc/bms-gateway/poisoned.py {how}")
    begun, heard = time.monotonic(), []
    sh("systemctl", "start", "--no-block", UNIT)

    def lives():
        heard.append(len(own_frames(2).get("gateway_status", [])))
        return heard[-1] >= 2

    until(lambda: (STATE.resolve() / "state.crashed").exists() and lives(), "the service without its state", 300.0)
    print(f"crash loop ({how}): estimates after {time.monotonic() - begun:.1f} s, {prop('NRestarts')} restarts")
    assert prop("NRestarts") == "3"
    assert (STATE.resolve() / "state.crashed").read_bytes() == learnt
    until(lambda: prop("StatusText").startswith("WARNING: "), "the alert in the status line")
    assert "was kept as state.crashed" in prop("StatusText")
    assert "the service has ended 3 times soon after it was restored" in journal()


@pytest.mark.usefixtures("learnt")
def test_kills_at_random_moments_cost_no_state():
    rng = random.Random(1)
    drop_in("test", "TimeoutStartSec=90s")
    sh("systemctl", "start", UNIT)
    for _ in range(12):
        time.sleep(rng.uniform(0.0, 2.5))
        pid = int(prop("MainPID"))
        if pid:
            os.kill(pid, 9)
        until(lambda pid=pid: int(prop("MainPID")) not in (0, pid), "the restart")
    assert not list(STATE.resolve().glob("state.crashed*"))
    until(lambda: prop("ActiveState") == "active", "the last start")
    sh("systemctl", "stop", UNIT)
    assert not (STATE.resolve() / "state.trying").exists()
