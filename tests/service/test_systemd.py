"""The installed service under a real systemd with a real vcan0.

Run by ``CANVM_MODE=systemd CANVM_REQUIRED=1 tests/canvm/canvm -t 1500 python -m pytest -m systemd``. What is done here
is what a user does: build the wheel, `deploy/install.sh`, edit the config, `systemctl start`. Only two things differ,
because the guest has no network and its Python may lie where `ProtectHome` hides it: the interpreter is mounted below
/opt, and the packages that the gateway needs are lent by the present environment.
"""

import asyncio
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import aiomqtt
import pytest
from prometheus_client.parser import text_string_to_metric_families

from bms_gateway.service.fit_process import NICE
from bms_gateway.store import StateStore
from tests.service.broker import make_broker
from tests.support.fit_jobs import windows
from tests.support.installed_service import (
    CONFIG,
    LENT,
    ROOT,
    STATE,
    UNIT,
    drop_in,
    install,
    journal,
    own_frames,
    prop,
    sh,
    until,
)

pytestmark = [pytest.mark.systemd, pytest.mark.slow]

CHILD_STARTS_IN = 32 << 20  # enough for it to say that it goes first, too little to read anything


HUNGRY = """
import os, sys
from pathlib import Path
Path("/proc/self/oom_score_adj").write_text("1000")
Path(sys.argv[1], "cgroup.procs").write_text(str(os.getpid()))
b"x" * (300 << 20)
"""


@pytest.fixture
def service(installed):
    # a short watchdog, so that the test need not wait; everything else is the unit as it is shipped
    drop_in("test", "WatchdogSec=8s", "TimeoutStartSec=90s")
    started = subprocess.run(["systemctl", "start", UNIT], check=False)
    assert started.returncode == 0, journal()
    yield
    subprocess.run(["systemctl", "stop", UNIT], check=False)
    subprocess.run(["systemctl", "reset-failed", UNIT], check=False)


def scrape():
    with urllib.request.urlopen("http://127.0.0.1:9105/metrics", timeout=60) as answer:
        return answer.read().decode()


def test_it_is_ready_only_once_the_bus_is_there(installed):
    sh("ip", "link", "del", "vcan0")
    drop_in("test", "TimeoutStartSec=20s")
    try:
        sh("systemctl", "start", "--no-block", UNIT)
        until(lambda: prop("StatusText") == "waiting: bus absent", "what it waits for in the status line")
        assert prop("ActiveState") == "activating"
        time.sleep(25)  # longer than the limit for a start, which is put off while it waits
        assert (prop("ActiveState"), prop("NRestarts")) == ("activating", "0")
    finally:
        sh("ip", "link", "add", "vcan0", "type", "vcan")
        sh("ip", "link", "set", "vcan0", "up")
    until(lambda: prop("ActiveState") == "active", "READY after the bus came")
    sh("systemctl", "stop", UNIT)


def test_the_unit_is_valid_and_hardened(installed):
    sh("systemd-analyze", "verify", f"/etc/systemd/system/{UNIT}.service")
    last = sh("systemd-analyze", "security", "--no-pager", "--offline=yes", f"/etc/systemd/system/{UNIT}.service")
    exposure = float(last.strip().splitlines()[-1].split(":")[1].split()[0])
    print("exposure", exposure)
    assert exposure <= 1.1  # the metrics port is on, and MQTT can be


REFUSED = {"EPERM", "EACCES", "EROFS", "ENOENT", "EAFNOSUPPORT", "ENOSYS", "ENODEV"}


