"""Reversible heat in the observer, against the independent truth: climbs and descents of half an hour each."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.errors import StateError
from bms_gateway.observe import PARAMETERS, AdaptiveObserver
from bms_gateway.observe.reversible import FARTHEST
from tests.observe.rig import model
from tests.truth.effects import entropic_heat
from tests.truth.pack import integrate, terms

CELLS, SENSORS, CAPACITY_AH = 5, (1, 5), 60.0
CLIMB_S, AMPS, NOISE = 1500, 45.0, 0.05
NAMES = ("entropic", "entropic_slope")
EXACT = np.diag([1e-12, 1e-12])


def observer(strings=1):
    """An observer that knows everything of its cells but their entropy."""
    m = replace(model(CELLS, SENSORS, tolerances={}), capacity_Ah=CAPACITY_AH)
    return AdaptiveObserver([m] * strings, 1.0, heat_rel_sd=0.0)


def current(seed):
    rng = np.random.default_rng([seed, 3])
    climb, descent = AMPS * rng.uniform(0.7, 1.3), -AMPS * rng.uniform(0.5, 1.0)
    return np.repeat([climb, descent], CLIMB_S) * (1.0 + 0.1 * rng.normal(size=2 * CLIMB_S))


def road(coefficients, seed=0):
    """Currents (K,), and true cores and noisy surfaces (K + 1, S, n), of a string for each coefficient, mV/K."""
    amps, logs = current(seed), []
    for u in coefficients:
        t = terms(CELLS, amps, np.full(len(amps) + 1, 25.0), np.ones(len(amps)), 0.5)
        entropic_heat(t, dUdT=1.0)
        moved = (np.cumsum(amps) - amps / 2.0) / 3600.0 / CAPACITY_AH
        t.entropic *= u[0] + u[1] * moved
        logs.append(t)
    traces = integrate(logs)
    y = np.stack([x.surface for x in traces], axis=1)
    y = y + NOISE * np.random.default_rng([seed, 4]).normal(size=y.shape)
    y[:, :, [k for k in range(CELLS) if k + 1 not in SENSORS]] = np.nan
    return amps, np.stack([x.core for x in traces], axis=1), y


def follow(o, amps, y, start=1, stop=None, *, told=True):
    """Estimates of the instants `start` … `stop`; the current is told with its sign, or its square alone."""
    S, found, now = y.shape[1], [], np.zeros(y.shape[1:])
    for k in range(start, len(y) if stop is None else stop):
        if told:
            o.reversible.flow(np.full(S, amps[k - 1]))
        found.append(o.step(np.full(S, amps[k - 1] ** 2), None, np.full(S, 25.0), y[k], now))
    return found


def of(found, name):
    return np.stack([getattr(e, name) for e in found])


def test_bands_cover_cells_with_the_entropy_of_the_prior_and_did_not_by_the_square_of_the_current() -> None:
    """Coefficients drawn from the prior: a climb moves cores by kelvins that no surface tells apart from the load's."""
    rng = np.random.default_rng(7)
    drawn = rng.normal(size=(40, 2)) * [0.25, 1.0]
    amps, core, y = road(drawn)
    found, blind = follow(observer(40), amps, y), follow(observer(40), amps, y, told=False)
    late = slice(600, None)
    z, before = (((of(e, "core") - core[1:]) / of(e, "core_sd"))[late] for e in (found, blind))
    assert np.mean(np.abs(z) < 2.0) > 0.93
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.15
    assert np.mean(np.abs(before) < 2.0) < 0.6


def test_known_coefficients_correct_the_cores_in_both_directions_of_the_current() -> None:
    u = (0.2, -0.4)
    amps, core, y = road([u])
    o = observer()
    o.set_parameters(0, dict(zip(NAMES, u, strict=True)), NAMES, EXACT)
    known, blind = (np.abs(of(follow(x, amps, y), "core") - core[1:])[600:] for x in (o, observer()))
    assert known.max() < 0.35
    assert blind.max() > 1.5


def test_coefficients_that_come_late_put_the_cores_where_they_would_always_have_been() -> None:
    u = {"entropic": -0.3, "entropic_slope": 0.5}
    amps, _, y = road([(-0.3, 0.5)])
    late, always, never = observer(), observer(), observer()
    always.set_parameters(0, u, NAMES, EXACT)
    for o in (late, always, never):
        follow(o, amps, y, stop=1400)
    late.set_parameters(0, u, NAMES, EXACT)
    a, b, c = (o.estimate().core for o in (late, always, never))
    assert np.abs(c - b).min() > 0.5
    assert np.abs(a - b).max() < 0.05 * np.abs(c - b).max()


