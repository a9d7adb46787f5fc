"""`check --log` where the values in a log contradict each other or the unit of the DBC, and the line that mends it."""

import json
import re
from pathlib import Path

import cantools
import pytest

from bms_gateway.cli.main import main
from tests.config.bench_cell import PARAMETERS, one_cell
from tests.config.model_texts import EXAMPLE

DBC = """VERSION ""
BU_: X
BO_ 256 Pack: 8 X
 SG_ Current : 0|32@1- ({step},0) [-100000|100000] "A" X
 SG_ Volts : 32|16@1+ (0.001,0) [0|60] "V" X
BO_ 257 Temps: 8 X
 SG_ T1 : 0|16@1- (0.1,0) [-40|400] "{degrees}" X
 SG_ Inlet : 16|16@1- (0.1,0) [-40|400] "{degrees}" X
VAL_ 257 T1 3995 "SNA" ;
"""
SECONDS, OHM = 90, 0.01
STRING = EXAMPLE.replace("sensors = [1, 3, 5]", "sensors = [1]")
PULSES = [8.0 * (k // 10 % 5 - 2) for k in range(10 * SECONDS)]


def write(
    folder: Path,
    current: str = "",
    temperature: str = "",
    *,
    in_log=lambda amps: amps,
    step="0.0001",
    zero=0.0,
    degrees="C",
    volts=3.7,
    ohm=OHM,
    model=None,
) -> tuple[Path, Path]:
    """A cell of 10 mΩ under pulses; its log may have currents and temperatures in another unit than the DBC says."""
    text = DBC.format(step=step, degrees=degrees)
    (folder / "car.dbc").write_text(text)
    (folder / "cell.toml").write_text(model or one_cell(2.3, **PARAMETERS["authors"]))
    config = folder / "gateway.toml"
    config.write_text(
        '[bus]\ndbc = ["car.dbc"]\n[[string]]\nname = "s"\nmodel = "cell.toml"\n[string.signals]\n'
        f'current = {{ signal = "Pack.Current"{current} }}\nvoltage = "Pack.Volts"\n'
        f'coolant_inlet = {{ signal = "Temps.Inlet"{temperature} }}\n'
        f'[string.signals.surface]\n1 = {{ signal = "Temps.T1"{temperature} }}\n'
    )
    database = cantools.database.load_string(text, "dbc")
    lines = []
    for k, amps in enumerate(PULSES):
        t = 1_700_000_000 + k / 10
        data = database.encode_message("Pack", {"Current": in_log(amps), "Volts": volts - ohm * amps})
        lines.append(f"({t:.6f}) can0 100#{data.hex()}")
        if k % 10 == 0:
            values = {"T1": 25 + 0.01 * k + 0.1 * (k % 3) + zero, "Inlet": 20 + 0.001 * k + zero}
            if k == 100:
                values["T1"] = 399.5
            lines.append(f"({t + 0.001:.6f}) can0 101#{database.encode_message('Temps', values).hex()}")
    log = folder / "drive.log"
    log.write_text("\n".join(lines) + "\n")
    return config, log


def check(config: Path, log: Path, capsys) -> tuple[int, str, dict]:
    status = main(["check", str(config), "--log", str(log), "--json", str(config.parent / "check.json")])
    return status, capsys.readouterr().out, json.loads((config.parent / "check.json").read_text())


def test_a_current_that_its_voltage_confirms_is_sound(tmp_path, capsys) -> None:
    status, _, said = check(*write(tmp_path), capsys)
    assert (status, said["contradictions"], said["ok"]) == (0, [], True)
    surface = said["signals"]["Temps.T1"]
    assert surface["refused"]["not_available"] >= 1
    assert surface["observed"][1] < 50.0  # what its sender calls no measurement was not observed


def test_a_wrong_sign_is_told_with_the_line_that_mends_it(tmp_path, capsys) -> None:
    status, text, said = check(*write(tmp_path, in_log=lambda amps: -amps), capsys)
    assert (status, said["ok"], len(said["contradictions"])) == (1, False, 1)
    assert "the sign of the current is wrong (scale = -1 in its entry changes it)" in text
    status, _, said = check(*write(tmp_path, ", scale = -1", in_log=lambda amps: -amps), capsys)
    assert (status, said["contradictions"]) == (0, [])


@pytest.mark.parametrize(("size", "mend"), [(1e-3, "1000"), (1e3, "0.001")])
def test_a_current_of_another_size_is_told_by_the_voltage(tmp_path, capsys, size, mend) -> None:
    """`check` called it sound, and the heat of the cells was a millionth of what it is."""
    step = "0.0001" if size < 1 else "0.1"
    amps = {"in_log": lambda amps: 0.15 * size * amps, "step": step}  # within what is plausible of a current
    status, text, said = check(*write(tmp_path, **amps), capsys)
    assert (status, len(said["contradictions"])) == (1, 1)
    assert f"scale = {mend} in its entry corrects it if the unit is wrong" in text
    status, _, said = check(*write(tmp_path, f", scale = {mend}", **amps), capsys)
    assert (status, said["contradictions"]) == (0, [])


@pytest.mark.parametrize(
    ("volts", "told"),
    [
        (5.5, "5.5 V on average are 1.1 V for each of the 5 cells of the model, and no cell has such a voltage: it is "
              "that of about 2 cells in series: correct cells in the model file\n"),
        (55.0, "55 V on average are 11 V for each of the 5 cells of the model, and no cell has such a voltage: it is "
               "that of about 15 cells in series: correct cells in the model file, or multiply the scale of the "
               "voltage by 0.333 if it is that of the whole pack\n"),
        (0.3, "is it the voltage of a battery, in this unit?\n"),
    ],
)  # fmt: skip
def test_a_voltage_that_so_many_cells_cannot_have_is_told(tmp_path, capsys, volts, told) -> None:
    """`check` called a string of 1.1 V for each cell sound."""
    status, text, said = check(*write(tmp_path, volts=volts, ohm=volts / 1000, model=STRING), capsys)
    assert (status, said["ok"]) == (1, False)
    assert "s.voltage (Pack.Volts): " in text
    assert told in text
    assert "not sound: signals contradict each other or the model" in text


@pytest.mark.parametrize("volts", [5 * 1.5, 5 * 2.4, 5 * 3.2, 5 * 4.35])
def test_the_voltage_of_any_kind_of_cell_is_right(tmp_path, capsys, volts) -> None:
    _, text, _ = check(*write(tmp_path, volts=volts, model=STRING), capsys)
    assert "no cell has such a voltage" not in text


def test_a_pack_behind_open_contactors_is_no_other_pack(tmp_path, capsys) -> None:
    config, log = write(tmp_path, volts=5 * 3.7, model=STRING)
    database = cantools.database.load_string((tmp_path / "car.dbc").read_text(), "dbc")
    off = [database.encode_message("Pack", {"Current": 0.001 * (k % 2), "Volts": 0.0}).hex() for k in range(2)]
    start = 1_700_000_000 + SECONDS
    with log.open("a") as out:
        out.writelines(f"({start + k / 10:.6f}) can0 100#{off[k % 2]}\n" for k in range(100 * SECONDS))
    assert "no cell has such a voltage" not in check(config, log, capsys)[1]


def test_several_cells_in_series_may_be_one_of_the_model(tmp_path, capsys) -> None:
    """Its resistance is theirs, and so is its voltage."""
    model = re.sub(
        r"R_e .*", 'R_e  = { value = 10.0, unit = "mOhm", rel_sd = 0.6 }', one_cell(2.3, **PARAMETERS["authors"])
    )
    status, _, said = check(*write(tmp_path, volts=11.1, model=model), capsys)
    assert (status, said["contradictions"]) == (0, [])


def test_a_current_of_which_a_part_is_refused_is_not_sound(tmp_path, capsys) -> None:
    """The wrong byte order makes noise of it, and a quarter of the noise is beyond the declared range."""
    config, log = write(tmp_path)
    dbc = tmp_path / "car.dbc"
    dbc.write_text(dbc.read_text().replace("[-100000|100000]", "[-20|15]"))
    status, text, said = check(config, log, capsys)
    assert (status, said["ok"]) == (1, False)
    assert "else look at its byte order, sign and factor in the DBC" in text
    assert "not sound: a part of s.current is refused" in text


def test_a_current_in_thousandths_that_is_beyond_all_currents_is_told_with_the_line(tmp_path, capsys) -> None:
    milli = {"in_log": lambda amps: 1e3 * amps, "step": "1"}
    status, text, _ = check(*write(tmp_path, **milli), capsys)
    assert status == 1
    assert 'is it in mA? current = { signal = "Pack.Current", scale = 0.001 } reads it so' in text
    assert check(*write(tmp_path, ", scale = 0.001", **milli), capsys)[0] == 0


@pytest.mark.parametrize(("unit", "zero", "offset"), [("C", 273.15, -273.15), ("K", 0.0, 273.15)])
def test_temperatures_in_another_unit_are_told_with_the_line_that_mends_it(
    tmp_path, capsys, unit, zero, offset
) -> None:
    status, text, _ = check(*write(tmp_path, zero=zero, degrees=unit), capsys)
    assert status == 1
    assert f'coolant_inlet = {{ signal = "Temps.Inlet", offset = {offset:g} }} reads it so' in text
    assert check(*write(tmp_path, "", f", offset = {offset:g}", zero=zero, degrees=unit), capsys)[0] == 0
