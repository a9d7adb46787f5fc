"""The installed service under systemd: its places, its frames, its journal, and what is added to its unit."""

import os
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

import cantools

ROOT = Path(__file__).resolve().parents[2]
UNIT = "bms-gateway"
LENT = Path("/opt/lent")
STATE = Path("/var/lib/bms-gateway")
CONFIG = Path("/etc/bms-gateway/gateway.toml")


def sh(*words, **options):
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
    return done.stdout


def prop(name):
    return sh("systemctl", "show", "-P", name, UNIT).strip()


def install(wheel):
    """Run the script as a user does, without a network, then lend the packages.

    Root may stand in a folder of somebody else's: modules that lie there are not loaded.
    """
    trap = Path("/tmp/of-somebody-else")
    for module in ("venv", "pip", "bms_gateway", "sitecustomize"):
        (trap / module).mkdir(parents=True, exist_ok=True)
        for part in ("__init__", "__main__"):
            (trap / module / f"{part}.py").write_text("raise SystemExit('loaded from where root happens to be')\n")
    environment = {**os.environ, "PIP_NO_INDEX": "1", "PIP_NO_DEPS": "1"}
    sh(ROOT / "deploy" / "install.sh", "--python", lend(), wheel, env=environment, cwd=trap)
    packages = Path(f"/opt/bms-gateway/venv/lib/python3.{sys.version_info.minor}/site-packages")
    (packages / "lent.pth").write_text(f"{LENT / 'site'}\n")


def until(condition, what, seconds=120.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return
        time.sleep(0.1)
    raise AssertionError(f"{what}: not within {seconds} s\n{journal()[-4000:]}")


def journal():
    return subprocess.run(
        ["journalctl", "--no-pager", "-o", "short-monotonic", "-u", UNIT], capture_output=True, text=True, check=False
    ).stdout


def lend():
    """The present interpreter and its packages, where the service may see them."""
    for source, name in ((sys.base_prefix, "python"), (sysconfig.get_path("purelib"), "site")):
        target = LENT / name
        target.mkdir(parents=True, exist_ok=True)
        if not any(target.iterdir()):
            sh("mount", "--bind", source, target)
    return LENT / "python" / "bin" / f"python3.{sys.version_info.minor}"


def drop_in(name, *lines):
    """Add lines to the unit's [Service], or take them away."""
    path = Path(f"/run/systemd/system/{UNIT}.service.d/{name}.conf")
    path.parent.mkdir(parents=True, exist_ok=True)
    if lines == (None,):
        path.unlink(missing_ok=True)
    else:
        path.write_text("\n".join(("[Service]", *lines, "")))
    sh("systemctl", "daemon-reload")


def own_frames(seconds):
    """Frames that the service sends, by message name, decoded by cantools."""
    database = cantools.database.load_file(ROOT / "dbc" / "bms_gateway.dbc")
    text = subprocess.run(
        ["timeout", str(seconds), "candump", "-L", "vcan0"], capture_output=True, text=True, check=False
    ).stdout
    found = {}
    for line in text.splitlines():
        number, data = line.split()[2].split("#")
        try:
            message = database.get_message_by_frame_id(int(number, 16))
        except KeyError:
            continue
        found.setdefault(message.name, []).append(message.decode(bytes.fromhex(data), decode_choices=False))
    return found
