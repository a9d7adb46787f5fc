"""What estimators take into use: results of jobs, time without frames, stored states; and whom they tell of it."""

import json
from dataclasses import replace
from math import nan
from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.engine import Notice, Parameters, Plan, estimators
from bms_gateway.engine.backlog import Backlog
from bms_gateway.engine.estimators import RESTED_S, Estimators
from bms_gateway.engine.events import Level
from bms_gateway.engine.readings import Layout, Readings
from bms_gateway.engine.string_estimator import StringEstimator
from bms_gateway.errors import StateError
from bms_gateway.health import HealthResult
from bms_gateway.health.mismatch import Mismatches
from bms_gateway.health.string_health import StringHealth
from bms_gateway.identify import Estimate, VoltageTracker
from bms_gateway.identify.cell_live import CellResult
from bms_gateway.identify.contract import Posterior
from bms_gateway.observe import AdaptiveObserver
from bms_gateway.observe.effect_observer import EffectObserver
from bms_gateway.thermal import Prior
from tests.engine.packs import plan
from tests.engine.strings_side_by_side import FALLING, LATE, PLAN, START, VOLTAGE, WIRES, S, driven, readings
from tests.engine.told_strings import commissioned

NAMES = [s.name for s in PLAN.strings]
PLACES = {0: (4, 0), 1: (3, 0), 2: (4, 1), 4: (3, 1), 5: (4, 2)}  # cells of the group and place in it
R_E = Estimate("R_e", 4e-3, 1e-4, "mOhm", "identified")


class Known:
    """An identifier with one number, by word of a test."""

    learns = True

    def __init__(self, done: list) -> None:
        self.done = done

    def patience(self, dt: float) -> int:
        return 0

    def take(self, ticks: object) -> None:
        raise AssertionError("nothing waits")

    def accept(self, result: object) -> None:
        self.done.append(("accept", result))

    def posterior(self) -> Posterior:
        return Posterior(("R_e", "R_c"), np.log([4e-3, 1.5]), np.diag([0.01, 0.04]))

    def estimates(self) -> tuple[Estimate, ...]:
        return (R_E,)

    def doubts(self) -> tuple[str, ...]:
        return ()


class Doubted(Known):
    """The same of a string that its model does not explain."""

    def doubts(self) -> tuple[str, ...]:
        return ("an effect is missing",) if ("accept", "result") in self.done else ()


@pytest.fixture
def done(monkeypatch: pytest.MonkeyPatch) -> list:
    """What observers and backlogs are told to do, in order."""
    done: list = []
    monkeypatch.setattr(Backlog, "catch_up", lambda _, j: done.append(("catch_up", j)))
    for kind in (AdaptiveObserver, EffectObserver):
        monkeypatch.setattr(kind, "set_parameters", lambda o, j, *what: done.append((o, j, *what)))
    return done


@pytest.mark.parametrize("i", range(6))
def test_a_result_is_for_the_ticks_after_those_that_waited_and_goes_to_the_strings_place(i: int, done: list) -> None:
    estimators = Estimators(PLAN, WIRES)
    s = estimators.strings[i]
    s.identifier = Known(done)
    events = estimators.accept(i, "result", 9)
    cells, j = PLACES.get(i, (3, 0))
    (_, caught), accepted, (observer, place, values, names, cov, *own) = done
    assert (caught, place) == (j, j)
    assert accepted == ("accept", "result")
    assert observer.covariances.shape[0] == {0: 3, 1: 2, 2: 3, 3: 1, 4: 2, 5: 3}[i]
    assert isinstance(observer, EffectObserver) == (i == 3)
    assert own == [None]
    assert s.plan.model.cells == cells
    assert values == pytest.approx({"R_e": 4e-3, "R_c": 1.5})
    assert names == ("R_e", "R_c")
    assert cov.tolist() == np.diag([0.01, 0.04]).tolist()
    assert s.estimates == (R_E,)
    assert events == [Parameters(9, s.plan.name, (R_E, *s.effects))]
    assert bool(s.effects) == (i == 3)


def test_what_is_common_scales_cells_that_were_told_apart_at_commissioning(done: list) -> None:
    one = commissioned(0.05)
    estimators = Estimators(one, [replace(WIRES[0], whole={**WIRES[0].whole, "voltage": -1})])
    (s,) = estimators.strings
    ((_, place, values, names, common, own),) = done
    assert (place, names) == (0, s.kept.names)
    assert values is s.kept.values
    assert (common is s.kept.common, own is s.kept.own) == (True, True)
    s.identifier = Known(done)
    estimators.accept(0, "result", 9)
    assert done[-1][-1] is s.kept.own


