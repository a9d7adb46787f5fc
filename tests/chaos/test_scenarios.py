"""Every fault of the bench, on a bus inside this process: each has its reaction, and each is recovered from."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.chaos.catalogue import Chaos
from bms_gateway.chaos.scenario import judge
from bms_gateway.chaos.stepped import SteppedBench
from bms_gateway.config import load_config, shipped
from bms_gateway.engine.inputs import Inputs
from bms_gateway.errors import UsageError
from bms_gateway.service.http import MetricsServer
from bms_gateway.store import trial
from tests.chaos.bench import LONG, config
from tests.config.files import MAPPED, write

WITHOUT_FLOW = MAPPED.replace('coolant_flow = "Pack.Flow"\n', "")
NEEDS_KERNEL = {"down-up", "removed", "burst", "stall"}
SERVICE = {"fit-hangs", "disk-hangs", "state-unreadable", "config-garbage", "metrics-idle", "broker-huge"}
STATES = {"crash-loop", "state-torn", "state-bomb"}
REAL_TIME = {"bus-off", "transmit-queue-full", "impostor", "full-load"} | SERVICE
# what a vehicle has to survive, by the name of the scenario that shows it
ASKED = {
    *("bus-off", "down-up", "removed", "transmit-queue-full", "full-load", "burst", "wrong-dlc"),
    *("unknown-multiplexer", "crc", "counter", "duplicated", "reordered", "stamps-backwards", "stamps-future"),
    *("clock-forward", "clock-back", "clock-1970", "inlet-missing", "restart", "parked-minutes", "parked-hours"),
    *("stall", *SERVICE, *STATES),
    *("impostor", "irrelevant-only", *LONG, "thermocouple-open", "thermocouple-short"),
}


@pytest.fixture(scope="module")
def chaos(tmp_path_factory: pytest.TempPathFactory) -> Chaos:
    loaded = load_config(config(tmp_path_factory.mktemp("chaos")))
    return Chaos(loaded.plan, loaded.database)


def test_the_catalogue_has_every_fault_that_was_asked_for(chaos):
    assert set(chaos.scenarios) >= ASKED
    assert {name for name, s in chaos.scenarios.items() if s.unfit and s.kind != "heat"} == NEEDS_KERNEL
    assert all(s.expected or name == "full-load" for name, s in chaos.scenarios.items())


SHORT = sorted(ASKED - NEEDS_KERNEL - REAL_TIME - LONG | {"stamps-equal", "stamps-jumbled", "foreign-load"})
SHORT = SHORT[::3] + SHORT[1::3] + SHORT[2::3]  # so that the plain cases are of every kind


@pytest.mark.parametrize("name", SHORT)
@pytest.mark.plain_cases(8)
def test_it_reacts_as_expected_and_recovers(chaos, name):
    outcome = chaos.run(name)
    assert outcome.tried
    assert outcome.holds, outcome


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(LONG | SERVICE | {"impostor", "transmit-queue-full"}))
def test_it_reacts_as_expected_and_recovers_where_that_takes_longer(chaos, name):
    outcome = chaos.run(name)
    assert outcome.tried
    assert outcome.holds, outcome


@pytest.mark.slow
@pytest.mark.parametrize("seed", [9, 10])
def test_a_thermocouple_that_freezes_soon_after_a_start_moves_no_core_out_of_its_band(seed):
    """It stands where the inlet swings: believed for five minutes it moved cores by 4 K, four standard deviations."""
    loaded = load_config(shipped("deploy/example/gateway.toml"))
    chaos = Chaos(loaded.plan, loaded.database, seed=seed)
    record = SteppedBench(loaded.plan, loaded.database, seed=seed).record(chaos.scenarios["thermocouple-stuck"])
    worst = max(float(np.nanmax(np.abs(s.error[:12]))) for s in record.since())
    before = max(float(np.nanmax(np.abs(s.error[:12]))) for s in record.seen if 60.0 < s.time_s <= record.start_s)
    assert judge(chaos.scenarios["thermocouple-stuck"], record).holds
    assert worst < before + 0.5


def test_a_gateway_that_does_not_react_fails(chaos, monkeypatch):
    monkeypatch.setattr(Inputs, "changes", lambda self, t1: [])
    outcome = chaos.run("wrong-dlc")
    assert not outcome.holds
    assert "is not used…) NOT SEEN" in outcome.seen


def test_a_gateway_that_starts_for_ever_with_a_state_that_ends_it_fails(chaos, monkeypatch):
    monkeypatch.setattr(trial, "NOTED_MOST", 1000)
    outcome = chaos.run("crash-loop")
    assert not outcome.holds
    assert outcome.recovered_s is None
    assert "set_aside NOT SEEN" in outcome.seen


@pytest.mark.slow
def test_a_page_that_is_not_answered_fails(chaos, monkeypatch):
    monkeypatch.setattr(MetricsServer, "answer", lambda self, head: b"")
    outcome = chaos.run("metrics-idle")
    assert not outcome.holds
    assert "scrapes NOT SEEN" in outcome.seen


def test_a_gateway_that_believes_a_shorted_thermocouple_fails(chaos, monkeypatch):
    scenario = chaos.scenarios["thermocouple-open"]
    monkeypatch.setitem(scenario.injection.values, ("surface", 1), lambda t, v: v + 2.0 * (t - t[0] >= 0))
    outcome = chaos.run("thermocouple-open")  # an offset of 2 K has no rail and makes no jump
    assert not outcome.holds


def test_a_recovery_that_takes_longer_than_allowed_fails(chaos, monkeypatch):
    hasty = replace(chaos.scenarios["thermocouple-open"], recovers_s=1.0)
    monkeypatch.setitem(chaos.scenarios, "thermocouple-open", hasty)
    outcome = chaos.run("thermocouple-open")
    assert None not in outcome.reacted_s
    assert not outcome.holds


def test_a_core_outside_its_band_fails(chaos, monkeypatch):
    monkeypatch.setattr("bms_gateway.chaos.observed_run.SLACK_K", 0.0)
    monkeypatch.setattr("bms_gateway.chaos.observed_run.BAND", 0.01)
    outcome = chaos.run("crc")
    assert not outcome.in_band
    assert not outcome.holds


@pytest.mark.slow
def test_a_vehicles_own_dbc_is_broken_too_and_what_it_lacks_is_said(tmp_path):
    loaded = load_config(write(tmp_path, WITHOUT_FLOW))
    chaos = Chaos(loaded.plan, loaded.database)
    others = {name: s for name, s in chaos.scenarios.items() if s.kind != "heat" and name not in NEEDS_KERNEL}
    unfit = {name: s.unfit for name, s in others.items() if s.unfit}
    assert unfit == dict.fromkeys(("crc", "counter", "duplicated"), "its messages have neither check sum nor counter")
    for name in ("thermocouple-open", "thermocouple-short", "wrong-dlc", "unknown-multiplexer"):
        assert chaos.run(name).holds, chaos.run(name)


def test_a_string_whose_voltage_nobody_sends_cannot_contradict_its_current(tmp_path):
    without = WITHOUT_FLOW.replace('voltage = "Pack.Voltage"\n', "").replace('"Pack.InletF"', "{ constant_C = 25.0 }")
    loaded = load_config(write(tmp_path, without))
    chaos = Chaos(loaded.plan, loaded.database)
    assert "nothing contradicts a current" in chaos.scenarios["current-stuck"].unfit
    assert chaos.scenarios["inlet-missing"].unfit == "the config has no coolant inlet from the bus"
    assert chaos.run("current-end-of-range").holds
    assert chaos.run("current-stuck").seen.startswith("not tried: ")


def test_a_config_whose_signals_cannot_carry_the_pack_is_told_from_a_fault(tmp_path):
    loaded = load_config(write(tmp_path))  # its flow ends at 25 l/min, the pack has 570
    outcome = Chaos(loaded.plan, loaded.database).run("thermocouple-open")
    assert not outcome.holds
    assert "wrong BEFORE THE FAULT" in outcome.seen


def test_a_misspelt_scenario_is_told_with_the_nearest(chaos):
    with pytest.raises(UsageError, match="--scenario parked-hour: no such scenario; did you mean 'parked-hours'"):
        chaos.choose(["parked-hour"])
    assert chaos.choose([]) == list(chaos.scenarios)
    assert chaos.choose(["crc", "bus-off", "crc"]) == ["crc", "bus-off"]
