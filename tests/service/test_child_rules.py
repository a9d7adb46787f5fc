"""Child processes of the service by their own rules: small programs stand in for a fit and for who reads a config."""

import asyncio
import ctypes
import io
import logging
import os
import pickle
import re
import runpy
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from bms_gateway import __version__
from bms_gateway.config import load
from bms_gateway.errors import ConfigError
from bms_gateway.service import fit_process, memory
from bms_gateway.service import reread as rereading
from bms_gateway.service.fit_process import Aside, NotDone
from bms_gateway.service.reread import Reread, read_for_parent, reread

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 60.0
SMALL = (sys.executable, "-S", "-E", "-c")  # starts in a twentieth of the time
ECHO = "import sys, pickle; pickle.dump(pickle.load(sys.stdin.buffer), sys.stdout.buffer)"
FOR_EVER = "import time; time.sleep(600)"


@pytest.fixture
def children(monkeypatch):
    """Those that are started, as `subprocess` keeps them."""
    made = []

    class Kept(subprocess.Popen):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            made.append(self)

    monkeypatch.setattr(subprocess, "Popen", Kept)
    return made


def gone(child):
    """Whether a child was waited for, and its pipes are closed."""
    return child.returncode is not None and child.stdin.closed and child.stdout.closed


def test_a_result_is_what_the_child_writes_and_nothing_is_left_of_it(children):
    one = Aside(child=(*SMALL, ECHO))
    for job in ((1, "a"), bytes(range(256)) * 4_000):  # no pipe holds this one
        assert one.run(job) == job
        assert one.process is None
    assert [(c.returncode, gone(c)) for c in children] == [(0, True)] * 2


def test_a_child_has_a_group_of_its_own_in_the_session_of_the_service():
    tells = "import os, sys, pickle; pickle.dump((os.getpid(), os.getpgid(0), os.getsid(0)), sys.stdout.buffer)"
    process, group, session = Aside(child=(*SMALL, tells)).run(0)
    assert (process, session) == (group, os.getsid(0))


@pytest.mark.parametrize(
    ("ends", "why"),
    [
        ("raise SystemExit(1)", "it failed by a bug; the lines above, from its process, say which"),
        ("raise SystemExit(200)", "it failed by a bug; the lines above, from its process, say which"),
        ("import os; os.kill(os.getpid(), 11)", "its process was ended by SIGSEGV"),
    ],
)
def test_a_child_that_ends_badly_has_made_no_fit(children, ends, why):
    assert Aside(child=(*SMALL, ends)).run(bytes(200_000)) == NotDone(why)  # and does not read what it is given
    assert gone(children[0])


def test_a_child_that_has_not_ended_in_time_is_killed_and_waited_for(children):
    one = Aside(deadline_s=0.2, child=(*SMALL, FOR_EVER))
    assert one.run(bytes(200_000)) == NotDone("it had not ended after 0.2 s and was killed")
    assert (children[0].returncode, gone(children[0]), one.process) == (-9, True, None)


def test_the_end_of_the_service_kills_the_child_that_works_and_starts_no_other(children):
    one, found = Aside(child=(*SMALL, FOR_EVER)), []
    assert one.process is None
    thread = threading.Thread(target=lambda: found.append(one.run(0)))
    thread.start()
    end = time.monotonic() + PATIENCE_S
    while one.process is None and time.monotonic() < end:
        time.sleep(0.002)
    assert one.process == children[0].pid
    one.close()
    thread.join(PATIENCE_S)
    assert found == [NotDone("its process was ended by SIGKILL")]
    assert one.process is None
    assert one.run(0) == NotDone("the service ends")
    assert len(children) == 1


@pytest.fixture
def hanging(monkeypatch):
    """The start of a child hangs while what was started lives, as between fork and exec; gives what was started."""
    started, begin = [], subprocess.Popen

    def hang(*args, **how):
        started.append(begin(["sleep", "600"]))
        started[-1].wait()
        return begin(*args, **how)

    monkeypatch.setattr(subprocess, "Popen", hang)
    return started


