"""No effect is named with a conductance, a resistance or a share that no body can have."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.diagnosis.adding import unbelievable
from bms_gateway.diagnosis.bounds import below_least
from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.diagnosis import diagnose
from bms_gateway.thermal.effects import catalogue
from tests.diagnosis.decided import by_first
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import Scenario, make_log

SIGNED = {("ambient_loss", "P"), ("core_loss", "P"), ("end_plate", "P"), ("neighbour_heat", "P")}
"""Heat in W that flows in or out."""
POSITIVE = {"W/K", "mOhm"}


def test_every_conductance_and_resistance_has_its_least_value():
    for effect in catalogue().values():
        for p in effect.parameters:
            if p.unit in POSITIVE and (effect.name, p.name) not in SIGNED and not p.log:
                assert p.least == 0.0 or p.lower >= 0.0, (effect.name, p.name)


@pytest.mark.parametrize(("sds", "excluded"), [(1.0, False), (-1.0, False), (-15.0, True)])
def test_a_number_certainly_below_its_least_excludes_its_effect_alone(monkeypatch, sds, excluded):
    d = by_first()
    fit, c = d.search.final, d.selected[0].candidate
    name = next(f"{c.key}.{p.name}" for p in c.effect.parameters if p.neutral == 0.0)
    i = fit.problem.index(name)
    theta = np.array(fit.theta)
    theta[i] = sds * np.sqrt(fit.covariance[i, i])
    moved = replace(fit, theta=theta)
    assert not below_least(moved)  # this effect's number may have either sign
    p = next(p for p in c.effect.parameters if f"{c.key}.{p.name}" == name)
    limited = tuple(replace(q, least=0.0) if q is p else q for q in c.effect.parameters)
    monkeypatch.setattr(type(c.effect), "parameters", limited)
    said = below_least(moved)
    assert bool(said) == excluded
    assert below_least(moved, c) == said
    assert below_least(moved, Candidate(catalogue()["core_loss"], None)) == ""
    assert (name in unbelievable(moved, [c])) == excluded
    if excluded:
        assert f"({name}) comes out as −" in said


def ends_at(name, value):
    """A fit with one number, which ends at its bound."""
    coordinate = SimpleNamespace(name=name, effect=name.partition(".")[0], sd=1.0)
    return SimpleNamespace(
        problem=SimpleNamespace(coordinates=(coordinate,)), theta=np.array([value]), at_bound=lambda _: True
    )


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("thermocouple_lag.tau", 2.304e-5, "(tau) ends at its bound, less than 0.001 s"),
        ("thermocouple_lag.tau", 60.0, "(tau) ends at its bound, 60 s"),
        ("phase_change.L", 12345.6, "(L) ends at its bound, 12350 J"),
        ("current_offset.b", -10.0, "(b) ends at its bound, −10 A"),
    ],
)
def test_a_bound_is_told_in_plain_units_and_as_of_the_closest_fit(monkeypatch, name, value, says):
    """A step told "tau 0.5 ± 2.0 s" and beside it "tau ends at its bound, 2.304e-05 s": two numbers for one thing."""
    monkeypatch.setattr("bms_gateway.diagnosis.adding.posterior", lambda _: np.eye(1))
    said = unbelievable(ends_at(name, value), [Candidate(catalogue()[name.partition(".")[0]], None)])
    assert said.startswith("closely fitted, ")
    assert said.endswith(f"{says}: not believed")


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.93, 0.95, 1.06])
def test_a_thermocouple_with_another_gain_makes_no_negative_conductance(gain):
    """The pair of end plates with −0.1 W/K and surroundings with +0.09 W/K explained a gain of 0.95."""
    log = make_log(Scenario(cells=5, sensors=(1, 2, 3, 5), seconds=3600, seed=31, noise=0.05))
    log.table["surface_2_C"][:] *= gain
    record, model = record_of(log)
    d = diagnose(model.unfitted, [record])
    assert d.verdict != "adequate"
    for s in d.selected:
        for p in s.candidate.effect.parameters:
            if p.least > -np.inf:
                value, sd = s.parameters[p.name].value, s.parameters[p.name].sd
                assert value >= p.least / p.to_si - 2.0 * sd, (s.candidate.key, p.name, value, sd)
