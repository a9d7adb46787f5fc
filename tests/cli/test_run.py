"""`run`: what a reload takes over and what it refuses."""

import asyncio
import errno
import gc
import json
import logging
import os
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log
from bms_gateway.bus.socketcan import RECEIVE_BUFFER
from bms_gateway.cli.main import main
from bms_gateway.cli.run import continued, reloaded, saver, started
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Decoded, Estimated, drive
from bms_gateway.errors import ConfigError, StateError
from bms_gateway.store import StateStore
from bms_gateway.store.recent import Recent

LOG = logging.getLogger("test")


@pytest.fixture
def running(tmp_path):
    """Config file, and an engine that has estimated with it for half a minute."""
    for name in ("gateway.toml", "string.toml"):
        (tmp_path / name).write_text(shipped(f"deploy/example/{name}").read_text())
    config, log = tmp_path / "gateway.toml", tmp_path / "drive.log"
    assert main(["simulate", "--config", str(config), "--out", str(log), "--duration", "30"]) == 0
    engine = load_config(config).engine()
    *_, newest = (e for e in drive(engine, read_log(log)) if isinstance(e, Estimated))
    last = list(newest.strings())
    return config, engine, last


def test_the_service_asks_for_the_receive_buffer_that_install_allows_and_the_documents_name(tmp_path):
    """2.2 s of a full 1 Mbit/s bus, 8,500 frames/s, of which the kernel charges 896 bytes each to half of this."""
    example = shipped("deploy/example/gateway.toml").read_text()
    (tmp_path / "gateway.toml").write_text(example)
    (tmp_path / "string.toml").write_text(shipped("deploy/example/string.toml").read_text())
    asked = load_config(tmp_path / "gateway.toml").config.bus.receive_buffer
    assert pytest.approx(2 * asked / 896 / 8_500, abs=0.01) == 2.2
    deploy = Path(__file__).resolve().parents[2] / "deploy"
    assert asked == RECEIVE_BUFFER
    assert f"\n# receive_buffer = {asked} " in example
    assert f"\nbuffer={asked}\n" in (deploy / "install.sh").read_text()
    assert f"net.core.rmem_max to {asked} " in (deploy / "prometheus" / "rules.yml").read_text()


def test_a_reload_goes_on_with_the_temperatures_there_are(running):
    config, engine, last = running
    config.write_text(config.read_text().replace("# [observer]", "[observer]\nheat_cell_W = 0.3\n#"))
    fresh = asyncio.run(reloaded(config, engine, LOG))
    assert fresh is not engine
    assert fresh.snapshot()["tick_end_ns"] == engine.snapshot()["tick_end_ns"] == last[0].time_ns
    assert str(fresh.snapshot()["estimators"]) == str(engine.snapshot()["estimators"])


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("transmit = true", "transmit = yes", "not valid TOML"),
        ("transmit = true", "transmit = false", "restart the service"),
        ('name = "string_5"\nmodel = "string.toml"', 'name = "string_5"\nmodel = "strin.toml"', "did you mean"),
    ],
)
@pytest.mark.plain_cases(1)
def test_a_reload_of_a_wrong_config_is_refused(running, before, after, says):
    config, engine, _ = running
    text = config.read_text()
    assert before in text
    config.write_text(text.replace(before, after))
    with pytest.raises(ConfigError, match=says):
        asyncio.run(reloaded(config, engine, LOG))


def test_a_state_that_does_not_fit_gives_a_fresh_engine_and_a_line(running, caplog):
    config, engine, _ = running
    state = engine.snapshot()
    state["estimators"]["observers"][0]["state"]["own"]["J"] = 3
    with caplog.at_level(logging.WARNING):
        fresh = continued(load_config(config).engine, state, LOG)
    assert "starting from the model files" in caplog.text
    assert all(np.isnan(s.core).all() for s in fresh.strings)