def test_a_child_that_hangs_before_it_has_begun_is_killed_at_the_deadline_too(hanging):
    one = Aside(deadline_s=0.3, child=(*SMALL, ECHO))
    began = time.monotonic()
    assert one.run(0) == NotDone("it had not ended after 0.3 s and was killed")
    assert 0.3 <= time.monotonic() - began < PATIENCE_S
    assert ([c.returncode for c in hanging], one.process) == ([-9], None)


def test_the_end_of_the_service_does_not_wait_for_a_child_that_hangs_before_it_has_begun(hanging):
    one, found = Aside(child=(*SMALL, FOR_EVER)), []
    thread = threading.Thread(target=lambda: found.append(one.run(0)))
    thread.start()
    end = time.monotonic() + PATIENCE_S
    while not hanging and time.monotonic() < end:
        time.sleep(0.002)
    timers = [t for t in threading.enumerate() if isinstance(t, threading.Timer)]
    assert [t.daemon for t in timers] == [True]  # the interpreter does not wait for it either
    one.close()
    thread.join(PATIENCE_S)
    assert found == [NotDone("its process was ended by SIGKILL")]
    assert [c.returncode for c in hanging] == [-9]


def test_the_end_of_the_service_kills_no_other_child_of_the_thread_that_made_fits():
    one = Aside(child=(*SMALL, ECHO))
    assert one.run(1) == 1
    bystander = os.posix_spawnp("sleep", ["sleep", "600"], os.environ)
    one.close()
    time.sleep(0.05)
    assert os.waitpid(bystander, os.WNOHANG) == (0, 0)
    os.kill(bystander, 9)
    os.waitpid(bystander, 0)


def test_a_deadline_is_that_of_its_own_child(monkeypatch):
    """The first child ends well; half a deadline after its start a second one begins, whose start hangs."""
    one, begin = Aside(deadline_s=1.0, child=("true",)), subprocess.Popen
    began = time.monotonic()
    with pytest.raises(EOFError):
        one.run(0)  # it writes nothing
    time.sleep(max(0.0, began + 0.5 - time.monotonic()))

    def hang(*args, **how):
        begin(["sleep", "600"]).wait()
        return begin(*args, **how)

    monkeypatch.setattr(subprocess, "Popen", hang)
    began = time.monotonic()
    assert isinstance(one.run(0), NotDone)
    assert time.monotonic() - began >= 1.0


def test_no_child_of_another_thread_is_killed_with_one_that_hangs(hanging):
    bystander, found = os.posix_spawnp("sleep", ["sleep", "600"], os.environ), []
    thread = threading.Thread(target=lambda: found.append(Aside(deadline_s=0.2, child=(*SMALL, ECHO)).run(0)))
    thread.start()
    thread.join(PATIENCE_S)
    assert found == [NotDone("it had not ended after 0.2 s and was killed")]
    assert os.waitpid(bystander, os.WNOHANG) == (0, 0)
    os.kill(bystander, 9)
    os.waitpid(bystander, 0)


def test_no_earlier_child_of_the_same_thread_is_killed_with_one_that_hangs(hanging):
    """`multiprocessing` keeps a helper process of its own for each program, often a child of the main thread."""
    bystander = os.posix_spawnp("sleep", ["sleep", "600"], os.environ)
    found = Aside(deadline_s=0.2, child=(*SMALL, ECHO)).run(0)
    assert found == NotDone("it had not ended after 0.2 s and was killed")
    assert os.waitpid(bystander, os.WNOHANG) == (0, 0)
    os.kill(bystander, 9)
    os.waitpid(bystander, 0)