def test_the_health_hears_of_every_result_whether_resistance_is_identified(done, monkeypatch) -> None:
    estimators, offered = Estimators(PLAN, WIRES), []
    monkeypatch.setattr(StringHealth, "offer", lambda _, *what: offered.append(what) or len(offered) > 1)
    s = estimators.strings[0]
    s.identifier = Known(done)
    assert [type(e) for e in estimators.accept(0, "first", 9)] == [Parameters]
    s.identifier.estimates = lambda: (replace(R_E, name="R_c"), replace(R_E, value=5e-3, status="learning"))
    (_, told) = estimators.accept(0, "second", 10)
    assert (told.code, told.level, told.string, told.time_ns) == ("ageing", Level.INFO, "string_1", 10)
    assert [(value, known) for *_, value, known in offered] == [(4e-3, True), (5e-3, False)]
    names, mean, cov, *_ = offered[0]
    assert (names, mean.tolist()) == (("R_e", "R_c"), np.log([4e-3, 1.5]).tolist())
    assert cov.tolist() == np.diag([0.01, 0.04]).tolist()


def test_what_the_health_finds_moves_no_parameter(done, monkeypatch) -> None:
    given = []
    monkeypatch.setattr(StringHealth, "accept", lambda _, *what: given.append(what) or [])
    result = HealthResult(None, 0.0, "", 0.0)
    assert Estimators(PLAN, WIRES).accept(5, result, 9) == []
    assert given == [(result, 9)]
    assert done == [("catch_up", 2)]


@pytest.mark.parametrize("gap", [None, 0.0, 500.0])
@pytest.mark.parametrize("unseen", [True, False])
def test_time_without_frames_passes_for_all(monkeypatch: pytest.MonkeyPatch, gap: float | None, unseen: bool) -> None:
    estimators, ticks, passed, reset, dts = Estimators(PLAN, WIRES), readings(2, 14), [], [], []
    driven(estimators, ticks[:12])
    for kind in (AdaptiveObserver, EffectObserver):
        monkeypatch.setattr(kind, "propagate", lambda _, s, *, unseen: passed.append((s, unseen)))
        monkeypatch.setattr(kind, "propagate_unknown", lambda _: passed.append(None))
    monkeypatch.setattr(VoltageTracker, "reset", lambda tracker: reset.append(tracker))
    monkeypatch.setattr(Backlog, "add", lambda _, tick: dts.append(tick.dt) or [])
    estimators.mismatches.excess[:] = 2.0
    estimators.pass_time(gap, unseen=unseen)
    groups = 4
    assert passed == [None if gap is None else (gap, unseen)] * groups
    assert len(reset) == len({id(x) for x in reset}) == len(VOLTAGE) - 1  # one of them has effects
    assert all(np.isnan(s.mismatch.excess) for s in estimators.strings)
    driven(estimators, ticks[12:], 13)
    since = 1.0 + (gap if gap is not None else RESTED_S)
    assert dts == [since] * groups + [1.0] * groups


def test_time_without_frames_is_taken_for_seen_where_nobody_says_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    passed = []
    monkeypatch.setattr(AdaptiveObserver, "propagate", lambda _, s, *, unseen: passed.append((s, unseen)))
    Estimators(plan(1), WIRES[:1]).pass_time(7.0)
    assert passed == [(7.0, False)]


def test_jobs_and_notices_come_in_the_order_of_the_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Backlog, "add", lambda b, _: [(j, -s.plan.number) for j, s in enumerate(b._strings)] * 2)
    monkeypatch.setattr(Mismatches, "take", lambda *_: [0, 3, 6])
    estimators = Estimators(PLAN, WIRES)
    estimators.strings[3].mismatch.flag.level = 1
    first, second = driven(estimators, readings(3, 2))
    assert first.jobs == [(i, -i - 1) for i in range(len(NAMES)) for _ in range(2)]
    assert [(type(e), e.string) for e in first.events[1:]] == [
        (kind, name)
        for k, name in enumerate(NAMES)
        for kind in ((Parameters, Notice) if k in (0, 3, 6) else (Parameters,))
    ]
    assert [(e.code, e.level, e.string, e.time_ns) for e in second.events[1:]] == [
        ("mismatch", Level.WARNING if k == 3 else Level.NOTICE, NAMES[k], START + 2 * S) for k in (0, 3, 6)
    ]


