"""What the service tells of a bus, `analyze` tells of its log: the same alerts at the same times."""

import json

import numpy as np
import pytest

from bms_gateway.bus.in_process import MemoryBus
from bms_gateway.bus.logfile import read_log, write_log
from bms_gateway.cli.main import main
from bms_gateway.config import load_config, shipped
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.own_dbc import input_messages
from bms_gateway.service.live import Gateway
from bms_gateway.service.watch import Watch

S = 1_000_000_000
FAULTS = (("string_1_surface", 15, 60), ("string_1_electrical", 40, 70), ("string_1_coolant", 0, 30), (None, 85, 110))
"""Messages that are missing, and from when to when, s; None: all of them."""


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Config of one string, and a log in which messages are missing for some time."""
    folder = tmp_path_factory.mktemp("drive")
    head, one, *_ = shipped("deploy/example/gateway.toml").read_text().split("[[string]]\nname")
    config, whole, log = folder / "gateway.toml", folder / "whole.log", folder / "faulty.log"
    config.write_text(
        f"{head}[[string]]\nname{one}\n[alerts]\nhold_s = 2.0\nclear_s = 5.0\ncore_max_C = 20.0\nsurface_max_C = 90.0\n"
    )
    (folder / "string.toml").write_text(shipped("deploy/example/string.toml").read_text())
    assert main(["simulate", "--config", str(config), "--out", str(whole), "--duration", "130"]) == 0
    frames, database = FrameBatch.concat(list(read_log(whole))), load_config(config).database
    since = (frames.time_ns - frames.time_ns[0]) / S
    keep = np.ones(len(frames), bool)
    for message, start, end in FAULTS:
        ids = [database.message(m).can_id for m in input_messages(1) if message in (m, None)]
        keep &= ~(np.isin(frames.can_id, ids) & (since >= start) & (since < end))
    kept = FrameBatch(frames.time_ns[keep], frames.can_id[keep], frames.length[keep], frames.data[keep])
    write_log(log, [kept], "vcan0")
    return config, log, kept


def served(config, frames, seed):
    """Alerts of the service, whose bus gives frames in lumps of any size and whose timers fall between them."""
    loaded = load_config(config)
    engine = loaded.engine()
    gateway = Gateway(engine, MemoryBus().port())
    watch = Watch(gateway, lambda: engine, channel="vcan0", settings=loaded.plan.alerts)
    told = []
    watch.listeners.append(told.append)
    rng, at = np.random.default_rng(seed), 0
    while at < len(frames):
        end = min(at + int(rng.integers(1, 60)), len(frames))
        engine.receive(frames[at:end], now_ns=int(frames.time_ns[end - 1]))
        gateway.put_out()
        if end < len(frames) and rng.random() < 0.5:
            engine.handle_timer(now_ns=int(frames.time_ns[end]) - 1)
            gateway.put_out()
        at = end
    return [(c.state, c.condition) for c in told]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.plain_cases(1)
def test_a_log_gives_the_alerts_that_the_live_bus_gave(drive, tmp_path, seed):
    config, log, frames = drive
    assert main(["analyze", str(log), "--config", str(config), "--out", str(tmp_path)]) == 0
    lines = [json.loads(line) for line in (tmp_path / "alerts.jsonl").read_text().splitlines()]
    live = served(config, frames, seed)
    assert [(x["state"], x["name"], x["severity"], x["string"], x["cell"], x["text"]) for x in lines] == [
        (state, c.name, c.severity.name.lower(), c.string, c.cell, c.text) for state, c in live
    ]
    states = {(x["name"], x["state"]) for x in lines}
    assert {("sensor", "raised"), ("sensor", "over"), ("core", "raised"), ("unheard", "raised")} <= states


def test_alerts_are_timed_like_estimates_and_each_is_raised_before_it_is_over(drive, tmp_path):
    config, log, frames = drive
    assert main(["analyze", str(log), "--config", str(config), "--out", str(tmp_path)]) == 0
    rows = (tmp_path / "estimates.csv").read_text().splitlines()[1:]
    ticks = {float(row.split(",")[0]) for row in rows}
    up = set()
    for line in (tmp_path / "alerts.jsonl").read_text().splitlines():
        x = json.loads(line)
        assert x["time_s"] in ticks
        key = x["name"], x["string"], x["text"].removeprefix("no longer so: ").split(" ")[0]
        assert (key in up) is (x["state"] != "raised")
        (up.discard if x["state"] == "over" else up.add)(key)
    assert frames.time_ns[0] / S + 10 <= min(
        json.loads(line)["time_s"] for line in (tmp_path / "alerts.jsonl").read_text().splitlines()
    )
