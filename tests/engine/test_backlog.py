"""What waits in a backlog comes to its string as if it had come tick by tick."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.engine.backlog import BLOCK, Backlog, GroupTick
from bms_gateway.health import collect
from bms_gateway.health.collect import Collector
from bms_gateway.identify import Settings, Tick, Ticks, WindowIdentifier
from bms_gateway.identify.ticks import ENDLESS
from bms_gateway.thermal import Prior, StringModel

STRINGS, CELLS = 3, 2
VALUES = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79, "R_cc": 4.0, "C_f": 11.33}
MODEL = StringModel(CELLS, (1, 2), "full", {name: Prior(x, 0.2) for name, x in VALUES.items()})


@dataclass
class Gatherer:
    """A string with what gathers windows, and all that came of it; `patient` strings let ticks wait."""

    patient: bool
    idle: bool = False
    identifier: WindowIdentifier = field(
        default_factory=lambda: WindowIdentifier(MODEL, Settings(window_s=60.0, shortest_s=15.0, least_rise=0.0))
    )
    collector: Collector = field(default_factory=Collector)
    found: list = field(default_factory=list)
    waited: int = 0

    def learn(self, tick: Tick, current: float, soc: float, flow: float, pairs: object) -> list:
        job = self.identifier.add(tick)
        if job is not None:
            w = job.window
            self.identifier._pending = False
            self.found.append((tick.time_ns, [a.tolist() for a in (w.square, w.heat, w.inlet, w.surface, w.age)], w.dt))
        drive = self.collector.add(tick, current, soc, flow)
        if drive is not None:
            w = drive.window
            self.found.append((tick.time_ns, [a.tolist() for a in (w.square, w.inlet, w.surface, w.age)], w.dt, w.soc))
            self.found.append(drive.current.tolist())
        return []

    def patience(self, dt: float) -> int:
        if self.idle:
            return ENDLESS
        return min(self.identifier.patience(dt), self.collector.patience(dt)) if self.patient else 0

    def take(self, ticks: Ticks) -> None:
        self.waited += len(ticks.square)
        self.identifier.take(ticks)
        self.collector.take(ticks)


def ticks(seed: int, count: int, holes: float) -> list[GroupTick]:
    """Ticks of a drive in which each string loses its current or inlet now and then, and the bus sleeps."""
    rng = np.random.default_rng(seed)
    found, heat = [], np.full(STRINGS, np.nan)
    state = np.ones((2, STRINGS), bool)
    for k in range(count):
        state ^= rng.random((2, STRINGS)) < np.where(state, holes, 0.3)
        square, inlet = rng.uniform(100, 900, STRINGS), rng.uniform(20, 30, STRINGS)
        surface = rng.uniform(20, 40, (STRINGS, CELLS))
        dt = rng.choice([1.0, 3.0, 500.0], p=[1 - holes, 0.7 * holes, 0.3 * holes])
        flow = np.where(rng.random(STRINGS) < holes, rng.uniform(0.9, 1.3, STRINGS), np.nan)
        soc = np.where(rng.random(STRINGS) < 0.5, rng.random(STRINGS), np.nan)
        found.append(
            GroupTick(
                k, float(dt), np.where(state[0], square, np.nan), heat, np.where(state[1], inlet, np.nan), flow,
                np.sqrt(square), soc, surface, rng.random((STRINGS, CELLS)), (),
            )
        )  # fmt: skip
    return found


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collect, "WINDOW_S", 70.0)
    monkeypatch.setattr(collect, "SHORTEST_S", 20.0)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), holes=st.sampled_from([0.0, 0.002, 0.02, 0.2]), asked=st.integers(1, 400))
def test_what_has_waited_is_what_would_have_come_tick_by_tick(seed: int, holes: float, asked: int) -> None:
    at_once, later = ([Gatherer(patient) for _ in range(STRINGS)] for patient in (False, True))
    backlogs = [Backlog(strings, 1.0) for strings in (at_once, later)]
    for k, tick in enumerate(ticks(seed, 3 * BLOCK + 220, holes)):
        if k == asked:
            backlogs[1].catch_up(1)
        for backlog in backlogs:
            backlog.add(tick)
    for j in range(STRINGS):
        backlogs[1].catch_up(j)
    for a, b in zip(at_once, later, strict=True):
        assert a.found == b.found
        for mine, theirs in ((a.identifier, b.identifier), (a.collector, b.collector)):
            for name in ("_square", "_inlet", "_dt", "_held"):
                assert getattr(mine, name) == getattr(theirs, name)
            assert np.array_equal(*(np.concatenate([np.empty((0, CELLS)), *x._surface]) for x in (mine, theirs)))
        assert a.collector._soc == b.collector._soc
    if not holes:
        assert all(len(a.found) >= 3 and b.waited > 250 for a, b in zip(at_once, later, strict=True))


def test_nothing_is_kept_for_strings_that_take_nothing() -> None:
    strings = [Gatherer(True, idle=True) for _ in range(STRINGS)]
    backlog = Backlog(strings, 1.0)
    for tick in ticks(1, 300, 0.05):
        backlog.add(tick)
    assert not backlog._blocks
    assert not backlog._single
    assert all(not s.waited for s in strings)


def test_a_backlog_holds_no_more_than_the_window_that_is_under_way() -> None:
    strings = [Gatherer(True) for _ in range(STRINGS)]
    backlog = Backlog(strings, 1.0)
    for tick in ticks(2, 2000, 0.01):
        backlog.add(tick)
        kept = sum(b.end - b.first for b in backlog._blocks) + len(backlog._single)
        assert kept <= 60 + BLOCK
