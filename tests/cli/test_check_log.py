"""`check --log` and `analyze`: what was made of each signal, from frames that were counted by hand."""

import gzip
import json
from pathlib import Path

import cantools
import pytest

from bms_gateway.cli.main import main
from bms_gateway.config import shipped
from tests.config.bench_cell import PARAMETERS, one_cell

DBC = """VERSION ""
BU_: X
BO_ 256 Pack: 8 X
 SG_ Current : 0|16@1- (0.1,0) [0|819] "A" X
 SG_ Volts : 16|16@1+ (0.1,0) [0|1000] "V" X
BO_ 257 Temps: 8 X
 SG_ T1 : 0|16@1- (0.1,0) [-40|60] "C" X
 SG_ Inlet : 16|16@1- (0.1,0) [-40|60] "C" X
BO_ 258 Never: 8 X
 SG_ V : 0|16@1+ (0.1,0) [0|1000] "V" X
"""
SECONDS = 60


def write(folder: Path, current: str = '"Pack.Current"', amps=lambda k: -8.0 + 0.05 * k, volts="Pack.Volts") -> tuple:
    """Config and log: 10 Hz of current and voltage, 1 Hz of temperatures."""
    (folder / "car.dbc").write_text(DBC)
    (folder / "cell.toml").write_text(one_cell(2.3, **PARAMETERS["authors"]))
    config = folder / "gateway.toml"
    config.write_text(
        '[bus]\ndbc = ["car.dbc"]\n[[string]]\nname = "s"\nmodel = "cell.toml"\n[string.signals]\n'
        f'current = {current}\ncoolant_inlet = "Temps.Inlet"\nvoltage = "{volts}"\n'
        '[string.signals.surface]\n1 = "Temps.T1"\n'
    )
    database = cantools.database.load_string(DBC, "dbc")
    lines = []
    for k in range(10 * SECONDS):
        t = 1_700_000_000 + k / 10
        values = {"Current": amps(k), "Volts": 3.7 - 0.1 * (k % 7)}
        data = database.encode_message("Pack", values, strict=False)
        lines.append(f"({t:.6f}) can0 100#{data.hex()}")
        if k % 10 == 0:
            data = database.encode_message("Temps", {"T1": 25 + 0.02 * k + 0.1 * (k % 3), "Inlet": 20 + 0.001 * k})
            lines.append(f"({t + 0.001:.6f}) can0 101#{data.hex()}")
    log = folder / "drive.log"
    log.write_text("\n".join(lines) + "\n")
    return config, log


def signals(config: Path, log: Path, capsys) -> tuple[int, dict, str]:
    said = config.parent / "check.json"
    status = main(["check", str(config), "--log", str(log), "--json", str(said)])
    return status, json.loads(said.read_text())["signals"], capsys.readouterr().out


def test_what_the_dbc_forbids_is_told_with_the_line_to_write(tmp_path, capsys) -> None:
    config, log = write(tmp_path, amps=lambda k: -8.0 + 6.7 * k / (10 * SECONDS))
    status, used, text = signals(config, log, capsys)
    assert status == 1
    current = used["Pack.Current"]
    assert current["used"] == 0
    assert current["refused"] == {"out_of_range": current["seen"]}
    assert current["seen"] == pytest.approx(10 * SECONDS, abs=20)  # the last second is still open
    assert current["observed"] == [pytest.approx(-8.0), pytest.approx(-1.3, abs=0.2)]
    assert current["allowed"] == [0.0, 819.0]
    assert 'current = { signal = "Pack.Current", minimum = -8 }' in text
    assert "refused 100 %" in text
    assert used["Temps.T1"]["used"] > 0.8 * used["Temps.T1"]["seen"]


@pytest.mark.parametrize("own", ["scale = -1", "scale = 1.02, offset = 0.5"])
def test_the_line_to_write_keeps_what_the_config_says_already(own, tmp_path, capsys) -> None:
    config, log = write(tmp_path, f'{{ signal = "Pack.Current", {own} }}', amps=lambda k: -8.0 + 6.7 * k / 600)
    _, _, text = signals(config, log, capsys)
    line = f'{{ signal = "Pack.Current", {own}, minimum = -8 }}'
    assert f"current = {line}" in text
    assert signals(*write(tmp_path, line, amps=lambda k: -8.0 + 6.7 * k / 600), capsys)[1]["Pack.Current"]["used"]


