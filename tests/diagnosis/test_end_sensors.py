"""Thermocouples on the end cells alone do not tell what happens at every cell from what happens at the ends."""

from dataclasses import replace

import pytest

from bms_gateway.diagnosis import search
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.search import search as searched
from bms_gateway.diagnosis.weighing import Settings
from tests.diagnosis.hidden_record import hidden


@pytest.mark.parametrize(("sensors", "tied"), [((1, 3), True), ((1, 2, 3), False)])
def test_joule_heat_of_every_surface_and_of_the_ends(sensors, tied):
    _, record, model = hidden(
        "surface_joule", "strong", cells=3, sensors=sensors, seconds=1500, seed=3, noise=0.05, cycle="pulses"
    )
    found = searched(model, [measured(record, model)], Settings(refits=4, effects=1))
    (chosen,) = found.chosen
    assert {"surface_joule", "busbar_joule"} & {chosen.candidate.name}
    assert ("busbar_joule" in (chosen.candidate.name, *chosen.tied)) == tied


def test_a_rival_that_explains_less_is_not_tied():
    _, record, model = hidden(
        "surface_joule", "strong", cells=3, sensors=(1, 3), seconds=1500, seed=3, noise=0.05, cycle="pulses"
    )
    found = searched(model, [measured(record, model)], Settings(refits=4, effects=1))
    first, *others = found.rounds[0]
    weak = [replace(t, log_odds=0.5 * first.log_odds, share=0.0) for t in others]
    assert not search.chosen_of(first, [first, *weak]).tied
