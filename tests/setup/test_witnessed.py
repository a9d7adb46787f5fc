"""A current that its voltage and SOC contradict: what `init`, `check` and `analyze` make of it."""

import json
import re

import numpy as np
import pytest

from bms_gateway.cli.main import main
from tests.setup.charged_vehicle import charged
from tests.setup.proposals import proposed
from tests.setup.vehicles import drive, write


def other(kind: str):
    """A vehicle whose DBC has, for the current of the pack, another one."""
    vehicle, d = charged(1.0), drive(14)  # with much braking
    vehicle.values["Elec.PackVoltage"] = 46.0 - 0.01 * d.current
    n = len(d.t)
    vehicle.values["State.BatterySOC"] = 80 - np.cumsum(d.current) * 0.1 / 36 / 40
    vehicle.values["Elec.PackCurrent"] = {
        "phase": 1.6 * np.abs(d.current) * np.sin(1.7 * np.arange(n)),
        "size": 1.4 * np.abs(d.current),
        "offset": d.current + 700.0,
        "right": d.current,
    }[kind]
    return vehicle


SAID = {
    "phase": "as in a phase of a motor",
    "size": "it is a magnitude|have the wrong direction",
    "offset": "the current has this offset; add -7",
}


@pytest.mark.parametrize("kind", SAID)
def test_a_current_that_is_contradicted_is_not_sure_and_its_cores_are_doubtful(kind: str, tmp_path, capsys) -> None:
    log, dbc = write(other(kind), tmp_path)
    out, said = tmp_path / "v", tmp_path / "said.json"
    words = [str(log), "--dbc", str(dbc), "--cell", "21700 5Ah 69g 25mOhm 8p", "--yes", "--out", str(out)]
    assert main(["init", *words, "--json", str(said)]) == 0
    found = json.loads(said.read_text())
    current = next(s for s in found["signals"] if s["role"] == "current")
    assert not current["sure"]
    assert any(re.search(SAID[kind], text) for text in current["why"])
    assert any(re.search(SAID[kind], text) for text in found["remarks"])
    assert "the current may be another one" in (out / "string_1.toml").read_text()
    capsys.readouterr()
    assert main(["check", str(out / "gateway.toml"), "--log", str(log)]) == 1
    text = capsys.readouterr().out
    assert re.search(SAID[kind], text)
    assert "sound" not in text.splitlines()[-1].replace("not sound", "")
    main(["analyze", str(log), "--config", str(out / "gateway.toml"), "--out", str(tmp_path / "r")])
    assert re.search(SAID[kind], capsys.readouterr().out)
    table = (tmp_path / "r" / "estimates.csv").read_text().splitlines()
    assert not [line for line in table[1:] if re.search(r",good(,|$)", line)]


def test_a_current_that_is_confirmed_is_sure(tmp_path) -> None:
    current = next(proposed(other("right"), tmp_path).of("current"))
    assert current.sure
    assert current.against == []


def test_the_line_that_is_told_mends_an_offset(tmp_path, capsys) -> None:
    log, dbc = write(other("offset"), tmp_path)
    config = tmp_path / "v" / "gateway.toml"
    main(
        [
            "init",
            str(log),
            "--dbc",
            str(dbc),
            "--cell",
            "21700 5Ah 69g 25mOhm 8p",
            "--yes",
            "--out",
            str(tmp_path / "v"),
        ]
    )
    told = re.search(r"; add (-?[\d.]+) to the offset", capsys.readouterr().err)
    assert told is not None
    line = 'current = "Elec.PackCurrent"'
    text = config.read_text()
    assert line in text
    config.write_text(text.replace(line, f'current = {{ signal = "Elec.PackCurrent", offset = {told[1]} }}'))
    assert main(["check", str(config), "--log", str(log)]) == 0


def test_a_current_that_never_comes_to_zero_is_not_sure_without_a_charge(tmp_path) -> None:
    vehicle = other("offset")
    vehicle.dbc = vehicle.dbc.replace("BatterySOC", "BatteryVoid")
    vehicle.values["State.BatteryVoid"] = vehicle.values.pop("State.BatterySOC")
    current = next(proposed(vehicle, tmp_path).of("current"))
    assert not current.sure
    assert any("never comes near 0" in why for why in current.why)


@pytest.mark.parametrize(("words", "sound"), [("21700 5Ah 69g 25mOhm 6p", True), ("21700 5Ah 69g 25mOhm 60p", False)])
def test_a_cell_that_the_charge_contradicts_is_doubtful_and_check_says_it(words, sound, tmp_path, capsys) -> None:
    vehicle = other("right")
    d = drive(14)
    vehicle.values["State.BatterySOC"] = 80 - 100 * np.cumsum(d.current) * 0.1 / 3600 / 30
    vehicle.values["Elec.PackVoltage"] = 46.0 - 12 * 25e-3 / 6 * d.current
    assert np.ptp(vehicle.values["State.BatterySOC"]) > 10
    log, dbc = write(vehicle, tmp_path)
    out = tmp_path / "v"
    assert main(["init", str(log), "--dbc", str(dbc), "--cell", words, "--yes", "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert ("current and SOC give" in said.err) != sound
    assert ("or it is another cell" in (out / "string_1.toml").read_text()) != sound
    assert main(["check", str(out / "gateway.toml"), "--log", str(log)]) == (0 if sound else 1)
    assert ("the model file says" in capsys.readouterr().out) != sound