def test_the_line_that_was_told_mends_it(tmp_path, capsys) -> None:
    config, log = write(tmp_path, '{ signal = "Pack.Current", minimum = -20 }')
    status, used, _ = signals(config, log, capsys)
    assert status == 0
    assert used["Pack.Current"]["refused"] == {}
    assert used["Pack.Current"]["allowed"] == [-20.0, 819.0]


def test_a_signal_that_never_comes_is_not_used(tmp_path, capsys) -> None:
    config, log = write(tmp_path, '{ signal = "Pack.Current", minimum = -20 }', volts="Never.V")
    status, used, text = signals(config, log, capsys)
    assert status == 1
    assert used["Never.V"] == {**used["Never.V"], "seen": 0, "used": 0, "refused": {}, "observed": None}
    assert "never comes" in text


def test_analyze_says_the_same_in_its_summary(tmp_path, capsys) -> None:
    config, log = write(tmp_path)
    _, checked, _ = signals(config, log, capsys)
    assert main(["analyze", str(log), "--config", str(config), "--out", str(tmp_path / "r")]) == 0
    told = capsys.readouterr().out
    summary = json.loads((tmp_path / "r" / "summary.json").read_text())["signals"]
    assert summary == checked
    assert "current (Pack.Current) refused" in told


def test_analyze_tells_what_never_comes_although_nothing_was_refused(tmp_path, capsys) -> None:
    config, log = write(tmp_path, '{ signal = "Pack.Current", minimum = -20 }', volts="Never.V")
    assert main(["analyze", str(log), "--config", str(config), "--out", str(tmp_path / "r")]) == 0
    assert json.loads((tmp_path / "r" / "summary.json").read_text())["rejected"] == {}
    assert "s.voltage: Never.V never comes in this log" in capsys.readouterr().out


def test_what_is_refused_is_told_before_what_never_comes(tmp_path, capsys) -> None:
    config, log = write(tmp_path, '{ signal = "Pack.Current", minimum = -20 }', volts="Never.V")
    config.write_text(config.read_text().replace('"Temps.T1"', '{ signal = "Temps.T1", maximum = 26 }'))
    _, _, text = signals(config, log, capsys)
    assert text.index("s.surface.1 (Temps.T1) refused") < text.index("s.voltage: Never.V never comes")


def test_a_log_that_is_none_is_one_line(tmp_path, capsys) -> None:
    config, _ = write(tmp_path)
    (tmp_path / "empty.log").write_text("")
    assert main(["check", str(config), "--log", str(tmp_path / "empty.log")]) == 2
    told = capsys.readouterr().err
    assert told.endswith("empty.log: no data frames\n")
    assert told.count("\n") == 1
    assert main(["check", str(config), "--log", str(tmp_path / "none.log")]) == 2
    told = capsys.readouterr().err
    assert "none.log" in told
    assert told.count("\n") == 1


def test_a_current_that_stands_at_the_end_is_named_and_no_thermocouple_is(tmp_path, capsys) -> None:
    lines, kept = [], ""
    for line in gzip.decompress(shipped("deploy/worked/drive.log.gz").read_bytes()).decode().splitlines():
        if " 121#" in line and float(line[1:18]) > 450.0:
            line = line.partition("#")[0] + f"#{kept}" + line.rpartition("#")[2][4:]
        elif " 121#" in line:
            kept = line.rpartition("#")[2][:4]
        lines.append(line)
    log = tmp_path / "drive.log"
    log.write_text("\n".join(lines) + "\n")
    words = [
        "analyze",
        str(log),
        "--config",
        str(shipped("deploy/worked/gateway.toml")),
        "--out",
        str(tmp_path / "out"),
    ]
    assert main(words) == 0
    out = capsys.readouterr().out
    why = "the voltage moves while it stands at one value: stuck, saturated or clipped"
    assert f"ALARM at the end: pack: current not used: {why} (BMS_PackStatus.PackCurrent)" in out
    assert len([line for line in out.splitlines() if f"samples of the current not used: {why}" in line]) == 1
    assert "while current flows" not in out
