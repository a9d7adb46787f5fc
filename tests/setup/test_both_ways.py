"""`init` on vehicles that send discharge and charge current as two signals, both positive."""

import json
import tomllib

import numpy as np
import pytest

from bms_gateway.cli.main import main
from tests.setup.proposals import proposed
from tests.setup.vehicles import SECONDS, Vehicle, drive, write

N = SECONDS * 10
VOLTS = ' SG_ BattVolt : 32|16@1+ (0.1,0) [0|1000] "V" X'


def two_ways(names: tuple[str, str], *, apart: bool = False, unit: str = "A", extra: str = "", turned: bool = False):
    """A vehicle with a signal for each direction; `apart` in a message each."""
    d = drive(21)
    out, into = names
    second = ["BO_ 401 Hv2: 8 X", f' SG_ {into} : 0|16@1+ (0.1,0) [0|0] "{unit}" X'] if apart else []
    first = [] if apart else [f' SG_ {into} : 16|16@1+ (0.1,0) [0|0] "{unit}" X']
    lines = [
        'VERSION ""',
        "BU_: X",
        "BO_ 400 Hv1: 8 X",
        f' SG_ {out} : 0|16@1+ (0.1,0) [0|0] "{unit}" X',
        *first,
        VOLTS,
    ]
    lines += [*second, "BO_ 402 Temps: 8 X"]
    lines += [f' SG_ CellTemp{k + 1} : {8 * k}|8@1+ (0.5,-40) [-40|87] "degC" X' for k in range(6)]
    lines += [' SG_ CoolantInlet : 48|8@1+ (0.5,-40) [-40|87] "degC" X']
    away = "Hv2" if apart else "Hv1"
    flow = -d.current if turned else d.current
    v = {f"Hv1.{out}": np.maximum(flow, 0.0), f"{away}.{into}": np.maximum(-flow, 0.0), "Hv1.BattVolt": d.voltage}
    v |= {f"Temps.CellTemp{k + 1}": d.surface[:, k] for k in range(6)} | {"Temps.CoolantInlet": d.inlet}
    if extra:
        lines += ["BO_ 403 More: 8 X", extra]
        v |= {"More.PackCurrent": d.current, "More.MaxDischCurr": np.full(N, 300.0)}
    return Vehicle("two_ways", "\n".join(lines), v, {"Temps": 1.0}, {}), d


NAMES = [
    ("BattDischCurr", "BattChrgCurr"),
    ("I_Discharge", "I_Charge"),
    ("HVB_Entladestrom", "HVB_Ladestrom"),
    ("PackDsgCurrent", "PackChgCurrent"),
    ("courant_decharge", "courant_charge"),
]


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("names", NAMES)
@pytest.mark.plain_cases(3)
def test_the_pair_is_proposed_with_both_signs(names: tuple[str, str], apart: bool, tmp_path) -> None:
    vehicle, d = two_ways(names, apart=apart)
    p = next(proposed(vehicle, tmp_path).of("current"))
    assert [(half.way, half.series.info.name) for half in p.single] == [("discharge", names[0]), ("charge", names[1])]
    assert p.sure
    assert p.observed[0] == pytest.approx(d.current.min(), abs=0.2)
    assert p.observed[1] == pytest.approx(d.current.max(), abs=0.2)
    assert [half.written for half in p.single] == [(1.0, 0.0), (1.0, 0.0)]


def test_half_of_a_current_is_not_sure(tmp_path) -> None:
    # Bug: a current of discharge alone, in a vehicle that charges at 119 A, was called certain.
    vehicle, _ = two_ways(NAMES[0], apart=True)
    vehicle.dbc = "\n".join(x for x in vehicle.dbc.splitlines() if "Chrg" not in x and "Hv2" not in x)
    del vehicle.values[f"Hv2.{NAMES[0][1]}"]
    p = next(proposed(vehicle, tmp_path).of("current"))
    assert p.path == f"Hv1.{NAMES[0][0]}"
    assert not p.sure
    assert "its name says one direction: look for the signal of the other" in p.why


