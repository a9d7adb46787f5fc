"""A real mosquitto for a test: started, stopped, halted and refused at will."""

import os
import shutil
import signal
import socket
import subprocess
import time

import pytest

PATIENCE_S = 60.0


def why_no_mosquitto():
    return (
        None
        if shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
        else "no mosquitto here: apt install it"
    )


def free_port():
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]


class Broker:
    """One broker on loopback; `config` is added to its file."""

    def __init__(self, folder, *config):
        self.port = free_port()
        self.file = folder / "mosquitto.conf"
        self.process = None
        self.configure("allow_anonymous true", *config)

    def configure(self, *lines):
        self.file.write_text("\n".join(("user root", f"listener {self.port} 127.0.0.1", *lines, "")))

    def start(self):
        program = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
        self.process = subprocess.Popen([program, "-c", self.file], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            assert self.process.poll() is None, self.process.stderr.read().decode()
            with socket.socket() as sock:
                if sock.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            time.sleep(0.02)
        raise AssertionError("the broker does not answer")

    def stop(self):
        if self.process is not None:
            self.process.kill()
            self.process.communicate()
            self.process = None

    def halt(self):
        os.kill(self.process.pid, signal.SIGSTOP)

    def go_on(self):
        os.kill(self.process.pid, signal.SIGCONT)


def make_broker(folder, *config):
    """A started broker; skips where there is no mosquitto, fails there in CI."""
    if (why := why_no_mosquitto()) is not None:
        if os.environ.get("CI") == "true":
            pytest.fail(why, pytrace=False)
        pytest.skip(why)
    broker = Broker(folder, *config)
    broker.start()
    return broker
