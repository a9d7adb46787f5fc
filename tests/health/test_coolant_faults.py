"""The coolant of a string: an inlet whose sensor is frozen, and a flow that nobody records."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.health.heat import HeatWatch
from bms_gateway.health.heat.heat_watch import HeatTick
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
        tick = HeatTick(nothing, None, nothing, inlet[k : k + 1], y[k], np.zeros((1, CELLS)))
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


@pytest.mark.slow
@pytest.mark.parametrize(("pack", "flow"), [("liquid", 10.0), ("liquid", 20.0), ("forced", 4.0)])
@pytest.mark.parametrize("drive", ["urban", "us06"])
def test_a_step_of_an_unrecorded_flow_is_no_heat_and_no_thermocouple(pack, flow, drive, monkeypatch) -> None:
    """The coolant warms along the string by up to tens of kelvin per kilowatt; its flow steps by up to a half."""
    monkeypatch.setitem(heat_case.PACKS, pack, heat_case.PACKS[pack] | {"C_f": flow})
    broken = heat_case._break

    def stepped(x, case: Case) -> None:
        broken(x, case)
        rng = np.random.default_rng([case.seed, 77])
        for _ in range(2):
            k, ratio = int(rng.integers(1200, case.seconds - 600)), float(np.exp(rng.choice([-1, 1]) * 0.4))
            x.C_f[k:] *= ratio
            x.R_u[k:] *= ratio**-0.4

    monkeypatch.setattr(heat_case, "_break", stepped)
    case = replace(Case(pack, 0, seconds=5400, drive=drive), at=5400)
    codes = [code for alerts in raised(case, range(5200, 5203)) for _, code, _ in alerts]
    assert "unexplained_heat" not in codes
    assert "thermocouple" not in codes
