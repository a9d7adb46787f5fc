"""What a record could show: sizes that would be found, effects that look alike, what parameters absorb."""

import re

import numpy as np
import pytest

from bms_gateway.diagnosis.candidates import candidates
from bms_gateway.diagnosis.detect import Projection, absorbed, detectability
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.residuals import structure
from bms_gateway.diagnosis.screen import screen
from bms_gateway.diagnosis.search import refit
from bms_gateway.diagnosis.weighing import prior_odds
from bms_gateway.identify.map_fit import fitted
from bms_gateway.identify.problem import Problem
from tests.diagnosis.hidden_record import hidden, named


def fit_of(*effect, **scenario):
    _, record, model = hidden(*effect, **scenario)
    m = measured(record, model)
    fit = fitted(Problem(model, [m]))
    return fit, candidates(model, m.drive, (float(m.y.min()), float(m.y.max())))


@pytest.fixture(scope="module")
def pulses():
    fit, offered = fit_of(seed=12, cycle="pulses")
    return fit, offered, detectability(fit, offered)


def test_a_size_above_the_smallest_is_found_and_one_below_is_not(pulses):
    smallest = next(d for d in pulses[2].effects if d.key == "resistance_asymmetry").smallest
    assert 0.003 < smallest < 0.05

    def odds(times):
        fit, offered = fit_of("resistance_asymmetry", times * smallest / 0.3, seed=12, cycle="pulses")
        (gain,) = screen(fit, [named("resistance_asymmetry")])
        more = refit(fit, gain)
        inflation = structure(more).inflation
        return (more.log_evidence - fit.log_evidence) / inflation + prior_odds(gain.candidate, offered) - np.log(0.5)

    assert odds(2.5) > 3.0
    assert odds(0.2) < 3.0


def test_projected_columns_are_what_least_squares_leaves(pulses):
    fit, offered, _ = pulses
    gains = screen(fit, [c for c in offered if c.key in ("current_offset", "surface_joule")])
    h = np.concatenate([g.columns for g in gains], axis=1)
    sd = np.concatenate([[c.sd for c in fit.problem.coordinates], fit.linear.sd])
    # ridge least squares as one tall ordinary problem: an oracle that shares no formula with the projection
    base = np.concatenate([fit.weighed(np.concatenate([fit.J, fit.linear.J], axis=1)), np.diag(1 / sd)])
    tall = np.concatenate([fit.weighed(h), np.zeros((len(sd), h.shape[1]))])
    rest = tall - base @ np.linalg.lstsq(base, tall, rcond=None)[0]
    assert np.allclose(Projection(fit).gram(h), rest.T @ rest, rtol=1e-5)


def test_entropic_heat_and_a_current_offset_look_alike_without_a_span_of_charge(pulses):
    assert "current_offset" not in {c.effect.name for c in pulses[1]}  # its rests read zero
    fit, offered = fit_of("current_offset", seed=12, cycle="pulses")
    card = detectability(fit, offered)
    pairs = {frozenset((a.one, a.other)) for a in card.alike}
    assert frozenset(("entropic_heat", "current_offset")) in pairs
    group = next(g for g in card.groups if "entropic_heat" in g)
    assert any("entropic_heat" in s and "look alike" in s for s in card.sentences)
    assert "current_offset" in group


def test_on_a_single_cell_at_constant_inlet_offsets_and_losses_are_one():
    fit, offered = fit_of(seed=4, cells=1, sensors=(1,), inlet="constant")
    card = detectability(fit, offered)
    group = next(g for g in card.groups if "inlet_offset" in g)
    assert "neighbour_heat:1" in group
    assert not any(d.visible for d in card.effects if d.key == "coolant_delay")
    blind = [d.effect for d in card.effects if not d.visible]
    assert all(name in card.sentences[0] for name in blind)


def test_the_places_of_one_effect_are_named_together():
    fit, offered = fit_of(seed=4, cells=12, sensors=tuple(range(1, 13)), seconds=900)
    card = detectability(fit, offered)
    offsets = [g for g in card.groups if any(k.startswith("thermocouple_offset:") for k in g)]
    assert len(offsets) > 2
    told = [s for s in card.sentences if "thermocouple_offset" in s]
    assert len(told) == 1
    assert re.match(r"In each of the cells \d+ to \d+.*, neighbour_heat and thermocouple_offset look alike", told[0])
    for sentence in card.sentences:
        names = re.findall(r"[a-z]+(?:_[a-z]+)+", sentence)
        assert len(names) == len(set(names)), sentence


def test_a_cell_without_a_sensor_hides_more(pulses):
    size = {d.key: d.smallest for d in pulses[2].effects}
    assert size["cell_resistance:2"] > 2 * size["cell_resistance:1"]


def test_a_products_sd_is_that_of_the_posterior(pulses):
    fit = pulses[0]
    got = absorbed(fit)
    draws = np.random.default_rng(0).multivariate_normal(fit.theta, fit.covariance, 20_000)
    names = [c.name for c in fit.problem.coordinates]
    for c in got.combinations:
        product = sum(draws[:, names.index(s)] for s in c.symbols)
        assert c.rel_sd == pytest.approx(np.std(product), rel=0.05)
    core = next(c for c in got.combinations if c.symbols == ("R_e", "R_c"))
    assert core.rel_sd < dict(core.apart)["R_e"]
    assert any("current sensor" in s for s in got.sentences)
