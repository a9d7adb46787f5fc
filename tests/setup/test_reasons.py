"""What `init` says of its choices: why each signal, where the sign is turned, which cells have numbers."""

import numpy as np
import pytest

from bms_gateway.cli.main import main
from tests.setup.vehicles import drive, german, imperial, plain, truck, write


def said(vehicle, folder, capsys) -> tuple[list[str], str]:
    """Lines on the terminal, notes among them, and the config."""
    log, dbc = write(vehicle, folder)
    out = folder / "v"
    assert main(["init", str(log), "--dbc", str(dbc), "--cell", "catl_lf280", "--out", str(out), "--yes"]) == 0
    told = capsys.readouterr()
    return (told.err + told.out).splitlines(), (out / "gateway.toml").read_text()


@pytest.fixture
def turned(tmp_path, capsys):
    return said(imperial(), tmp_path, capsys)


def test_each_signal_has_its_reason(turned) -> None:
    lines, _ = turned
    assert (
        "  current (BatteryElectrical.PackCurrent): unit mA; named as a current; has both signs; the pack's voltage "
        "rises as it rises (correlation of their steps +1.00); so it is positive on charge, and its sign is turned"
    ) in lines
    assert "  soc (Accessories.StateOfCharge): named as the SOC; falls as current is drawn" in lines
    assert "  coolant_inlet (Accessories.AmbientTemp): unit degF; the temperature of the surroundings" in lines
    assert (
        "  surface 1 (ModuleTemps1.Thermistor1 and 6 more): unit degF; one of 8 called alike; slow, as cells are"
    ) in lines


def test_a_sign_that_is_right_is_not_turned(tmp_path, capsys) -> None:
    lines, _ = said(truck(), tmp_path, capsys)
    (current,) = (line for line in lines if line.startswith("  current ("))
    assert "falls as it rises" in current
    assert not any("its sign is turned" in line for line in lines)
    assert any(line.startswith("  surface max (HVESS_Temps.HVESS_HighestCellTemp): ") for line in lines)


def test_a_dead_channel_is_told_with_what_it_means_for_the_numbers(turned) -> None:
    lines, config = turned
    sentence = (
        "a channel of a thermocouple was left out (ModuleTemps2.Thermistor7): nothing confirms how many cells "
        "there are, so the cells are numbered by the channels that are used, and not by the numbers in the names"
    )
    assert f"bms-gateway: note: {sentence}" in lines
    assert f"[string.signals.surface]\n# {sentence}\n" in config
    assert '\n7 = "ModuleTemps2.Thermistor8"' in config


def test_several_dead_channels_are_counted(tmp_path, capsys) -> None:
    temperatures = {f"CellTemp{k + 1}": drive(8).surface[:, k % 8] for k in range(8)}
    for k in (3, 5):
        temperatures[f"CellTemp{k}"] = np.full(4000, -40.0)
    lines, config = said(plain(temperatures, "16@1- (0.1,0)", "degC"), tmp_path, capsys)
    assert any("2 channels of thermocouples were left out" in line for line in lines)
    assert "# 2 channels of thermocouples" in config


def test_where_all_channels_measure_nothing_is_said_of_them(tmp_path, capsys) -> None:
    lines, config = said(german(), tmp_path, capsys)
    assert not any("left out (" in text for text in (*lines, config))


def volted(cells: int, temperatures: dict[str, np.ndarray]):
    """A vehicle whose cells have voltages that add up to that of the pack."""
    d = drive(8)
    vehicle = plain(temperatures, "16@1- (0.1,0)", "degC")
    for k in range(cells):
        vehicle.dbc += f'\nBO_ {700 + k} Volt{k + 1}: 8 B\n SG_ CellVoltage{k + 1:02d} : 0|16@1+ (0.001,0) [0|0] "V" B'
        vehicle.values[f"Volt{k + 1}.CellVoltage{k + 1:02d}"] = d.cell_voltage[:, k]
    vehicle.values["Elec.PackVoltage"] = d.cell_voltage[:, :cells].sum(axis=1)
    return vehicle


def test_where_the_cells_are_counted_the_true_reason_for_the_numbers_is_told(tmp_path, capsys) -> None:
    """It was said that nothing confirms how many cells there are, above 14 voltages that add up to the pack's."""
    temperatures = {f"CellTemp{k:02d}": drive(8).surface[:, k % 8] for k in (1, 3, 5, 7, 9, 11, 13)}
    temperatures["CellTemp13"] = np.full(4000, -40.0)
    lines, config = said(volted(14, temperatures), tmp_path, capsys)
    assert any("the 14 cell voltages add up to it" in line for line in lines)
    assert not any("nothing confirms how many cells" in text for text in (*lines, config))
    assert "6 thermocouples are too few for a model of all 14 cells that have a voltage, so the cells" in config


def test_numbers_beyond_the_counted_cells_are_told(tmp_path, capsys) -> None:
    temperatures = {f"CellTemp{k:02d}": drive(8).surface[:, k % 8] for k in (1, 3, 5, 7, 9)}
    temperatures["CellTemp05"] = np.full(4000, -40.0)
    _, config = said(volted(6, temperatures), tmp_path, capsys)
    assert "the numbers in the names do not fit those of the 6 cell voltages, so the cells" in config


def voltage_line(config: str) -> str:
    (line,) = (line for line in config.splitlines() if line.startswith("voltage = "))
    return line


def test_a_voltage_whose_scale_rests_on_a_guessed_count_of_cells_is_marked(tmp_path, capsys) -> None:
    temperatures = {f"CellTemp{k + 1}": drive(8).surface[:, k] for k in range(8)}
    lines, config = said(plain(temperatures, "16@1- (0.1,0)", "degC"), tmp_path, capsys)
    assert any("cells in series" in line for line in lines)
    assert "scale = " in voltage_line(config)
    assert "# (?) " in voltage_line(config)


def test_a_voltage_that_the_cells_add_up_to_is_not_marked(tmp_path, capsys) -> None:
    temperatures = {f"CellTemp{k + 1}": drive(8).surface[:, k] for k in range(8)}
    _, config = said(volted(14, temperatures), tmp_path, capsys)
    assert "scale = 0.571429" in voltage_line(config)
    assert "(?)" not in voltage_line(config)
