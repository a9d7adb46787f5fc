"""What a computer lacks to run the gateway: read from /proc and /sys, each with the command that repairs it."""

import errno
import importlib.util
import json
import os
import platform
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

OLDEST: Final = (3, 11)
RECEIVE_BUFFER: Final = 8 << 20
"""2.2 s of a full bus of 1 Mbit/s."""
CAN_TYPE: Final = "280"  # ARPHRD_CAN in linux/if_arp.h
UP: Final = 1  # IFF_UP
QUEUE: Final = 128
"""Frames: those of one tick of all strings; the kernel's default is 10."""
EXTRAS: Final = (
    ("report", ("plotly", "matplotlib", "pyarrow"), "pictures, pages, Parquet"),
    ("mf4", ("asammdf",), "MF4 logs"),
    ("mqtt", ("aiomqtt",), "sending to a broker"),
    ("fleet", ("dask",), "many logs on many machines"),
)


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check.

    Attributes
    ----------
    name : str
    state : {"ok", "missing", "note"}
        `missing`: the service cannot run, or not well; `note`: needed by some users only.
    what : str
    command : str or None
        Command that repairs it.
    """

    name: str
    state: str
    what: str
    command: str | None = None


def examine(channel: str, root: Path = Path("/")) -> Iterator[Finding]:
    """Examine this computer.

    Parameters
    ----------
    channel : str
        Interface for the gateway.
    root : Path
        Root of /proc, /sys, /run and /dev.
    """
    yield python_version()
    yield Finding("kernel", "ok" if sys.platform == "linux" else "missing", f"{platform.system()} {platform.release()}")
    yield can_modules(root)
    yield from _interface(channel, root, virtual=channel.startswith("vcan"))
    yield _buffer(root)
    yield _clock(root)
    yield from _extras()


def python_version() -> Finding:
    """Check the version of Python."""
    version = ".".join(map(str, sys.version_info[:3]))
    if sys.version_info >= OLDEST:
        return Finding("Python", "ok", version)
    return Finding("Python", "missing", f"{version}, 3.11 is needed", "sudo apt install python3.11 python3.11-venv")


def can_modules(root: Path) -> Finding:
    """Check for the CAN modules by asking the kernel for a CAN socket, the most reliable way."""
    if root == Path("/"):
        try:
            socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
        except AttributeError:
            return Finding(
                "CAN modules", "missing", "this Python was built without SocketCAN", "use the system's python3"
            )
        except OSError as e:
            if e.errno == errno.EPERM:
                return Finding(
                    "CAN modules", "missing", "a sandbox forbids CAN sockets", "run it outside, or allow AF_CAN"
                )
            what = "the kernel has no CAN sockets (modules can, can_raw)"
            return Finding("CAN modules", "missing", what, load_command(root, "can_raw"))
        return Finding("CAN modules", "ok", "can and can_raw answer")
    known = (root / "proc/net/can").is_dir()
    if known:
        return Finding("CAN modules", "ok", "can and can_raw answer")
    what = "the kernel has no CAN sockets (modules can, can_raw)"
    return Finding("CAN modules", "missing", what, load_command(root, "can_raw"))


def load_command(root: Path, module: str) -> str:
    """Return the command that loads a module, or the one that installs it if the kernel lacks it."""
    release = platform.release()
    if root == Path("/") and not Path("/lib/modules", release).is_dir():
        return f"sudo apt install linux-modules-extra-{release} (this kernel has no modules beside it), then modprobe"
    return f"sudo modprobe {module} && echo {module} | sudo tee /etc/modules-load.d/can.conf"


def _interface(channel: str, root: Path, *, virtual: bool) -> Iterator[Finding]:
    here = root / "sys/class/net" / channel
    name = f"interface {channel}"
    if not here.exists():
        yield Finding(name, "missing", _others(root), _bring(channel, root, virtual=virtual))
        return
    if _text(here / "type") != CAN_TYPE:
        yield Finding(name, "missing", "is no CAN interface", "name another one: --interface can0")
        return
    flags = int(_text(here / "flags") or "0", 16)
    if not flags & UP:
        yield Finding(name, "missing", "is down", _bring(channel, root, virtual=virtual))
    else:
        yield Finding(name, "ok", "is up")
    if not virtual:
        yield bit_rate(channel, root)
    queue = int(_text(here / "tx_queue_len") or "0")
    if queue < QUEUE and not virtual:
        what = f"{queue} frames; those of one tick are more"
        yield Finding("transmit queue", "missing", what, f"sudo ip link set {channel} txqueuelen {QUEUE}")
    else:
        yield Finding("transmit queue", "ok", f"{queue} frames")


def _others(root: Path) -> str:
    net = root / "sys/class/net"
    there = sorted(p.name for p in net.iterdir() if _text(p / "type") == CAN_TYPE) if net.is_dir() else []
    return "is not there" + (f"; there are {', '.join(there)}" if there else ", nor any other CAN interface")


def _bring(channel: str, root: Path, *, virtual: bool) -> str:
    if virtual:
        return f"sudo modprobe vcan && sudo ip link add {channel} type vcan && sudo ip link set {channel} up"
    up = f"sudo ip link set {channel} up type can bitrate 500000 restart-ms 100"
    keep = f"for good: deploy/can0.network to /etc/systemd/network/{channel}.network"
    if (root / "run/NetworkManager").is_dir():
        # Raspberry Pi OS: NetworkManager leaves CAN alone, and networkd beside it takes only what has a file there
        keep += " and sudo systemctl enable --now systemd-networkd (NetworkManager does not bring CAN up)"
    overlay = "; a Raspberry Pi's hat needs its dtoverlay line in /boot/firmware/config.txt first"
    pi = "Raspberry Pi" in _text(root / "proc/device-tree/model")
    return f"{up}; {keep}{overlay if pi else ''}"


def bit_rate(channel: str, root: Path) -> Finding:
    """Check whether the interface has a bit rate."""
    details = link_details(channel) if root == Path("/") else _given(root / "link.json")
    data = details.get("linkinfo", {}).get("info_data", {})
    rate = data.get("bittiming", {}).get("bitrate")
    if not rate:
        what = "is not set, or ip (iproute2) is not there to tell it"
        command = f"sudo ip link set {channel} type can bitrate 500000 (that of your vehicle)"
        return Finding("bit rate", "missing", what, command)
    if data.get("state") == "BUS-OFF":
        what = f"{rate} bit/s, and the controller is bus-off: a wrong rate, or no terminator"
        return Finding("bit rate", "missing", what, f"sudo ip link set {channel} type can restart")
    if not data.get("restart_ms"):
        what = f"{rate} bit/s, but after bus-off nothing starts it again"
        return Finding("bit rate", "missing", what, f"sudo ip link set {channel} type can restart-ms 100")
    return Finding("bit rate", "ok", f"{rate} bit/s, restarts after bus-off")


def link_details(channel: str) -> dict[str, Any]:
    """Return what `ip` tells of an interface; empty where it tells nothing."""
    ip = shutil.which("ip") or shutil.which("ip", path="/usr/sbin:/sbin")
    if ip is None:
        return {}
    words = [ip, "-json", "-details", "link", "show", channel]
    try:
        told = subprocess.run(words, capture_output=True, timeout=5, check=True).stdout  # noqa: S603 — no shell
        found = json.loads(told)
    except (OSError, subprocess.SubprocessError, ValueError):
        return {}
    return found[0] if found else {}


def _given(file: Path) -> dict[str, Any]:
    return dict(json.loads(file.read_text())) if file.exists() else {}


def _buffer(root: Path) -> Finding:
    most = int(_text(root / "proc/sys/net/core/rmem_max") or "0")
    if most >= RECEIVE_BUFFER:
        return Finding("receive buffer", "ok", f"up to {most >> 20} MiB")
    what = f"at most {most >> 10} KiB; {RECEIVE_BUFFER >> 20} MiB hold two seconds of a full bus"
    line = f"net.core.rmem_max = {RECEIVE_BUFFER}"
    return Finding(
        "receive buffer",
        "missing",
        what,
        f"echo '{line}' | sudo tee /etc/sysctl.d/60-bms-gateway.conf && sudo sysctl --system",
    )


def _clock(root: Path) -> Finding:
    """Check the source of the wall clock, which gives the days in logs; bus time is the kernel's own."""
    if (root / "run/systemd/timesync/synchronized").exists() or (root / "run/chrony").is_dir():
        return Finding("time source", "ok", "the wall clock follows the network")
    if (root / "dev/rtc0").exists():
        return Finding("time source", "ok", "a clock with a battery")
    what = "neither network time nor a clock with a battery: days in logs may be wrong; estimates do not depend on it"
    return Finding("time source", "note", what, "sudo timedatectl set-ntp true")


def _extras() -> Iterator[Finding]:
    for extra, modules, what in EXTRAS:
        lacking = [m for m in modules if importlib.util.find_spec(m) is None]
        if lacking:
            yield Finding(f"extra {extra}", "note", f"for {what}: not there", f"pip install 'bms-gateway[{extra}]'")
        else:
            yield Finding(f"extra {extra}", "ok", what)


def state_folder(path: Path) -> Finding:
    """Check whether a state can be stored."""
    there = path.absolute()
    while not there.exists() and there != there.parent:
        there = there.parent
    if there.is_dir() and os.access(there, os.W_OK | os.X_OK):
        return Finding("state", "ok", f"{path} can be written")
    what = f"{path} cannot be written by this user; under systemd the service has a directory of its own"
    return Finding("state", "note", what, f"sudo install -d -o $USER {path}")


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace").strip().rstrip("\0")
    except OSError:
        return ""
