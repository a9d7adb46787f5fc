"""The coolant of a string: an inlet whose sensor is frozen, and a flow that nobody records."""

import json
from base64 import b64encode

import numpy as np
import pytest

from bms_gateway.health.heat import HeatWatch
from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.heat_tick import HeatTick
from tests.benchmarks import heat_case
from tests.benchmarks.heat_case import CELLS, Case, model
from tests.health.heat_runs import raised


@pytest.mark.parametrize("pack", ["small", "forced", "liquid"])
@pytest.mark.plain_cases(2)
def test_an_inlet_that_freezes_is_told_in_minutes(pack: str) -> None:
    case = Case(pack, 0, seconds=2700, fault="frozen", at=1800)
    for alerts in raised(case, range(400, 403)):
        assert [code for _, code, _ in alerts][:1] == ["inlet"]
        assert case.at < alerts[0][0] <= case.at + 300


def inlet_told(inlet: np.ndarray) -> list[tuple[int, int, str]]:
    """Give a string at rest this inlet (K,), °C, NaN where no frame came: (s, level, sentence) of the alert."""
    watch, told = HeatWatch([model("small")], 1.0), []
    y = 25.0 + np.random.default_rng(1).normal(0.0, 0.03, (len(inlet), 1, CELLS))
    nothing = np.zeros(1)
    for k in range(len(inlet)):
        tick = HeatTick(nothing, nothing, inlet[k : k + 1], y[k], np.zeros((1, CELLS)))
        told += [(k, f.level, f.text) for _, f in watch.add(k * 10**9, tick) or () if f.code == "inlet"]
    return told


def lively(seconds: int, step: float, level: float = 25.0) -> np.ndarray:
    rng = np.random.default_rng(2)
    return np.round((level + rng.normal(0.0, 0.03, seconds)) / step) * step


def test_an_inlet_that_froze_and_moves_again_is_over() -> None:
    frozen = np.concatenate((lively(1800, 0.01), np.full(600, 25.0), lively(900, 0.01)))
    told = inlet_told(frozen)
    assert [level for _, level, _ in told] == [1, 0]
    assert 1800 + 230 <= told[0][0] <= 1800 + 300
    assert "has read exactly the same for 4 min" in told[0][2]
    assert told[1][0] <= 2400 + 400


def test_a_frozen_inlet_whose_frames_are_rare_stays_frozen_between_them() -> None:
    """The alert said in turn that the sensor is frozen and by how much it is off."""
    every = np.where(np.arange(3600) % 25 == 0, np.concatenate((lively(1800, 0.01), np.full(1800, 25.0))), np.nan)
    watch, seen = HeatWatch([model("small")], 1.0), set()
    y = 25.0 + np.random.default_rng(1).normal(0.0, 0.03, (len(every), 1, CELLS))
    for k in range(len(every)):
        tick = HeatTick(np.zeros(1), np.zeros(1), every[k : k + 1], y[k], np.zeros((1, CELLS)))
        watch.add(k * 10**9, tick)
        seen |= {f.text.split(" for ")[0] for f in watch.verdicts[0].findings}
    assert seen == {"the coolant inlet has read exactly the same"}


@pytest.mark.parametrize(
    ("inlet", "why"),
    [
        (np.full(7200, 25.0), "it never moved"),
        (np.concatenate((lively(3600, 0.5, 25.25), np.full(3600, 25.0))), "a coarse reading has left a border"),
        (np.concatenate((lively(3600, 0.01), np.full(3600, np.nan))), "no frame comes: that is another alert"),
        (np.repeat(25.0 + 0.02 * np.arange(24), 300), "a frame comes every five minutes"),
        (np.concatenate((lively(600, 0.01), np.full(200, 25.0))), "it has not stood still for long enough"),
    ],
)
def test_a_sound_inlet_that_stands_still_is_not_frozen(inlet: np.ndarray, why: str) -> None:
    assert inlet_told(inlet) == [], why


@pytest.mark.parametrize(("pack", "flow"), [("liquid", 10.0), ("liquid", 20.0), ("forced", 4.0)])
@pytest.mark.parametrize(("drive", "step"), [("urban", 1.5), ("us06", 0.67)])
@pytest.mark.plain_cases(2)
def test_a_step_of_an_unrecorded_flow_is_no_fault_of_a_cell_or_sensor(pack, flow, drive, step, monkeypatch) -> None:
    """The less of it flows, the more the coolant warms along the string. A third less may be called worse cooling."""
    monkeypatch.setitem(heat_case.PACKS, pack, heat_case.PACKS[pack] | {"C_f": flow})
    case = Case(pack, 0, seconds=4500, drive=drive, fault="flow", size=step, at=2400)
    codes = {code for alerts in raised(case, range(5200, 5203)) for _, code, _ in alerts}
    assert codes <= ({"cooling"} if step < 1.0 else set())


def test_a_state_of_before_the_stream_is_taken_up_and_ends_no_alarm() -> None:
    first, y = HeatWatch([model("small")], 1.0), np.full((1, CELLS), 25.0)
    for k in range(600):
        tick = HeatTick(np.zeros(1), np.zeros(1), np.full(1, 25.0), y + 1e-3 * (k % 2), np.zeros((1, CELLS)))
        first.add(k * 10**9, tick)
    g = Finding("unexplained_heat", 6, 2, 10**9, place=4, places=(4,), size=3.0)
    first.verdicts[0].take_up(g, 600 * 10**9)
    state = json.loads(json.dumps(first.snapshot()))
    at = first.filter.at
    for key in ("numbers", "variances"):
        del state[key][0][at.stream - at.nodes]
    rest = state["rest"][0]
    if rest is not None:
        fewer = at.states - 1
        rest["covariance"] = b64encode(np.zeros(fewer * (fewer + 1) // 2, "<f4").tobytes()).decode("ascii")
    second = HeatWatch([model("small")], 1.0)
    second.restore(state)
    kept = np.delete(np.arange(at.nodes, at.states), at.stream - at.nodes)
    assert np.array_equal(second.filter.z[0, kept], first.filter.z[0, kept])
    assert second.filter.z[0, at.stream] == 0.0
    assert second.filter.P[0, at.stream, at.stream] > 0.0
    assert second.verdicts[0].hot
