"""What the columns of a foreign table are proposed to be; the reader is that of the commands."""

import csv

import numpy as np
import pytest

from bms_gateway.errors import DataError
from bms_gateway.report.guess import lookalike, plain, rises
from bms_gateway.report.look import look
from bms_gateway.report.table import parse_columns, read_table
from tests.workbench.foreign import german

OURS = ["time_s", "current_A", "coolant_inlet_C", "soc", "coolant_flow_m3_s", "surface_1_C", "surface_3_C"]
NEVER = 1e-3
"""K, A …: of rounding in the file."""


@pytest.fixture
def plainly(tmp_path):
    """A table of ours: an hour at 1 Hz, charge by the integral of a current that is positive on discharge."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 3600.0)
    current = 20.0 * np.repeat(rng.standard_normal(60), 60) + 10.0
    soc = 0.8 - np.cumsum(current) / 3600.0 / 40.0
    columns = [t, current, 20.0 + np.sin(t / 300.0), soc, 1e-4 + 1e-6 * np.cos(t), 25 + np.cos(t / 200), 26 + np.sin(t)]
    path = tmp_path / "ours.csv"
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(OURS)
        out.writerows(zip(*(np.round(c, 6).tolist() for c in columns), strict=True))
    return path


def pairs(found):
    return [
        f"{c['ours']}={'-' if c['flip'] else ''}{c['name']}{' [' + c['unit'] + ']' if c['unit'] else ''}"
        for c in found["columns"]
        if c["by"] == "guess"
    ]


def test_a_german_table_is_proposed_as_what_it_is_and_then_read_as_the_original(plainly, tmp_path):
    foreign = german(plainly, tmp_path / "german.csv")
    found = look(foreign)
    assert {c["ours"] for c in found["columns"]} == {"", *OURS}
    assert found["missing"] == ["time_s", "current_A", "coolant_inlet_C"]
    read, truth = read_table(foreign, parse_columns(pairs(found))), read_table(plainly)
    for name in ("time_s", "current_A", "coolant_inlet_C", "soc", "coolant_flow_m3_s"):
        assert np.abs(getattr(read, name) - getattr(truth, name)).max() < NEVER, name
    assert set(read.surface_C) == {1, 3}
    again = look(foreign, parse_columns(pairs(found)))
    assert again["missing"] == []
    current = next(c for c in again["columns"] if c["ours"] == "current_A")
    assert (current["by"], current["flip"]) == ("told", True)
    assert current["low"] == pytest.approx(truth.current_A.min(), abs=NEVER)
    assert current["high"] == pytest.approx(truth.current_A.max(), abs=NEVER)


def test_names_of_ours_need_no_guess(plainly):
    found = look(plainly)
    assert [c["by"] for c in found["columns"]] == ["name"] * 7
    assert found["missing"] == []


INLET, AIR = "time_s current_A coolant_inlet_C", "coolant_inlet_C"
VOLTS = "cell_voltage_1_V cell_voltage_2_V"


@pytest.mark.parametrize(
    ("header", "first", "expected"),
    [
        ("t;I;T_amb;T1;T2", "0;1;20;20;20", f"{INLET} surface_1_C surface_2_C"),
        ("Datum;Strom/A;Umgebung;Zelle0 Temp;Zelle1 Temp", "@;1;20;20;20", f"{INLET} surface_1_C surface_2_C"),
        ("time_ms;amps;chamber;core temp;surface temp", "0;1;293.1;295;296", f"{INLET} core_1_C surface_1_C"),
        (
            "Time (s);Power [W];Current (A);Inlet;Outlet;Cell 7 [°C]",
            "0;1;1;20;21;20",
            f"time_s - current_A {AIR} - surface_7_C",
        ),
        (
            "Zeit;Strom;Vorlauf;U_Zelle_1 [mV];U_Zelle_2 [mV];Oberfläche 2",
            "0;1;20;3600;3600;20",
            f"{INLET} {VOLTS} surface_2_C",
        ),
        ("t;I;Tamb;Tsurf", "0;1;20;20", f"{INLET} surface_1_C"),
        ("Zeit;Strom;Tumgebung;Tzelle", "0;1;20;20", f"{INLET} surface_1_C"),
        ("Zeit;Strom;Umgebung;T_Oberfläche", "0;1;20;20", f"{INLET} surface_1_C"),
        ("Zeit;Strom;Umgebung;T_Oberfla\u0308che", "0;1;20;20", f"{INLET} surface_1_C"),
        ("t;I;Tin;TZelle1;TZelle2", "0;1;20;20;20", f"{INLET} surface_1_C surface_2_C"),
        ("t;I;Tair;Tcore;Tcase;total", "0;1;20;20;20;7", f"{INLET} core_1_C surface_1_C -"),
        (
            "t_s;I_A;V_V;T_batt_max_C;T_batt_C;T_amb_C",
            "0;1;380;23;23;20",
            f"time_s current_A voltage_V - surface_1_C {AIR}",
        ),
        (
            "Zeit;Laststrom / A;Klemmenspannung / V;Volumenstrom;T_amb;T1",
            "0;1;52;2;20;20",
            f"time_s current_A voltage_V coolant_flow_m3_s {AIR} surface_1_C",
        ),
        ("t;I;T_amb;Battery Temperature", "0;1;20;20", f"{INLET} surface_1_C"),
        (
            "t;I;T ambiante amb;T coeur élément 3;T coeur élément 6;T surface élément 3;Etat de charge %",
            "0;1;20;20;20;20;50",
            f"{INLET} core_3_C core_6_C surface_3_C soc",
        ),
        ("t;I;T_amb;T_batt;T1;T2", "0;1;20;20;20;20", f"{INLET} - surface_1_C surface_2_C"),
        (
            "Zeit;Strom;T Wasser ein °F;Ladung %;Fühler 1 außen °F;Fühler 2 außen °F;Drehzahl 1/min",
            "0;1;70;50;70;71;3000",
            f"{INLET} soc surface_1_C surface_2_C -",
        ),
        ("t;I;T_amb;Cell_3_Voltage;Cell_3_Temp;Zellspannung", "0;1;20;3.6;20;3.6", f"{INLET} - surface_3_C -"),
    ],
)
def test_names_of_others(tmp_path, header, first, expected):
    path = tmp_path / "table.csv"
    start, rest = first.split(";", 1)
    stamps = [f"2026-01-01 00:00:{k:02}" if start == "@" else f"{k}" for k in range(30)]
    path.write_text("\n".join([header, *(f"{t};{rest}" for t in stamps)]) + "\n", encoding="utf-8")
    assert [c["ours"] or "-" for c in look(path)["columns"]] == expected.split()


def test_units_are_guessed_by_size(tmp_path):
    path = tmp_path / "table.csv"
    rows = [f"{100 * k},{3000 * (-1) ** k},{293 + 0.01 * k},{50 + k}" for k in range(30)]
    path.write_text("\n".join(["t,I,T_inlet,Ladezustand", *rows]) + "\n")
    found = look(path)["columns"]
    assert [c["unit"] for c in found[:4]] == ["ms", "mA", "K", "%"]
    (tmp_path / "other.csv").write_text("\n".join(["t,SOC", *(f"{k},{50 + k}" for k in range(30))]) + "\n")
    by_name = look(tmp_path / "other.csv")["columns"][1]  # the reader itself tells per cent
    assert (by_name["by"], by_name["low"], by_name["high"]) == ("name", 0.5, 0.79)


def test_what_is_no_table_is_one_line(tmp_path):
    (tmp_path / "empty.csv").write_text("a,b\n")
    with pytest.raises(DataError, match="no rows"):
        look(tmp_path / "empty.csv")
    with pytest.raises(DataError, match="no such file"):
        look(tmp_path / "nothing.csv")


def test_signs_are_told_by_the_voltage_before_the_charge():
    rng = np.random.default_rng(1)
    I = 10.0 * rng.standard_normal(600)  # noqa: E741
    V = 12.0 - 0.01 * I
    assert rises(I, V, None) == ""
    assert rises(-I, V, None) == "the voltage rises with it"
    assert rises(None, V, None) == ""
    t = np.arange(600.0)
    falls, rest = 3.6 - 1e-3 * t, np.where(t < 300, 0.0, 1.0)  # a discharge at constant current, after a rest
    assert rises(-2.5 * rest, np.where(t < 300, 3.6, falls + 0.3), None) == "the voltage falls while it is negative"
    assert rises(2.5 * np.ones(600), falls[::-1], None) == "the voltage rises while it is positive"
    assert rises(2.5 * np.ones(600), falls, None) == rises(-2.5 * np.ones(600), falls[::-1], None) == ""
    assert rises(np.where(t < 300, 2.5, -2.5), falls, None) == ""  # both ways: a slope tells nothing
    assert rises(-2.5 * np.ones(600), np.full(600, 3.3), None) == ""


@pytest.mark.parametrize(
    ("name", "flip"),
    [
        ("I_Batt (Laden +) [kA]", True),
        ("Strom, Laden positiv [A]", True),
        ("current [A] (+ charge)", True),
        ("Current (discharge -)", True),
        ("Current (discharge +)", False),
        ("Strom Entladen + [A]", False),
        ("charge/discharge current [A]", False),
        ("Ladestrom [A]", False),
    ],
)
def test_a_name_tells_the_sign_where_nothing_else_does(tmp_path, name, flip):
    path = tmp_path / "table.csv"
    rows = [f"{k};{3 * (-1) ** k};20;20" for k in range(30)]
    path.write_text("\n".join([f"t;{name};T_amb;T1", *rows]), encoding="utf-8")
    current = look(path)["columns"][1]
    assert (current["ours"], current["flip"]) == ("current_A", flip)
    rows = [f"{k};{3 * (-1) ** (k // 7)};20;20;{12 - 0.1 * (-1) ** (k // 7)}" for k in range(60)]
    path.write_text("\n".join([f"t;{name};T_amb;T1;U", *rows]), encoding="utf-8")
    assert not look(path)["columns"][1]["flip"]  # the voltage knows better


def test_a_german_export_without_brackets_says_its_units_all_the_same(tmp_path):
    path = tmp_path / "Messung.csv"
    rows = [f"{k},0;{3000 * (-1) ** k};3,6{k % 2};25,{k:02d};23,5" for k in range(30)]
    head = "Zeit in s;Strom in mA;Spannung in V;Temperatur Zelle °C;Umgebungstemperatur °C"
    path.write_text("\n".join([head, *rows]), encoding="utf-8")
    found = {c["name"]: (c["ours"], c["stated"]) for c in look(path)["columns"]}
    assert found == {
        "Zeit in s": ("time_s", "s"),
        "Strom in mA": ("current_A", "mA"),
        "Spannung in V": ("voltage_V", "V"),
        "Temperatur Zelle °C": ("surface_1_C", "°C"),
        "Umgebungstemperatur °C": ("coolant_inlet_C", "°C"),
    }


def test_words_are_parted():
    assert plain("packVoltage_V") == "pack voltage v"
    assert lookalike("current_A", ["Strom (A)", "U"]) == "Strom (A)"
    assert lookalike("current_A", ["current 1", "current 2"]) is None


def test_columns_without_numbers_and_decimal_commas_are_told(tmp_path):
    path = tmp_path / "table.csv"
    rows = [f"{k};1,5;20,25;20,5;{'ok' if k else ''};" for k in range(30)]
    path.write_text("\n".join(["time_s;current_A;coolant_inlet_C;surface_1_C;Bemerkung;leer", *rows]) + "\n")
    notes = look(path)["notes"]
    assert "decimal commas" in notes
    assert "'Bemerkung' holds 'ok', which is no number" in notes
    assert "'leer' is empty" in notes
    many = [f"w{k}" for k in range(8)]
    path.write_text("\n".join([",".join(["time_s", *many]), *(",".join([f"{k}", *many]) for k in range(3))]) + "\n")
    notes = look(path)["notes"]
    assert notes[-1] == "3 more columns hold no numbers"
    assert len(notes) == 6


@pytest.mark.parametrize(
    ("unit", "inlet", "says"),
    [
        ("K", 22.0, ["'inlet [K]' would be -251 to -251 °C: is K its unit?"]),
        ("°C", 295.15, ["'inlet [°C]' would be 295 to 295 °C: is °C its unit?"]),
        ("K", 295.15, []),
    ],
)
def test_a_temperature_that_no_coolant_has_is_marked_before_the_table_is_opened(tmp_path, unit, inlet, says):
    path = tmp_path / "table.csv"
    rows = [f"{k},{k % 3},{inlet},{20 + k % 2}" for k in range(30)]
    path.write_text("\n".join([f"time_s,current_A,inlet [{unit}],surface_1_C", *rows]) + "\n", encoding="utf-8")
    notes = look(path, parse_columns([f"coolant_inlet_C=inlet [{unit}]"]))["notes"]
    assert [n for n in notes if "would be" in n] == says
