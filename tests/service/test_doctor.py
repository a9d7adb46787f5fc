"""`doctor` finds what a computer lacks, by a /proc and /sys that are made for the test, and says what mends it."""

import json

import pytest

from bms_gateway.cli.main import main
from bms_gateway.service.doctor import examine, state_folder


@pytest.fixture
def computer(tmp_path):
    """Make a sound computer with can0."""
    for name, text in {
        "proc/sys/net/core/rmem_max": "8388608",
        "sys/class/net/can0/type": "280",
        "sys/class/net/can0/flags": "0x40081",
        "sys/class/net/can0/tx_queue_len": "128",
        "sys/class/net/eth0/type": "1",
        "run/systemd/timesync/synchronized": "",
        "link.json": json.dumps(
            {"linkinfo": {"info_data": {"state": "ERROR-ACTIVE", "restart_ms": 100, "bittiming": {"bitrate": 500000}}}}
        ),
    }.items():
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    (tmp_path / "proc/net/can").mkdir(parents=True)
    return tmp_path


def missing(computer, channel="can0"):
    return {f.name: f for f in examine(channel, computer) if f.state == "missing"}


def test_a_sound_computer_lacks_nothing(computer):
    assert missing(computer) == {}


def link(**data):
    return json.dumps({"linkinfo": {"info_data": {"restart_ms": 100, "bittiming": {"bitrate": 500000}} | data}})


@pytest.mark.parametrize(
    ("file", "text", "name", "what", "command"),
    [
        ("proc/sys/net/core/rmem_max", "212992", "receive buffer", "208 KiB", "net.core.rmem_max = 8388608"),
        ("sys/class/net/can0/flags", "0x40080", "interface can0", "is down", "ip link set can0 up type can bitrate"),
        ("sys/class/net/can0/type", "1", "interface can0", "no CAN interface", "--interface"),
        ("sys/class/net/can0/tx_queue_len", "10", "transmit queue", "10 frames", "txqueuelen 128"),
        ("link.json", "{}", "bit rate", "is not set", "bitrate 500000"),
        ("link.json", link(restart_ms=0), "bit rate", "nothing starts it again", "restart-ms 100"),
        ("link.json", link(state="BUS-OFF"), "bit rate", "bus-off", "type can restart"),
    ],
)
def test_what_is_missing_is_told_with_its_command(computer, file, text, name, what, command):
    (computer / file).write_text(text)
    found = missing(computer)
    assert set(found) == {name}
    assert what in found[name].what
    assert command in found[name].command


def test_no_modules_are_loaded_by_modprobe(computer):
    (computer / "proc/net/can").rmdir()
    assert "modprobe can_raw" in missing(computer)["CAN modules"].command


def test_an_interface_that_is_not_there_names_those_that_are(computer):
    found = missing(computer, "can1")["interface can1"]
    assert "there are can0" in found.what
    assert "systemd-networkd" not in found.command


def test_beside_network_manager_networkd_is_to_be_started(computer):
    (computer / "run/NetworkManager").mkdir()
    (computer / "proc/device-tree").mkdir()
    (computer / "proc/device-tree/model").write_text("Raspberry Pi 5 Model B Rev 1.0\0")
    command = missing(computer, "can1")["interface can1"].command
    assert "enable --now systemd-networkd" in command
    assert "dtoverlay" in command


def test_a_virtual_interface_has_no_bit_rate(computer):
    assert "ip link add vcan0 type vcan" in missing(computer, "vcan0")["interface vcan0"].command


def test_a_clock_that_nobody_sets_is_a_note_only(computer):
    (computer / "run/systemd/timesync/synchronized").unlink()
    (note,) = [f for f in examine("can0", computer) if f.name == "time source"]
    assert (note.state, note.command) == ("note", "sudo timedatectl set-ntp true")


def test_a_state_that_cannot_be_kept_is_a_note(tmp_path):
    assert state_folder(tmp_path / "a" / "b").state == "ok"
    (tmp_path / "file").write_text("")
    assert state_folder(tmp_path / "file" / "b").state == "note"


def test_the_command_ends_with_what_it_found(tmp_path, capsys):
    said = tmp_path / "d.json"
    status = main(["doctor", "--interface", "nocan7", "--json", str(said)])
    found = json.loads(said.read_text())
    assert status == 1
    assert not found["ok"]
    assert any(f["name"] == "interface nocan7" and f["state"] == "missing" for f in found["found"])
    assert "missing" in capsys.readouterr().out.splitlines()[-1]


@pytest.mark.parametrize("name", ["can0; rm -rf x", "can 0", "$(id)", "", "a" * 16])
def test_what_no_interface_is_called_is_not_put_into_commands(name, capsys):
    assert main(["doctor", "--interface", name]) == 2
    assert "an interface has a name of 1 to 15 letters and digits" in capsys.readouterr().err
