"""Strings in groups against each by itself: an observer, a voltage and an identifier of its own, fed by hand."""

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest

from bms_gateway.engine import Notice, Parameters, StringPlan
from bms_gateway.engine.core_floor import Floor, Step
from bms_gateway.engine.estimators import Estimators, TickResult
from bms_gateway.engine.group import index_of
from bms_gateway.engine.readings import Readings
from bms_gateway.frames.quality import Quality
from bms_gateway.health import mismatch
from bms_gateway.health.mismatch import Mismatches
from bms_gateway.identify import Tick, VoltageTracker, WindowIdentifier, build, string_parameters, voltage
from bms_gateway.observe import AdaptiveObserver, Measured
from bms_gateway.observe.effect_observer import EffectObserver
from bms_gateway.thermal.warmth import WARMTH_SD
from tests.engine.strings_side_by_side import (
    LAYOUT,
    NAN,
    NO,
    PLAN,
    START,
    VOLTAGE,
    WIRES,
    N,
    S,
    readings,
)


@dataclass
class Alone:
    """One string by hand, from what the classes that it is made of say of themselves."""

    plan: StringPlan
    mismatch: Mismatches = field(default_factory=lambda: Mismatches(1))
    given: list[tuple] = field(default_factory=list)

    def __post_init__(self) -> None:
        model = self.plan.model
        if model.effects:
            self.observer = EffectObserver(model, 1.0, PLAN.disturbance)
        else:
            self.observer = AdaptiveObserver([model], 1.0, PLAN.disturbance)
            self.observer.consider_warmth(WARMTH_SD)
        self.voltage = VoltageTracker(8.0, model.cells) if self.plan.name in VOLTAGE and not model.effects else None
        self.identifier = build(self.plan.identify, model)
        self.floor = Floor.of([model])

    def step(self, r: Readings, i: int, t: int) -> tuple[np.ndarray, ...]:
        model, mine = self.plan.model, LAYOUT.parts[i]
        n = model.cells
        I, I2, V, IV, I_abs = r.means[:, i].tolist()  # noqa: E741
        inlet, y, age = float(r.inlet[i]), r.y[mine], r.age[mine]
        flow = float(r.slow["coolant_flow"][i]) / model.flow if model.flow else NAN
        heat = NAN if self.voltage is None else self.voltage.update(I, V, IV, 1.0).heat / n
        square, shift = I2, 0.0
        if model.effects:
            measured = Measured(I, I2, I_abs, inlet, flow, float(r.slow["soc"][i]), V / n, IV / n)
            e = self.observer.step(measured, y, age)
            effective, shift = self.observer.effective
            square = NAN if np.isnan(I2) else effective
        else:
            self.observer.reversible.flow(np.array([I]))
            e = self.observer.step(
                np.array([I2]), np.full((1, n), heat), np.array([inlet]), y[None], age[None], np.array([flow])
            )
        tick = Tick(t, 1.0, square, heat, inlet + shift, y, age)
        self.given.append((tick, I, float(r.slow["soc"][i]), flow))
        if self.plan.identify == "rls":
            self.identifier.add(tick)
            if t % (60 * S) == 0:
                p = self.identifier.posterior()
                numbers = string_parameters(model, p.names, p.mean)
                self.observer.set_parameters(0, {name: getattr(numbers, name) for name in p.names}, p.names, p.cov)
        z = (e.innovation / e.innovation_sd)[np.isfinite(e.innovation)]
        self.mismatch.take(np.array([np.mean(z**2) if len(z) else NAN]), 1.0)
        known = e.core_sd[0] <= 12.0
        driven = (np.array([x]) for x in (inlet + shift, I, square))
        cold = self.floor.below(Step(e.core, e.core_sd, e.surface, *driven, 1.0))
        cold = np.zeros(n, bool) if cold is None else cold[0]
        row = (np.where(known, x[0], NAN) for x in (e.core, e.core_sd, e.surface))
        felt = np.where(y > e.centre[0] + 0.3, y, e.centre[0])
        inside = (np.where(known, x, NAN) for x in (felt, e.centre_sd[0]))
        return *row, self.quality(r, i, known, cold), *inside, e.innovation[0], e.innovation_sd[0]

    def quality(self, r: Readings, i: int, known: np.ndarray, cold: np.ndarray) -> np.ndarray:
        current, found = Quality(int(r.current_quality[i])), []
        mine = (r.quality[LAYOUT.parts[i]].tolist(), known.tolist(), cold.tolist())
        for own, sound, too_cold in zip(*mine, strict=True):
            said = Quality.ESTIMATED if own == NO else Quality(own)
            if said in (Quality.GOOD, Quality.ESTIMATED) and current != Quality.GOOD:
                said = Quality.STALE if current == NO else current
            if said in (Quality.GOOD, Quality.ESTIMATED) and too_cold:
                said = Quality.DOUBTFUL
            found.append(said if sound else Quality.NOT_AVAILABLE)
        return np.array(found)


