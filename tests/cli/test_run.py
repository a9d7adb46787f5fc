"""`run`: what a reload takes over and what it refuses."""

import logging

import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log
from bms_gateway.cli.main import main
from bms_gateway.cli.run import engine_of, reloaded
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Estimated, drive
from bms_gateway.errors import ConfigError

LOG = logging.getLogger("test")


@pytest.fixture
def running(tmp_path):
    """Config file, and an engine that has estimated with it for half a minute."""
    for name in ("gateway.toml", "string.toml"):
        (tmp_path / name).write_text(shipped(f"deploy/example/{name}").read_text())
    config, log = tmp_path / "gateway.toml", tmp_path / "drive.log"
    assert main(["simulate", "--config", str(config), "--out", str(log), "--duration", "30"]) == 0
    engine = engine_of(load_config(config), None, LOG)
    last = [e for e in drive(engine, read_log(log)) if isinstance(e, Estimated)][-5:]
    return config, engine, last


def test_a_reload_goes_on_with_the_temperatures_there_are(running):
    config, engine, last = running
    config.write_text(config.read_text().replace("# [observer]", "[observer]\nheat_cell_W = 0.3\n#"))
    fresh = reloaded(config, engine, LOG)
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
def test_a_reload_of_a_wrong_config_is_refused(running, before, after, says):
    config, engine, _ = running
    text = config.read_text()
    assert before in text
    config.write_text(text.replace(before, after))
    with pytest.raises(ConfigError, match=says):
        reloaded(config, engine, LOG)


def test_a_state_that_does_not_fit_gives_a_fresh_engine_and_a_line(running, caplog):
    config, engine, _ = running
    state = engine.snapshot()
    state["estimators"]["observers"][0]["state"]["own"]["J"] = 3
    with caplog.at_level(logging.WARNING):
        fresh = engine_of(load_config(config), state, LOG)
    assert "starting from the model files" in caplog.text
    assert all(np.isnan(s.core).all() for s in fresh.strings)


@pytest.mark.parametrize("seconds", ["-1", "0", "nan"])
def test_a_time_to_run_that_is_none_is_refused(running, capsys, seconds):
    assert main(["run", str(running[0]), "--seconds", seconds]) == 2
    assert "--seconds" in capsys.readouterr().err
