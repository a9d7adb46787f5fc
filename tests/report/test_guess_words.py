"""Columns by the words that other makers use: both ends of the coolant's way, the state of charge, a mean voltage."""

import csv

import numpy as np
import pytest

from bms_gateway.report.look import look

T = np.arange(0.0, 600.0)
I = np.repeat(np.tile([0.0, 20.0, 5.0, 35.0, -10.0], 12), 10)  # noqa: E741
SOC = 80.0 - np.cumsum(I) / 3600.0 / 20.0 * 100.0
COLUMNS = {"coolant": 20.0 + np.sin(T / 90.0), "out": 24.0 + np.sin(T / 90.0), "soc": SOC, "volt": 3.9 - 2e-3 * I}


def proposed(folder, **names: str) -> dict[str, str]:
    """Our name of each column, by its name in the file."""
    path = folder / "bench.csv"
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["Time [s]", "Current [A]", "Skin 1 [degC]", *names.values()])
        rows = [T, I, 25 + np.cumsum(I**2) * 1e-5, *(COLUMNS[key] for key in names)]
        out.writerows(zip(*(np.round(c, 4).tolist() for c in rows), strict=True))
    return {c["name"]: c["ours"] for c in look(path)["columns"]}


@pytest.mark.parametrize(
    ("inlet", "outlet"),
    [
        ("Glycol, feed [°C]", "Glycol, return [°C]"),
        ("Water flow temp [°C]", "Water return temp [°C]"),
        ("Brine in [°C]", "Brine out [°C]"),
        ("T_KM_VL [°C]", "T_KM_RL [°C]"),
        ("Sole Vorlauf [°C]", "Sole Rücklauf [°C]"),
        ("Wasser-Glykol Zulauf [°C]", "Wasser-Glykol Ablauf [°C]"),
        ("eau, aller [°C]", "eau, retour [°C]"),
        ("acqua mandata [°C]", "acqua ritorno [°C]"),
        ("coolant supply [°C]", "coolant [°C] leaving"),
    ],
)
def test_the_coolant_is_read_where_it_enters(inlet: str, outlet: str, tmp_path) -> None:
    found = proposed(tmp_path, out=outlet, coolant=inlet)
    assert found[inlet] == "coolant_inlet_C"
    assert found[outlet] == ""


@pytest.mark.parametrize("name", ["Glycol, return [°C]", "Coolant return [°C]", "Kühlwasser Rücklauf [°C]"])
def test_a_return_alone_is_no_inlet(name: str, tmp_path) -> None:
    assert proposed(tmp_path, out=name)[name] == ""


@pytest.mark.parametrize("name", ["BMS gauge [%]", "Pack remaining [%]", "Battery [%]", "Akku Restkapazität [%]"])
def test_a_share_of_the_battery_is_the_charge(name: str, tmp_path) -> None:
    assert proposed(tmp_path, soc=name)[name] == "soc"


@pytest.mark.parametrize("name", ["BMS SOH [%]", "Battery fan duty [%]", "Pack power limit [%]", "Humidity [%]"])
def test_another_share_is_not(name: str, tmp_path) -> None:
    assert proposed(tmp_path, soc=name)[name] == ""


@pytest.mark.parametrize("name", ["Vcell mean [V]", "Zellspannung Mittelwert [V]", "avg cell voltage [V]"])
def test_a_mean_of_the_cells_stands_for_one_cell(name: str, tmp_path) -> None:
    assert proposed(tmp_path, volt=name)[name] in ("cell_voltage_1_V", "voltage_V")