@pytest.fixture(scope="module")
def together() -> tuple[Estimators, list[TickResult], list[tuple], list[Alone]]:
    """Estimates of all, and of each by itself, over a minute and a half; what each was given to learn from."""
    with pytest.MonkeyPatch.context() as patch:  # or flags and heat from the voltage would need three minutes
        patch.setattr(mismatch, "GRACE_S", 10.0)
        patch.setattr(mismatch, "EXCESS", replace(mismatch.EXCESS, hold=5))
        patch.setattr(voltage, "LEARN", 20.0)
        estimators, alone = Estimators(PLAN, WIRES), [Alone(s) for s in PLAN.strings]
        assert all(np.isnan(row).all() and row.shape == (N,) for row in estimators.errors())  # of no readings
        told, rows = [], []
        for k, r in enumerate(readings(1, 85), 1):
            told.append(estimators.step(r, START + k * S))
            new = estimators.newest
            got = (new.core, new.core_sd, new.surface, new.quality, new.centre, new.centre_sd, *estimators.errors())
            own = [a.step(r, i, START + k * S) for i, a in enumerate(alone)]
            rows.append((got, [np.concatenate(x) for x in zip(*own, strict=True)]))
    return estimators, told, rows, alone


def test_every_string_is_estimated_as_if_it_were_alone(together) -> None:
    _, told, rows, alone = together
    for result, (got, expected) in zip(told, rows, strict=True):
        for a, b in zip(got, expected, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)
        e = result.events[0]
        for a, b in zip((e.core, e.core_sd, e.surface, e.quality, e.centre, e.centre_sd), got, strict=False):
            np.testing.assert_array_equal(a, b)
    assert all(np.isfinite([tick.heat for tick, *_ in alone[i].given]).sum() > 30 for i in (0, 1, 4))
    core, quality = (np.array([got[k] for got, _ in rows]) for k in (0, 3))
    assert np.isfinite(core[10:]).mean() > 0.8
    assert set(quality.ravel().tolist()) == {
        *(Quality.GOOD, Quality.ESTIMATED, Quality.STUCK, Quality.STALE, Quality.NOT_AVAILABLE, Quality.DOUBTFUL)
    }


def test_what_was_told_of_a_tick_stays_as_it_was(together) -> None:
    _, told, rows, _ = together
    cores = [result.events[0].core for result in told]
    assert not any(a is b or np.shares_memory(a, b) for a, b in pairwise(cores))
    assert all(result.events[0].core is got[0] for result, (got, _) in zip(told, rows, strict=True))


def test_every_string_is_surprised_as_if_it_were_alone(together) -> None:
    estimators, told, _, alone = together
    excess = [s.mismatch.excess for s in estimators.strings]
    assert excess == pytest.approx([float(a.mismatch.excess[0]) for a in alone], rel=1e-6)
    levels = [s.mismatch.flag.level for s in estimators.strings]
    assert levels == [a.mismatch.flags[0].level for a in alone]
    assert any(levels)
    assert not all(levels)
    notices = [e for result in told for e in result.events if isinstance(e, Notice)]
    assert {e.string for e in notices} == {
        s.plan.name for s, level in zip(estimators.strings, levels, strict=True) if level
    }


def test_every_string_learns_from_its_own_ticks(together) -> None:
    estimators, _, _, alone = together
    for i, (s, a) in enumerate(zip(estimators.strings, alone, strict=True)):
        if a.plan.identify == "rls":
            ours, theirs = s.identifier.posterior(), a.identifier.posterior()
            np.testing.assert_allclose(ours.mean, theirs.mean, rtol=1e-6)
            np.testing.assert_allclose(ours.cov, theirs.cov, rtol=1e-4)
        if isinstance(s.identifier, WindowIdentifier):
            group, j = estimators.place(i)
            group.backlog.catch_up(j)
            for tick, *_ in a.given:
                a.identifier.add(tick)
            mine, theirs = s.identifier.now, a.identifier.now
            np.testing.assert_allclose(mine.of_ticks[0], theirs.of_ticks[0], rtol=1e-6)
            np.testing.assert_allclose(mine.inlet, theirs.inlet, rtol=1e-6)
            np.testing.assert_allclose(mine.dt, theirs.dt, rtol=1e-6)
            assert len(mine) > 5


def test_parameters_are_told_at_the_start_and_those_of_the_recursive_method_every_whole_minute(together) -> None:
    estimators, told, _, alone = together
    said = [[(e.string, e) for e in result.events if isinstance(e, Parameters)] for result in told]
    names = [s.name for s in PLAN.strings]
    assert [name for name, _ in said[0]] == names
    for k, events in enumerate(said[1:], 2):
        recursive = ["string_2", "string_5", "string_6"] if k in (20, 80) else []
        assert [name for name, _ in events] == recursive
    for (_, e), s, a in zip(said[0], estimators.strings, alone, strict=True):
        effects = {x.name for x in e.estimates if "." in x.name}
        assert effects == {x.name for x in getattr(a.observer, "effect_numbers", [])} == {x.name for x in s.effects}
    last = dict(said[79])
    for name in ("string_2", "string_5", "string_6"):
        s = estimators.strings[names.index(name)]
        assert last[name].time_ns == START + 80 * S
        assert last[name].estimates == s.estimates


@pytest.mark.parametrize(
    ("places", "at"),
    [([3], slice(3, 4)), ([0, 1], slice(0, 2)), ([4, 5, 6], slice(4, 7)), ([0, 2], None), ([1, 0], None)],
)
def test_places_in_a_row_are_read_without_a_copy_and_others_one_by_one(places: list[int], at: slice | None) -> None:
    found = index_of(places)
    assert np.arange(10)[found].tolist() == places
    assert found == at if at is not None else isinstance(found, np.ndarray)
