"""A measured 26650 cell with a thermocouple in its core, which the observer never sees."""

import numpy as np
import pytest

from bms_gateway.observe import AdaptiveObserver
from bms_gateway.thermal import Prior, StringModel
from tests.data import need

AUTHORS = {"C_c": 84.5 * 0.93, "C_s": 84.5 * 0.07, "R_e": 0.010, "R_c": 3.0, "R_u": 4.8}
"""C in all, R_c and R_u as published for this cell; how C divides and R_e from its data sheet."""
OPEN_CIRCUIT = 3.3
"""V; flat over the middle of the charge of this chemistry."""


@pytest.fixture(scope="module")
def record():
    folder = need("core_surface")
    d = np.genfromtxt(folder / "a123_26650_hev2.csv", delimiter=",", names=True)
    raw = np.genfromtxt(folder / "a123_26650_hev2_raw_current.csv", delimiter=",", names=True)
    charge = np.concatenate(([0.0], np.cumsum(raw["I_A"][:-1] ** 2 * np.diff(raw["t_s"]))))
    I2 = np.diff(np.interp(d["t_s"], raw["t_s"], charge), prepend=0.0)
    return d, I2


def run(record, rel_sd, heat=None, **values):
    d, I2 = record
    priors = {k: Prior(values.get(k, v), rel_sd[k]) for k, v in AUTHORS.items()}
    observer = AdaptiveObserver([StringModel(1, (1,), "single", priors)], 1.0)
    none, now = np.full((1, 1), np.nan), np.zeros((1, 1))
    estimates = [
        observer.step(
            I2[[k]], none if heat is None else heat[[k], None], d["T_amb_C"][[k]], d["T_surf_C"][[k], None], now
        )
        for k in range(len(I2))
    ]
    error = np.array([e.core[0, 0] for e in estimates]) - d["T_core_C"]
    inside = np.abs(error) < 2 * np.array([e.core_sd[0, 0] for e in estimates])
    return np.sqrt(np.mean(error**2)), inside.mean()


@pytest.mark.parametrize("R_c", [1.5, 3.0, 6.0])
@pytest.mark.plain_cases(1)
def test_wide_priors_make_no_false_promise(record, R_c):
    wide = {"C_c": 0.3, "C_s": 0.3, "R_e": 0.6, "R_c": 0.6, "R_u": 0.6}
    assert run(record, wide, R_c=R_c)[1] > 0.9


@pytest.mark.parametrize("R_e", [0.006, 0.010, 0.020])
@pytest.mark.plain_cases(1)
def test_published_resistances_find_the_core_whatever_the_electrical_one(record, R_e):
    known = {"C_c": 0.15, "C_s": 0.15, "R_e": 0.6, "R_c": 0.2, "R_u": 0.6}
    rmse, inside = run(record, known, R_e=R_e)
    assert rmse < 1.0  # "core = surface" is 5.2 K off
    assert inside > 0.9


def test_heat_from_voltage_finds_the_core_too(record):
    d, _ = record
    known = {"C_c": 0.15, "C_s": 0.15, "R_e": 0.6, "R_c": 0.2, "R_u": 0.1}
    rmse, inside = run(record, known, heat=np.abs(d["I_A"] * (d["V_V"] - OPEN_CIRCUIT)))
    assert rmse < 0.7
    assert inside > 0.9