def test_init_writes_both_and_check_and_analyze_take_them(tmp_path, capsys) -> None:
    vehicle, _ = two_ways(NAMES[0], unit="mA")
    log, dbc = write(vehicle, tmp_path)
    out = tmp_path / "out"
    said = tmp_path / "said.json"
    assert main(["init", str(log), "--dbc", str(dbc), "--cell", "catl_lf280", "--out", str(out), "--yes",
                 "--json", str(said)]) == 0  # fmt: skip
    entries = [s for s in json.loads(said.read_text())["signals"] if s["role"] == "current"]
    assert [(s["signal"], s["way"]) for s in entries] == [("Hv1.BattDischCurr", "discharge"),
                                                          ("Hv1.BattChrgCurr", "charge")]  # fmt: skip
    config = tomllib.loads((out / "gateway.toml").read_text())
    current = config["string"][0]["signals"]["current"]
    # 300 times 0.1 mA are no current of a vehicle: the resistance shows that the unit is A
    assert {name: half["signal"] for name, half in current.items()} == {
        "discharge": "Hv1.BattDischCurr", "charge": "Hv1.BattChrgCurr"}  # fmt: skip
    assert main(["check", str(out / "gateway.toml"), "--log", str(log)]) == 0
    shown = capsys.readouterr().out
    assert "string_1.current.discharge" in shown
    assert "string_1.current.charge" in shown
    results = tmp_path / "results"
    assert main(["analyze", str(log), "--config", str(out / "gateway.toml"), "--out", str(results)]) == 0


def test_names_that_the_voltage_contradicts_are_told_and_exchanged(tmp_path) -> None:
    vehicle, _ = two_ways(NAMES[0], turned=True)
    p = next(proposed(vehicle, tmp_path).of("current"))
    assert [(half.way, half.series.info.name) for half in p.single] == [
        ("discharge", "BattChrgCurr"), ("charge", "BattDischCurr")]  # fmt: skip
    assert not p.sure
    assert any("exchanged" in why for why in p.why)


def test_a_single_signal_that_carries_both_is_taken_instead(tmp_path) -> None:
    vehicle, _ = two_ways(NAMES[0], extra=' SG_ PackCurrent : 0|16@1- (0.1,0) [0|0] "A" X')
    p = next(proposed(vehicle, tmp_path).of("current"))
    assert p.path == "More.PackCurrent"
    assert not p.halves


def test_limits_of_both_directions_are_no_current(tmp_path) -> None:
    vehicle, d = two_ways(("BattDischCurr", "BattChrgCurr"), extra=' SG_ PackCurrent : 0|16@1- (0.1,0) [0|0] "A" X')
    vehicle.values["Hv1.BattDischCurr"] = 200.0 + 0.2 * d.t
    vehicle.values["Hv1.BattChrgCurr"] = 90.0 + 0.1 * d.t
    p = next(proposed(vehicle, tmp_path).of("current"))
    assert p.path == "More.PackCurrent"
    assert p.sure


def test_a_drive_without_any_charge_has_the_pair_too(tmp_path) -> None:
    vehicle, d = two_ways(NAMES[0])
    vehicle.values["Hv1.BattDischCurr"] = np.abs(d.current)
    vehicle.values["Hv1.BattChrgCurr"] = np.zeros(N)
    vehicle.values["Hv1.BattVolt"] = 390.0 - 0.12 * np.abs(d.current)
    p = next(proposed(vehicle, tmp_path).of("current"))
    assert [half.series.info.name for half in p.single] == ["BattDischCurr", "BattChrgCurr"]


