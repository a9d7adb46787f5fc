"""What runs beside the gateway follows the config, and a reload that would change it is refused."""

import json
import re

import pytest

from bms_gateway.bus.in_process import MemoryBus
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Engine
from bms_gateway.errors import ConfigError, MissingExtraError
from bms_gateway.health.alerts import Change, Condition, Severity
from bms_gateway.service import metrics, reporting
from bms_gateway.service.live import Gateway
from bms_gateway.service.reporting import accompany, same_beside
from tests.config.files import MAPPED, write

BROKER = '[mqtt]\nhost = "localhost"'


@pytest.fixture
def loaded(tmp_path):
    """Loads the example config with more at its end."""
    (tmp_path / "string.toml").write_text(shipped("deploy/example/string.toml").read_text())
    example = shipped("deploy/example/gateway.toml").read_text()

    def load(more=""):
        (tmp_path / "gateway.toml").write_text(f"{example}\n{more}\n")
        return load_config(tmp_path / "gateway.toml")

    return load


def parts(config):
    engine = Engine(config.plan, config.database)
    gateway = Gateway(engine, MemoryBus().port())
    watch = accompany(gateway, config, lambda: engine)
    return gateway, watch


def test_alerts_always_run_metrics_unless_off_and_mqtt_where_there_is_a_broker(loaded):
    assert list(parts(loaded())[0].beside) == ["alerts", "metrics"]
    assert list(parts(loaded('[metrics]\nlisten = "off"'))[0].beside) == ["alerts"]
    assert list(parts(loaded(BROKER))[0].beside) == ["alerts", "metrics", "mqtt"]


def test_the_settings_of_alerts_are_those_of_the_config(loaded):
    gateway, watch = parts(loaded("[alerts]\ngrace_s = 20.0\nhold_s = 1.0\nclear_s = 2.0\ncore_max_C = 55.0"))
    for alerts in (watch.alerts, watch.engine().alerts):
        assert (alerts.grace_s, alerts.hold_s, alerts.clear_s) == (20.0, 1.0, 2.0)
    assert gateway.engine.plan.alerts.core_max_C == 55.0
    assert gateway.summary() == "OK"


def test_a_change_of_the_alerts_is_told_to_systemd_at_once_and_to_the_broker(loaded):
    told = []
    change = Change(Condition("sensor", Severity.ALARM, "60 °C", "s1", 4), True)
    for more in ("", BROKER):
        gateway, watch = parts(loaded(more))
        gateway.tell_status = lambda: told.append("status")
        for listener in watch.listeners:
            listener(change)
        assert told == ["status"]
        told.clear()
    kind, message = gateway.beside["mqtt"].__self__.broker.spool.head()
    assert (kind, json.loads(message.payload)["text"]) == ("alert", "60 °C")


def test_the_metrics_are_those_of_what_runs_and_of_the_broker_where_there_is_one(loaded, monkeypatch):
    further = []
    monkeypatch.setattr(metrics, "Page", lambda gateway, engine, watch, more: further.append(more))
    parts(loaded())
    parts(loaded(BROKER))
    assert [len(more) for more in further] == [0, 1]
    assert "bms_gateway_mqtt_connected" in {family.name for call in further[1] for family in call()}


def test_mqtt_without_its_extra_is_one_line_with_the_command(loaded, monkeypatch):
    monkeypatch.setattr(reporting, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"gateway.toml: \[mqtt\] needs .* pip install 'bms-gateway\[mqtt\]'"):
        parts(loaded(BROKER))


@pytest.mark.parametrize("more", ['[metrics]\nlisten = "off"', "[alerts]\ngrace_s = 20.0", BROKER])
def test_a_reload_that_needs_another_neighbour_needs_a_restart(loaded, more):
    running = loaded()
    same_beside(running.config, loaded("[observer]\nheat_cell_W = 0.3").config, running.path)
    section = more.split("]")[0] + "]"
    with pytest.raises(ConfigError, match=rf"\{section[:-1]}\] has changed: restart the service"):
        same_beside(running.config, loaded(more).config, running.path)


@pytest.mark.parametrize(
    ("before", "after", "key"),
    [
        ('channel = "vcan0"', 'channel = "vcan1"', "bus.channel"),
        ('channel = "vcan0"', 'channel = "vcan0"\nreceive_buffer = 65536', "bus.receive_buffer"),
        ('interface = "socketcan"', 'interface = "virtual"', "bus.interface"),
        ('path = "state"', 'path = "elsewhere"', "[store]"),
        ('path = "state"', 'path = "state"\nrecent_MB = 1.0', "[store]"),
    ],
)
def test_a_reload_that_could_not_take_effect_needs_a_restart(tmp_path, before, after, key):
    running = load_config(write(tmp_path)).config
    assert before in MAPPED
    path = write(tmp_path, MAPPED.replace(before, after))
    with pytest.raises(ConfigError, match=rf"gateway.toml: {re.escape(key)} has changed: restart the service"):
        same_beside(running, load_config(path).config, path)
