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
