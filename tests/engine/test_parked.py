"""A parked vehicle through the engine: a short is told from frames that come rarely, over sleeps and restarts.

Temperatures are those of `heat_case`, voltages those of the tests of self-discharge: no code of the package.
"""

import json

import numpy as np
import pytest

from bms_gateway.bus.traffic import SECOND, Traffic, lines, steps
from bms_gateway.engine import Channel, Engine, Notice, Plan, StringPlan, drain
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.own_dbc import own_signal
from bms_gateway.thermal import StringModel
from tests.benchmarks.heat_case import CELLS, SENSORS, Case, make, model
from tests.engine.packs import EPOCH_S, database
from tests.health.nights import AH, night

HEATS = Case("small", 77, seconds=11000, drive="rest", fault="heat", cell=6, size=1.0, at=4000)


def plan(of: StringModel, voltages: bool = False) -> Plan:
    channels = [Channel("current", None, own_signal(1, "current"))]
    channels.append(Channel("coolant_inlet", None, own_signal(1, "coolant_inlet")))
    channels += [Channel("surface", c, own_signal(1, "surface", c)) for c in SENSORS]
    if voltages:
        channels += [Channel("cell_voltage", c, own_signal(1, "cell_voltage", c)) for c in range(1, CELLS + 1)]
    return Plan((StringPlan("string_1", 1, of, tuple(channels)),), transmit=False)


def parked(the_plan: Plan, feed: dict, wakes: list[tuple[int, int]], *, restarts: bool = False) -> tuple[Engine, list]:
    """Run an engine over stretches of traffic, with nothing between them; with `restarts` it is off in between."""
    source, engine, events = Traffic(the_plan, database()), Engine(the_plan, database()), []
    for a, b in wakes:
        if restarts and a != wakes[0][0]:
            kept = json.loads(json.dumps(engine.snapshot()))
            engine = Engine(the_plan, database())
            engine.restore(kept)
        f = source.between([feed], a * SECOND, b * SECOND)
        frames = FrameBatch(f.time_ns + EPOCH_S * SECOND, f.can_id, f.length, f.data)
        engine.receive(frames, now_ns=(EPOCH_S + b) * SECOND)
        engine.handle_timer(now_ns=(EPOCH_S + b + 70) * SECOND)
        events += drain(engine)
    return engine, events


def told(events: list, code: str) -> list[tuple[float, int | None]]:
    return [(e.time_ns / SECOND - EPOCH_S, e.cell) for e in events if isinstance(e, Notice) and e.code == code]


@pytest.fixture(scope="module")
def heated() -> dict:
    made = make([HEATS])[0]
    time = np.arange(HEATS.seconds, dtype=np.float64)
    feed = {("current", None): steps(time, made.current), ("coolant_inlet", None): lines(time, made.inlet)}
    return feed | {("surface", k): lines(time, made.y[:, k - 1]) for k in SENSORS}


@pytest.mark.parametrize("restarts", [False, True])
@pytest.mark.plain_cases(1)
def test_heat_of_a_night_is_told_at_the_first_wake_up_of_twenty_seconds_after_it_began(heated, restarts) -> None:
    wakes = [(k, k + 30) for k in range(0, 10900, 3600)]
    engine, events = parked(plan(model("small")), heated, wakes, restarts=restarts)
    found = told(events, "unexplained_heat")
    assert 7200 < found[0][0] <= 7240
    assert found[0][1] in (5, 6, 7)
    assert any(c.code == "unexplained_heat" for c in engine.strings[0].health.conditions())  # an hour later still


def test_heat_is_told_with_two_frames_where_they_come_every_five_minutes(heated) -> None:
    wakes = [(k, k + 1) for k in range(0, 6000, 300)]
    _, events = parked(plan(model("small")), heated, wakes)
    assert told(events, "unexplained_heat")[0][0] <= 4500 + 20


def test_a_cell_that_discharges_itself_is_told_over_sleeps_and_restarts() -> None:
    n = night(np.random.default_rng(21), 5.0, 0.08)
    of = StringModel(CELLS, SENSORS, "natural", model("small").priors, capacity_Ah=AH)
    feed = {("cell_voltage", k + 1): lines(n.time_s, n.V[:, k]) for k in range(CELLS)}
    feed |= {("current", None): steps(n.time_s, n.current)}
    feed |= {("coolant_inlet", None): lines(n.time_s, np.full(len(n.time_s), 25.0))}
    feed |= {("surface", k): lines(n.time_s, np.full(len(n.time_s), 25.0)) for k in SENSORS}
    wakes = [(1500, 1860), *((k, k + 20) for k in range(3600, 18000, 1800))]
    engine, events = parked(plan(of, voltages=True), feed, wakes, restarts=True)
    assert told(events, "self_discharge")[0][1] == 6
    change = next(c for c in engine.strings[0].health.conditions() if c.code == "self_discharge")
    assert change.cell == 6
    assert abs(change.facts["current_A"] - 0.08) < 2.0 * change.facts["current_sd_A"]
    assert "self_discharge_warning:6" in engine.strings[0].flags or "self_discharge_alarm:6" in engine.strings[0].flags
