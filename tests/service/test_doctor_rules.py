"""What `doctor` says of each part of a computer, word by word, with the command that mends it."""

import errno
import json
import socket
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from bms_gateway.service import doctor
from bms_gateway.service.doctor import EXTRAS, Finding, examine, state_folder

MODPROBE = "sudo modprobe can_raw && echo can_raw | sudo tee /etc/modules-load.d/can.conf"
NO_CAN = "the kernel has no CAN sockets (modules can, can_raw)"


def laid(root, **files):
    """Write files below a root; names with `__` for `/`."""
    for name, text in files.items():
        file = root / name.replace("__", "/")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return root


def given(root, name, channel="can0"):
    return [f for f in examine(channel, root) if f.name == name]


def one(root, name, channel="can0"):
    (found,) = given(root, name, channel)
    return (found.state, found.what, found.command)


def interface(root, channel="can0", kind="280", flags="0x1", queue="128"):
    here = f"sys__class__net__{channel}__"
    return laid(root, **{f"{here}type": kind, f"{here}flags": flags, f"{here}tx_queue_len": queue})


def test_the_bounds():
    assert (doctor.OLDEST, doctor.RECEIVE_BUFFER, doctor.CAN_TYPE, doctor.UP, doctor.QUEUE) == (
        (3, 11),
        8 * 1024 * 1024,
        "280",
        1,
        128,
    )


@pytest.mark.parametrize(
    ("version", "expected"),
    [
        ((3, 11, 0, "final"), Finding("Python", "ok", "3.11.0")),
        ((3, 14, 2, "final"), Finding("Python", "ok", "3.14.2")),
        (
            (3, 10, 9, "final"),
            Finding("Python", "missing", "3.10.9, 3.11 is needed", "sudo apt install python3.11 python3.11-venv"),
        ),
    ],
)
def test_python(monkeypatch, version, expected):
    monkeypatch.setattr(doctor.sys, "version_info", version)
    assert doctor.python_version() == expected


@pytest.mark.parametrize(("platform", "state"), [("linux", "ok"), ("darwin", "missing")])
def test_the_kernel(tmp_path, monkeypatch, platform, state):
    monkeypatch.setattr(doctor.sys, "platform", platform)
    monkeypatch.setattr(doctor.platform, "system", lambda: "Os")
    monkeypatch.setattr(doctor.platform, "release", lambda: "1.2")
    assert one(tmp_path, "kernel") == (state, "Os 1.2", None)


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (None, ("ok", "can and can_raw answer", None)),
        (AttributeError("x"), ("missing", "this Python was built without SocketCAN", "use the system's python3")),
        (
            OSError(errno.EPERM, "x"),
            ("missing", "a sandbox forbids CAN sockets", "run it outside, or allow AF_CAN"),
        ),
        (OSError(errno.EAFNOSUPPORT, "x"), ("missing", NO_CAN, MODPROBE)),
    ],
)
def test_the_kernels_modules_are_asked_for_a_socket(monkeypatch, error, expected):
    opened = []

    def make(*asked):
        if error is not None:
            raise error
        opened.append(asked)
        return SimpleNamespace(close=lambda: opened.append("closed"))

    names = {name: getattr(socket, name) for name in ("AF_CAN", "SOCK_RAW", "CAN_RAW")}
    monkeypatch.setattr(doctor, "socket", SimpleNamespace(socket=make, **names))
    monkeypatch.setattr(doctor.Path, "is_dir", lambda self: True)
    found = doctor.can_modules(Path("/"))
    assert (found.name, found.state, found.what, found.command) == ("CAN modules", *expected)
    assert opened == ([(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW), "closed"] if error is None else [])


def test_a_kernel_without_modules_beside_it_needs_a_package(monkeypatch):
    monkeypatch.setattr(doctor.platform, "release", lambda: "1.2-x")
    asked = []
    monkeypatch.setattr(doctor.Path, "is_dir", lambda self: asked.append(str(self)))
    assert doctor.load_command(Path("/"), "can_raw") == (
        "sudo apt install linux-modules-extra-1.2-x (this kernel has no modules beside it), then modprobe"
    )
    assert asked == ["/lib/modules/1.2-x"]


def test_modules_of_another_root(tmp_path):
    assert one(tmp_path, "CAN modules") == ("missing", NO_CAN, MODPROBE)
    (tmp_path / "proc/net/can").mkdir(parents=True)
    assert one(tmp_path, "CAN modules") == ("ok", "can and can_raw answer", None)


