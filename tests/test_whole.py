"""Root writes and reads beside another user, who puts links wherever root might follow one."""

import errno
import os
import re
import stat
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from bms_gateway.config.dbc_files import read_dbc
from bms_gateway.errors import StateError
from bms_gateway.folders import MOST_LINKS, open_folder
from bms_gateway.store.files import read_file
from bms_gateway.store.requests import BaselineReset, ask
from bms_gateway.whole import whole
from tests.support.other_user import NOT_ROOT, OTHER, home, untouched

__all__ = ["home"]

TRIES = 1_000
LINKS = """
import os, sys
folder, secret = sys.argv[1:]
os.setresuid(65534, 65534, 65534)
os.chdir(folder)
print("up", flush=True)
while True:
    for name in {".", *os.listdir(".")} - {"."} | {"out.json"}:
        try:
            os.unlink(name)
        except OSError:
            pass
        try:
            os.symlink(secret, name)
            os.unlink(name)
            os.close(os.open(name, os.O_CREAT | os.O_WRONLY, 0o666))
        except OSError:
            pass
"""
SWAPS = """
import os, sys
home, secret = sys.argv[1:]
os.setresuid(65534, 65534, 65534)
os.chdir(home)
print("up", flush=True)
while True:
    try:
        os.rename("state", "away")
        os.symlink(secret, "state")
        os.unlink("state")
        os.rename("away", "state")
    except OSError:
        pass
"""


