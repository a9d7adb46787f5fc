"""`init` where the messages of the DBC come from another source address than it says."""

import pytest

from bms_gateway.cli.main import main
from bms_gateway.frames.j1939 import MARK
from tests.setup.vehicles import truck, write


@pytest.fixture
def unmarked(tmp_path):
    """Log and DBC of a truck whose DBC has lost what says that it is of J1939."""
    vehicle = truck()
    log, dbc = write(vehicle, tmp_path)
    dbc.write_text(vehicle.dbc.partition("BA_DEF_")[0])
    return log, dbc


def init(log, dbc, out, capsys):
    status = main(["init", str(log), "--dbc", str(dbc), "--cell", "catl_lf280", "--out", str(out), "--yes"])
    return status, capsys.readouterr()


def test_the_line_that_is_told_has_the_messages_read(unmarked, tmp_path, capsys) -> None:
    log, dbc = unmarked
    status, said = init(log, dbc, tmp_path / "v", capsys)
    assert status == 1
    assert (
        "no frame has the identifier of HVESS_Data, HVESS_Temps, but the same parameter group comes from another "
        f"source address, 0x56. If the messages are of J1939, add this line at the end of the DBC: {MARK}" in said.err
    )
    dbc.write_text(f"{dbc.read_text()}\n{MARK}\n")
    status, said = init(log, dbc, tmp_path / "v", capsys)
    assert status == 0
    assert "add this line" not in said.err
    assert main(["check", str(tmp_path / "v" / "gateway.toml"), "--log", str(log)]) == 0


def test_identifiers_that_differ_in_their_last_byte_are_no_addresses(unmarked, tmp_path, capsys) -> None:
    """A DBC that has several messages of one group counts them by the last byte: they are not of J1939."""
    log, dbc = unmarked
    at = dbc.read_text().index("BO_ ", dbc.read_text().index("BO_ ") + 1)
    first, rest = dbc.read_text()[:at], dbc.read_text()[at:]
    twin = first[first.index("BO_ ") :].replace(str(0x80000000 | 0x18F1D0F3), str(0x80000000 | 0x18F1D0F4))
    dbc.write_text(first + twin.replace("HVESS_Data", "Twin") + rest)
    _, said = init(log, dbc, tmp_path / "v", capsys)
    assert "no frame has the identifier of HVESS_Temps, but" in said.err


def test_where_most_identifiers_are_right_the_others_have_no_address(unmarked, tmp_path, capsys) -> None:
    log, dbc = unmarked
    log.write_text(log.read_text().replace("18F1D056#", "18F1D0F3#"))
    _, said = init(log, dbc, tmp_path / "v", capsys)
    assert "no frame has the identifier of" not in said.err


def test_another_address_is_not_called_a_fault_of_the_dbc(tmp_path, capsys) -> None:
    """A thermocouple was missing, and the user was told to correct the DBC."""
    vehicle = truck()
    log, dbc = write(vehicle, tmp_path)
    log.write_text("".join(line for line in log.read_text().splitlines(True) if "18F1D2" not in line))
    status, said = init(log, dbc, tmp_path / "v", capsys)
    assert status == 1
    assert "HVESS_Data: its parameter group comes from address 0x56, not from 0xF3 as in the DBC" in said.err
    assert "no signal is a temperature of cells: nothing was written; is it in another DBC or log?" in said.out


def sent_twice(log) -> None:
    """Let a second address send every other frame of a group too."""
    lines = log.read_text().splitlines(True)
    second = [line.replace("18F1D056#", "18F1D027#") for line in lines if "18F1D056#" in line][::2]
    log.write_text("".join(sorted([*lines, *second], key=lambda line: float(line[1 : line.index(")")]))))


def test_every_address_of_a_group_is_named(tmp_path, capsys) -> None:
    log, dbc = write(truck(), tmp_path)
    sent_twice(log)
    _, said = init(log, dbc, tmp_path / "v", capsys)
    assert "comes from address 0x56 (and from 0x27: `[bus] source_address` in gateway.toml chooses)" in said.err


def of_another_sender(log, folder):
    other = folder / "other.log"
    other.write_text(log.read_text().replace("18F1D056#", "18F1D027#").replace("18F1D256#", "18F1D227#"))
    return other


def test_a_sound_dbc_is_named_itself_so_that_any_sender_is_read(tmp_path, capsys) -> None:
    log, dbc = write(truck(), tmp_path)
    status, said = init(log, dbc, tmp_path / "v", capsys)
    assert status == 0
    assert 'dbc = ["../truck.dbc"]' in (tmp_path / "v" / "gateway.toml").read_text()
    assert not (tmp_path / "v" / "vehicle.dbc").exists()
    assert "is a copy" not in said.err
    assert main(["check", str(tmp_path / "v" / "gateway.toml"), "--log", str(of_another_sender(log, tmp_path))]) == 0


def test_the_copy_of_a_faulty_dbc_keeps_the_mark_of_j1939_and_says_why_it_is_a_copy(tmp_path, capsys) -> None:
    log, dbc = write(truck(), tmp_path)
    inside = ' SG_ Torn : 8|16@1+ (1,0) [0|0] "" B'
    dbc.write_text(dbc.read_text().replace(" SG_ HVESS_SOC", f"{inside}\n SG_ HVESS_SOC"))
    status, said = init(log, dbc, tmp_path / "v", capsys)
    assert status == 0
    config = tmp_path / "v" / "gateway.toml"
    assert 'dbc = ["vehicle.dbc"]' in config.read_text()
    (why,) = (line for line in said.err.splitlines() if "vehicle.dbc is a copy of the part of the DBC" in line)
    assert "because of this" in why
    assert "Torn" in why
    assert 'BA_ "VFrameFormat" BO_ 2565984342 3;' in (config.parent / "vehicle.dbc").read_text()
    assert main(["check", str(config), "--log", str(of_another_sender(log, tmp_path))]) == 0


def test_of_several_senders_the_one_that_was_read_is_named_in_a_copy(tmp_path, capsys) -> None:
    log, dbc = write(truck(), tmp_path)
    sent_twice(log)
    status, said = init(log, dbc, tmp_path / "v", capsys)
    assert status == 0
    assert "because of this: HVESS_Data is read from address 0x56, and 2 addresses send it" in said.err