def test_the_sandbox_is_in_force_from_within(installed):
    """A probe in the unit's own sandbox tries what a taken-over gateway would."""
    shutil.copy(ROOT / "tests" / "service" / "probe.py", LENT / "probe.py")
    Path("/tmp/probe-of-the-host").touch()
    home = Path("/home/driver")
    home.mkdir(parents=True, exist_ok=True)
    drop_in("probe", f"ExecStartPre=/opt/bms-gateway/venv/bin/python {LENT}/probe.py")
    try:
        sh("systemctl", "start", UNIT)
        pid = prop("MainPID")
        found = json.loads((STATE.resolve() / "probe.json").read_text())
        print("sandbox", found)
        status = dict(
            line.split(":\t", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines() if ":\t" in line
        )
        mounted = sh("nsenter", "-t", pid, "-m", "findmnt", "-n", "-o", "OPTIONS", "-T", "/etc")
        limits = (sh("systemctl", "show", "-P", p, UNIT).strip() for p in ("MemoryMax", "CPUQuotaPerSecUSec"))
    finally:
        subprocess.run(["systemctl", "stop", UNIT], check=False)
        drop_in("probe", None)
        for left in ("probe.json", "probe.txt", "suid"):
            (STATE.resolve() / left).unlink(missing_ok=True)
    allowed = {name for name, how in found.items() if how == "done"}
    assert allowed == {"write state", "can"}, found
    tried = {name: how for name, how in found.items() if name[0].islower() and name != "user"}
    assert {how for name, how in tried.items() if name not in allowed} <= REFUSED, found
    assert found["user"] >= 61_184
    # the running program itself, seen from outside
    for name in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb"):
        assert int(status[name], 16) == 0, name
    assert (status["NoNewPrivs"], status["Seccomp"]) == ("1", "2")
    assert mounted.startswith("ro,")
    assert list(limits) == [str(256 << 20), "1.200000s"]


def test_installing_again_is_safe_and_keeps_an_edited_config(installed):
    before = CONFIG.read_text()
    try:
        CONFIG.write_text(before + "# mine\n")
        install(installed)
        assert CONFIG.read_text().endswith("# mine\n")
    finally:
        CONFIG.write_text(before)


def test_what_is_not_roots_alone_is_not_installed_into(installed):
    for place in (Path("/opt/bms-gateway"), CONFIG.parent):
        before = sorted(place.iterdir())
        for spoil, mend in ((("chown", "1000"), ("chown", "0")), (("chmod", "g+w"), ("chmod", "g-w"))):
            sh(*spoil, place)
            done = subprocess.run([ROOT / "deploy" / "install.sh"], capture_output=True, text=True)
            sh(*mend, place)
            assert (done.returncode, done.stderr.count("\n")) == (2, 1)
            assert f"{place} must be a directory of root's" in done.stderr
        aside = place.rename(f"{place}.aside")
        place.symlink_to(aside)
        done = subprocess.run([ROOT / "deploy" / "install.sh"], capture_output=True, text=True)
        place.unlink()
        aside.rename(place)
        assert done.returncode == 2
        assert sorted(place.iterdir()) == before


def reloads():
    """Count the reloads that the journal tells of, whatever it tells after them."""
    return len(re.findall(r": reloaded$", journal(), re.M))


def test_it_gets_ready_estimates_survives_and_stops_cleanly(service, pack):
    assert prop("ActiveState") == "active"
    assert prop("StatusText").startswith("OK; bus up")
    assert "raise net.core.rmem_max" not in journal()  # install.sh has, to what the service asks for
    pid = int(prop("MainPID"))
    assert os.stat(f"/proc/{pid}").st_uid >= 61_184  # a dynamic user

    # estimates on the bus
    until(lambda: len(own_frames(3).get("gateway_status", [])) >= 2, "our own frames on vcan0")
    rss = next(line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("VmRSS"))
    print("READY", prop("StatusText"), rss)

    # metrics on loopback, read by Prometheus' parser; nothing listens anywhere else
    families = {f.name: f for f in text_string_to_metric_families(scrape())}
    assert families["bms_gateway_bus_up"].samples[0].value == 1
    assert {s.labels["string"] for s in families["bms_gateway_core_max_celsius"].samples} >= {"string_1", "string_5"}
    listening = [
        line.split() for line in sh("ss", "-H", "-l", "-n", "-t", "-u", "-p").splitlines() if f"pid={pid}," in line
    ]
    assert [words[4] for words in listening] == ["127.0.0.1:9105"]

    # healthy: the watchdog leaves it alone
    time.sleep(12)
    assert prop("NRestarts") == "0"

    # a reload: a wrong config is refused, a right one taken, the process stays
    config = CONFIG.read_text()
    try:
        CONFIG.write_text(config.replace("channel", "chanel"))
        subprocess.run(["systemctl", "reload", UNIT], check=False)
        until(lambda: "not reloaded, going on as before" in journal(), "refusal of the wrong config")
        CONFIG.write_text(config.replace("# [observer]", "[observer]\nheat_cell_W = 0.3\n#"))
        before = reloads()
        sh("systemctl", "reload", UNIT)
        until(lambda: reloads() > before, "reload")
    finally:
        CONFIG.write_text(config)
    assert (int(prop("MainPID")), prop("NRestarts")) == (pid, "0")
    until(lambda: len(own_frames(3).get("gateway_status", [])) >= 2, "our own frames after the reload")

    # a hang: everything stands still
    os.kill(pid, 19)
    until(lambda: prop("NRestarts") == "1" and prop("ActiveState") == "active", "restart by the watchdog")
    assert "watchdog" in journal().lower()

    # a crash
    os.kill(int(prop("MainPID")), 11)
    until(lambda: prop("NRestarts") == "2" and prop("ActiveState") == "active", "restart after a crash")
    until(lambda: len(own_frames(3).get("gateway_status", [])) >= 2, "our own frames again")

    # the interface goes down and comes up, is removed and comes back: no restart, an alarm each time, and it is over
    for gone, back in (
        (["ip link set vcan0 down"], ["ip link set vcan0 up"]),
        (["ip link del vcan0"], ["ip link add vcan0 type vcan", "ip link set vcan0 up"]),
    ):
        before = journal().count("back after")
        for words in gone:
            sh(*words.split())
        until(lambda: prop("StatusText").startswith("ALARM: vcan0: "), "the alarm of the bus in the status line")
        assert b"bms_gateway_bus_up 0" in scrape().encode()
        for words in back:
            sh(*words.split())
        until(lambda before=before: journal().count("back after") > before, "reconnection")
        until(lambda: prop("StatusText").split("; ")[1].startswith("bus up"), "the status line of the open bus")
    assert prop("NRestarts") == "2"

    # journald has the fields to filter by
    alarms = sh("journalctl", "--no-pager", "-o", "json", "-u", UNIT, "BMS_CODE=alert-bus").splitlines()
    assert {(e["PRIORITY"], e["SYSLOG_IDENTIFIER"]) for e in map(json.loads, alarms)} >= {("2", "bms-gateway")}

    # a clean stop saves the state
    begun = time.time()
    sh("systemctl", "stop", UNIT)
    assert (prop("ActiveState"), prop("Result"), prop("ExecMainStatus")) == ("inactive", "success", "0")
    saved = [p for p in STATE.resolve().iterdir() if p.stat().st_mtime >= begun - 1]
    assert saved, list(STATE.resolve().iterdir())

    # the unit tells it the boot, whose identifier the sandbox hides
    stored = StateStore(STATE.resolve()).load().state
    assert stored is not None
    assert stored["clock"]["boot"] == Path("/proc/sys/kernel/random/boot_id").read_text().strip().replace("-", "")


def test_a_child_for_which_there_is_no_memory_is_lost_alone(service):
    """By default systemd stops a service as soon as the kernel has ended any process of it for want of memory."""
    pid, group = prop("MainPID"), Path("/sys/fs/cgroup") / prop("ControlGroup").lstrip("/")
    stat = dict(line.split() for line in (group / "memory.stat").read_text().splitlines())
    held = sum(int(stat[k]) for k in ("anon", "kernel"))
    sh("systemctl", "set-property", "--runtime", UNIT, f"MemoryMax={held + CHILD_STARTS_IN}")
    try:
        subprocess.run(["systemctl", "reload", UNIT], check=False, capture_output=True)
        until(lambda: "the process that read it ended with SIGKILL" in journal(), "the refusal of the reload")
        assert "oom_kill 1" in (group / "memory.events").read_text()
    finally:
        sh("systemctl", "set-property", "--runtime", UNIT, "MemoryMax=256M")
    before = reloads()
    sh("systemctl", "reload", UNIT)
    until(lambda: reloads() > before, "reload")
    assert subprocess.run([sys.executable, "-c", HUNGRY, group], check=False).returncode == -9  # as a fit would end
    until(lambda: "killed by the OOM killer" in journal(), "what systemd has to say")
    assert (prop("ActiveState"), prop("MainPID"), prop("NRestarts")) == ("active", pid, "0")


def test_a_config_that_is_wrong_is_told_in_one_line_and_tried_again(installed):
    before = CONFIG.read_text()
    try:
        CONFIG.write_text(before.replace("channel", "chanel"))
        subprocess.run(["systemctl", "start", UNIT], check=False, capture_output=True)
        until(lambda: "did you mean 'channel'" in journal(), "the error line")
        assert "Traceback" not in journal().split("did you mean 'channel'")[-1]
    finally:
        CONFIG.write_text(before)
        subprocess.run(["systemctl", "stop", UNIT], check=False)
        subprocess.run(["systemctl", "reset-failed", UNIT], check=False)


def test_the_broker_is_told_with_a_password_that_only_systemd_can_read(installed, tmp_path):
    before, password = CONFIG.read_text(), CONFIG.with_name("mqtt-password")
    words = tmp_path / "passwords"
    words.touch(0o600)
    sh("mosquitto_passwd", "-b", words, "car", "kingfisher")
    broker = make_broker(tmp_path)
    broker.stop()
    broker.configure("allow_anonymous false", f"password_file {words}")
    broker.start()

    async def ask():
        async with aiomqtt.Client("127.0.0.1", broker.port, username="car", password="kingfisher") as client:
            await client.subscribe("car/status")
            return (await anext(client.messages)).payload.decode()

    def retained():
        try:
            return asyncio.run(asyncio.wait_for(ask(), 10))
        except (TimeoutError, aiomqtt.MqttError):
            return ""

    try:
        table = f'[mqtt]\nhost = "127.0.0.1"\nport = {broker.port}\ntopic = "car"\nusername = "car"'
        CONFIG.write_text(f'{before}\n{table}\npassword_file = "mqtt-password"\n')
        password.write_text("kingfisher\n")
        password.chmod(0o644)
        drop_in("test", "TimeoutStartSec=90s")
        subprocess.run(["systemctl", "start", UNIT], check=False, capture_output=True)
        until(
            lambda: "'/etc/bms-gateway/mqtt-password' is open to others (mode 0644): chmod 600" in journal(), "refusal"
        )
        subprocess.run(["systemctl", "stop", UNIT], check=False)
        password.chmod(0o600)
        drop_in("test", "TimeoutStartSec=90s", f"LoadCredential=mqtt-password:{password}")
        started = subprocess.run(["systemctl", "start", UNIT], check=False)
        assert started.returncode == 0, journal()[-3000:]
        until(lambda: retained().startswith("OK"), "the status line at the broker")
        os.kill(int(prop("MainPID")), 9)
        until(lambda: retained().startswith("OFFLINE") or int(prop("NRestarts")) > 0, "the last will")
        until(lambda: retained().startswith("OK"), "the status line after the restart")
        sh("systemctl", "stop", UNIT)
        until(lambda: retained() == "STOPPED", "the end at the broker")
        assert "kingfisher" not in journal()
    finally:
        subprocess.run(["systemctl", "stop", UNIT], check=False)
        subprocess.run(["systemctl", "reset-failed", UNIT], check=False)
        CONFIG.write_text(before)
        password.unlink(missing_ok=True)
        drop_in("test", None)
        broker.stop()


def test_networkd_understands_the_interface_file(installed):
    folder = Path("/etc/systemd/network")
    folder.mkdir(exist_ok=True)
    text = (ROOT / "deploy" / "can0.network").read_text()
    (folder / "can0.network").write_text(text)
    (folder / "can1.network").write_text(text.replace("can0", "can1").replace("RestartSec", "RestartSeconds"))
    runtime = Path("/run/systemd/netif")
    for name in ("links", "leases", "lldp"):
        (runtime / name).mkdir(parents=True, exist_ok=True)
    sh("chown", "-R", "systemd-network", runtime)
    environment = {**os.environ, "SYSTEMD_LOG_LEVEL": "debug", "SYSTEMD_LOG_TARGET": "console"}
    daemon = subprocess.Popen(
        ["/lib/systemd/systemd-networkd"], env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    )
    told = []
    try:
        for line in daemon.stderr:
            told.append(line.strip())
            if "Enumeration completed" in line:
                break
    finally:
        daemon.kill()
        daemon.wait()
        daemon.stderr.close()
    complaints = [line for line in told if "/etc/systemd/network/can" in line]
    assert complaints == [
        "/etc/systemd/network/can1.network:8: Unknown key 'RestartSeconds' in section [CAN], ignoring."
    ], told[-20:]
    assert {"BitRate=500K", "RestartSec=100ms", "PacketLimit=128"} <= set(text.splitlines())


ASIDE = """
import asyncio, os, pickle
from pathlib import Path
from bms_gateway.service.fit_process import Aside
from priority import Priority

async def main():  # in a thread, as the gateway does it
    job = pickle.loads(Path("/etc/bms-gateway/job").read_bytes())
    print("found:", type(await asyncio.to_thread(Aside().run, job)).__name__)
    print("priorities:", os.getpriority(os.PRIO_PROCESS, 0), await asyncio.to_thread(Aside().run, Priority()))

asyncio.run(main())
"""
PRIORITY = """
import os
class Priority:
    def run(self):
        return os.getpriority(os.PRIO_PROCESS, 0)
"""


def test_a_window_is_fitted_in_a_process_of_its_own_below_the_loop_under_all_the_units_restrictions(installed):
    job = windows()[0]
    (CONFIG.parent / "job").write_bytes(pickle.dumps(job))
    (CONFIG.parent / "job").chmod(0o644)
    (CONFIG.parent / "aside.py").write_text(ASIDE)
    (CONFIG.parent / "priority.py").write_text(PRIORITY)
    python = "/opt/bms-gateway/venv/bin/python"
    run = ("Type=oneshot", "Restart=no", "WatchdogSec=0", "ExecStart=", f"ExecStart={python} /etc/bms-gateway/aside.py")
    drop_in("aside", *run, "Environment=PYTHONPATH=/etc/bms-gateway")
    try:
        subprocess.run(["systemctl", "start", UNIT], check=False)
        assert f"found: {type(job.run()).__name__}" in journal()
        assert "NotDone" not in journal()
        loop, fit = map(int, journal().split("priorities: ")[1].split()[:2])  # nice values: the lower one goes first
        assert loop <= fit - NICE
    finally:
        drop_in("aside", None)
        subprocess.run(["systemctl", "reset-failed", UNIT], check=False)
