"""Temperatures of unusual kinds: without a unit, one per module, with a channel that is not fitted, or none at all."""

import numpy as np
import pytest

from bms_gateway.cli.main import main
from bms_gateway.setup.propose import propose
from bms_gateway.setup.vehicle_logs import read_traffic
from bms_gateway.setup.write import write_setup
from tests.setup.proposals import proposed
from tests.setup.vehicles import CELLS, drive, plain, write

WARM = drive(8).surface
COOLANT = '\nBO_ 900 Cooling: 8 B\n SG_ CoolantInletTemp : 0|16@1- (0.1,0) [0|0] "degC" B'


def in_degrees(F: float = 1.0, shift: float = 0.0, beside: bool = False, unit: str = ""):
    vehicle = plain({f"CellTemp{k + 1}": F * WARM[:, k] + shift for k in range(4)}, unit=unit)
    if beside:
        vehicle.dbc += COOLANT
        vehicle.values["Cooling.CoolantInletTemp"] = drive(8).inlet
    return vehicle


@pytest.mark.parametrize(
    ("F", "shift", "beside", "sure"),
    [(1.8, 32.0, True, True), (1.8, 32.0, False, False), (1.0, 0.0, True, True), (1.0, 0.0, False, False),
     (1.0, 273.15, True, True), (1.0, 273.15, False, False)],
)  # fmt: skip
def test_a_unit_that_is_not_stated_is_told_by_the_other_temperatures(F, shift, beside, sure, tmp_path) -> None:
    found = list(proposed(in_degrees(F, shift, beside), tmp_path).of("surface"))
    assert len(found) == 4
    assert [p.sure for p in found] == 4 * [sure]
    if beside or F == 1.0:
        for k, p in enumerate(found):
            assert p.factor * p.series.x + p.shift == pytest.approx(WARM[:: len(WARM) // len(p.series.x), k], abs=0.2)
    if not beside and shift != 273.15:
        assert any("°C" in why and "°F" in why for why in found[0].why)  # both readings are named
    assert not any("  " in why for p in found for why in p.why)


def test_a_unit_that_is_stated_needs_no_neighbour(tmp_path) -> None:
    assert all(p.sure for p in proposed(in_degrees(unit="degC"), tmp_path).of("surface"))


@pytest.mark.parametrize("least", [False, True])
def test_modules_that_say_only_their_hottest_all_count(least: bool, tmp_path) -> None:
    said = {f"Module{m + 1}.M{m + 1}_TMax": WARM[:, 2 * m : 2 * m + 2].max(axis=1) for m in range(4)}
    vehicle = plain(said, unit="degC")
    if least:
        for m in range(4):
            old = f' SG_ M{m + 1}_TMax : 0|16@1- (0.1,0) [0|0] "degC" B'
            vehicle.dbc = vehicle.dbc.replace(old, f"{old}\n{old.replace('TMax : 0', 'TMin : 16')}")
            vehicle.values[f"Module{m + 1}.M{m + 1}_TMin"] = WARM[:, 2 * m : 2 * m + 2].min(axis=1)
    found = proposed(vehicle, tmp_path)
    assert [(p.path, p.index, p.statistic) for p in found.of("surface")] == [
        (path, k, "max") for k, path in enumerate(said, 1)
    ]
    assert all("one of 4 modules" in " ".join(p.why) for p in found.of("surface"))


def of_all_cells(swapped: bool = False):
    """A bus with the greatest, mean and least of eight cells, and the voltage of twelve in series."""
    high, low = ("Lo", "Hi") if swapped else ("Hi", "Lo")
    said = {f"CellTemp{high}": WARM.max(axis=1), "CellTempAvg": WARM.mean(axis=1), f"CellTemp{low}": WARM.min(axis=1)}
    vehicle = plain(said, unit="degC")
    vehicle.values["Elec.PackVoltage"] = drive(8).cell_voltage[:, :12].sum(axis=1)
    return vehicle


def test_the_greatest_mean_and_least_of_all_cells_are_taken_for_what_they_are(tmp_path) -> None:
    found = proposed(of_all_cells(), tmp_path)
    taken = {p.statistic: (p.path.split(".")[1], p.index, p.string) for p in found.of("surface")}
    assert taken == {
        "max": ("CellTempHi", None, 1), "mean": ("CellTempAvg", None, 1), "min": ("CellTempLo", None, 1)
    }  # fmt: skip
    assert found.cells[0] == pytest.approx(12, abs=1)  # by the voltage: no cell says its own
    assert all(p.sure for p in found.of("surface"))


def test_a_greatest_that_is_below_the_mean_is_not_sure(tmp_path) -> None:
    found = list(proposed(of_all_cells(swapped=True), tmp_path).of("surface"))
    assert [p.sure for p in found] == [False]
    assert any("is called the" in why for why in found[0].why)


def with_voltages(missing: float, voltages: int):
    """Twelve thermocouples of which the seventh says always the same, with the voltages of the cells."""
    warm = {f"CellTemp{k + 1:02d}": WARM[:, k % CELLS] for k in range(12)}
    warm["CellTemp07"] = np.full(len(WARM), missing)
    vehicle = plain(warm, "16@1- (0.1,0)", "degC")
    for m in range(voltages // 4):
        vehicle.dbc += f"\nBO_ {700 + m} Volts{m}: 8 B"
        for j in range(4):
            vehicle.dbc += f'\n SG_ CellVoltage{4 * m + j + 1:02d} : {16 * j}|16@1+ (0.001,0) [0|0] "V" B'
            vehicle.values[f"Volts{m}.CellVoltage{4 * m + j + 1:02d}"] = drive(8).cell_voltage[:, 4 * m + j]
    vehicle.values["Elec.PackVoltage"] = drive(8).cell_voltage[:, :12].sum(axis=1)
    return vehicle


@pytest.mark.parametrize("missing", [3276.7, -250.0])
@pytest.mark.plain_cases(1)
def test_a_channel_that_is_not_fitted_moves_no_number(missing: float, tmp_path, capsys) -> None:
    log, dbc = write(with_voltages(missing, 12), tmp_path)
    traffic = read_traffic([log], [dbc])
    found = propose(traffic)
    rest = [k for k in range(1, 13) if k != 7]
    assert found.cells == [12]
    assert {p.path[-2:]: p.index for p in found.of("surface")} == {f"{k:02d}": k for k in rest}
    assert [(p.string, p.index) for p in found.of("cell_voltage")] == [(1, k) for k in range(1, 13)]
    write_setup(found, traffic, tmp_path / "w", cell=None, logs=[log])
    assert "sensors = [1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12]" in (tmp_path / "w" / "string_1.toml").read_text()
    assert main(["init", str(log), "--dbc", str(dbc), "--out", str(tmp_path / "v"), "--yes"]) == 0
    assert "not used: Thermal_CellTemp07.CellTemp07: " in capsys.readouterr().out


def test_what_is_refused_later_moves_no_number_either(tmp_path) -> None:
    found = proposed(with_voltages(3276.7, 12), tmp_path)
    found.leave_out({"Thermal_CellTemp03.CellTemp03": "refused"})
    assert found.cells == [12]
    assert [p.index for p in found.of("surface")] == [1, 2, 4, 5, 6, 8, 9, 10, 11, 12]
    assert [p.index for p in found.of("cell_voltage")] == list(range(1, 13))


def test_without_as_many_voltages_cells_are_counted(tmp_path) -> None:
    found = proposed(with_voltages(3276.7, 8), tmp_path)
    assert found.cells == [11]
    assert [p.index for p in found.of("surface")] == list(range(1, 12))


def test_a_counter_with_a_unit_is_no_temperature(tmp_path) -> None:
    vehicle = plain({"CellTempCycle": 20.0 + np.arange(len(WARM)) // 100 % 10} | {"BatteryTemp": WARM[:, 0]},
                    unit="degC")  # fmt: skip
    found = proposed(vehicle, tmp_path)
    assert [p.path for p in found.of("surface")] == ["Thermal_BatteryTemp.BatteryTemp"]
    assert "counter" in dict(found.unused)["Thermal_CellTempCycle.CellTempCycle"]


def test_a_family_whose_first_message_has_no_number_is_one(tmp_path) -> None:
    # Bug: of a family in BAT_Temps and BAT_Temps2 the second message was left out, and with it the hottest cells.
    vehicle = plain({}, unit="degC")
    for m, (message, first, count) in enumerate((("BAT_Temps", 1, 4), ("BAT_Temps2", 5, 2))):
        vehicle.dbc += f"\nBO_ {910 + m} {message}: 8 B"
        for j in range(count):
            vehicle.dbc += f'\n SG_ NTC_{first + j} : {16 * j}|16@1- (0.1,0) [0|0] "degC" B'
            vehicle.values[f"{message}.NTC_{first + j}"] = WARM[:, first + j - 1]
    found = [(p.path, p.index) for p in proposed(vehicle, tmp_path).of("surface")]
    assert found == [(f"BAT_Temps{'2' if k > 4 else ''}.NTC_{k}", k) for k in range(1, 7)]


def test_a_second_group_of_temperatures_is_told(tmp_path) -> None:
    warm = {f"CellTemp{k + 1}": WARM[:, k] for k in range(6)} | {f"BusTempSensor{k + 1}": WARM[:, k] for k in range(3)}
    found = proposed(plain(warm, unit="degC"), tmp_path)
    assert len(list(found.of("surface"))) == 6
    assert any("3 more temperatures" in remark for remark in found.remarks)
    assert "likelier" in dict(found.unused)["Thermal_BusTempSensor1.BusTempSensor1"]


def test_every_signal_is_used_or_is_told_why_not(tmp_path) -> None:
    vehicle = plain({f"CellTemp{k + 1}": WARM[:, k] for k in range(4)}, unit="degC")
    vehicle.dbc += '\nBO_ 901 Extra: 8 B\n SG_ BrakePressure : 0|16@1+ (0.1,0) [0|0] "" B'
    vehicle.values["Extra.BrakePressure"] = 50 + 20 * np.sin(np.arange(len(WARM)) / 30)
    found = proposed(vehicle, tmp_path)
    told = {p.path for p in found.signals} | {path for path, _ in found.unused}
    assert told == {f"{m}.{s}" for m, s in (path.split(".") for path in vehicle.values)}


def test_channels_without_a_sensor_do_not_change_the_scale_of_the_others(tmp_path) -> None:
    """Seven of twelve read the end of their range, 154.6 °C, which is a usual temperature in tenths."""
    cells = {f"NTC{k + 1}": WARM[:, k] if k < 5 else np.full(len(WARM), 154.6) for k in range(12)}
    found = list(proposed(plain(cells, unit="degC"), tmp_path).of("surface"))
    assert {p.path.rpartition(".")[2] for p in found} == {f"NTC{k + 1}" for k in range(5)}
    assert {(p.factor, p.shift) for p in found} == {(1.0, 0.0)}
    assert not any("contradicts" in why for p in found for why in p.why)


@pytest.mark.parametrize("inlet", ["Luft_Eintritt_T", "Zuluft_Temp", "Wasser_Einlass_T"])
def test_what_enters_comes_before_the_weather(inlet, tmp_path) -> None:
    """A constant outside temperature was taken for the inlet."""
    vehicle = plain({f"CellTemp{k + 1}": WARM[:, k] for k in range(4)}, unit="degC")
    names = (inlet, "Luft_Austritt_T", "Aussentemp")
    vehicle.dbc += "\nBO_ 900 Klima: 8 B" + "".join(
        f'\n SG_ {name} : {16 * k}|16@1- (0.1,0) [0|0] "degC" B' for k, name in enumerate(names)
    )
    d = drive(8)
    for name, values in zip(names, (d.inlet, d.inlet + 4.0, np.full_like(d.inlet, 12.0)), strict=True):
        vehicle.values[f"Klima.{name}"] = values
    (found,) = proposed(vehicle, tmp_path).of("coolant_inlet")
    assert found.path == f"Klima.{inlet}"
