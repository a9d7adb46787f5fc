"""A table with the voltage of a whole pack, for a string of fewer cells: what is told, and the way out."""

import pytest

from bms_gateway.bus.logfile import read_log
from bms_gateway.cli.main import main
from bms_gateway.config import shipped

HEAD = "time_s,current_A,voltage_V,coolant_inlet_C,soc," + ",".join(f"surface_{k}_C" for k in range(1, 5))


def volts(k):
    """Of 96 cells in series."""
    return 96 * (3.3 - (0.02 if k % 40 < 20 else 0.0))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The shipped vehicle, whose signal carries the voltage of 96 cells, and its string of four."""
    monkeypatch.chdir(tmp_path)
    for name in ("vehicle.dbc", "pack.toml"):
        (tmp_path / name).write_text(shipped(f"deploy/worked/{name}").read_text())
    text = shipped("deploy/worked/gateway.toml").read_text()
    (tmp_path / "own.toml").write_text(text)
    share = 'voltage = { signal = "BMS_PackStatus.PackVoltage", scale = 0.0416667 }'
    text = text.replace('voltage = "BMS_PackStatus.PackVoltage"', share)
    assert share in text
    (tmp_path / "gateway.toml").write_text(text)
    rows = [f"{k},{40 if k % 40 < 20 else -10},{volts(k):.3f},22,0.6" + f",{24 + k / 100:.2f}" * 4 for k in range(120)]
    (tmp_path / "pack.csv").write_text("\n".join([HEAD, *rows]) + "\n")
    return tmp_path


def encode(*more, config="gateway.toml"):
    return main(["encode", "pack.csv", "--config", config, "--out", "a.log", *more])


def sent_V():
    """Raw big-endian words of the signal, in steps of 0.01 V."""
    return [int.from_bytes(row[2:4], "big") / 100 for b in read_log("a.log") for row in b.data[b.can_id == 0x121]]


def test_the_voltage_of_more_cells_is_refused_with_their_number_and_the_option_works(folder, capsys):
    assert encode() == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert " V for each of the 4 cells of pack: if it is the voltage of more cells in series" in err
    assert "--series 96; nothing was written" in err
    assert "mV" not in err
    assert encode("--series", "96") == 0
    assert sent_V()[:3] == pytest.approx([volts(0)] * 3, abs=0.02)


def test_a_config_that_takes_the_whole_signal_gets_the_share_and_a_word_without_the_option(folder, capsys):
    assert encode(config="own.toml") == 0
    assert (
        "if it is the voltage of more cells in series, give their number: --series N, about 88"
        in capsys.readouterr().err
    )
    assert encode("--series", "96", config="own.toml") == 0
    assert "--series" not in capsys.readouterr().err
    assert sent_V()[:3] == pytest.approx([volts(0) * 4 / 96] * 3, abs=0.01)


def test_millivolts_are_still_told(folder, capsys):
    text = (folder / "pack.csv").read_text().splitlines()
    rows = [",".join([*r.split(",")[:2], "13200", *r.split(",")[3:]]) for r in text[1:]]
    (folder / "pack.csv").write_text("\n".join([text[0], *rows]) + "\n")
    assert encode() == 2
    assert "are they in mV?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--series", "3"], "--series 3: valid: 4 (the cells of pack) to 10000"),
        (["--series", "x"], "--series"),
        (["--series", "96", "--columns", "voltage_V=current_A"], "current_A"),
    ],
)
def test_a_wrong_number_is_one_line(folder, capsys, more, says):
    assert encode(*more) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert says in err