def beside(attack, *words):
    process = subprocess.Popen([sys.executable, "-c", attack, *map(str, words)], stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"up\n"
    return process


def won_by(attacker, act, home):
    """Let root act a thousand times beside an attacker; tell how often a file of root's was touched."""
    won = done = 0
    try:
        for n in range(TRIES):
            with suppress(OSError, StateError):  # refused in one line
                act(n)
                done += 1
            won += not untouched(home)
    finally:
        attacker.kill()
        attacker.wait()
        attacker.stdout.close()
    print(f"{won} of {TRIES} won, {done} done")
    return won


@NOT_ROOT
def test_a_thousand_results_of_root_in_a_folder_of_an_attacker_change_no_file_of_root(home):
    """By its path the temporary file was opened and its mode set: 20 of 20 went through a link."""

    def write(_):
        with whole(home / "out.json") as file:
            file.write(b"{}")

    assert won_by(beside(LINKS, home, home.parent / "secret" / "file"), write, home) == 0


@NOT_ROOT
def test_a_thousand_requests_into_a_folder_that_its_owner_swaps_for_a_link_reach_no_other(home):
    """17 of 1,000 were written into a folder of root's."""

    def write(n):
        ask(home / "state", BaselineReset("string_1", None, "x", n))

    assert won_by(beside(SWAPS, home, home.parent / "secret"), write, home) == 0


@NOT_ROOT
def test_root_reads_no_state_through_a_link_of_another_user(home):
    (home / "state" / "state").symlink_to(home.parent / "secret" / "file")
    with pytest.raises(OSError, match="state is a link that another user can change") as told:
        read_file(home / "state" / "state", 100)
    assert told.value.errno == errno.ELOOP
    (home / "state" / "state").unlink()
    (home / "state" / "state").write_text("sound")
    assert read_file(home / "state" / "state", 100) == b"sound"


@NOT_ROOT
def test_root_reads_no_state_through_a_link_that_takes_its_place_after_it_was_looked_at(home, monkeypatch):
    state, look = home / "state" / "state", os.stat
    state.write_text("sound")

    def swap(path, **how):
        found = look(path, **how)
        if path == "state":
            state.unlink()
            state.symlink_to(home.parent / "secret" / "file")
        return found

    monkeypatch.setattr(os, "stat", swap)
    with pytest.raises(OSError, match="Too many levels of symbolic links"):
        read_file(state, 100)
    assert state.is_symlink()


@NOT_ROOT
def test_root_with_the_home_of_another_user_keeps_no_cache_behind_a_link_of_theirs(home, monkeypatch):
    """32 of the 40 files there were left: the oldest were removed."""
    secret = home.parent / "secret"
    for k in range(40):
        (secret / f"{k}.table").write_text("of root's own")
    (home / ".cache").mkdir()
    (home / ".cache" / "bms-gateway").symlink_to(secret)
    for path in (home / ".cache", home / ".cache" / "bms-gateway"):
        os.chown(path, OTHER, OTHER, follow_symlinks=False)
    for name in ("CACHE_DIRECTORY", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(home))
    text = 'VERSION ""\nBS_:\nBU_: A\nBO_ 1 M: 8 A\n SG_ x : 0|8@1+ (1,0) [0|0] "" A\n'
    assert [m.name for m in read_dbc("a.dbc", text)] == ["M"]
    assert len(list(secret.glob("*.table"))) == 40
    (home / ".cache" / "bms-gateway").unlink()
    read_dbc("a.dbc", text)
    assert len(list((home / ".cache" / "bms-gateway").glob("*.table"))) == 1


@NOT_ROOT
def test_links_that_nobody_else_can_change_are_followed(home):
    """As that of systemd from the state directory to its private one."""
    own = home.parent
    (own / "link").symlink_to("home/../home")
    (own / "again").symlink_to(own / "link" / "state")
    (home / "state" / "state").write_text("sound")
    assert read_file(own / "again" / "state", 100) == b"sound"
    with whole(own / "again" / "new") as file:
        file.write(b"new")
    assert (home / "state" / "new").read_text() == "new"
    (own / "to-file").symlink_to(own / "there.json")
    with whole(own / "to-file") as file:
        file.write(b"there")
    assert (own / "there.json").read_text() == "there"
    assert (own / "to-file").is_symlink()
    assert read_file(own / "to-file", 100) == b"there"


@NOT_ROOT
def test_links_into_which_another_user_can_put_a_link_are_not(home):
    own, secret = home.parent, home.parent / "secret"
    (home / "in").symlink_to(secret)
    (own / "out").symlink_to(home / "in")
    for way in (home / "in", own / "out"):
        with pytest.raises(OSError, match="in is a link that another user can change"):
            open_folder(way)
    shared = own / "shared"  # as /tmp: anybody's, and nobody takes another's name away
    shared.mkdir()
    shared.chmod(0o1777)
    (shared / "ours").symlink_to(secret)
    (shared / "theirs").symlink_to(secret)
    os.chown(shared / "theirs", OTHER, OTHER, follow_symlinks=False)
    os.close(open_folder(shared / "ours"))
    with pytest.raises(OSError, match="theirs is a link that another user can change"):
        open_folder(shared / "theirs")
    shared.chmod(0o777)  # now anybody may put another link in the place of ours
    with pytest.raises(OSError, match="ours is a link that another user can change"):
        open_folder(shared / "ours")


def test_a_folder_is_opened_by_any_spelling_and_what_is_none_is_refused(tmp_path, monkeypatch):
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "file").write_text("")
    monkeypatch.chdir(tmp_path / "a")
    for way in (Path(), Path("b/.."), Path("../a"), tmp_path / "a", Path("./b/../../a/")):
        at = open_folder(way)
        assert os.fstat(at).st_ino == (tmp_path / "a").stat().st_ino
        os.close(at)
    with pytest.raises(NotADirectoryError):
        open_folder(tmp_path / "file")
    with pytest.raises(FileNotFoundError):
        open_folder(tmp_path / "none" / "b")
    assert MOST_LINKS == 40  # as the kernel's own
    for k in range(MOST_LINKS + 1):
        (tmp_path / f"l{k}").symlink_to(f"l{k + 1}" if k < MOST_LINKS else "a")
    os.close(open_folder(tmp_path / "l1"))
    with pytest.raises(OSError, match=r"[Tt]oo many|Not a directory"):
        open_folder(tmp_path / "l0")
    with pytest.raises(OSError, match=r"[Tt]oo many|Not a directory"), whole(tmp_path / "l0" / "x"):
        pass
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(OSError, match="Too many levels of symbolic links"), whole(tmp_path / "loop"):
        pass


