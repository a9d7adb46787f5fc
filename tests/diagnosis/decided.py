"""One cell with two hidden effects, diagnosed by the first search alone and by the second: short ones, made once."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from bms_gateway.diagnosis import diagnosis
from bms_gateway.diagnosis.diagnosis import diagnose
from bms_gateway.diagnosis.search import Chosen
from bms_gateway.diagnosis.second_search import SecondSettings, second_search
from bms_gateway.diagnosis.weighing import Settings
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import Scenario, make_log

FEW = SecondSettings(singles=4, pairs=2, triples=0, parents=1, pair_parents=1, again=2)


@cache
def pair():
    """Two hidden effects of one cell, and what a short search makes of them."""
    log = make_log(
        Scenario(
            {"entropic_heat": ("strong", None), "resistance_temperature": ("strong", None)},
            cells=1,
            sensors=(1,),
            seconds=1800,
            seed=5,
            noise=0.05,
        )
    )
    return record_of(log)


@cache
def by_first():
    record, model = pair()
    with pytest.MonkeyPatch.context() as m:
        m.setattr(diagnosis, "needs_second", lambda found: False)
        return diagnose(model, [record], Settings(refits=4))


@cache
def by_second():
    record, model = pair()
    with pytest.MonkeyPatch.context() as m:
        m.setattr(diagnosis, "needs_second", lambda found: True)
        m.setattr(diagnosis, "second_search", partial(second_search, settings=FEW))
        return diagnose(model, [record], Settings(refits=4))


def at_its_bound():
    """A search that ended with a number of its first effect on a bound."""
    d = by_first()
    first, trials = d.search.chosen[0], d.search.rounds[0]
    trial = next(t for t in trials if t.candidate.key == first.candidate.key)
    name = f"{first.candidate.key}.{first.candidate.effect.parameters[0].name}"

    def pushed(fit):
        theta = np.array(fit.theta)
        theta[fit.problem.index(name)] = fit.problem.coordinates[fit.problem.index(name)].lower
        return replace(fit, theta=theta)

    other = replace(trial, fit=pushed(trial.fit), share=1.0)
    rounds = [[other if t is trial else t for t in trials], *d.search.rounds[1:]]
    chosen = [Chosen(first.candidate, ("hysteresis",), first.log_odds), *d.search.chosen[1:]]
    return other, replace(d.search, rounds=rounds, chosen=chosen, final=pushed(d.search.final))
