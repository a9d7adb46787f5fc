"""Cells told apart from records as they come: rows between the seconds, gaps, another flow."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bms_gateway.diagnosis.cell_rows import CellRows
from bms_gateway.diagnosis.cells_apart import sensed_everywhere, tell_apart
from bms_gateway.diagnosis.record import Record, make_record
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.identify.cell_prior import CellSettings
from bms_gateway.thermal import Disturbance, Prior, StringModel
from tests.truth.string import C_F, TABLE_1
from tests.truth.unequal import FIG_10, drives

FLOW = 0.0095


def model() -> StringModel:
    sd = {"C_c": 0.05, "C_s": 0.05, "R_e": 0.6, "R_c": 0.05, "R_u": 0.1, "R_cc": 0.2, "C_f": 0.05}
    values = {**TABLE_1, "R_cc": 4.0, "C_f": C_F}
    return StringModel(5, (1, 5), "full", {k: Prior(v, sd[k]) for k, v in values.items()}, "ntu", flow=FLOW)


@cache
def pack():
    return drives([31], minutes=40, swing=8.0)


def columns() -> dict:
    d = pack()
    none = [np.nan]
    return {
        "time_s": np.arange(len(d.inlet), dtype=float),
        "current_A": np.append(d.current, d.current[-1]),
        "coolant_inlet_C": d.inlet,
        "surface_C": {k + 1: np.concatenate([none, d.readings[0, :, k]]) for k in range(5)},
        "cell_voltage_V": {k + 1: np.concatenate([v, none]) for k, v in enumerate(d.voltage(0, 0.03).T)},
    }


def record(c: dict, m: StringModel | None = None) -> Record:
    return make_record(Columns(**c, source="run.csv"), sensed_everywhere(m or model()))


def found(r: Record, m: StringModel | None = None):
    return tell_apart(m or model(), r, CellSettings(), Disturbance())


def test_each_cell_is_found() -> None:
    result, notes = found(record(columns()))
    assert notes == ()
    assert result.fit.sensed == (0, 1, 2, 3, 4)
    assert (np.abs(np.log(result.fit.R_e / FIG_10)) < 3 * result.fit.rel_sd).all()
    assert result.resistance == pytest.approx(pack().R_el(0.03)[0], rel=0.02)


def test_rows_between_the_seconds_tell_the_same() -> None:
    """Twice a second: readings between the instants of the grid, currents and voltages held."""
    c, usual = columns(), found(record(columns()))[0]
    t = np.arange(0.0, c["time_s"][-1] + 1e-9, 0.5)
    held = np.minimum(t.astype(int), len(c["time_s"]) - 1)
    fine = {
        "time_s": t,
        "current_A": c["current_A"][held],
        "coolant_inlet_C": np.interp(t, c["time_s"], c["coolant_inlet_C"]),
        "surface_C": {k: np.interp(t, c["time_s"][1:], y[1:]) for k, y in c["surface_C"].items()},
        "cell_voltage_V": {k: v[held] for k, v in c["cell_voltage_V"].items()},
    }
    result, _ = found(record(fine))
    assert result.fit.R_e == pytest.approx(usual.fit.R_e, rel=0.01)
    assert result.resistance == pytest.approx(usual.resistance, rel=0.01)


def test_a_gap_leaves_the_longest_part() -> None:
    c = columns()
    t = c["time_s"]
    keep = (t < 500) | (t > 900)
    cut = {k: {i: x[keep] for i, x in v.items()} if isinstance(v, dict) else v[keep] for k, v in c.items()}
    result, notes = found(record(cut))
    assert len(notes) == 1
    assert notes[0].startswith("Gaps part this record: the longest part of it, 25 min,")
    assert (np.abs(np.log(result.fit.R_e / FIG_10)) < 3 * result.fit.rel_sd).all()


def test_numbers_are_those_at_nominal_flow() -> None:
    """A model whose nominal flow is half of what was driven states half the C_f, and the same cells."""
    c = columns() | {"coolant_flow_m3_s": np.full(len(pack().inlet), FLOW)}
    half = replace(
        model(),
        flow=FLOW / 2,
        priors={**model().priors, "C_f": replace(model().priors["C_f"], value=C_F / 2)},
    )
    one, two = found(record(c))[0].fit, found(record(c, half), half)[0].fit
    assert two.R_e == pytest.approx(one.R_e, rel=1e-6)
    at = one.layout.at("C_f")[0]
    assert two.mean[at] == pytest.approx(one.mean[at] - np.log(2.0), abs=1e-6)


def test_a_voltage_meets_the_current_in_force() -> None:
    nan = np.nan
    rows = CellRows(
        np.array([0.0, 0.4, 0.8, 1.2, 1.6, 5.0]),
        np.array([10.0, nan, 20.0, nan, nan, nan]),
        {2: np.array([nan, 3.0, nan, 2.5, 2.7, 2.0]), 9: np.ones(6)},
    )
    first, second, third, *rest = rows.over(np.arange(8.0), 3)
    assert (first.I[1], first.IV[1]) == (10.0, 30.0)
    assert np.isnan(first.IV[[0, 2]]).all()
    assert second.I[1] == 20.0
    assert second.V[1] == pytest.approx(2.6)
    assert second.IV[1] == pytest.approx(20.0 * 2.6)
    assert third is None
    assert rest == [None] * 4  # the current of 0.8 s says nothing of 5 s
