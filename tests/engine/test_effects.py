"""Strings whose model holds effects, in the engine: same stream however frames are cut, restart, identification."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.engine import Cells, Channel, Engine, Estimated, Notice, Parameters, Plan, drain, drive
from bms_gateway.engine.sent_values import STATUS_CODES
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.own_dbc import own_signal
from bms_gateway.frames.quality import Quality
from bms_gateway.thermal import AddedEffect
from tests.engine.packs import EPOCH_S, cut, database, plan, text, traffic

S = 1_000_000_000
FALLING = AddedEffect("resistance_temperature", None, {"B": 3000.0}, {"B": 300.0})
SLOW = AddedEffect("polarization", None, {"R_1": 1e-3, "tau": 60.0}, {"R_1": 1e-4, "tau": 0.2})
COOLED = AddedEffect("natural_convection", None, {"n": 0.2}, {"n": 0.02})
LATE = AddedEffect("coolant_delay", None, {"tau": 20.0}, {"tau": 4.0})


def with_effects(*effects: AddedEffect, rel_sd: float = 0.3) -> Plan:
    """String 1 with effects and the charge on the bus, string 2 as ever."""
    one, two = plan(rel_sd=rel_sd).strings
    soc = Channel("soc", None, own_signal(1, "soc"))
    one = replace(one, model=replace(one.model, effects=effects), channels=(*one.channels, soc))
    return Plan((one, two))


def engine(*effects: AddedEffect) -> Engine:
    return Engine(with_effects(*(effects or (FALLING, SLOW, LATE))), database())


def estimates(events: list, string: str = "string_1") -> list[Cells]:
    return [s for e in events if isinstance(e, Estimated) for s in e.strings() if s.string == string]


FRAMES = traffic(75)


def test_the_stream_does_not_depend_on_how_frames_are_cut() -> None:
    whole = text(list(drive(engine(), [FRAMES])))
    rng = np.random.default_rng(1)
    assert text(list(drive(engine(), cut(FRAMES, rng.integers(0, len(FRAMES), 40).tolist())))) == whole
    live, out = engine(), []
    for i in range(len(FRAMES)):
        t = int(FRAMES.time_ns[i])
        while (deadline := live.next_deadline()) is not None and deadline <= t:
            live.handle_timer(now_ns=t)
        live.receive(FRAMES[i : i + 1], now_ns=t)
        out += list(drain(live))
    assert text(out) == whole


def test_a_string_without_effects_does_not_notice_its_neighbours() -> None:
    alone = Plan((plan().strings[1],))
    beside = estimates(list(drive(engine(), [FRAMES])), "string_2")
    by_itself = estimates(list(drive(Engine(alone, database()), [FRAMES])), "string_2")
    assert text(beside) == text(by_itself)


def test_every_core_has_a_band_or_is_not_available() -> None:
    for e in estimates(list(drive(engine(), [FRAMES]))):
        assert (np.isfinite(e.core) == np.isfinite(e.core_sd)).all()
        assert (np.isnan(e.core) == (e.quality == Quality.NOT_AVAILABLE)).all()


def test_a_restart_with_no_time_in_between_goes_on_bit_for_bit() -> None:
    """Memories and sensitivities too; guards and the inlet's line start anew, so their signals are constant here."""
    half = int(np.searchsorted(FRAMES.time_ns, (EPOCH_S + 40) * S))
    one = engine()
    before = estimates(list(drive(one, [FRAMES[:half]])))[-1]
    two = engine()
    two.restore(json.loads(json.dumps(one.snapshot(), allow_nan=False)))
    assert one.snapshot()["estimators"]["observers"] == two.snapshot()["estimators"]["observers"]
    after = estimates(list(drive(two, [FRAMES[half:]])))[0]
    assert (np.abs(after.core - before.core) < 2 * before.core_sd + 0.5).all()
    assert (after.core_sd < before.core_sd + 1.0).all()


def test_a_state_of_another_effect_is_not_used_and_said_so() -> None:
    one = engine(FALLING)
    list(drive(one, [FRAMES]))
    two = engine(replace(FALLING, values={"B": 2000.0}))
    two.restore(json.loads(json.dumps(one.snapshot())))
    told = [e.text for e in drain(two) if isinstance(e, Notice)]
    assert told == ["string_1: new or changed, starts from its model file"]


def test_a_silent_bus_is_carried_over_in_one_step() -> None:
    later = FrameBatch(FRAMES.time_ns + 3600 * S, FRAMES.can_id, FRAMES.length, FRAMES.data)
    events = estimates(list(drive(engine(), [FRAMES, later])))
    woken = next(e for e in events if e.time_ns > (EPOCH_S + 3600) * S)
    assert np.isfinite(woken.core).all()


def test_numbers_that_come_from_a_fit_with_effects_are_told_as_fixed() -> None:
    told = [e for e in drive(engine(COOLED), [FRAMES]) if isinstance(e, Parameters) and e.string == "string_1"]
    assert {p.status for p in told[0].estimates} == {"fixed: identified offline, with its effects"}
    assert STATUS_CODES[told[0].estimates[0].status.split(":")[0]] == 3


def test_numbers_of_effects_are_told_with_the_strings_own() -> None:
    """In SI, by the name that model files use; the sd of what is known in per cent is turned into its unit."""
    told = [e for e in drive(engine(), [FRAMES]) if isinstance(e, Parameters)]
    for e in told:
        numbers = {p.name: p for p in e.estimates if "." in p.name}
        if e.string == "string_2":
            assert not numbers
            continue
        names = ["resistance_temperature.B", "polarization.R_1", "polarization.tau", "coolant_delay.tau"]
        assert [n for n in numbers if n in names] == names
        B, tau = numbers["resistance_temperature.B"], numbers["polarization.tau"]
        assert (B.value, B.sd, B.unit) == (3000.0, 300.0, "K")
        assert (tau.value, tau.unit) == (60.0, "s")
        assert tau.sd == pytest.approx(12.0)
        assert numbers["polarization.R_1"].value == 1e-3


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.plain_cases(1)
def test_nothing_on_the_bus_raises(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 600
    data, time = FRAMES.data[:n].copy(), FRAMES.time_ns[:n].copy()
    hit = rng.random(n) < 0.3
    data[hit] = rng.integers(0, 256, (int(hit.sum()), 8))
    time += rng.choice(np.array([0, -(10**9), 10**9, 10**13, -(10**13)]), n, p=[0.97, 0.01, 0.01, 0.005, 0.005])
    noisy = FrameBatch(time, FRAMES.can_id[:n], FRAMES.length[:n], data)
    for event in drive(engine(), cut(noisy, rng.integers(0, n, 5).tolist())):
        if isinstance(event, Estimated):
            assert np.array_equal(np.isfinite(event.core), np.isfinite(event.core_sd))