def test_each_string_has_its_own_pair(tmp_path) -> None:
    d = drive(22)
    lines, v = ['VERSION ""', "BU_: X"], {}
    for k, share in ((1, 0.55), (2, 0.45)):
        flow = share * d.current
        lines += [f"BO_ {410 + k} String{k}: 8 X", ' SG_ DischCurr : 0|16@1+ (0.1,0) [0|0] "A" X',
                  ' SG_ ChrgCurr : 16|16@1+ (0.1,0) [0|0] "A" X', ' SG_ Volt : 32|16@1+ (0.1,0) [0|1000] "V" X',
                  f"BO_ {420 + k} String{k}_Temps: 8 X",
                  *(f' SG_ CellTemp{j + 1} : {8 * j}|8@1+ (0.5,-40) [-40|87] "degC" X' for j in range(4))]  # fmt: skip
        v |= {f"String{k}.DischCurr": np.maximum(flow, 0.0), f"String{k}.ChrgCurr": np.maximum(-flow, 0.0)}
        v |= {f"String{k}.Volt": d.voltage} | {f"String{k}_Temps.CellTemp{j + 1}": d.surface[:, j] for j in range(4)}
    vehicle = Vehicle("two_strings", "\n".join(lines), v, {"String1_Temps": 1.0, "String2_Temps": 1.0}, {})
    found = {p.string: [half.path for half in p.single] for p in proposed(vehicle, tmp_path).of("current")}
    assert found == {k: [f"String{k}.DischCurr", f"String{k}.ChrgCurr"] for k in (1, 2)}


DATA_NAMES = ("DrawAmps", "RegenAmps")


@pytest.mark.parametrize("apart", [False, True])
def test_a_pair_without_words_for_its_directions_is_found_by_the_data_and_is_likely(apart: bool, tmp_path) -> None:
    vehicle, d = two_ways(DATA_NAMES, apart=apart)
    p = next(proposed(vehicle, tmp_path).of("current"))
    assert [(half.way, half.series.info.name) for half in p.single] == [
        ("discharge", DATA_NAMES[0]), ("charge", DATA_NAMES[1])]  # fmt: skip
    assert not p.sure
    assert p.observed[0] == pytest.approx(d.current.min(), abs=0.2)
    assert p.observed[1] == pytest.approx(d.current.max(), abs=0.2)
    assert any("the voltage falls with the first" in why for why in p.why)
    assert not any("not measured" in why for why in p.why)


def test_the_data_say_which_of_the_two_is_the_discharge(tmp_path) -> None:
    vehicle, _ = two_ways(("AmpsA", "AmpsB"), turned=True)
    p = next(proposed(vehicle, tmp_path).of("current"))
    assert [(half.way, half.series.info.name) for half in p.single] == [("discharge", "AmpsB"), ("charge", "AmpsA")]
    assert not any("exchanged" in why for why in p.why)


def test_a_second_signal_that_nothing_confirms_is_named(tmp_path) -> None:
    """The voltage stands still: it may be the other direction, and the first must not be called the only one."""
    vehicle, _ = two_ways(DATA_NAMES)
    vehicle.values["Hv1.BattVolt"] = np.full(N, 350.0)
    p = next(proposed(vehicle, tmp_path).of("current"))
    other = ({f"Hv1.{name}" for name in DATA_NAMES} - {p.path}).pop()
    assert not p.sure
    assert not any("not measured" in why for why in p.why)
    assert any(f"{other} may be the current in the other direction" in why for why in p.why)


@pytest.mark.parametrize("second", ["at once", "another resistance", "small"])
def test_two_currents_that_are_no_pair_are_not_joined(second: str, tmp_path) -> None:
    vehicle, d = two_ways(DATA_NAMES)
    flow = np.maximum(-d.current, 0.0)
    made = {"at once": np.abs(d.current), "another resistance": 5.0 * flow, "small": 0.01 * np.abs(d.current) + 0.3}
    vehicle.values["Hv1.RegenAmps"] = made[second]
    p = next(proposed(vehicle, tmp_path).of("current"))
    assert not p.halves
