"""Root asks the service for a new baseline, and whoever has taken the service over tries to make root touch a file."""

import os
import stat
import subprocess
import sys

import pytest

from bms_gateway.errors import StateError
from bms_gateway.store.requests import BaselineReset, ask, asked

TRIES = 1_000
ATTACKER = """
import os, sys
folder, secret = sys.argv[1:]
os.chdir(folder)
print("up", flush=True)
while True:
    for name in os.listdir("."):
        if not name.endswith(".request"):
            try:
                os.unlink(name)
                os.symlink(secret, name)
            except OSError:
                pass
"""


def wish(n):
    return BaselineReset("string_1", None, "x", n)


def test_a_thousand_requests_beside_an_attacker_change_no_file_of_root(tmp_path):
    """By its path the mode of the file was set that had taken the name of the request: 43 of 200 times."""
    secret, folder = tmp_path / "secret", tmp_path / "state"
    folder.mkdir()
    secret.write_text("for root alone")
    secret.chmod(0o600)
    attacker = subprocess.Popen([sys.executable, "-c", ATTACKER, folder, secret], stdout=subprocess.PIPE)
    won = written = 0
    try:
        assert attacker.stdout.readline() == b"up\n"
        for n in range(TRIES):
            try:
                ask(folder, wish(n))
                written += 1
            except StateError:
                pass  # its file was taken away before it had its name: refused in one line
            won += stat.S_IMODE(secret.stat().st_mode) != 0o600 or secret.read_text() != "for root alone"
            secret.chmod(0o600)
    finally:
        attacker.kill()
        attacker.wait()
        attacker.stdout.close()
    print(f"{won} of {TRIES} won, {written} requests written")
    assert won == 0


@pytest.mark.parametrize("what", ["a link to a file", "a link to nothing", "a pipe", "a directory"])
def test_what_lies_in_the_place_of_a_request_is_replaced_and_never_written_through(tmp_path, what):
    secret, folder = tmp_path / "secret", tmp_path / "state"
    folder.mkdir()
    secret.write_text("for root alone")
    place = folder / "baseline.7.request"
    {
        "a link to a file": lambda: place.symlink_to(secret),
        "a link to nothing": lambda: place.symlink_to(tmp_path / "new"),
        "a pipe": lambda: os.mkfifo(place),
        "a directory": lambda: place.mkdir(),
    }[what]()
    if what == "a directory":
        with pytest.raises(StateError, match="cannot be written: Is a directory"):
            ask(folder, wish(7))
    else:
        assert ask(folder, wish(7)) == place
        assert stat.S_ISREG(place.lstat().st_mode)
        assert [w for _, w in asked(folder)] == [wish(7)]
    assert secret.read_text() == "for root alone"
    assert not (tmp_path / "new").exists()
    assert [f.name for f in folder.iterdir()] == [place.name]  # nothing is left of what could not be done


def test_the_service_may_read_what_root_asks_whatever_roots_umask(tmp_path):
    before = os.umask(0o077)
    try:
        path = ask(tmp_path, wish(1))
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


def test_where_nothing_can_be_written_it_is_one_line(tmp_path):
    with pytest.raises(StateError, match="nowhere: the request cannot be written: No such file or directory"):
        ask(tmp_path / "nowhere", wish(1))
