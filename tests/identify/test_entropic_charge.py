"""The charge along which an entropic coefficient is carried from window to window, and what a window finds of it."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.errors import StateError
from bms_gateway.identify import Tick, WindowIdentifier
from bms_gateway.identify.entropic_charge import EntropicCharge
from bms_gateway.identify.ticks import Ticks
from bms_gateway.identify.window_evidence import Evidence
from tests.identify.drive import model
from tests.truth.effects import entropic_heat
from tests.truth.pack import NOMINAL, integrate, terms

CAPACITY_AH = 40.0
LEVEL = 0.2
"""mV/K"""


def road(seed=1):
    """Currents of a climb and a descent, and surfaces of a single cell with a coefficient of `LEVEL`."""
    rng = np.random.default_rng(seed)
    amps = np.repeat(rng.uniform(30.0, 60.0, 48), 50) * np.repeat([1.0, -0.8], 1200)
    t = terms(1, amps, np.full(2401, 25.0), np.ones(2400), 0.5)
    entropic_heat(t, dUdT=LEVEL)
    return amps, integrate([t])[0].surface + 0.05 * rng.normal(size=(2401, 1))


def ticks(amps, y):
    for k in range(len(amps)):
        yield Tick(int((k + 1) * 1e9), 1.0, amps[k] ** 2, np.nan, 25.0, y[k + 1], np.zeros(1), float(amps[k]))


def made():
    names = ("C_c", "C_s", "R_e", "R_c", "R_u")
    known = model(1, (1,), **{k: NOMINAL[k] for k in names})
    priors = {k: replace(p, rel_sd=min(p.rel_sd, 0.1)) for k, p in known.priors.items()}
    return replace(known, priors=priors, capacity_Ah=CAPACITY_AH)


@pytest.fixture(scope="module")
def learnt():
    identifier = WindowIdentifier(made())
    amps, y = road()
    for tick in ticks(amps, y):
        if (job := identifier.add(tick)) is not None:
            identifier.accept(job.run())
    identifier.accept(identifier.finish().run())
    return identifier, amps


def test_windows_of_a_climb_and_a_descent_find_the_coefficient_and_leave_it_out_of_the_resistance(learnt):
    identifier, _ = learnt
    p = identifier.posterior()
    assert identifier.windows == 2
    at = p.apart.names.index("entropic")
    assert abs(p.apart.mean[at] - LEVEL) < 2.0 * np.sqrt(p.apart.cov[at, at]) < 0.3
    R_e = p.apart.names.index("R_e")
    assert abs(p.apart.mean[R_e] - np.log(NOMINAL["R_e"])) < 2.0 * np.sqrt(p.apart.cov[R_e, R_e])
    # the last window went downhill, where this entropy warms: with its share, R_e is larger
    assert p.mean[R_e] > p.apart.mean[R_e] + 0.1
    values, names, _ = p.for_observer(model(1, (1,)))
    assert names[-3:] == ("entropic", "entropic_slope", "warmth")
    assert values["R_e"][0] == pytest.approx(np.exp(p.apart.mean[R_e]))


def test_the_coefficient_is_stated_at_the_mean_charge_of_the_window(learnt):
    identifier, amps = learnt
    moved = np.cumsum(amps) / 3600.0 / CAPACITY_AH
    mean = (moved[1200:] - amps[1200:] / 7200.0 / CAPACITY_AH).mean()
    assert identifier.posterior().apart.charge == pytest.approx(moved[-1] - mean, abs=2e-3)


def test_a_restart_knows_the_coefficient_and_its_charge(learnt):
    identifier, _ = learnt
    again, state = WindowIdentifier(made()), identifier.snapshot()
    again.restore(state)
    a, b = identifier.posterior().apart, again.posterior().apart
    assert (a.names, a.charge) == (b.names, b.charge)
    assert a.cov.tobytes() == b.cov.tobytes()
    with pytest.raises(StateError, match="damaged"):
        again.restore({**state, "entropy": {**state["entropy"], "mean": [0.0]}})
    wild = [*state["entropy"]["mean"][:-1], 1e3]
    with pytest.raises(StateError, match="damaged"):
        again.restore({**state, "entropy": {**state["entropy"], "mean": wild}})
    again.restore({k: x for k, x in state.items() if k != "entropy"})  # of a version without it
    assert again.posterior().apart is None


def test_ticks_that_waited_count_as_one_by_one_to_the_last_bit():
    current = np.random.default_rng(2).normal(0.0, 40.0, 500)
    one, all_of = EntropicCharge(1e4, 0.3), EntropicCharge(1e4, 0.3)
    for x in current:
        one.add(float(x), 1.0)
    none = np.zeros(500)
    all_of.take(Ticks(1.0, none, none, none, current, none, none[:, None], none[:, None]))
    assert one.moved == all_of.moved
    one.add(np.nan, 1.0)
    assert one.moved == all_of.moved


def test_evidence_says_the_same_of_a_line_after_charge_has_moved():
    """δ = (z, level, slope) in prior sd, 0.25 and 1 mV/K: where 0.3 of the charge has moved, the level differs."""
    rng = np.random.default_rng(5)
    A = rng.normal(size=(6, 3))
    e = Evidence(np.zeros(1), A.T @ A, rng.normal(size=3))
    moved = e.at_charge(0.3, (1, 2))
    for level, slope in ((0.4, -0.7), (-1.0, 0.2)):
        old, new = np.array([0.5, level, slope]), np.array([0.5, level + 0.3 * slope * 1.0 / 0.25, slope])
        cost = 0.5 * old @ e.info @ old + e.grad @ old
        assert 0.5 * new @ moved.info @ new + moved.grad @ new == pytest.approx(cost)