def test_a_line_means_the_same_wherever_on_it_the_level_is_stated() -> None:
    amps, _, y = road([(0.1, 0.3)])
    a, b = observer(), observer()
    turn = np.array([[1.0, 0.2], [0.0, 1.0]])  # the level at a charge that is farther by 0.2
    cov = np.array([[0.04, 0.03], [0.03, 0.5]])
    for o in (a, b):
        follow(o, amps, y, stop=900)
    at = float(a.reversible.charge[0])
    a.set_parameters(0, {"entropic": 0.1, "entropic_slope": 0.3, "charge": at}, NAMES, cov)
    b.set_parameters(0, {"entropic": 0.16, "entropic_slope": 0.3, "charge": at - 0.2}, NAMES, turn @ cov @ turn.T)
    for x, z in zip(follow(a, amps, y, 900), follow(b, amps, y, 900), strict=True):
        np.testing.assert_allclose(x.core, z.core, atol=1e-7)
        np.testing.assert_allclose(x.core_sd, z.core_sd, rtol=1e-6)


def test_the_charge_of_a_cell_of_unknown_size_does_not_widen_the_band_without_end() -> None:
    o = observer()
    o.reversible.flow(np.full(1, 3e6))
    o.step(np.full(1, 100.0), None, np.full(1, 25.0), np.full((1, CELLS), 25.0), np.zeros((1, CELLS)))
    assert o.reversible.charge[0] == FARTHEST


def test_a_current_that_is_not_known_makes_no_reversible_heat() -> None:
    amps, _, y = road([(0.3, 0.0)])
    o, never = observer(), observer()
    o.set_parameters(0, {"entropic": 0.3}, NAMES, EXACT)
    a = follow(o, np.full(60, np.nan), y, stop=60)[-1]
    b = follow(never, np.full(60, np.nan), y, stop=60, told=False)[-1]
    assert np.isfinite(a.core).all()
    np.testing.assert_allclose(a.core, b.core, atol=1e-9)
    assert o.reversible.charge[0] == 0.0
    assert len(amps) > 60


@pytest.mark.parametrize("cut", [900, 907, 913])
def test_a_restart_goes_on_bit_for_bit(cut: int) -> None:
    amps, _, y = road([(0.2, 0.4), (-0.2, 0.1)])
    a, b = observer(2), observer(2)
    follow(a, amps, y, stop=700)
    a.set_parameters(1, {"entropic": -0.2, "entropic_slope": 0.1, "charge": 0.05}, NAMES, EXACT)
    follow(a, amps, y, 700, cut)
    b.restore(json.loads(json.dumps(a.snapshot(), allow_nan=False)))
    for x, z in zip(follow(a, amps, y, cut, cut + 60), follow(b, amps, y, cut, cut + 60), strict=True):
        for name in ("core", "core_sd", "surface", "surface_sd", "innovation", "innovation_sd"):
            assert getattr(x, name).tobytes() == getattr(z, name).tobytes()
    assert json.dumps(a.snapshot()) == json.dumps(b.snapshot())


@pytest.mark.parametrize(("name", "value"), [("entropic", [[1e3, 0.0]]), ("charge", [7.0]), ("charge", [None])])
def test_a_damaged_state_is_refused(name, value) -> None:
    amps, _, y = road([(0.2, 0.4)])
    o = observer()
    follow(o, amps, y, stop=100)
    stored = json.loads(json.dumps(o.snapshot()))
    stored["own"][name] = value
    with pytest.raises(StateError):
        observer().restore(stored)


def test_a_state_of_a_version_without_reversible_heat_is_taken_up_with_the_prior() -> None:
    amps, _, y = road([(0.2, 0.4)])
    a, b = observer(), observer()
    follow(a, amps, y, stop=700, told=False)
    stored = json.loads(json.dumps(a.snapshot()))
    own, block, k = stored["own"], stored["block"], len(PARAMETERS) - 3
    for part in (own, block):  # such a version did not follow what the cores' warmth does to R_e either
        part["J"] = np.where(np.arange(k + 3) == k + 2, 0.0, np.array(part["J"])).tolist()
    a.restore(stored)
    del own["entropic"], own["charge"], block["amps"], block["firm"]
    own["cov"] = np.array(own["cov"])[:, :k, :k].tolist()
    own["J"], block["J"] = (np.array(J)[:, :, :k].tolist() for J in (own["J"], block["J"]))
    b.restore(stored)
    assert b.estimate().core_sd.tobytes() == a.estimate().core_sd.tobytes()
    np.testing.assert_array_equal(follow(a, amps, y, 700, 900)[-1].core_sd, follow(b, amps, y, 700, 900)[-1].core_sd)
