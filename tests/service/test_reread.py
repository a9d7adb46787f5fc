"""A reload of whatever: the service goes on with the old configuration, or takes the new one."""

import asyncio
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bms_gateway.cli.run import continued
from bms_gateway.config import load_config
from bms_gateway.errors import ConfigError
from bms_gateway.service import reread as module
from bms_gateway.service.reread import reread
from tests.benchmarks.bench_start import SERVICE
from tests.config.files import DBC, MAPPED, write
from tests.config.hostile import HOSTILE, SLOW
from tests.config.model_texts import EXAMPLE

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 60.0
TELLS_ALL = "from bms_gateway.service.journal import Throttle; Throttle.filter = lambda *_: True"


@pytest.fixture(autouse=True)
def tables(tmp_path, monkeypatch):
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "tables"))


def test_what_a_child_reads_is_what_this_process_reads(tmp_path):
    path = write(tmp_path)
    found, loaded = asyncio.run(reread(path)), load_config(path)
    assert found.config == loaded.config
    assert found.engine() is not found.engine()
    assert found.engine().snapshot() == loaded.engine().snapshot()
    assert found.engine().sends == loaded.engine().sends
    assert (
        continued(found.engine, loaded.engine().snapshot(), None).can_ids.tolist() == loaded.engine().can_ids.tolist()
    )


def test_a_fault_of_the_files_comes_back_as_its_line(tmp_path):
    with pytest.raises(ConfigError, match=r"gateway.toml: bus.channel: must not be empty"):
        asyncio.run(reread(write(tmp_path, MAPPED.replace('"vcan0"', '""'))))


def test_a_child_that_comes_to_no_end_is_gone_before_the_refusal_is_told(tmp_path, monkeypatch):
    code = f"import os, time; open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    monkeypatch.setattr(module, "CHILD", (sys.executable, "-c", code))

    async def refused():
        for patience_s in (1.0, 10.0, PATIENCE_S):  # of a machine on which a start takes so long
            monkeypatch.setattr(module, "PATIENCE_S", patience_s)
            with pytest.raises(ConfigError, match="came to no end"):
                await reread(write(tmp_path))
            if (tmp_path / "pid").exists():
                break
        return Path("/proc", (tmp_path / "pid").read_text()).exists()

    assert asyncio.run(refused()) is False


def test_a_service_that_stops_ends_the_child(tmp_path, monkeypatch):
    code = f"import os, time; open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    monkeypatch.setattr(module, "CHILD", (sys.executable, "-c", code))

    async def stopped():
        task = asyncio.ensure_future(reread(write(tmp_path)))
        while not (tmp_path / "pid").exists() or not (tmp_path / "pid").read_text():
            await asyncio.sleep(0.02)
        task.cancel()
        await asyncio.wait([task])

    asyncio.run(stopped())
    pid = int((tmp_path / "pid").read_text())
    end = time.monotonic() + PATIENCE_S
    while Path(f"/proc/{pid}/exe").exists() and Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z":
        assert time.monotonic() < end
        time.sleep(0.02)


class Service:
    """`run` itself, with a socket pair for its CAN socket, and what it says."""

    def __init__(self, config: Path, folder: Path) -> None:
        self.told = folder / "stderr"
        self._notified = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._notified.bind(str(folder / "notify"))
        self._notified.settimeout(PATIENCE_S)
        environment = {**os.environ, "NOTIFY_SOCKET": str(folder / "notify"), "STATE_DIRECTORY": str(folder)}
        with self.told.open("wb") as err:
            words = [sys.executable, "-c", f"{TELLS_ALL}\n{SERVICE}", str(config)]
            self.process = subprocess.Popen(words, env=environment, cwd=ROOT, stderr=err)
        self.ready()

    def ready(self) -> None:
        while b"READY=1" not in self._notified.recv(4096):
            assert self.process.poll() is None, self.told.read_text()

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self._notified.close()

    def reload(self) -> str:
        """What is said from a SIGHUP until the service is ready again."""
        before = self.told.stat().st_size
        self.process.send_signal(signal.SIGHUP)
        self.ready()
        return self.told.read_bytes()[before:].decode()


def test_an_interrupt_ends_it_as_any_command_with_its_state_saved(tmp_path):
    service = Service(write(tmp_path, MAPPED + '\n[metrics]\nlisten = "off"\n'), tmp_path)
    try:
        service.process.send_signal(signal.SIGINT)
        assert service.process.wait(PATIENCE_S) == 130
        said = service.told.read_text()
        assert (said.splitlines()[-1], "Traceback" in said) == ("bms-gateway: stopped", False)
        assert (tmp_path / "state" / "state").exists()
    finally:
        service.close()


@pytest.mark.slow
def test_no_file_stops_the_service_that_runs(tmp_path):
    more = '\n[metrics]\nlisten = "off"\n'
    sound = MAPPED + more
    path = write(tmp_path, sound)
    service = Service(path, tmp_path)
    try:
        for name, ((config, model, dbc), _) in {**HOSTILE, "slow": SLOW["200,000 tables"]}.items():
            write(tmp_path, config if config != MAPPED else sound, model)
            (tmp_path / "vehicle.dbc").write_text(dbc)
            said = service.reload()
            assert re.search(r"not reloaded, going on as before: \S+", said), (name, said)
            assert "Traceback" not in said
            assert said.count("\n") == 1
        write(tmp_path, sound.replace('method = "window"', 'method = "off"'), EXAMPLE)
        (tmp_path / "vehicle.dbc").write_text(DBC)
        assert service.reload().rstrip().endswith("reloaded")
        service.process.send_signal(signal.SIGTERM)
        assert service.process.wait(PATIENCE_S) == 0, service.told.read_text()
        assert (tmp_path / "state" / "state").exists()
    finally:
        service.close()
