"""A real Dask scheduler and two workers on loopback, one of which is killed with work in its hands."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from bms_gateway.cli.main import main
from tests.fleet.packs import logs
from tests.truth.hidden import Scenario

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 60.0
LOGS = 6


def come(wish, what):
    """Wait until the wish is fulfilled."""
    until = time.monotonic() + PATIENCE_S
    while not (found := wish()):
        assert time.monotonic() < until, f"waited {PATIENCE_S:g} s for {what}"
        time.sleep(0.1)
    return found


@pytest.fixture
def cluster(tmp_path):
    """Address of the scheduler and the processes of its workers, by name; all are ended."""
    place = tmp_path / "scheduler.json"
    environment = os.environ | {"PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__SCHEDULER__WORK_STEALING": "False"}
    made = []

    def dask(*words):
        log = (tmp_path / f"dask{len(made)}.log").open("w")
        made.append(
            subprocess.Popen(
                [sys.executable, "-m", "dask", *words], env=environment, stdout=log, stderr=log, cwd=tmp_path
            )
        )
        log.close()
        return made[-1]

    try:
        dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(place))
        address = come(lambda: place.exists() and place.read_text() and json.loads(place.read_text())["address"],
                       "the scheduler")  # fmt: skip
        # without a nanny, which would start a new worker in the place of a dead one
        workers = {
            name: dask("worker", address, "--name", name, "--nthreads", "1", "--no-nanny", "--no-dashboard",
                       "--host", "127.0.0.1", "--local-directory", str(tmp_path))
            for name in ("lost", "left")
        }  # fmt: skip
        yield address, workers
    finally:
        for process in made:
            process.send_signal(signal.SIGCONT)
            process.kill()
            process.wait()


class Cluster:
    """What the scheduler says of its workers."""

    def __init__(self, address):
        from distributed import Client

        self.client = Client(address, timeout=PATIENCE_S, set_as_default=False)

    def workers(self):
        return {w["name"]: a for a, w in self.client.scheduler_info(n_workers=-1)["workers"].items()}

    def in_hand(self, address):
        return len(self.client.processing([address]).get(address, ()))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
def test_a_worker_killed_with_work_in_its_hands_changes_nothing(tmp_path, cluster):
    address, workers = cluster
    config, made = logs(tmp_path, {f"v{k}": Scenario(seed=k, seconds=40) for k in range(LOGS)})
    words = ["fleet", *map(str, made), "--config", str(config)]
    seen = Cluster(address)
    with seen.client:
        come(lambda: len(seen.workers()) == 2, "two workers")
        lost = seen.workers()["lost"]
        workers["lost"].send_signal(signal.SIGSTOP)  # it takes work and finishes none, until it is killed
        status = []
        out = tmp_path / "cluster"
        run = threading.Thread(target=lambda: status.append(main([*words, "--out", str(out), "--scheduler", address])))
        run.start()
        try:
            come(lambda: seen.in_hand(lost), "work in the hands of the worker that will be lost")
            come(lambda: len(list((out / "logs").glob("*.parquet"))) > 0, "a log done by the other worker")
            assert run.is_alive()
            assert seen.in_hand(lost)
        finally:
            workers["lost"].kill()
        run.join(PATIENCE_S)
        assert not run.is_alive()
        assert status == [0]
        assert set(seen.workers()) == {"left"}
    assert main([*words, "--out", str(tmp_path / "local"), "--jobs", "1"]) == 0
    assert contents(tmp_path / "cluster") == contents(tmp_path / "local")
    assert len(contents(tmp_path / "local")) == LOGS + 2


def contents(out):
    return {str(f.relative_to(out)): f.read_bytes() for f in sorted(out.rglob("*")) if f.is_file()}


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
def test_a_scheduler_that_is_not_there_is_told_in_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("bms_gateway.fleet.pool.CONNECT_S", 0.5)
    config, made = logs(tmp_path, {"v": Scenario(seed=1, seconds=20)})
    words = ["fleet", str(made[0]), "--config", str(config), "--out", str(tmp_path / "out")]
    for address in ("tcp://127.0.0.1:1", "nonsense://x"):
        assert main([*words, "--scheduler", address]) == 2
        err = capsys.readouterr().err.splitlines()
        assert len(err) == 1
        assert f"--scheduler {address}: no Dask scheduler answers" in err[0]