UP = "sudo ip link set can0 up type can bitrate 500000 restart-ms 100"
KEEP = "; for good: deploy/can0.network to /etc/systemd/network/can0.network"
NETWORKD = " and sudo systemctl enable --now systemd-networkd (NetworkManager does not bring CAN up)"
OVERLAY = "; a Raspberry Pi's hat needs its dtoverlay line in /boot/firmware/config.txt first"


def test_an_interface_that_is_not_there(tmp_path):
    alone = "is not there, nor any other CAN interface"
    assert one(tmp_path, "interface can0") == ("missing", alone, UP + KEEP)
    interface(tmp_path, "eth0", kind="1")
    assert one(tmp_path, "interface can0") == ("missing", alone, UP + KEEP)
    interface(tmp_path, "can9")
    interface(tmp_path, "can8")
    assert one(tmp_path, "interface can0")[1] == "is not there; there are can8, can9"
    (tmp_path / "run/NetworkManager").mkdir(parents=True)
    assert one(tmp_path, "interface can0")[2] == UP + KEEP + NETWORKD
    laid(tmp_path, **{"proc__device-tree__model": "Raspberry Pi 5\0"})
    assert one(tmp_path, "interface can0")[2] == UP + KEEP + NETWORKD + OVERLAY
    made = "sudo modprobe vcan && sudo ip link add {0} type vcan && sudo ip link set {0} up"
    assert one(tmp_path, "interface vcan1", "vcan1")[2] == made.format("vcan1")


def test_an_interface_of_another_kind_or_down(tmp_path):
    interface(tmp_path, kind="1")
    assert one(tmp_path, "interface can0") == ("missing", "is no CAN interface", "name another one: --interface can0")
    assert given(tmp_path, "transmit queue") == []
    interface(tmp_path, flags="0x40080")
    assert one(tmp_path, "interface can0") == ("missing", "is down", UP + KEEP)
    interface(tmp_path, flags="0x40081")
    assert one(tmp_path, "interface can0") == ("ok", "is up", None)
    interface(tmp_path, flags="", queue="")
    assert one(tmp_path, "interface can0")[:2] == ("missing", "is down")
    assert one(tmp_path, "transmit queue")[:2] == ("missing", "0 frames; those of one tick are more")


def test_the_transmit_queue(tmp_path):
    interface(tmp_path, queue="127")
    told = ("missing", "127 frames; those of one tick are more", "sudo ip link set can0 txqueuelen 128")
    assert one(tmp_path, "transmit queue") == told
    interface(tmp_path, queue="128")
    assert one(tmp_path, "transmit queue") == ("ok", "128 frames", None)
    interface(tmp_path, "vcan0", queue="10")
    assert one(tmp_path, "transmit queue", "vcan0") == ("ok", "10 frames", None)
    assert given(tmp_path, "bit rate", "vcan0") == []


def link(**data):
    return {"linkinfo": {"info_data": {"restart_ms": 100, "bittiming": {"bitrate": 500000}} | data}}


NO_RATE = (
    "missing",
    "is not set, or ip (iproute2) is not there to tell it",
    "sudo ip link set can0 type can bitrate 500000 (that of your vehicle)",
)
BIT_RATES = [
    (link(), ("ok", "500000 bit/s, restarts after bus-off", None)),
    (link(bittiming={}), NO_RATE),
    (link(bittiming={"bitrate": 0}), NO_RATE),
    ({}, NO_RATE),
    (
        link(state="BUS-OFF"),
        (
            "missing",
            "500000 bit/s, and the controller is bus-off: a wrong rate, or no terminator",
            "sudo ip link set can0 type can restart",
        ),
    ),
    (
        link(restart_ms=0),
        (
            "missing",
            "500000 bit/s, but after bus-off nothing starts it again",
            "sudo ip link set can0 type can restart-ms 100",
        ),
    ),
]


@pytest.mark.parametrize(("told", "expected"), BIT_RATES)
def test_the_bit_rate(tmp_path, told, expected):
    interface(tmp_path)
    assert one(tmp_path, "bit rate") == NO_RATE
    laid(tmp_path, **{"link.json": json.dumps(told)})
    assert one(tmp_path, "bit rate") == expected


