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
        (
            "t;I;T_amb;Temp Cell 2 (module 3);Temp Cell 4 (module 3)",
            "0;1;20;20;20",
            f"{INLET} surface_2_C surface_4_C",
        ),
        ("t;I;T_amb;T_surf_2 module 7;T_surf_5 module 7", "0;1;20;20;20", f"{INLET} surface_2_C surface_5_C"),
        ("t;I;T_amb;Cell 2 of 12 surface;Cell 5 of 12 surface", "0;1;20;20;20", f"{INLET} surface_2_C surface_5_C"),
        (
            "t;I;T_amb;Zelle 1 Oberfläche am Modul 3;Zelle 4 Oberfläche am Modul 3",
            "0;1;20;20;20",
            f"{INLET} surface_1_C surface_4_C",
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
        ("Ladestrom [A]", True),
        ("Lade-/Entladestrom [A]", False),
        ("Courant de charge (A)", True),
        ("Courant de décharge (A)", False),
        ("Courant charge/décharge (A)", False),
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
    assert lookalike("time_s", ["Step_Time(s)", "Test_Time(s)", "Date_Time"]) == "Test_Time(s)"  # either is right
    assert lookalike("time_s", ["Time 1", "Time 2"]) is None


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


def exported(path, head, rows, encoding="utf-8"):
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n", encoding=encoding)
    return {c["name"]: c for c in look(path)["columns"]}


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", ["Current(A)", "current [A]"])
def test_the_sign_of_a_current_whose_name_is_known_is_checked_by_the_voltage(tmp_path, name, sign):
    rng = np.random.default_rng(7)
    I = 5.0 * np.repeat(rng.standard_normal(40), 10)  # noqa: E741 - discharge positive
    rows = [(k, round(sign * i, 3), round(3.7 - 0.03 * i, 4), 22, 23) for k, i in enumerate(I)]
    found = exported(tmp_path / "cycler.csv", f"time_s,{name},Voltage(V),coolant_inlet_C,surface_1_C", rows)
    assert (found[name]["ours"], found[name]["flip"]) == ("current_A", sign < 0)
    assert found[name]["by"] == ("name" if sign > 0 else "guess")
    assert ("the voltage rises with it" in found[name]["why"]) == (sign < 0)
    assert found[name]["high"] == pytest.approx(I.max(), abs=1e-3)  # as it will be read
    told = look(tmp_path / "cycler.csv", parse_columns([f"current_A={name}"]))["columns"][1]
    assert (told["by"], told["flip"]) == ("told", False)  # what a person says is not guessed again


def test_the_time_of_the_whole_test_is_proposed_and_not_that_of_its_steps(tmp_path):
    clock = lambda k: f"{k // 3600}:{k // 60 % 60:02}:{k % 60:02}"  # noqa: E731
    rows = [(k + 1, clock(k % 60), clock(k), k % 7, 3.7, 22) for k in range(200)]
    found = exported(tmp_path / "neware.csv", "DataPoint,Time,Total Time,Current(mA),Voltage(V),T1", rows)
    assert [c for c in found if found[c]["ours"] == "time_s"] == ["Total Time"]
    rows = [(k % 60, k, k % 7, 22) for k in range(200)]
    for head, expected in (("StepTime,TestTime", "TestTime"), ("t_step [s],Time [s]", "Time [s]")):
        found = exported(tmp_path / "maccor.csv", f"{head},Amps,T1", rows)
        assert [c for c in found if found[c]["ours"] == "time_s"] == [expected]


@pytest.mark.parametrize(
    ("name", "ours"),
    [
        ("Vorlauftemperatur", "coolant_inlet_C"),
        ("Kühlmitteltemperatur", "coolant_inlet_C"),
        ("Kühlmitteleintrittstemperatur", "coolant_inlet_C"),
        ("Zulufttemperatur", "coolant_inlet_C"),
        ("Umgebungstemp.", "coolant_inlet_C"),
        ("Raumtemperatur", "coolant_inlet_C"),
        ("Außentemperatur", "coolant_inlet_C"),
        ("Wassertemperatur ein", "coolant_inlet_C"),
        ("T_KM_ein", "coolant_inlet_C"),
        ("Rücklauftemperatur", ""),
        ("Kühlmittelaustrittstemperatur", ""),
        ("Zelltemperatur 3", "surface_3_C"),
        ("Kerntemperatur", "core_1_C"),
    ],
)
def test_german_compounds_are_parted(tmp_path, name, ours):
    rows = [(k, k % 5, 20 + k % 2, 21) for k in range(30)]
    found = exported(tmp_path / "table.csv", f"Zeit,Strom,{name} [°C],T1 [°C]", rows, "cp1252")
    assert found[f"{name} [°C]"]["ours"] == ours


def test_the_export_of_a_chinese_cycler_is_read(tmp_path):
    rows = [(k, k % 5, 3.7, 22.5, 20) for k in range(30)]
    path = tmp_path / "table.csv"
    found = exported(path, "time_s,电流(A),电压(V),温度1(℃),Ambient(℃)", rows, "gb18030")
    assert {c: (v["ours"], v["stated"]) for c, v in found.items()} == {
        "time_s": ("time_s", ""),
        "电流(A)": ("current_A", "A"),
        "电压(V)": ("", "V"),
        "温度1(℃)": ("surface_1_C", "℃"),
        "Ambient(℃)": ("coolant_inlet_C", "℃"),
    }
    assert "not UTF-8 from line 1 on: read as GB 18030" in look(path)["notes"]
    for western in ("Größe", "Prüfstand Öl °C", "T [°C] ± 1"):
        path.write_bytes(f"time_s,{western}\n0,1\n1,2\n".encode("cp1252"))
        assert look(path)["columns"][1]["name"] == western


@pytest.mark.parametrize(("count", "all_seen"), [(100, True), (30_000, False)])
def test_a_range_says_of_how_many_rows_it_is(tmp_path, count, all_seen):
    path = tmp_path / "long.csv"
    rows = [(k, k % 7, 20, 21.5) for k in range(count)]
    high = exported(path, "time_s,current_A,coolant_inlet_C,surface_1_C", rows)["time_s"]["high"]
    told = [n for n in look(path)["notes"] if "first" in n]
    if all_seen:
        assert (high, told) == (count - 1, [])
    else:
        assert told == [f"least and greatest values are those of the first {round(high) + 1:,} rows"]


@pytest.mark.parametrize("first", ["hh:mm:ss", "", "s"])
def test_a_row_of_units_with_signs_of_powers_is_one(tmp_path, first):
    path = tmp_path / "bench.csv"
    rows = [f"{10 * k};{k % 7}00,5;295,1;70,0;34,2;72,5;72,6" for k in range(30)]
    if first == "hh:mm:ss":
        rows = [f"23:59:{k:02d}{row[row.index(';') :]}" for k, row in enumerate(rows)]
    head = "Uhrzeit;Strom Batterie;Wasser ein;Füllstand Akku;Durchfluss;Mantel Z1;Mantel Z5"
    text = "\r\n".join(["Prüfstand 7;;;;;;", "", head, f"{first};mA;K;%;m³/h;°F;°F", *rows])
    path.write_bytes(text.encode("cp1252"))
    found = look(path)["columns"]
    assert [c["stated"] for c in found[1:]] == ["mA", "K", "%", "m³/h", "°F", "°F"]
    assert [c["ours"] for c in found][1:3] == ["current_A", "coolant_inlet_C"]


@pytest.mark.parametrize(
    "names",
    ["ts,Ib,Tfluid,NTC1", "Temps écoulé (s),Courant (A),Eau entrée,T° peau 1", "Tiempo,Corriente [A],Agua entrada,T1"],
)
def test_words_of_other_makers_and_languages(tmp_path, names):
    path = tmp_path / "table.csv"
    rows = [f"{1764000000 + k},{3 * (-1) ** k},20.{k:02d},21.{k:02d}" for k in range(40)]
    path.write_text("\n".join([names, *rows]), encoding="utf-8")
    found = [c["ours"] for c in look(path)["columns"]]
    assert found == ["time_s", "current_A", "coolant_inlet_C", "surface_1_C"]
