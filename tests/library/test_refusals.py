"""What people give to the library by mistake: one line that says what, and what is expected."""

import numpy as np
import pytest

from bms_gateway import Columns, Observer, Record, cell_model, compare, diagnose, fit
from bms_gateway.errors import GatewayError

T = np.arange(1200.0)
SURFACE = 25.0 + 8.0 * (1.0 - np.exp(-T / 500.0)) + 0.02 * np.sin(T)
MODEL = cell_model("21700 5Ah 69g 25mOhm")


def columns(**more):
    given = {"time_s": T, "current_A": np.full(1200, 9.0), "coolant_inlet_C": np.full(1200, 25.0)}
    return Columns(**(given | {"surface_C": {1: SURFACE}} | more))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"surface_C": SURFACE}, "surface_C: a mapping of numbers of cells is expected"),
        ({"surface_C": {"1": SURFACE}}, "surface_C: a mapping of numbers of cells is expected"),
        ({"current_A": None}, "current_A: missing"),
        ({"current_A": np.full(1200, 9.0 + 1.0j)}, "current_A: complex numbers"),
    ],
)
def test_columns_that_are_none(more, words):
    with pytest.raises(GatewayError, match=words):
        columns(**more)


@pytest.mark.parametrize("time_s", [T + 1.7e12, np.where(T == 5.0, np.inf, T), np.where(T == 5.0, np.nan, T)])
def test_times_that_are_no_seconds(time_s):
    with pytest.raises(GatewayError, match="time_s"):
        Observer(MODEL).run(columns(time_s=time_s))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"current_A": np.where(T % 2 == 0, 15_000.0, 0.0)}, r"current_A: 600 of 1200 .*15000.*are they in mA\?"),
        ({"coolant_inlet_C": np.full(1200, 298.15)}, r"coolant_inlet_C: 1200 of 1200 .*298\.15.*are they in K\?"),
    ],
)
def test_units_that_nobody_means(more, words):
    # Bug: "No current flows", where 15000 stood in every second row.
    with pytest.raises(GatewayError, match=words):
        Record.of(columns(**more), MODEL)


@pytest.mark.parametrize("command", [fit, compare, diagnose])
@pytest.mark.parametrize("records", [[], columns(), [None]])
def test_records_that_are_none(command, records):
    with pytest.raises(GatewayError, match=r"^records: "):
        command(MODEL, records)


@pytest.mark.parametrize(
    "given",
    [
        {"cells": 2.5},
        {"cells": 0, "sensors": (1,)},
        {"cells": "3"},
        {"sensors": 1},
        {"sensors": (1.5,)},
        {"cells": 3, "condition": "full", "coolant_W_K": -1.0},
        {"cells": 3, "condition": "full", "coolant_W_K": float("nan")},
    ],
)
def test_models_that_are_none(given):
    with pytest.raises(GatewayError):
        cell_model("21700 5Ah", **given)
    with pytest.raises(GatewayError, match="model: NoneType"):
        Observer(None)


def test_what_is_masked_is_missing():
    # Bug: the numbers under the mask were used.
    gap = (T >= 300) & (T < 360)
    masked = np.ma.masked_array(np.where(gap, 1000.0, 9.0), mask=gap)
    plain = columns(current_A=np.where(gap, np.nan, 9.0))
    np.testing.assert_array_equal(columns(current_A=masked).current_A, plain.current_A)
    assert Record.of(columns(current_A=masked), MODEL).drive.I.max() < 10.0