def test_the_bit_rate_of_this_computer_is_asked_of_ip(monkeypatch):
    asked = []

    def run(words, **options):
        asked.append((words, options))
        return SimpleNamespace(stdout=json.dumps([link()]).encode())

    monkeypatch.setattr(doctor.subprocess, "run", run)
    monkeypatch.setattr(doctor.shutil, "which", lambda name, path=None: path and f"/usr/sbin/{name}")
    assert doctor.bit_rate("can0", Path("/")) == Finding("bit rate", *BIT_RATES[0][1])
    words = ["/usr/sbin/ip", "-json", "-details", "link", "show", "can0"]
    assert asked == [(words, {"capture_output": True, "timeout": 5, "check": True})]
    for answer in (b"[]", b"no json"):
        monkeypatch.setattr(doctor.subprocess, "run", lambda *_, a=answer, **__: SimpleNamespace(stdout=a))
        assert doctor.link_details("can0") == {}
    for error in (OSError("x"), subprocess.TimeoutExpired("ip", 5), subprocess.CalledProcessError(1, "ip")):

        def fails(*_, error=error, **__):
            raise error

        monkeypatch.setattr(doctor.subprocess, "run", fails)
        assert doctor.link_details("can0") == {}
    monkeypatch.setattr(doctor.shutil, "which", lambda name, path=None: None)
    assert doctor.link_details("can0") == {}


@pytest.mark.parametrize(
    ("most", "state", "what"),
    [
        ("8388608", "ok", "up to 8 MiB"),
        ("8388607", "missing", "at most 8191 KiB; 8 MiB hold two seconds of a full bus"),
        ("212992", "missing", "at most 208 KiB; 8 MiB hold two seconds of a full bus"),
    ],
)
def test_the_receive_buffer(tmp_path, most, state, what):
    laid(tmp_path, proc__sys__net__core__rmem_max=f"{most}\n")
    line = "echo 'net.core.rmem_max = 8388608' | sudo tee /etc/sysctl.d/60-bms-gateway.conf && sudo sysctl --system"
    assert one(tmp_path, "receive buffer") == (state, what, None if state == "ok" else line)


def test_a_receive_buffer_that_nobody_tells(tmp_path):
    assert one(tmp_path, "receive buffer")[1].startswith("at most 0 KiB")


def test_the_source_of_time(tmp_path):
    assert one(tmp_path, "time source") == (
        "note",
        "neither network time nor a clock with a battery: days in logs may be wrong; estimates do not depend on it",
        "sudo timedatectl set-ntp true",
    )
    laid(tmp_path, dev__rtc0="")
    assert one(tmp_path, "time source") == ("ok", "a clock with a battery", None)
    network = ("ok", "the wall clock follows the network", None)
    (tmp_path / "run/chrony").mkdir(parents=True)
    assert one(tmp_path, "time source") == network
    (tmp_path / "run/chrony").rmdir()
    laid(tmp_path, run__systemd__timesync__synchronized="")
    assert one(tmp_path, "time source") == network


def test_extras_are_complete_or_told_with_their_command(tmp_path, monkeypatch):
    monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda name: None if name == "pyarrow" else object())
    assert one(tmp_path, "extra report") == (
        "note",
        "for pictures, pages, Parquet: not there",
        "pip install 'bms-gateway[report]'",
    )
    assert one(tmp_path, "extra mf4") == ("ok", "MF4 logs", None)
    assert [f.name for f in examine("can0", tmp_path)][-4:] == [f"extra {name}" for name, *_ in EXTRAS]


def test_a_state_is_kept_in_the_nearest_folder_that_is_there(tmp_path, monkeypatch):
    wanted = tmp_path / "a" / "b"
    assert state_folder(wanted) == Finding("state", "ok", f"{wanted} can be written")
    refused = Finding(
        "state",
        "note",
        f"{wanted} cannot be written by this user; under systemd the service has a directory of its own",
        f"sudo install -d -o $USER {wanted}",
    )
    monkeypatch.setattr(
        doctor.os, "access", lambda path, how: (path, how) != (tmp_path, doctor.os.W_OK | doctor.os.X_OK)
    )
    assert state_folder(wanted) == refused
    monkeypatch.undo()
    (tmp_path / "a").write_text("")
    assert state_folder(wanted) == refused
    monkeypatch.chdir(tmp_path)
    assert state_folder(Path("x/y")).state == "ok"