@NOT_ROOT
def test_results_are_not_written_through_a_link_of_another_user_and_take_no_mode_of_theirs(home):
    (home / "out.json").symlink_to(home.parent / "secret" / "file")
    with pytest.raises(OSError, match=r"out\.json is a link that another user can change"), whole(home / "out.json"):
        pass
    assert untouched(home)
    (home / "out.json").unlink()
    (home / "out.json").write_text("theirs")
    (home / "out.json").chmod(0o666)
    os.chown(home / "out.json", OTHER, OTHER)
    with whole(home / "out.json") as file:
        file.write(b"ours")
    found = (home / "out.json").stat()
    assert (found.st_uid, found.st_mode & 0o777) == (0, 0o666 & ~umask())


def umask():
    now = os.umask(0)
    os.umask(now)
    return now


def test_a_new_file_has_a_name_that_nobody_can_foresee_and_the_usual_mode(tmp_path):
    (tmp_path / "shut").write_text("")
    (tmp_path / "shut").chmod(0o600)
    before, names = os.umask(0), []
    try:
        for name in ("a.txt", "n" * 255):
            with whole(tmp_path / name):
                (made,) = (p.name for p in tmp_path.iterdir() if p.name.startswith("."))
                names.append(made)
                if name == "a.txt":  # a link that comes meanwhile is replaced, and its file's mode is not taken
                    (tmp_path / name).symlink_to("shut")
            assert stat.S_IMODE((tmp_path / name).lstat().st_mode) == 0o666
    finally:
        os.umask(before)
    for made, start in zip(names, ("a.txt", "n" * 40), strict=True):
        assert re.fullmatch(rf"\.{re.escape(start)}\.[0-9a-f]{{16}}\.tmp", made)
    assert (tmp_path / "shut").read_text() == ""


@pytest.mark.parametrize(("name", "code"), [("pipe", errno.ELOOP), ("link", errno.EBUSY)])
def test_a_pipe_that_becomes_a_file_meanwhile_is_not_written(tmp_path, monkeypatch, name, code):
    (tmp_path / "file").write_text("old")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    look = os.stat

    def swap(path, *, dir_fd=None, follow_symlinks=True):
        found = look(path, dir_fd=dir_fd, follow_symlinks=follow_symlinks)
        if path == name and follow_symlinks and dir_fd is not None:
            (tmp_path / "pipe").unlink()
            (tmp_path / "pipe").symlink_to("file")
        return found

    monkeypatch.setattr(os, "stat", swap)
    with pytest.raises(OSError, match=r"Too many|somebody else") as told, whole(tmp_path / name) as file:
        file.write(b"new")
    assert told.value.errno == code
    assert (tmp_path / "file").read_text() == "old"


def test_no_descriptor_is_left_open(tmp_path):
    def count():
        return len(list(Path("/proc/self/fd").iterdir()))

    (tmp_path / "to-a").symlink_to("to-b")
    (tmp_path / "to-b").symlink_to("a")
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    (shared / "link").symlink_to(tmp_path / "a")
    before = count()
    for k in range(50):
        with whole(tmp_path / "to-a") as file:
            file.write(b"x")
        if os.geteuid() == 0:
            with pytest.raises(OSError, match="another user can change"), whole(shared / "link"):
                pass
        with whole(tmp_path / "a") as file:
            file.write(b"x")
        for way in (tmp_path / "a" / "b", tmp_path / "none" / f"{k}"):
            with pytest.raises(OSError), whole(way):  # noqa: PT011 - one or the other
                pass
    assert count() == before
