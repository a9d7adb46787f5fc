"""The score of a candidate promises what a refit finds, as long as the effect is small enough to be linear."""

from functools import cache

import numpy as np
import pytest

from bms_gateway.diagnosis.candidates import candidates
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.screen import AMPLITUDE_SD, Responses, screen
from bms_gateway.diagnosis.search import refit
from bms_gateway.diagnosis.weighing import Settings, gate
from bms_gateway.identify.map_fit import converged, fitted, stacked
from bms_gateway.identify.problem import Problem
from tests.diagnosis.hidden_record import hidden, named

SMALL = [
    ("resistance_drift", None),
    ("thermocouple_offset:3", 3),
    ("entropic_heat", None),
    ("cell_resistance:3", 3),
    ("ambient_loss", None),
]
"""Effects that the balances are linear in, or nearly, and where they sit."""
PACK = {"cells": 3, "sensors": (1, 3), "seconds": 1500, "seed": 4}


@cache
def weak(name, cell):
    """Fit of the model without an effect to a log that holds a weak one."""
    conditions = {"cycle": "sweep"} if name == "entropic_heat" else {}
    _, record, model = hidden(name, "weak", cell, **PACK, **conditions)
    return fitted(Problem(model, [measured(record, model)]))


@cache
def nothing():
    _, record, model = hidden(None, **PACK)
    return fitted(Problem(model, [measured(record, model)]))


def offered(fit):
    y = stacked(fit.problem)[0]
    return candidates(fit.problem.model, fit.problem.records[0].drive, (float(y.min()), float(y.max())))


@pytest.mark.parametrize(("key", "cell"), SMALL)
def test_the_promised_gain_is_what_a_refit_gains(key, cell):
    """Twice the logarithm of the posterior, with the numbers and the nuisances of the fit free to move along."""
    fit = weak(key.partition(":")[0], cell)
    c = next(c for c in offered(fit) if c.key == key)
    (g,) = screen(fit, [c])
    found = fit.cost - converged(refit(fit, g, iterations=20)).cost
    assert found > 5.0, "nothing to promise: the test would be empty"
    assert g.gain == pytest.approx(found, rel=0.1, abs=0.5)


def test_what_is_not_there_is_promised_no_more_than_chance_gives():
    """The gain of one strength that is not there is χ² of one degree of freedom or less, whichever the effect."""
    gains = [g for g in screen(nothing(), offered(nothing())) if len(g.candidate.strengths) == 1]
    assert len(gains) > 15
    assert np.median([g.gain for g in gains]) < 1.5
    assert max(g.gain for g in gains) < 20.0


@pytest.mark.parametrize("key", ["resistance_drift", "cell_resistance:2", "surface_joule", "thermocouple_offset:1"])
def test_the_gain_is_that_of_the_joint_linear_problem(key):
    """Against one least-squares problem of readings and priors together, solved whole."""
    fit = nothing()
    c = named(key)
    (g,) = screen(fit, [c])
    used = stacked(fit.problem)[4]
    sigma = fit.problem.records[0].sigma
    coordinates = fit.problem.coordinates
    prior_sd = np.concatenate([[x.sd for x in coordinates], fit.linear.sd])
    away = np.concatenate([(fit.theta - [x.prior for x in coordinates]), fit.nu]) / prior_sd
    own = np.array([AMPLITUDE_SD if p.log else p.sd for p in c.strengths])
    left = fit.problem.records[0].y - fit.y
    base = fit.problem.spread(np.concatenate([fit.J, fit.linear.J], axis=1))

    def least(J, sd, pulled):
        """Smallest sum of squares over steps from where the fit stands."""
        A = np.concatenate([(J / sigma[:, None])[used], np.diag(1.0 / sd)])
        b = np.concatenate([(left / sigma)[used], -pulled])
        x = np.linalg.lstsq(A, b, rcond=None)[0]
        return float(np.sum((A @ x - b) ** 2))

    without = least(base, prior_sd, away)
    joint = np.concatenate([base, fit.problem.spread(g.columns)], axis=1)
    with_it = least(joint, np.concatenate([prior_sd, own]), np.concatenate([away, np.zeros(len(own))]))
    assert g.gain == pytest.approx(without - with_it, rel=0.02, abs=0.02)


@pytest.mark.parametrize(
    "key", ["resistance_drift", "cell_cooling:2", "ambient_loss", "polarization", "radial_gradient", "coolant_delay"]
)
def test_a_response_is_the_difference_of_two_simulations(key):
    """Against the whole string run again from its start, with the effect and without."""
    fit = nothing()
    c = named(key)
    p = c.strengths[0]
    column = Responses(fit).column(c, p)
    begin = dict(c.begin)
    for q in c.strengths:
        begin[q.name] = q.probe if q is p else q.neutral
    problem = Problem(c.put_into(fit.problem.model, begin), fit.problem.records)
    theta = np.concatenate([fit.theta, problem.begin[len(fit.theta) :]])
    for i, x in enumerate(problem.coordinates):
        if x.effect == c.key:
            value = begin[x.name.rpartition(".")[2]]
            theta[i] = np.log(value) if c.effect.parameter(x.name.rpartition(".")[2]).log else value
    moved = problem.predict(theta, nu=fit.nu).y - fit.problem.predict(fit.theta, nu=fit.nu).y
    unit = 1.0 if p.log else p.probe - p.neutral
    size = float(np.max(np.abs(moved)))
    assert size > 0.0
    assert np.max(np.abs(column * unit - moved)) < 0.15 * size


@pytest.mark.parametrize(
    ("odds", "number", "says"),
    [
        (2.0, 0, "evidence too weak (log-odds 2.0)"),
        (2.0, 1, "evidence too weak (log-odds 2.0)"),
        (5.0, 1, "evidence too weak (log-odds 5.0, and one more effect needs 6)"),
        (8.6, 2, "evidence too weak (log-odds 8.6, and one more effect needs 12)"),
    ],
)
def test_evidence_that_would_be_enough_for_a_first_effect_is_told_to_be_too_little_for_one_more(odds, number, says):
    assert gate(nothing(), nothing(), odds, 1.0, Settings(), number) == says