def test_a_kernel_that_lists_no_children_ends_no_fit_by_a_fault(monkeypatch):
    """Without the list nothing can be killed before it has begun; what hangs for a while is then late, no more."""
    begin = subprocess.Popen

    def slow(*args, **how):
        begin(["sleep", "0.5"]).wait()
        return begin(*args, **how)

    def refused(*_args, **_how):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(subprocess, "Popen", slow)
    monkeypatch.setattr(Path, "read_text", refused)
    assert Aside(deadline_s=0.2, child=(*SMALL, ECHO)).run(0) == NotDone("it had not ended after 0.2 s and was killed")


@pytest.mark.parametrize(
    ("version", "vfork"), [((3, 11, 0), False), ((3, 11, 3), False), ((3, 11, 4), True), ((3, 12, 0), True)]
)
def test_a_fit_is_not_started_by_vfork_where_python_holds_its_lock_until_the_program_is_read(
    monkeypatch, version, vfork
):
    """Before 3.11.4, a program on a disk that hangs would stop all threads of the service. Later, vfork is quicker."""
    monkeypatch.setattr(subprocess, "_USE_VFORK", True)
    monkeypatch.setattr(sys, "version_info", (*version, "final", 0))
    monkeypatch.delitem(sys.modules, fit_process.__name__)
    runpy.run_module(fit_process.__name__, run_name="loaded_again")
    assert subprocess._USE_VFORK is vfork


def test_the_end_of_a_service_without_a_child_kills_nothing():
    one = Aside(child=(*SMALL, ECHO))
    one.close()
    assert one.run(0) == NotDone("the service ends")


class Main:
    """A module run as a program, with what it does to its own process told instead of done."""

    def __init__(self, monkeypatch, module, *words):
        self.done, self.out = [], io.BytesIO()
        monkeypatch.delitem(sys.modules, module)
        monkeypatch.setattr(memory, "first_to_go", lambda: self.done.append("first to go"))
        monkeypatch.setattr(os, "nice", lambda by: self.done.append(f"nice {by}"))
        monkeypatch.setattr(logging, "disable", lambda: self.done.append("quiet"))
        libc = SimpleNamespace(prctl=lambda *what: self.done.append(("prctl", *what)))
        monkeypatch.setattr(ctypes, "CDLL", lambda name: libc if name is None else None)
        monkeypatch.setattr(sys, "argv", [module, *words])
        monkeypatch.setattr(sys, "stdout", SimpleNamespace(buffer=self.out))
        self._module = module

    def run(self):
        self.names = runpy.run_module(self._module, run_name="__main__")
        return self.done


class Job:
    def run(self):
        return "result"


@pytest.mark.parametrize("forbidden", [False, True])
def test_the_program_of_a_fit_dies_with_the_service_goes_first_and_comes_last(monkeypatch, forbidden):
    main = Main(monkeypatch, fit_process.__name__)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(pickle.dumps(Job()))))
    if forbidden:  # as the hardened unit does

        def nice(by):
            raise PermissionError(by)

        monkeypatch.setattr(os, "nice", nice)
    assert main.run() == [("prctl", 1, 9), "first to go", *([] if forbidden else ["nice 5"])]
    assert pickle.loads(main.out.getvalue()) == "result"
    # a stop takes five seconds at most, of which a killed child has one; a fit counts late after half a minute
    assert (main.names["DEADLINE_S"], main.names["REAP_S"]) == (60.0, 1.0)


@pytest.mark.parametrize(("threads", "then"), [(None, "1"), ("3", "3")])
def test_the_program_that_reads_a_config_goes_first_and_says_nothing_beside(monkeypatch, threads, then):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    if threads is not None:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", threads)
    main, asked = Main(monkeypatch, rereading.__name__, "/a/b.toml", "/c"), []
    monkeypatch.setattr(rereading, "read_for_parent", lambda path, out: asked.append((path, out)))
    assert main.run() == ["first to go", "quiet"]
    assert asked == [(Path("/a/b.toml"), main.out)]
    assert os.environ["OPENBLAS_NUM_THREADS"] == then
    unit = (ROOT / "deploy" / "bms-gateway.service").read_text()  # systemd waits longer for a reload
    assert float(re.search(r"^TimeoutStartSec=(\d+)", unit, re.M).group(1)) == main.names["PATIENCE_S"] + 5.0


