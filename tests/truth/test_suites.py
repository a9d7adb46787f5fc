"""The suites ask for what the effects need, and are as large as the benchmark wants them."""

import numpy as np
import pytest

from tests.truth.hidden import FINAL_SEED, make_logs
from tests.truth.sizes import ANY, LOCATED, NEEDS, SIZES
from tests.truth.strange import UNKNOWN
from tests.truth.suites import NOT_WITH_ONE_CELL, SUITES, controls, one_cell, pairs, singles, unknowns

LEAST = {"singles": 200, "one_cell": 60, "controls": 100, "absorbed": 18, "unknowns": 40, "pairs": 40}


@pytest.mark.parametrize("name", SUITES)
def test_a_suite_is_large_enough_and_no_pack_is_in_two(name):
    found = SUITES[name](3)
    assert len(found) >= LEAST[name]
    others = {s.seed for n, f in SUITES.items() if n != name for s in f(3)} | {s.seed for s in SUITES[name](4)}
    seeds = {s.seed for s in found}
    assert len(seeds) == len(found)
    assert not seeds & others
    assert not seeds & {s.seed for s in SUITES[name](FINAL_SEED)}


def test_every_effect_is_hidden_at_every_size_with_what_it_needs():
    found = singles(3) + one_cell(3)
    for name in SIZES:
        mine = [s for s in found if name in s.effects]
        assert {s.effects[name][0] for s in mine} == {"weak", "medium", "strong"}
        assert (name in NOT_WITH_ONE_CELL) == all(s.cells > 1 for s in mine)
        needs = NEEDS.get(name, ANY)
        for s in mine:
            assert s.cycle in needs.cycles
            assert s.inlet in needs.inlets
            assert s.flow in needs.flows
            assert set(needs.columns) <= set(s.columns)
            assert (s.effects[name][1] is None) == (name not in LOCATED)


def test_pairs_are_two_effects_and_unknowns_none_of_the_catalogue():
    assert all(len(s.effects) == 2 for s in pairs(3))
    assert {name for s in unknowns(3) for name in s.effects} == set(UNKNOWN)


def test_controls_cover_what_logs_have():
    found = controls(3)
    assert not any(s.effects for s in found)
    for of, values in (
        ("noise", {0.01, 0.05, 0.1, 0.2, 0.3}),
        ("step", {0.0, 0.1, 0.25, 0.5, 1.0}),
        ("cells", {1, 2, 3, 5, 8, 12}),
        ("cycle", {"urban", "us06", "udds", "pulses", "sweep", "mixed"}),
        ("inlet", {"constant", "steps", "ramp", "sine"}),
        ("missing", {0.0, 0.1}),
        ("jitter", {0.0, 0.3}),
    ):
        assert {getattr(s, of) for s in found} == values
    assert any(s.inlet == s.flow == "constant" and not s.columns for s in found)


def test_flow_that_varies_is_recorded_unless_it_is_what_is_hidden():
    assert all("flow" in s.columns for f in SUITES.values() for s in f(3) if s.flow == "steps")


@pytest.mark.slow
def test_every_log_of_every_suite_is_sound():
    for suite in SUITES.values():
        for log in make_logs(suite(3)):
            assert log.scenario.seconds == len(log.core)
            assert -10 < log.core.min() < log.core.max() < 110, log.scenario.name
            assert all(np.mean(np.isfinite(x)) > 0.05 for x in log.table.values())
            assert 0.1 < np.nanmin(log.table.get("soc", [0.5])) < np.nanmax(log.table.get("soc", [0.5])) + 1e-9 < 0.96