@pytest.mark.parametrize("seconds", ["-1", "0", "nan"])
def test_a_time_to_run_that_is_none_is_refused(running, capsys, seconds):
    assert main(["run", str(running[0]), "--seconds", seconds]) == 2
    assert "--seconds" in capsys.readouterr().err


def test_a_start_takes_the_newest_state_that_is_possible(running, tmp_path, caplog):
    config, engine, _ = running
    store, loaded = StateStore(tmp_path / "lib"), load_config(config)
    good = json.loads(json.dumps(engine.snapshot()))
    bad = json.loads(json.dumps(good))
    bad["estimators"]["observers"][0]["state"]["state"]["x"][0][0] = 5000.0
    for n, state in enumerate((good, bad)):
        assert store.save(state, wall_ns=n) is None
    with caplog.at_level(logging.WARNING):
        begun = started(loaded, store, LOG)
    assert "5000 °C" in caplog.text
    assert "state.refused" in caplog.text
    assert begun.snapshot()["tick_end_ns"] == good["tick_end_ns"]
    assert str(begun.snapshot()["estimators"]) == str(good["estimators"])
    store.save(bad, wall_ns=3)
    (tmp_path / "lib" / "state.previous").unlink(missing_ok=True)
    with caplog.at_level(logging.WARNING):
        begun = started(loaded, store, LOG)
    assert "starting from the model files" in caplog.text
    assert begun.snapshot()["tick_end_ns"] is None


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS, errno.EIO])
@pytest.mark.plain_cases(1)
def test_estimates_go_on_where_nothing_can_be_written(running, tmp_path, monkeypatch, code):
    """Every write is refused, save after save: each is told in one line, and estimates are the same to the bit."""
    config, _, _ = running
    loaded = load_config(config)
    log = tmp_path / "drive.log"
    outcomes = []
    for refused in (False, True):
        engine = started(loaded, None, LOG)
        engine.recording = True
        store = StateStore(tmp_path / f"lib{refused}")
        recent = Recent(store.directory / "recent", 1.0)
        save = saver(store, recent)
        lines, estimates = [], []
        with monkeypatch.context() as m:
            if refused:

                def write(handle, data, code=code):
                    raise OSError(code, os.strerror(code))

                m.setattr(os, "write", write)
            for event in drive(engine, read_log(log)):
                if isinstance(event, Decoded):
                    recent.add(event, engine)
                    try:
                        save(engine.snapshot())
                    except StateError as e:
                        lines.append(str(e))
                elif isinstance(event, Estimated):
                    estimates.append(event.core.tobytes())
        outcomes.append(estimates)
        assert len(lines) == (29 if refused else 0)
        assert all("estimates go on" in x and "\n" not in x for x in lines)
        assert (store.load().state is None) == refused
    assert outcomes[0] == outcomes[1]


def test_what_a_start_made_is_not_looked_through_for_garbage_while_frames_come(tmp_path, monkeypatch):
    for name in ("gateway.toml", "string.toml"):
        (tmp_path / name).write_text(shipped(f"deploy/example/{name}").read_text())
    config = tmp_path / "gateway.toml"
    text = config.read_text().replace('interface = "socketcan"', 'interface = "virtual"')
    config.write_text(text + '\n[metrics]\nlisten = "off"\n')
    seen, served = [], asyncio.run

    def run(work):
        seen.append((gc.isenabled(), gc.get_freeze_count() > 0))
        return served(work)

    monkeypatch.setattr(asyncio, "run", run)
    monkeypatch.setenv("STATE_DIRECTORY", "")
    assert main(["run", str(config), "--seconds", "0.2"]) == 0
    assert seen == [(True, True)]
    assert (gc.isenabled(), gc.get_freeze_count()) == (True, 0)
    config.write_text("bus = 5\n")
    assert main(["run", str(config)]) == 2
    assert (gc.isenabled(), gc.get_freeze_count()) == (True, 0)
