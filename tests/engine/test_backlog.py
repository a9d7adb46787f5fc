"""What waits in a backlog comes to its string as if it had come tick by tick."""

from dataclasses import dataclass, field
from math import nan

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
        default_factory=lambda: WindowIdentifier(
            MODEL, Settings(window_s=150.0, first_look_s=70.0, shortest_s=15.0, least_rise=0.0)
        )
    )
    collector: Collector = field(default_factory=Collector)
    found: list = field(default_factory=list)
    waited: int = 0
    heard: list = field(default_factory=list)

    def learn(self, tick: Tick, current: float, soc: float, flow: float, pairs: object) -> list:
        self.heard.append(pairs)
        before = len(self.found)
        job = self.identifier.add(tick)
        if job is not None:
            w = job.window
            self.identifier._pending = False
            self.found.append(
                (tick.time_ns, [a.tolist() for a in (w.square, w.heat, w.current, w.inlet, w.surface, w.age)], w.dt)
            )
        drive = self.collector.add(tick, current, soc, flow)
        if drive is not None:
            w = drive.window
            self.found.append((tick.time_ns, [a.tolist() for a in (w.square, w.inlet, w.surface, w.age)], w.dt, w.soc))
            self.found.append(drive.current.tolist())
        return self.found[before:]

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
    monkeypatch.setattr(collect, "WINDOW_S", 170.0)
    monkeypatch.setattr(collect, "SHORTEST_S", 20.0)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), holes=st.sampled_from([0.0, 0.002, 0.02, 0.2]), asked=st.integers(1, 400))
def test_what_has_waited_is_what_would_have_come_tick_by_tick(seed: int, holes: float, asked: int) -> None:
    at_once, later = ([Gatherer(patient) for _ in range(STRINGS)] for patient in (False, True))
    backlog = Backlog(later, 1.0)
    for k, tick in enumerate(ticks(seed, 3 * BLOCK + 220, holes)):
        if k == asked:
            backlog.catch_up(1)
        wanted = []
        for j, s in enumerate(at_once):
            own = Tick(k, tick.dt, tick.square[j], nan, tick.inlet[j], tick.surface[j], tick.age[j], tick.current[j])
            wanted += [(j, job) for job in s.learn(own, tick.current[j], tick.soc[j], tick.flow[j], None)]
        assert backlog.add(tick) == wanted
    for j in range(STRINGS):
        backlog.catch_up(j)
    for a, b in zip(at_once, later, strict=True):
        assert a.found == b.found
        for mine, theirs in ((a.identifier.now, b.identifier.now), (a.collector.ticks, b.collector.ticks)):
            for name in ("inlet", "dt", "held"):
                assert getattr(mine, name) == getattr(theirs, name)
            assert np.array_equal(mine.of_ticks, theirs.of_ticks, equal_nan=True)
            for x, y in zip(mine.readings.whole(), theirs.readings.whole(), strict=True):
                assert np.array_equal(x, y)
        assert a.collector._soc == b.collector._soc
    if not holes:
        assert all(len(a.found) >= 3 and b.waited > 250 for a, b in zip(at_once, later, strict=True))


def test_nothing_is_kept_for_strings_that_take_nothing() -> None:
    strings = [Gatherer(True, idle=True) for _ in range(STRINGS)]
    backlog = Backlog(strings, 1.0)
    for tick in ticks(1, 300, 0.05):
        backlog.add(tick)
    assert backlog.kept == 0
    assert all(not s.waited for s in strings)
    assert all(len(s.heard) == 1 for s in strings)


def test_a_backlog_holds_no_more_than_the_window_that_is_under_way() -> None:
    strings = [Gatherer(True) for _ in range(STRINGS)]
    backlog = Backlog(strings, 1.0)
    for tick in ticks(2, 2000, 0.01):
        backlog.add(tick)
        assert backlog.kept <= 150 + BLOCK


def test_every_string_hears_its_own_cells_or_none() -> None:
    strings = [Gatherer(False) for _ in range(STRINGS)]
    backlog = Backlog(strings, 1.0)
    first, second = ticks(3, 2, 0.0)
    backlog.add(first)
    backlog.add(second._replace(cells=["one", None, "three"]))
    assert [s.heard for s in strings] == [[None, "one"], [None, None], [None, "three"]]


def test_the_heat_of_each_string_comes_to_it() -> None:
    """Where nothing of a group knows its flow."""
    strings = [Gatherer(True) for _ in range(STRINGS)]
    backlog = Backlog(strings, 1.0)
    for tick in ticks(4, 30, 0.0):
        backlog.add(tick._replace(heat=np.array([1.0, 2.0, 3.0]) + tick.time_ns, flow=None))
    for j, s in enumerate(strings):
        backlog.catch_up(j)
        assert s.waited >= 20
        assert s.identifier.now.heat == [1.0 + j + k for k in range(1, 30)]  # the first tick begins the window


def test_a_string_that_was_caught_up_sees_the_next_tick_itself() -> None:
    strings = [Gatherer(True) for _ in range(STRINGS)]
    backlog = Backlog(strings, 1.0)
    for k, tick in enumerate(ticks(5, 12, 0.0)):
        if k == 8:
            backlog.catch_up(2)
            assert [s.waited for s in strings] == [0, 0, 7]
        backlog.add(tick)
    assert [len(s.heard) for s in strings] == [1, 1, 2]


def test_a_string_without_a_current_stirs_no_other() -> None:
    strings = [Gatherer(True) for _ in range(STRINGS)]
    backlog = Backlog(strings, 1.0)
    for k, tick in enumerate(ticks(6, 10, 0.0)):
        missing = np.where((np.arange(STRINGS) == 1) & (k >= 5), np.nan, tick.square)
        backlog.add(tick._replace(square=missing))
    assert [len(s.heard) for s in strings] == [1, 6, 1]
    assert [s.waited for s in strings] == [0, 4, 0]
