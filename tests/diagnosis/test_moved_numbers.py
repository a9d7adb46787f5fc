"""A number that left what was known of it is not one of which the data say no more than was known."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.diagnosis import adding
from bms_gateway.diagnosis.adding import unbelievable
from bms_gateway.diagnosis.calibrate import AT_BOUND, MOVED, UNIDENTIFIABLE, statuses
from bms_gateway.diagnosis.compare import compare
from bms_gateway.report.html_correlation import APART, correlation_table, correlations
from bms_gateway.report.html_evidence import summary
from bms_gateway.report.html_series import Shown
from bms_gateway.report.html_tables import called, parameters_table
from tests.diagnosis.decided import by_first
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import Scenario, make_log


@pytest.fixture(scope="module")
def compared():
    """A string whose coolant hardly moves, so that some of its numbers stay as they were known."""
    record, model = record_of(make_log(Scenario(cells=3, sensors=(1, 2, 3), seconds=600, seed=4, noise=0.3)))
    return compare(model, [record]).refitted


def moved_by(fit, i, sds):
    """The fit with a coordinate so many sd of its prior off it, or at its bound for None."""
    c, theta = fit.problem.coordinates[i], np.array(fit.theta)
    theta[i] = c.lower if sds is None else c.prior + sds * c.sd
    return replace(fit, theta=theta)


@pytest.mark.parametrize(("sds", "status"), [(0.5, UNIDENTIFIABLE), (2.5, MOVED), (-2.5, MOVED), (None, AT_BOUND)])
def test_a_number_that_moved_is_not_said_to_be_as_it_was_known(compared, sds, status):
    """One that ended 3.3 sd from its prior stood among those of which the data say no more than was known."""
    fit = compared.fit
    i = next(k for k, s in enumerate(statuses(fit)) if s.startswith(UNIDENTIFIABLE))
    other = moved_by(fit, i, sds)
    assert statuses(other)[i].startswith(status)
    label = called(fit.problem.coordinates[i])
    card = summary([replace(Shown.of("x", compared), fit=other)]).partition("Not identifiable")[2]
    kept = card.partition("these are known no better than before: ")[2]
    assert (label in kept) == (status == UNIDENTIFIABLE)
    assert ("far from what was known, yet no better known: " in card) == (status == MOVED)
    assert ("at a limit, so not used: " in card) == (status == AT_BOUND)
    if status == MOVED:
        assert f'<span class="alarm">{MOVED}</span>' in parameters_table(other)


@pytest.mark.parametrize(
    ("sds", "says"), [(0.5, "not identifiable: "), (3.0, "its size moved far from what was known")]
)
def test_an_effect_whose_size_moved_is_refused_for_that(monkeypatch, sds, says):
    d = by_first()
    c = d.selected[0].candidate
    free = [x.name for x in d.search.final.problem.coordinates]
    sizes = [p for p in c.effect.parameters if p.neutral is not None and f"{c.key}.{p.name}" in free]
    assert sizes
    at = [d.search.final.problem.index(f"{c.key}.{p.name}") for p in sizes]
    fit = d.search.final
    for i in at:
        fit = moved_by(fit, i, sds)
    assert unbelievable(d.search.final, [c]) == ""
    monkeypatch.setattr(adding, "UNTOLD", 0.0)  # as where no number is better known than before
    assert unbelievable(fit, [c]).startswith(says)


def test_numbers_hardly_known_apart_do_not_stand_beside_a_claim_that_all_are_determined():
    """The data "determine every free parameter", it was said beside two of them with a correlation of 1.00."""
    record, model = record_of(make_log(Scenario(cells=1, sensors=(1,), seconds=3600, seed=4, noise=0.02)))
    wide = {k: replace(p, rel_sd=0.6) for k, p in model.priors.items() if p.rel_sd}
    own = compare(replace(model, priors={**model.priors, **wide}), [record]).refitted
    _, r = correlations(own.fit)
    alike = np.abs(np.tril(r, -1)).max() > APART
    card = summary([Shown.of("x", own)]).partition("Not identifiable")[2]
    assert not any(s.startswith(UNIDENTIFIABLE) for s in statuses(own.fit))
    assert alike
    assert "Hardly known apart" in correlation_table(own.fit)
    assert "but hardly apart: " in card
    assert "determine every" not in card
