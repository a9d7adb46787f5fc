"""A measured cell with a thermocouple in its core, as CAN traffic through `analyze`: is the core right, is the band?"""

import numpy as np
import pytest

from bms_gateway.cli.main import main
from tests.acceptance.drives import analyze
from tests.config.bench_cell import write_bench_cell, write_bench_table
from tests.data import need


def judged(tmp_path, **config):
    """RMSE of the core, share of samples inside ± 2 sd, RMSE of "core = surface", median sd."""
    gateway = write_bench_cell(tmp_path, **config)
    table, log = write_bench_table(tmp_path / "bench.csv", core=False), tmp_path / "bench.log"
    assert main(["encode", str(table), "--config", str(gateway), "--out", str(log)]) == 0
    e = analyze(log, gateway, tmp_path / "out")
    measured = np.genfromtxt(need("core_surface", "a123_26650_hev2.csv"), delimiter=",", names=True)
    t = e["time_s"] - np.floor(e["time_s"][0]) + 1.0  # first tick closes the first second
    core = np.interp(t, measured["t_s"], measured["T_core_C"])
    known = np.isfinite(e["core_C"])
    assert known.mean() > 0.99
    error, sd = (e["core_C"] - core)[known], e["core_sd_K"][known]
    naive = np.interp(t, measured["t_s"], measured["T_surf_C"]) - core
    return _rms(error), float(np.mean(np.abs(error) <= 2 * sd)), _rms(naive), float(np.median(sd))


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


@pytest.mark.slow
def test_with_wide_priors_the_band_holds(tmp_path) -> None:
    rmse, inside, naive, sd = judged(tmp_path, priors="wide")
    print(f"(a) wide priors: core RMSE {rmse:.2f} K, {100 * inside:.0f} % in ± 2 sd, median sd {sd:.2f} K")
    assert inside >= 0.90
    assert naive == pytest.approx(5.2, abs=0.1)
    assert sd < 8.0  # a band that holds because it says nothing is none


def test_with_the_authors_figures_as_priors_the_core_is_found(tmp_path) -> None:
    rmse, inside, _, sd = judged(tmp_path, priors="authors")
    print(f"(b) authors' priors: core RMSE {rmse:.2f} K, {100 * inside:.0f} % in ± 2 sd, median sd {sd:.2f} K")
    assert rmse <= 2.2
    assert inside >= 0.90


@pytest.mark.slow
def test_with_voltage_on_the_bus_the_core_is_found_closely(tmp_path) -> None:
    rmse, inside, _, sd = judged(tmp_path, priors="authors", voltage=True)
    print(f"(c) heat from voltage: core RMSE {rmse:.2f} K, {100 * inside:.0f} % in ± 2 sd, median sd {sd:.2f} K")
    assert rmse <= 0.7
    assert inside >= 0.90