def test_a_core_known_to_within_its_limit_is_sent_and_none_beyond(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = readings(4, 12)
    one = Estimators(PLAN, WIRES)
    driven(one, ticks)
    limit = float(np.nanmedian(one.newest.core_sd))
    monkeypatch.setattr("bms_gateway.engine.estimators.AVAILABLE_SD_K", limit)
    two = Estimators(PLAN, WIRES)
    driven(two, ticks)
    known = one.newest.core_sd <= limit
    assert limit in one.newest.core_sd
    assert 0 < known.sum() < len(known)
    for name in ("core", "core_sd", "surface", "centre", "centre_sd"):
        ours = getattr(two.newest, name)
        np.testing.assert_array_equal(ours, np.where(known, getattr(one.newest, name), nan))
    assert ((two.newest.quality == estimators.NOT_AVAILABLE) == ~known).all()


def stored(count: int = 14) -> tuple[Estimators, dict]:
    one = Estimators(PLAN, WIRES)
    driven(one, readings(5, count))
    return one, json.loads(json.dumps(one.snapshot(), allow_nan=False))


def observers(state: dict) -> dict[tuple[str, ...], dict]:
    return {tuple(o["strings"]): o["state"] for o in state["observers"]}


def test_a_state_is_kept_by_string_and_by_group_and_taken_up_whole() -> None:
    one, state = stored()
    assert list(state["strings"]) == NAMES
    assert sorted(observers(state)) == [
        ("string_1", "string_3", "string_6"), ("string_2", "string_5"), ("string_4",), ("string_7",)
    ]  # fmt: skip
    two = Estimators(PLAN, WIRES)
    assert two.restore(state) == []
    assert json.loads(json.dumps(two.snapshot(), allow_nan=False)) == state
    assert [s.estimates for s in two.strings] == [s.known() for s in one.strings]


def test_a_string_that_does_not_belong_takes_the_temperatures_of_its_group_along(monkeypatch) -> None:
    _, state = stored()
    state["strings"]["string_3"]["plan"] = "another"
    del state["strings"]["string_4"]
    two, given = Estimators(PLAN, WIRES), []
    set_parameters = AdaptiveObserver.set_parameters
    monkeypatch.setattr(
        AdaptiveObserver, "set_parameters", lambda o, j, *what: given.append(j) or set_parameters(o, j, *what)
    )
    fresh = observers(json.loads(json.dumps(two.snapshot(), allow_nan=False)))
    assert two.restore(state) == [
        "string_1: temperatures start anew",
        "string_3: new or changed, starts from its model file",
        "string_4: new or changed, starts from its model file",
        "string_6: temperatures start anew",
    ]
    assert given == [0, 2]  # what is known of the others of the group is given to the observer
    after = json.loads(json.dumps(two.snapshot(), allow_nan=False))
    now, before = observers(after), observers(state)
    for names in (("string_2", "string_5"), ("string_7",)):
        assert now[names] == before[names]
    assert now["string_4",] == fresh["string_4",]
    for name in NAMES:
        same = after["strings"][name]["identifier"] == state["strings"].get(name, {}).get("identifier")
        assert same or name in ("string_3", "string_4")


def test_a_state_belongs_to_every_number_of_the_model_and_to_the_method() -> None:
    one = plan(1).strings[0]
    m = replace(one.model, flow=1e-4, effects=(FALLING, LATE))
    dear = {k: replace(p, value=1.01 * p.value) if k == "R_c" else p for k, p in m.priors.items()}
    vague = {k: Prior(p.value, 0.31) if k == "R_c" else p for k, p in m.priors.items()}
    models = [m, replace(m, flow=2e-4), replace(m, priors=dear), replace(m, priors=vague), replace(m, sensors=(1, 3))]
    models += [replace(m, effects=e) for e in ((), (FALLING,), (replace(FALLING, values={"B": 1.0}), LATE))]
    models += [replace(m, effects=(replace(FALLING, sd={"B": 1.0}), LATE))]
    sums = [estimators.fingerprint(replace(one, model=x)) for x in models]
    sums.append(estimators.fingerprint(replace(one, model=m, identify="off")))
    told = [commissioned(error).strings[0] for error in (0.05, 0.06)]
    sums += [estimators.fingerprint(s) for s in told]
    sums.append(estimators.fingerprint(replace(told[0], model=replace(told[0].model, commissioning=None))))
    assert len(set(sums)) == len(sums)
    assert all(len(x) == 16 for x in sums)
    turned = replace(m, priors=dict(reversed(m.priors.items())))
    renamed = replace(one, model=turned, name="string_9", number=9, channels=())
    assert estimators.fingerprint(renamed) == sums[0]


def test_a_single_string_of_its_own_length_is_a_group() -> None:
    three = Plan(tuple(PLAN.strings[k] for k in (0, 1)))
    assert [g.cells for g in Estimators(three, WIRES[:2]).groups] == [3, 4]


class Apart(Known):
    """Cells that are told apart, or not yet."""

    def __init__(self, done: list, numbers: object) -> None:
        self.done, self._numbers = done, numbers

    def numbers(self) -> object:
        return self._numbers

    def estimates(self) -> tuple[Estimate, ...]:
        return (replace(R_E, name="R_e_1"),)


def test_a_window_of_a_string_whose_cells_are_told_apart_leaves_their_numbers_with_the_observer(done: list) -> None:
    estimators = Estimators(PLAN, WIRES)
    s = estimators.strings[2]
    numbers = SimpleNamespace(values={"R_e": np.ones(4)}, names=("R_e",), common=np.eye(1), own=np.zeros((4, 3, 3)))
    s.identifier, s.cells = Known(done), Apart(done, numbers)
    told = estimators.accept(2, "result", 9)
    _, accepted, (_, place, *what) = done
    assert accepted == ("accept", "result")
    assert place == 1
    for a, b in zip(what, (numbers.values, numbers.names, numbers.common, numbers.own), strict=True):
        assert a is b
    assert s.estimates == (R_E, replace(R_E, name="R_e_1"))
    assert told == [Parameters(9, "string_3", s.estimates)]
    s.cells = Apart(done, None)
    estimators.accept(2, "result", 9)
    assert done[-1][2] == pytest.approx({"R_e": 4e-3, "R_c": 1.5})


def test_cells_told_apart_are_left_alone_while_the_model_does_not_explain_the_string_and_that_is_told(
    done: list,
) -> None:
    estimators = Estimators(PLAN, WIRES)
    s = estimators.strings[2]
    numbers = SimpleNamespace(values={"R_e": np.ones(4)}, names=("R_e",), common=np.eye(1), own=np.zeros((4, 3, 3)))
    s.identifier, s.cells = Doubted(done), Apart(done, numbers)
    told = estimators.accept(2, "result", 9)
    assert done[-1][2] == pytest.approx({"R_e": 4e-3, "R_c": 1.5})
    (notice,) = [e for e in told if isinstance(e, Notice)]
    assert (notice.code, notice.string, notice.time_ns) == ("unproven", "string_3", 9)
    assert "an effect is missing" in notice.text
    assert not any(isinstance(e, Notice) for e in estimators.accept(2, "result", 10))  # once
    s.identifier.doubts = lambda: () if ("accept", "sound") in done else ("an effect is missing",)
    (notice,) = [e for e in estimators.accept(2, "sound", 11) if isinstance(e, Notice)]
    assert "proven again" in notice.text


def test_cells_told_apart_are_kept_and_taken_up_where_there_are_any() -> None:
    one, two, taken = Estimators(PLAN, WIRES), Estimators(PLAN, WIRES), []
    one.strings[1].cells = SimpleNamespace(snapshot=lambda: {"of": "cells"})
    state = json.loads(json.dumps(one.snapshot(), allow_nan=False))
    assert [state["strings"][name]["cells"] for name in NAMES] == [None, {"of": "cells"}, *[None] * 5]
    for i in (0, 1):
        two.strings[i].cells = SimpleNamespace(restore=lambda x, i=i: taken.append((i, x)), estimates=lambda: ())
    two.restore(state)
    assert taken == [(1, {"of": "cells"})]


def test_a_state_of_before_health_had_a_memory_is_taken_up_without(monkeypatch: pytest.MonkeyPatch) -> None:
    _, state = stored()
    for i in (0, 4):
        del state["strings"][NAMES[i]]["health"]
    taken = []
    monkeypatch.setattr(StringHealth, "restore", lambda _, kept: taken.append(kept))
    assert Estimators(PLAN, WIRES).restore(state) == []
    assert taken == [state["strings"][NAMES[i]]["health"] for i in (1, 2, 3, 5, 6)]


def test_the_first_tick_is_as_long_as_any(monkeypatch: pytest.MonkeyPatch) -> None:
    dts: list[float] = []
    monkeypatch.setattr(Backlog, "add", lambda _, tick: dts.append(tick.dt) or [])
    driven(Estimators(PLAN, WIRES), readings(6, 2))
    assert dts == [1.0] * 8


def test_unlike_cells_share_the_heat_of_the_voltage_by_their_resistance(monkeypatch: pytest.MonkeyPatch) -> None:
    given = []
    step = AdaptiveObserver.step
    monkeypatch.setattr(
        AdaptiveObserver, "step", lambda o, I2, heat, *more: given.append(heat) or step(o, I2, heat, *more)
    )
    monkeypatch.setattr(StringEstimator, "heat", lambda *_: 2.0)
    one = commissioned(0.05)
    estimators = Estimators(one, WIRES[:1])
    (r,) = readings(7, 1)
    estimators.step(
        Readings(
            r.means[:, :1],
            r.current_quality[:1],
            {q: x[:1] for q, x in r.slow.items()},
            *(x[:4] for x in (r.y, r.age, r.quality)),
            Layout.of(["string_1"], [4]).parts,
        ),
        START,
    )
    R = np.array([0.9, 1.0, 1.2, 1.05])
    np.testing.assert_allclose(given, [[2.0 * R / R.mean()]], rtol=1e-6)


@pytest.mark.parametrize("factor", [1.1, 1e4])
def test_parameters_of_a_state_are_told_at_once_if_they_can_be_true(factor: float) -> None:
    one, state = stored()
    identifier = state["strings"]["string_1"]["identifier"]
    identifier["mean"][identifier["names"].index("R_e")] += float(np.log(factor))
    two = Estimators(PLAN, WIRES)
    if factor > 1e3:
        with pytest.raises(StateError, match="string_1: R_e is"):
            two.restore(state)
        return
    two.restore(state)
    before, after = ({e.name: e.value for e in x.strings[0].known()} for x in (one, two))
    assert after["R_e"] == pytest.approx(factor * before["R_e"])
    assert two.strings[0].estimates == two.strings[0].known()


class Moving(Known):
    """A recursive method."""

    def add(self, tick: object) -> None:
        self.done.append(("add", tick))

    def doubts(self) -> tuple[str, ...]:
        return ()


def test_every_whole_minute_what_moves_with_each_tick_is_taken_up_and_told(done: list, monkeypatch) -> None:
    monkeypatch.setattr(StringHealth, "offer", lambda *_: True)
    estimators = Estimators(PLAN, WIRES)
    for i in (1, 4, 5):
        estimators.strings[i].identifier = Moving(done)
    first, minute = readings(8, 2)
    estimators.step(first, START)
    assert not [x for x in done if isinstance(x[0], AdaptiveObserver)]
    told = estimators.step(minute, START + 20 * S).events[1:]
    assert [(o.covariances.shape[0], j) for o, j, *_ in (x for x in done if x[0] not in ("add", "accept"))] == [
        (2, 0), (2, 1), (3, 2)
    ]  # fmt: skip
    assert [(type(e), e.string) for e in told] == [
        (kind, name) for name in ("string_2", "string_5", "string_6") for kind in (Parameters, Notice)
    ]
    assert all(e.estimates == (R_E,) for e in told[::2])
    assert all((e.code, e.level) == ("ageing", Level.INFO) for e in told[1::2])


def test_a_fit_of_cells_goes_to_the_observer_at_once(done: list, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bms_gateway.engine.estimators.sentence", lambda _: "so it is")
    estimators = Estimators(PLAN, WIRES)
    s = estimators.strings[2]
    numbers = SimpleNamespace(values={"R_e": np.ones(4)}, names=("R_e",), common=np.eye(1), own=np.zeros((4, 3, 3)))
    s.cells = Apart(done, numbers)
    s.cells.warning = ""
    result = CellResult(SimpleNamespace(), np.full(4, nan), False, "")
    told = estimators.accept(2, result, 9)
    caught, accepted, (_, place, values, *_) = done
    assert (caught, accepted, place) == (("catch_up", 1), ("accept", result), 1)
    assert values is numbers.values
    assert told[0] == Parameters(9, "string_3", s.known())
    assert s.estimates == s.known()
