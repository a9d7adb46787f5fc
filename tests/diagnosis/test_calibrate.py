"""A fit becomes a model again: its numbers, how their errors hang together, and what was known before."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.diagnosis import calibrate, filed
from bms_gateway.diagnosis.adding import check_signals, wanted
from bms_gateway.diagnosis.calibrate import changes, channel_errors, fitted_model, identify, posterior
from bms_gateway.diagnosis.record import make_record
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.errors import ConfigError, DataError
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import AddedEffect, Prior
from tests.diagnosis.logs import rows, string_model
from tests.truth.hidden import Scenario, make_logs

MODEL = string_model(3, (1, 2, 3))
WIDE = replace(MODEL, priors={k: Prior(p.value, 0.05 if k[0] == "C" else 0.6) for k, p in MODEL.priors.items()})


def record(log, model=WIDE):
    t = log.table
    names = {k: f"surface_{k}_C" for k in log.scenario.sensors}
    return make_record(
        Columns(
            time_s=t["time_s"],
            current_A=t["current_A"],
            coolant_inlet_C=t["coolant_inlet_C"],
            soc=t["soc"],
            coolant_flow_m3_s=t["coolant_flow_m3_s"],
            surface_C={k: t[name] for k, name in names.items()},
            source=log.scenario.name,
        ),
        model,
    )


@pytest.fixture(scope="module")
def records():
    common = {"cells": 3, "sensors": (1, 2, 3), "noise": 0.05, "seconds": 1800, "seed": 5}
    return [record(log) for log in make_logs([Scenario(**common), Scenario(**common, drive_seed=6)])]


@pytest.fixture(scope="module")
def fit(records):
    return identify(WIDE, records[:1]).fit


def test_the_model_says_what_the_fit_says(fit):
    model = fitted_model(fit, WIDE)
    free = Problem(model, fit.problem.records)
    there = dict(zip([c.name for c in fit.problem.coordinates], fit.theta, strict=True))
    theta = [0.0 if c.name in model.priors else there[c.name] for c in free.coordinates]
    starts = {c.name: z for c, z in zip(fit.problem.nuisances, fit.nu, strict=True)}
    # offsets of sensors belong to the record, what the cells are to the model
    nu = np.array([0.0 if c.name.startswith("R_") else starts[c.name] for c in free.nuisances])
    columns = free.jacobian(np.array(theta), free.predict(np.array(theta)), free.nuisances, refinements=0)
    y = free.predict(np.array(theta)).y + columns @ nu
    assert np.sqrt(np.mean((y - fit.y) ** 2)) < 0.02


def test_what_was_known_before_is_kept_and_comes_back(fit, records):
    model = fitted_model(fit, WIDE)
    assert dict(model.before) == dict(WIDE.priors)
    again = identify(model, records[:1]).fit
    assert again.theta == pytest.approx(fit.theta, abs=1e-6)
    assert fitted_model(again, model).before == model.before


def test_the_correlation_is_that_of_the_posterior(fit):
    model = fitted_model(fit, WIDE)
    names, R = model.correlation
    assert set(names) == set(WIDE.priors)
    assert np.linalg.eigvalsh(R)[0] > -1e-5
    C = posterior(fit)
    i, j = fit.problem.index("R_e"), fit.problem.index("R_u")
    expected = C[i, j] / np.sqrt(C[i, i] * C[j, j])
    assert R[names.index("R_e"), names.index("R_u")] == pytest.approx(expected, abs=1e-5)
    assert model.priors["R_e"].rel_sd == pytest.approx(np.sqrt(C[i, i]), rel=1e-3)


def test_no_fit_is_made_whose_numbers_nobody_sees(records, monkeypatch):
    seen = []

    def counted(model, ready, *, model_error):
        seen.append(model_error)
        return filed.filed_fit(model, ready, model_error=model_error)

    def unasked(_problem):
        raise AssertionError("a fit without a model error is not asked for where one is allowed for")

    lacking = replace(WIDE, priors={**WIDE.priors, "R_u": Prior(2.0 * WIDE.priors["R_u"].value)})
    monkeypatch.setattr(filed, "fitted", unasked)
    monkeypatch.setattr(calibrate, "filed_fit", counted)
    assert identify(lacking, records[:1]).model_error_K > 0.0
    assert seen == [True]


def test_what_is_fixed_stays_fixed(records):
    model = replace(WIDE, priors={**WIDE.priors, "C_c": Prior(268.0)})
    fitted = fitted_model(identify(model, records[:1]).fit, model)
    assert fitted.priors["C_c"] == Prior(268.0)
    assert "C_c" not in fitted.correlation[0]


def test_coloured_residuals_weaken_the_posterior(fit):
    right = posterior(fit)
    slow = 0.3 * np.sin(np.arange(len(fit.y)) / 60.0)
    wrong = posterior(replace(fit, r=fit.r + slow / 0.05))
    P = len(fit.theta)
    assert (np.diag(wrong)[:P] > 1.1 * np.diag(right)[:P]).sum() >= 3
    assert (np.diag(wrong) >= np.diag(right) * (1 - 1e-9)).all()


def test_each_record_has_its_own_cooling_and_the_model_a_mean_that_covers_the_next(records):
    fit = identify(WIDE, records).fit
    own = [c for c in changes(fit) if c.name == "R_u"]
    assert [c.of for c in own] == [r.source for r in records]
    model = fitted_model(fit, WIDE)
    mean = np.exp(np.mean(np.log([c.after for c in own])))
    assert np.mean(np.log(model.priors["R_u"].value)) == pytest.approx(np.log(mean), abs=0.02)
    apart = np.std(np.log([c.after for c in own]), ddof=1)
    assert model.priors["R_u"].rel_sd > apart
    assert len(channel_errors(fit)) == 6


def test_numbers_are_told_before_and_after(fit):
    by_name = {c.name: c for c in changes(fit)}
    assert by_name["R_e"].before == pytest.approx(3.5)
    assert by_name["R_e"].before_sd == pytest.approx(0.6 * 3.5)
    assert by_name["R_e"].unit == "mOhm"
    assert by_name["R_e"].status == "identified"


class TestWanted:
    def test_an_effect_at_a_place(self):
        w = wanted("cell_cooling:2", MODEL)
        assert (w.effect.name, w.cell, w.key) == ("cell_cooling", 2, "cell_cooling:2")
        assert wanted("cell_cooling", MODEL).cell is None

    @pytest.mark.parametrize(
        ("word", "message"),
        [
            ("cell_coling", "did you mean 'cell_cooling'"),
            ("cell_cooling:0", "valid: 1, 2, 3"),
            ("cell_cooling:x", "valid: 1, 2, 3"),
            ("polarization:1", "sits on no cell; write polarization"),
        ],
    )
    def test_a_slip_names_the_nearest_choice(self, word, message):
        with pytest.raises(ConfigError, match=message):
            wanted(word, MODEL)

    def test_what_needs_neighbours_needs_cells(self):
        with pytest.raises(ConfigError, match="coolant_bypass needs at least 3 cells; this model has 1"):
            wanted("coolant_bypass:1", string_model(1, (1,)))

    def test_what_is_there_already(self):
        model = replace(MODEL, effects=(AddedEffect("cell_cooling", 2, {"a": 0.1}, {"a": 0.1}),))
        with pytest.raises(ConfigError, match="cell_cooling:2 is in the model already"):
            wanted("cell_cooling:2", model)
        assert wanted("cell_cooling", model).cell is None
        assert wanted("cell_cooling:1", model).cell == 1

    def test_signals_that_are_not_there(self):
        columns = {k: v for k, v in rows(600).items() if k not in ("soc", "voltage_V")}
        bare = string_model(3, (1, 3), capacity_Ah=None)
        r = make_record(Columns(**columns, source="bench.csv"), bare)
        with pytest.raises(DataError, match=r"bench.csv: resistance_soc needs the column soc, or cell.capacity_Ah"):
            check_signals([wanted("resistance_soc", bare)], [r])
        with pytest.raises(DataError, match="voltage_heat needs the column voltage_V"):
            check_signals([wanted("voltage_heat", bare)], [r])
        with pytest.raises(DataError, match="flow_dependent_cooling cannot show here: it needs a flow that changes"):
            check_signals([wanted("flow_dependent_cooling", bare)], [r])
