"""A fit of single cells survives its way through the string's model: to a later fit and to the observer."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bms_gateway.config.model_file import format_model, parse_model
from bms_gateway.identify import WindowIdentifier, string_parameters
from bms_gateway.identify.cell_kept import baseline_of, kept, numbers_kept
from bms_gateway.identify.cell_live import CellIdentifier
from bms_gateway.identify.cell_prior import AGED_APART, AGED_TOGETHER
from bms_gateway.identify.resistance_by_cell import CellFit, CellRecord, Known, fit_cells
from bms_gateway.observe import AdaptiveObserver
from bms_gateway.thermal import AddedEffect, Prior, StringModel
from tests.truth.string import C_F, TABLE_1
from tests.truth.unequal import FIG_10, drives

ENDS = (1, 5)


@cache
def packs():
    return drives([21], minutes=45, swing=8.0, run=1)


def model() -> StringModel:
    sd = {"C_c": 0.05, "C_s": 0.05, "R_e": 0.6, "R_c": 0.05, "R_u": 0.1, "R_cc": 0.2, "C_f": 0.05}
    values = {**TABLE_1, "R_cc": 4.0, "C_f": C_F}
    return StringModel(5, ENDS, "full", {k: Prior(v, sd[k]) for k, v in values.items()}, "ntu")


@cache
def commissioned() -> tuple[CellFit, StringModel, np.ndarray]:
    """All surfaces sensed; the voltage of cell 4 is missing."""
    d = packs()
    R_el = d.R_el(0.03)[0].copy()
    R_el[3] = np.nan
    fit = fit_cells(
        model(), CellRecord(d.current**2, d.inlet, d.readings[0], np.zeros_like(d.readings[0])), known=Known(R_el)
    )
    return fit, parse_model(format_model(kept(model(), fit, R_el))), R_el


def test_the_baseline_read_back_is_that_of_the_fit():
    fit, m, R_el = commissioned()
    a, b = fit.baseline(R_el), baseline_of(m)
    assert b.layout == a.layout
    assert b.mean == pytest.approx(a.mean, abs=1e-5)
    sd = np.sqrt(np.diag(a.cov))
    assert np.abs(b.cov - a.cov).max() < 1e-3 * np.outer(sd, sd).max()
    assert b.resistance == pytest.approx(a.resistance, rel=1e-5, nan_ok=True)


def test_the_vehicles_sensors_and_what_was_known_before_stay():
    _, m, _ = commissioned()
    assert m.sensors == ENDS
    assert {k: (p.value, p.rel_sd) for k, p in m.unfitted.priors.items()} == {
        k: (p.value, p.rel_sd) for k, p in model().priors.items()
    }


def test_an_observer_begins_with_the_cells_and_a_band_that_allows_for_ageing():
    fit, m, _ = commissioned()
    numbers = numbers_kept(m)
    assert numbers.values["R_e"] == pytest.approx(fit.R_e, rel=1e-5)
    assert numbers.values["R_e"] == pytest.approx(FIG_10, rel=0.1)
    own = np.sqrt(numbers.own[:, 0, 0])
    assert (own > 0.9 * AGED_APART).all()
    assert (own < 1.5 * AGED_APART).all()
    assert m.priors["R_e"].rel_sd > AGED_TOGETHER
    observer = AdaptiveObserver([m], 1.0)
    observer.set_parameters(0, numbers.values, numbers.names, numbers.common, numbers.own)
    assert observer.parameters[0].R_e == pytest.approx(fit.R_e, rel=1e-5)


def test_what_is_common_scales_all_cells():
    _, m, _ = commissioned()
    posterior = WindowIdentifier(m).posterior()
    at = posterior.names.index("R_e")
    more = posterior.mean.copy()
    more[at] += np.log(1.2)
    one, two = (string_parameters(m, posterior.names, x).R_e for x in (posterior.mean, more))
    assert one == pytest.approx(m.priors["R_e"].value)
    assert two == pytest.approx(1.2 * one)


def test_with_the_baseline_two_surfaces_and_voltages_know_the_cells_better():
    _, m, _ = commissioned()
    d = drives([21], minutes=45, swing=3.0)
    y = np.full_like(d.readings[0], np.nan)
    y[:, [0, 4]] = d.readings[0][:, [0, 4]]
    r = CellRecord(d.current**2, d.inlet, y, np.zeros_like(y))
    fresh = fit_cells(model(), r)
    fit = fit_cells(m, r, known=Known(baseline=baseline_of(m)))
    assert (fit.rel_sd[1:4] < 0.6 * fresh.rel_sd[1:4]).all()
    assert (np.abs(np.log(fit.R_e / FIG_10)) < 3 * fit.rel_sd).all()


def test_a_live_identifier_takes_the_baseline_of_its_model():
    _, m, _ = commissioned()
    identifier = CellIdentifier(m)
    kept_state = identifier.snapshot()
    assert kept_state["baseline"]["mean"] == baseline_of(m).mean.tolist()
    assert kept_state["baseline_resistance"][3] is None


def test_a_model_of_another_structure_has_no_baseline():
    _, m, _ = commissioned()
    assert baseline_of(model()) is None
    assert numbers_kept(model()) is None
    assert baseline_of(replace(m, effects=(AddedEffect("entropic_heat"),))) is None
    fixed = {**m.priors, "C_s": replace(m.priors["C_s"], rel_sd=0.0)}
    assert baseline_of(replace(m, priors=fixed)) is None
