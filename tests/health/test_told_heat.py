"""Cores that the watch over heat gives instead of the observer's, and their sd."""

import numpy as np

from bms_gateway.health.heat.told_heat import DOUBTED, Told

NAN = np.nan


def told(core: list[list[float]], core_sd: list[list[float]], doubted: list[float]) -> Told:
    nothing = np.full((len(core), len(core[0])), NAN)
    return Told(nothing, nothing, np.array(core), np.array(core_sd), np.array(doubted)[:, None], some=True)


def test_cores_of_the_watch_are_as_uncertain_as_they_differ_from_the_observer_where_cooling_was_lost() -> None:
    """Bug: lost cooling was seen where end plates were missing in the model; cores 12 K too cold had an sd of 2.7 K."""
    core, sd = np.full((3, 2), 60.0), np.full((3, 2), 1.0)
    new, wider = told([[50.0, NAN]] * 3, [[2.0, 1.5]] * 3, [0.0, DOUBTED, DOUBTED]).cores(core, sd)
    assert (new == [[50.0, 60.0]] * 3).all()
    assert np.allclose(wider[0], [np.hypot(1.0, 2.0), np.hypot(1.0, 1.5)])
    assert np.allclose(wider[1], [np.sqrt(1.0 + 4.0 + (DOUBTED * 10.0) ** 2), np.hypot(1.0, 1.5)])


def test_what_the_watch_does_not_tell_stays_as_it_was() -> None:
    core, sd = np.array([[40.0, 41.0]]), np.array([[0.5, 0.6]])
    new, same = told([[NAN, NAN]], [[NAN, NAN]], [DOUBTED]).cores(core, sd)
    assert (new == core).all()
    assert (same == sd).all()


def test_a_core_that_the_observer_does_not_know_is_that_of_the_watch() -> None:
    new, sd = told([[50.0]], [[2.0]], [DOUBTED]).cores(np.array([[NAN]]), np.array([[0.0]]))
    assert new[0, 0] == 50.0
    assert sd[0, 0] == 2.0
