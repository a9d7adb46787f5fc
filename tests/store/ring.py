"""A ring written as the service writes it, from traffic driven through the engine."""

import re
from pathlib import Path

from bms_gateway.bus.logfile import read_log
from bms_gateway.cli.main import main
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Decoded, Engine, drive
from bms_gateway.store.recent import Recent
from tests.engine.packs import database, plan, traffic


def recorded(folder: Path, *, seconds=240, megabytes=64.0, every=60, strings=2, shift_ns=0, seed=1):
    """Drive traffic, writing a block every so many ticks; the events."""
    frames = traffic(seconds, seed, strings)
    frames.time_ns[:] += shift_ns
    return _kept(Engine(plan(strings), database()), [frames], Recent(folder, megabytes), every)


def drove(folder: Path, seconds: int) -> None:
    """Make a gateway's folder: config of two strings, a simulated drive as a log, and in `lib` the ring kept of it."""
    text = shipped("deploy/example/gateway.toml").read_text()
    text = text[: text.index('[[string]]\nname = "string_3"')] + '\n[store]\npath = "lib"\n'
    (folder / "gateway.toml").write_text(text)
    model = shipped("deploy/example/string.toml").read_text()
    (folder / "string.toml").write_text(re.sub(r"cells = 12", "cells = 4", model).replace("[1, 12]", "[1, 4]"))
    config, log = folder / "gateway.toml", folder / "drive.log"
    assert main(["simulate", "--config", str(config), "--out", str(log), "--duration", str(seconds)]) == 0
    loaded = load_config(config)
    _kept(Engine(loaded.plan, loaded.database), read_log(log), Recent(loaded.store / "recent", 8.0))


def _kept(engine, batches, ring, every=60):
    engine.recording = True
    events = []
    for event in drive(engine, batches):
        if isinstance(event, Decoded):
            events.append(event)
            ring.add(event, engine)
            if len(events) % every == 0:
                assert ring.flush() is None
    assert ring.flush() is None
    return events
