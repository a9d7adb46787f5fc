"""J1939 messages from another address than the DBC has: told where it is noticed, and read once it is stated."""

import pytest

from bms_gateway.cli.main import main
from bms_gateway.config import load_config
from bms_gateway.errors import ConfigError
from bms_gateway.frames.batch import EXTENDED
from bms_gateway.frames.j1939 import MARK
from tests.config.files import DBC, MAPPED, write
from tests.config.model_texts import EXAMPLE

PGN = (
    'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\nBA_ "VFrameFormat" BO_ {} 3;\n'
)
CONFIG = MAPPED.replace("transmit = true", "transmit = true\nsource_address = 0x56")
FRAMES = "({0:.3f}) can0 100#F6FFA4006A32D002\n" + "".join(
    f"({{0:.3f}}) can0 18FEF1{{1}}#{mux:02X}C8320033000000\n" for mux in range(3)
)


def folder(tmp_path, config):
    """Write all files; the temperatures are a parameter group, from 0x00 in the DBC."""
    file = write(tmp_path, config, EXAMPLE)
    (tmp_path / "vehicle.dbc").write_text(DBC + PGN.format(2566844672))
    log = "".join(FRAMES.format(1e9 + k / 10, "56") for k in range(100))
    (tmp_path / "drive.log").write_text(log)
    return file


def test_the_address_of_the_config_is_that_of_the_parameter_groups_only(tmp_path):
    loaded = load_config(folder(tmp_path, CONFIG))
    assert loaded.database.message("Temps").can_id == 0x18FEF156 | EXTENDED
    assert loaded.database.resolve("Temps.T1").can_id == 0x18FEF156 | EXTENDED
    assert loaded.database.message("Pack").can_id == 256
    ours = [m for m in loaded.database.messages.values() if m.name.startswith("string_1_")]
    plain = load_config(folder(tmp_path, MAPPED)).database
    assert all(m.can_id == plain.message(m.name).can_id for m in ours)


def test_frames_from_there_are_used(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder(tmp_path, CONFIG)
    main(["check", "gateway.toml", "--log", "drive.log"])
    assert "Temps.T1 never comes" not in capsys.readouterr().out


def test_a_parameter_group_is_read_whoever_sends_it_and_the_sender_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder(tmp_path, MAPPED)
    main(["check", "gateway.toml", "--log", "drive.log"])
    said = capsys.readouterr().out
    assert "Temps is read from source address 86, the first that sends it; the DBC names 0" in said
    assert "Temps.T1 never comes" not in said
    assert main(["analyze", "drive.log", "--config", "gateway.toml", "--out", "any"]) == 0
    assert "Temps is read from source address 86, the first that sends it" in capsys.readouterr().out
    folder(tmp_path, CONFIG)
    assert main(["analyze", "drive.log", "--config", "gateway.toml", "--out", "stated"]) == 0
    for name in ("estimates.csv", "broadcast.log"):
        assert (tmp_path / "any" / name).read_bytes() == (tmp_path / "stated" / name).read_bytes()


def test_where_the_config_states_another_address_the_line_to_write_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder(tmp_path, CONFIG.replace("0x56", "0x57"))
    only = [line for line in (tmp_path / "drive.log").read_text().splitlines(True) if "18FEF156" in line]
    (tmp_path / "drive.log").write_text("".join(only))
    assert main(["analyze", "drive.log", "--config", "gateway.toml", "--out", "r"]) == 2
    assert "[bus] source_address = 86" in capsys.readouterr().err


def test_messages_that_are_no_parameter_group_are_read_by_their_identifier_only(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder(tmp_path, MAPPED)
    (tmp_path / "vehicle.dbc").write_text(DBC + PGN.format(2566844672).replace(" 3;", " 1;"))
    main(["check", "gateway.toml", "--log", "drive.log"])
    assert "Temps.T1 never comes" in capsys.readouterr().out


def test_the_line_that_is_told_is_right_also_where_the_dbc_marks_nothing_as_j1939(tmp_path, monkeypatch, capsys):
    """The line was refused: no file in bus.dbc has messages of J1939."""
    monkeypatch.chdir(tmp_path)
    folder(tmp_path, MAPPED)
    (tmp_path / "vehicle.dbc").write_text(DBC)
    only = [line for line in (tmp_path / "drive.log").read_text().splitlines(True) if "18FEF156" in line]
    (tmp_path / "drive.log").write_text("".join(only))
    words = ["analyze", "drive.log", "--config", "gateway.toml", "--out", "r"]
    assert main(words) == 2
    told = capsys.readouterr().err.strip().partition("[bus] ")[2]
    config = tmp_path / "gateway.toml"
    config.write_text(config.read_text().replace("[bus]", f"[bus]\n{told}"))
    assert main(words) == 0


def test_a_dbc_that_is_of_j1939_as_a_whole_needs_no_mark_at_each_message(tmp_path, monkeypatch, capsys):
    """`init` read such messages from any address, `analyze` and `run` did not."""
    monkeypatch.chdir(tmp_path)
    folder(tmp_path, MAPPED)
    (tmp_path / "vehicle.dbc").write_text(f"{DBC}{MARK}\n")
    main(["check", "gateway.toml", "--log", "drive.log"])
    assert "Temps is read from source address 86, the first that sends it" in capsys.readouterr().out


def test_an_address_without_such_messages_is_an_error(tmp_path):
    file = write(tmp_path, CONFIG, EXAMPLE)
    (tmp_path / "vehicle.dbc").write_text(DBC.replace("BO_ 2566844672 ", "BO_ 257 "))
    with pytest.raises(ConfigError, match=r"bus\.source_address: no file in bus\.dbc has messages of J1939"):
        load_config(file)


@pytest.mark.parametrize("wrong", ["254", "-1", '"0x56"', "true"])
def test_an_address_that_nobody_has_is_an_error(tmp_path, wrong):
    with pytest.raises(ConfigError, match="source_address"):
        load_config(folder(tmp_path, CONFIG.replace("0x56", wrong)))
