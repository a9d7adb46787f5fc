"""The next experiment: feasible, and on the hidden pack it tells two explanations apart."""

from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.diagnosis.experiment import next_experiment
from bms_gateway.diagnosis.feasible import limits_of, plans
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.screen import screen
from bms_gateway.diagnosis.search import Chosen, Search, refit, refit_from_nominal
from bms_gateway.diagnosis.weighing import Trial
from bms_gateway.identify.map_fit import fitted, refreshed
from bms_gateway.identify.problem import Problem
from tests.benchmarks.diagnosis_experiment import as_driven, gained
from tests.diagnosis.hidden_record import hidden, named


def hypotheses(names, *effect, **scenario):
    """Baseline and the fit of each named effect, the hidden one first."""
    log, record, model = hidden(*effect, **scenario)
    base = fitted(Problem(model, [measured(record, model)]))
    fits = {}
    for key in names:
        gain = screen(base, [named(key)])[0]
        near = refit(base, gain)
        far = refit_from_nominal(near, base)
        fits[key] = refreshed(max(near, far, key=lambda f: f.log_evidence))
    return log, base, fits


def found(base, fits):
    """A search that left the two tied."""
    first, second = fits
    trials = [Trial(named(k), f, 10.0, 0.5, True, "") for k, f in fits.items()]
    chosen = Chosen(named(first), (second.partition(":")[0],), 10.0)
    return Search(base, fits[first], [chosen], [trials])


PAIRS = {
    "direction": (("entropic_heat", "current_offset"), ("entropic_heat", "medium", None), {"cycle": "urban"}),
    "offset": (
        ("thermocouple_offset:3", "neighbour_heat:3"),
        ("thermocouple_offset", "medium", 3),
        {"inlet": "constant"},
    ),
    "drift": (("resistance_drift", "cooling_drift"), ("resistance_drift", "medium", None), {"inlet": "constant"}),
    "warmth": (
        ("resistance_temperature", "charge_transfer"),
        ("resistance_temperature", 0.15, None),
        {"inlet": "constant", "cycle": "us06"},
    ),
    "surface": (("surface_joule", "thermocouple_lag"), ("surface_joule", 0.1, None), {"cells": 1, "sensors": (1,)}),
    "unseen": (("cell_resistance:2", "cell_cooling:2"), ("cell_resistance", "strong", 2), {"inlet": "constant"}),
}


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.slow
def test_the_suggested_test_tells_more_on_the_hidden_pack_than_the_worst_ranked(pair):
    keys, effect, scenario = PAIRS[pair]
    log, base, fits = hypotheses(keys, *effect, seed=31, seconds=1800, **scenario)
    got = next_experiment(found(base, fits)).partings[0]
    best, worst = got.tests[0], got.tests[-1]
    assert best.log_odds > worst.log_odds
    with_best = gained(log.scenario, base, fits.values(), best.plan)
    with_worst = gained(log.scenario, base, fits.values(), worst.plan)
    print(pair, best.plan.name, best.log_odds, with_best, worst.plan.name, worst.log_odds, with_worst)
    assert with_best > with_worst
    assert got.decides is (best.log_odds >= 3.0)


@pytest.fixture(scope="module")
def offset():
    keys, effect, scenario = PAIRS["offset"]
    return hypotheses(keys, *effect, seed=31, seconds=1800, **scenario)


def test_an_offset_and_a_heat_at_the_surface_part_when_the_flow_steps(offset):
    _, base, fits = offset
    parting = next_experiment(found(base, fits)).partings[0]
    assert parting.tests[0].plan.name == "flow_steps"
    assert parting.sentence.startswith("To tell thermocouple_offset (cell 3) from neighbour_heat (cell 3): ")


def test_no_test_separates_a_hypothesis_from_itself(offset):
    _, base, fits = offset
    same = dict.fromkeys(fits, next(iter(fits.values())))
    parting = next_experiment(found(base, same)).partings[0]
    assert parting.tests
    assert all(test.log_odds == pytest.approx(0.0, abs=1e-6) for test in parting.tests)


def test_plans_stay_within_what_the_record_and_the_cells_allow(offset):
    _, base, _ = offset
    m, model = base.problem.records[0], base.problem.model
    limits = limits_of(m, model)
    library = plans(limits, model)
    assert len({p.name for p in library}) == len(library) >= 12
    for p in library:
        u = p.drive
        assert u.I.max() <= m.drive.I.max() + 1e-9
        assert u.I.min() >= m.drive.I.min() - 1e-9
        assert (u.I2 >= u.I**2 - 1e-6).all()
        assert abs(u.T_in - np.mean(m.drive.T_in)).max() <= 10.0 + 1e-9
        assert u.flow.min() >= 0.5
        assert u.flow.max() <= 1.5
        assert u.soc.min() >= 0.05
        assert u.soc.max() <= 1.0
        assert 30 < p.minutes <= 90


def test_where_no_test_parts_two_places_a_sensor_is_asked_for():
    keys = ("cell_resistance:2", "cell_cooling:2")
    _, base, fits = hypotheses(keys, "cell_resistance", "weak", 2, seed=8, sensors=(1, 5), inlet="constant")
    parting = next_experiment(found(base, fits)).partings[0]
    if not parting.decides:
        assert parting.sensor.cell == 2
        assert "add one on cell 2" in parting.sentence


def test_nothing_is_asked_for_where_nothing_is_in_doubt(offset):
    _, base, fits = offset
    first, second = fits
    trials = [
        Trial(named(k), f, o, s, True, "")
        for (k, f), o, s in zip(fits.items(), (100.0, 1.0), (0.9999, 1e-4), strict=True)
    ]
    clear = Search(base, fits[first], [Chosen(trials[0].candidate, (), 100.0)], [trials])
    assert next_experiment(clear) is None
    assert next_experiment(Search(base, base)) is None
    doubted = next_experiment(clear, uncertain=True)
    assert (doubted.partings[0].one, doubted.partings[0].other) == (first, second)


def test_the_same_search_asks_for_the_same(offset):
    _, base, fits = offset
    a, b = (next_experiment(found(base, fits)).partings[0] for _ in range(2))
    assert [t.log_odds for t in a.tests] == [t.log_odds for t in b.tests]


def test_the_plan_is_driven_as_it_was_planned():
    plan = SimpleNamespace(
        drive=SimpleNamespace(
            dt=4.0,
            N=2,
            I=np.array([10.0, 0.0]),
            I2=np.array([125.0, 0.0]),
            T_in=np.array([20.0, 21.0]),
            flow=np.ones(2),
            soc=np.array([0.5, 0.4]),
        )
    )
    d = as_driven(plan)
    assert d.current[:4].mean() == 10.0
    assert (d.current[:4] ** 2).mean() == pytest.approx(125.0)
    assert len(d.inlet) == 9
