"""A record has one noise: cards, tables, bars, terminal and verdict state the same figure."""

import re

import numpy as np

from bms_gateway.config.model_file import parse_model
from bms_gateway.diagnosis.compare import compare
from bms_gateway.diagnosis.record import HELD_OUT, make_record
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.diagnosis.verdict_parts import errors
from bms_gateway.report.comparison_text import comparison_text
from bms_gateway.report.html_evidence import summary
from bms_gateway.report.html_series import Shown
from bms_gateway.report.html_tables import errors_table
from bms_gateway.report.show import kelvins
from tests.truth.hidden import Scenario, make_logs


def test_fitted_and_held_out_readings_are_held_against_one_noise():
    # Bug: "noise alone 0.232 K" and "0.221 K" in two cards of one report, and 0.228 K in the verdict below them,
    # because the coarse thermocouple has a smaller share of the readings that were held out.
    (log,) = make_logs([Scenario({"resistance_temperature": ("strong", None)}, cells=2, sensors=(1, 2), seconds=900)])
    told = {name: np.array(values, np.float64) for name, values in log.table.items()}
    share = told["time_s"] / told["time_s"][-1]
    held = np.any([(share >= a) & (share < b) for a, b in HELD_OUT], axis=0)
    columns = Columns(
        time_s=told["time_s"],
        current_A=told["current_A"],
        coolant_inlet_C=told["coolant_inlet_C"],
        surface_C={1: told["surface_1_C"], 2: np.where(held, np.nan, np.round(told["surface_2_C"]))},
    )
    model = parse_model(log.model)
    c = compare(model, [make_record(columns, model)])
    shown = [Shown.of("from its file", c.filed), Shown.of("refitted", c.refitted)]
    one = kelvins(errors(c.refitted.fit).noise_floor_K)
    assert re.findall(r"noise alone ([\d.]+) K", summary(shown)) == [one, one]
    *_, whole = (line.split() for line in comparison_text(c, [], []).splitlines() if line.startswith("all "))
    assert whole[3] == one
    assert f">{one}<" in errors_table(shown)
