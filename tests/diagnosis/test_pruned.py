"""What a search does not refit could not have been let in: it saves time and changes no verdict."""

import numpy as np
import pytest

from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.search import refit, search
from bms_gateway.diagnosis.weighing import EXACT_K, Settings, inexact, prior_odds
from bms_gateway.identify.map_fit import fitted
from bms_gateway.identify.problem import Problem
from tests.diagnosis.hidden_record import hidden


@pytest.mark.parametrize("effect", ["entropic_heat", "cell_resistance"])
def test_an_effect_that_is_not_refitted_is_far_behind(effect):
    cell = 3 if effect == "cell_resistance" else None
    _, record, model = hidden(effect, "strong", cell, cells=5, seconds=1800, noise=0.05, seed=6_100_400)
    tried = []
    found = search(
        model, [measured(record, model)], progress=lambda _, text: tried.append(text.removeprefix("refitting with "))
    )
    assert found.chosen[0].candidate.name == effect
    offered = [g.candidate for g in found.gains]
    left = {}
    for g in found.gains:
        if g.candidate.key not in tried and np.isfinite(g.gain) and g.gain > 20.0:
            left.setdefault(g.candidate.name, g)
    assert left  # all of the best fourteen were refitted, at 0.3 to 0.9 s each in a long string
    best = found.final.log_evidence + prior_odds(found.chosen[0].candidate, offered)
    for g in list(left.values())[:8]:
        assert refit(found.baseline, g).log_evidence + prior_odds(g.candidate, offered) < best - 20.0, g.candidate.key


def test_what_no_model_is_exact_to_grows_with_what_was_found():
    _, record, model = hidden("entropic_heat", "strong", cells=5, seconds=1800, noise=0.05, seed=6_100_400)
    found = search(model, [measured(record, model)])
    s = Settings()
    (m,) = found.baseline.problem.records
    a_second = len(m.y) / (m.drive.N * m.drive.dt)
    alone = a_second * s.memory * EXACT_K**2 * np.mean(m.sigma[m.used] ** -2.0)
    assert inexact(found.baseline, found.baseline, s) == pytest.approx(alone)
    assert inexact(found.final, found.baseline, s) > 2.0 * alone


def test_noise_that_hides_a_millikelvin_tempers_nothing():
    _, record, model = hidden(cells=1, sensors=(1,), seconds=1800, noise=0.3, seed=6_100_401)
    fit = fitted(Problem(model, [measured(record, model)]))
    assert inexact(fit, fit, Settings()) < 0.01
