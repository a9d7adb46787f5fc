"""Numbers near the end of what a float can hold are left out or refused, without a warning of the libraries."""

import warnings

import numpy as np
import pytest

from tests.cli.calls import call
from tests.config.model_texts import EXAMPLE

HEADER = "time_s,current_A,coolant_inlet_C,voltage_V,soc,coolant_flow_m3_s,surface_1_C,surface_3_C,surface_5_C"
HUGE = 1e308


@pytest.fixture
def rows():
    t = np.arange(600.0)
    warm = 22.0 + 0.01 * t
    return np.array(
        [t, 10.0 + 5.0 * np.sin(t / 20.0), 20.0 + 0 * t, 16.5 + 0 * t, 0.5 + 0 * t, 0.0095 + 0 * t] + 3 * [warm]
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("column", ["voltage_V", "soc", "coolant_flow_m3_s", "surface_1_C", "coolant_inlet_C"])
@pytest.mark.plain_cases(3)
def test_a_column_of_huge_numbers_makes_no_warning(tmp_path, rows, column, sign):
    rows[HEADER.split(",").index(column)] = sign * HUGE
    (tmp_path / "model.toml").write_text(EXAMPLE)
    np.savetxt(tmp_path / "bench.csv", rows.T, delimiter=",", header=HEADER, comments="", fmt="%.17g")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        status, _, err = call("compare", tmp_path / "bench.csv", "--model", tmp_path / "model.toml")
    assert status in (0, 2), err