def refuse(path):
    raise ConfigError(f"{path}: is none")


@pytest.mark.parametrize("sound", [True, False])
def test_what_was_read_is_written_after_the_version(monkeypatch, sound):
    loaded = SimpleNamespace(config={"a": 1}, engine=lambda: ["engine"])
    monkeypatch.setattr(load, "load_config", (lambda _: loaded) if sound else refuse)
    out = io.BytesIO()
    read_for_parent(Path("/a/b.toml"), out)
    version, _, content = out.getvalue().partition(b"\n")
    assert version.decode() == __version__
    found = pickle.loads(content)
    if sound:
        assert (found.config, found.engine()) == ({"a": 1}, ["engine"])
        assert found.engine() is not found.engine()
    else:
        assert found == "/a/b.toml: is none"


def answers(monkeypatch, folder, content, version=__version__):
    (folder / "answer").write_bytes(f"{version}\n".encode() + content)
    monkeypatch.setattr(rereading, "CHILD", ("/bin/sh", "-c", f"cat '{folder}/answer'"))


def test_a_sound_config_comes_back_from_the_child_whatever_is_packed_in_it(monkeypatch, tmp_path):
    sent = Reread({"a": 1}, pickle.dumps(["engine", b"\n" * 100_000]))  # no pipe holds it
    answers(monkeypatch, tmp_path, pickle.dumps(sent))
    assert asyncio.run(reread(Path("/a/b.toml"))) == sent


def test_a_refusal_comes_back_as_it_was_said(monkeypatch, tmp_path):
    answers(monkeypatch, tmp_path, pickle.dumps("/a/b.toml: line 3"))
    with pytest.raises(ConfigError, match=r"^/a/b.toml: line 3$"):
        asyncio.run(reread(Path("/a/b.toml")))


def test_an_answer_of_another_version_is_not_even_unpacked(monkeypatch, tmp_path):
    answers(monkeypatch, tmp_path, b"not a pickle", __version__ + "1")
    with pytest.raises(ConfigError, match="another version of the program has been installed: restart the service"):
        asyncio.run(reread(Path("/a/b.toml")))


@pytest.mark.parametrize(
    ("child", "says"),
    [
        (("/bin/sh", "-c", "kill -9 $$"), "the process that read it ended with SIGKILL"),
        (("/bin/sh", "-c", "kill -40 $$"), "the process that read it ended with signal 40"),  # has no name
        (("/bin/sh", "-c", "exit 1"), "the process that read it ended with status 1"),
        (("/bin/sh", "-c", "exit 3"), "the process that read it ended with status 3"),
        (("/nonexistent",), "no process could be started to read it: No such file or directory"),
    ],
)
def test_a_child_that_gives_no_answer_refuses_the_config(monkeypatch, child, says):
    monkeypatch.setattr(rereading, "CHILD", child)
    with pytest.raises(ConfigError, match=f"^/a/b.toml: {says}$"):
        asyncio.run(reread(Path("/a/b.toml")))


def test_a_child_that_takes_too_long_is_killed_and_waited_for(monkeypatch):
    made, real = [], asyncio.create_subprocess_exec

    async def kept(*words, **settings):
        made.append(await real(*words, **settings))
        return made[-1]

    monkeypatch.setattr(rereading.asyncio, "create_subprocess_exec", kept)
    monkeypatch.setattr(rereading, "CHILD", (*SMALL, "import time; time.sleep(4)"))
    monkeypatch.setattr(rereading, "PATIENCE_S", 0.2)
    with pytest.raises(ConfigError, match=r"^/a/b.toml: reading it came to no end in 0.2 s$"):
        asyncio.run(reread(Path("/a/b.toml")))
    assert [child.returncode for child in made] == [-9]
