"""Whatever is in a config, its model or its DBC: `check` tells it in one line, soon, and without filling the memory."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from bms_gateway.cli.main import main
from bms_gateway.config import load_config, read_bounds, text_file
from bms_gateway.config.read_bounds import bounded
from bms_gateway.errors import ConfigError
from tests.config.files import DBC, MAPPED, write
from tests.config.hostile import HOSTILE, SLOW, many_signals
from tests.config.model_texts import EXAMPLE

# A bound that strikes within a destructor or a callback of the garbage collector is lost there, and told all the same.
pytestmark = pytest.mark.filterwarnings(r"ignore:[\s\S]*_BeyondError:pytest.PytestUnraisableExceptionWarning")

ROOT = Path(__file__).resolve().parents[2]
LONGEST_LINE = 600
GIVEN_UP_S = 4.0
"""Processor time: the bound and what one call into C goes on for, on a slow machine; unbounded they take minutes."""
CHECK = """
import sys, time
from bms_gateway.cli.main import main
from tests.memory import peak_mib
print(main(["check", sys.argv[1]]), peak_mib(), time.process_time())
"""


def lay(folder: Path, files: tuple[str, str, str]) -> Path:
    path = write(folder, *files[:2])
    (folder / "vehicle.dbc").write_text(files[2])
    return path


@pytest.fixture(autouse=True)
def no_tables(tmp_path, monkeypatch):
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "tables"))


def one_line_of(capsys) -> str:
    told = capsys.readouterr().err
    assert told.count("\n") == 1, told
    assert len(told) < LONGEST_LINE
    return told


@pytest.mark.parametrize("name", HOSTILE)
def test_what_no_file_should_hold_is_told_in_one_line(name, tmp_path, capsys):
    files, says = HOSTILE[name]
    assert main(["check", str(lay(tmp_path, files))]) == 2
    assert re.search(says, one_line_of(capsys))


@pytest.mark.parametrize("name", SLOW)
def test_what_takes_too_long_or_too_much_is_given_up(name, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(read_bounds, "READ_S", 0.03)  # less than any of these takes on a quick machine
    monkeypatch.setattr(read_bounds, "LOOK_S", 0.005)  # a timer that comes later may miss a quick reading
    files, says = SLOW[name]
    path = lay(tmp_path, files)
    began = time.process_time()
    assert main(["check", str(path)]) == 2
    assert time.process_time() - began < GIVEN_UP_S
    assert re.search(says, one_line_of(capsys))


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SLOW, "20,000 signals"])
def test_a_whole_check_stays_within_eight_seconds_and_the_units_memory(name, tmp_path):
    files = (MAPPED, EXAMPLE, many_signals(19_980) + DBC[DBC.index("BO_ 256") :])
    files = SLOW[name][0] if name in SLOW else files
    words = [sys.executable, "-c", CHECK, str(lay(tmp_path, files))]
    done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, check=True)
    status, peak, taken_s = done.stdout.split()[-3:]
    assert status == ("2" if name in SLOW else "0"), done.stderr
    assert float(peak) < 200
    assert float(taken_s) < 8.0


@pytest.mark.parametrize(
    ("store", "says"),
    [
        ("s" * 300, "cannot be made: a name of 300 bytes; at most 255 are possible"),
        ("not there/" + "s" * 300 + "/state", "cannot be made: a name of 300 bytes"),
        ("a" * 5000, "cannot be made: a name of 5000 bytes"),
        ("ab/" * 1500, r"cannot be made: a path of 45\d\d bytes; at most 4032 are possible"),
        ("string_1.toml", "string_1.toml is no directory; name one"),
        ("string_1.toml/state", "string_1.toml is no directory; name one"),
        ("nowhere", "nowhere is no directory"),
        ("loop/state", "cannot be made: Too many levels of symbolic links"),
        ("/dev/null", "/dev/null is no directory"),
        ("/dev/zero/x", "/dev/zero is no directory"),
        ("/proc/state", "no disk keeps what lies in /proc"),
        ("to_proc/state", "no disk keeps what lies in /proc"),
        ("/dev/state", "no disk keeps what lies in /dev"),
    ],
)
@pytest.mark.parametrize("systemd", [False, True])
def test_a_store_that_nobody_can_make_is_not_sound(store, says, systemd, tmp_path, capsys, monkeypatch):
    """`check` noted it and called the config sound; or did not see that a folder to be made cannot be."""
    path = write(tmp_path, MAPPED.replace('path = "state"', "" if systemd else f'path = "{store}"'))
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / store) if systemd else "")
    (tmp_path / "nowhere").symlink_to(tmp_path / "gone")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "to_proc").symlink_to("/proc")
    before = sorted(tmp_path.iterdir())
    assert main(["check", str(path)]) == 2
    assert re.search(rf"gateway.toml: {'STATE_DIRECTORY' if systemd else 'store.path'}: .*{says}", one_line_of(capsys))
    assert [p for p in sorted(tmp_path.iterdir()) if p.name != "tables"] == before


def test_a_store_that_only_this_user_cannot_make_is_a_note(tmp_path, capsys, monkeypatch):
    path = write(tmp_path)
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert main(["check", str(path)]) == 0
    assert re.search("store.path: .* cannot be written by this user: the state would not be kept", one_line_of(capsys))


def test_a_file_that_never_ends_is_not_taken_in(capsys):
    assert main(["check", "/dev/zero"]) == 2
    assert "longer than 16 MiB" in one_line_of(capsys)


def test_a_pipe_into_which_nobody_writes_is_given_up(tmp_path, monkeypatch, capsys):
    """`check` waited for its end for ever."""
    monkeypatch.setattr(text_file, "READ_S", 0.5)
    os.mkfifo(tmp_path / "gateway.toml")
    assert main(["check", str(tmp_path / "gateway.toml")]) == 2
    assert "it came to no end in 0.5 s" in one_line_of(capsys)


def test_a_pipe_with_a_writer_is_read_to_its_end(tmp_path, capsys):
    """As of `check <(make_config)`: the writer may take a while, and more than one piece."""
    write(tmp_path, MAPPED)
    text = (tmp_path / "gateway.toml").read_bytes()
    (tmp_path / "gateway.toml").unlink()
    os.mkfifo(tmp_path / "gateway.toml")

    def give():
        with (tmp_path / "gateway.toml").open("wb", buffering=0) as f:
            f.write(text[:50])
            time.sleep(0.3)
            f.write(text[50:])

    writer = threading.Thread(target=give)
    writer.start()
    assert main(["check", str(tmp_path / "gateway.toml")]) == 0
    writer.join()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("host", ["a..b", "..", "x" * 64 + ".de"])
def test_a_broker_whose_name_no_resolver_takes_is_told_before_the_service_runs(tmp_path, capsys, host):
    assert main(["check", str(write(tmp_path, MAPPED + f'[mqtt]\nhost = "{host}"\n'))]) == 2
    assert "mqtt.host" in one_line_of(capsys)


def test_strings_of_too_many_cells_are_refused_before_the_service_takes_them(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("bms_gateway.config.load.ENGINE_S", 0.02)  # a fast machine takes some tenths of a second
    monkeypatch.setattr(read_bounds, "LOOK_S", 0.005)
    model = EXAMPLE.replace("cells = 5", "cells = 600")
    config = MAPPED.replace("transmit = true", "transmit = false")
    assert main(["check", str(write(tmp_path, config, model))]) == 2
    assert "making the estimators of its strings takes over" in one_line_of(capsys)


def test_the_bounds_name_the_file_that_was_read_and_leave_no_timer(monkeypatch):
    monkeypatch.setattr(read_bounds, "LOOK_S", 0.01)
    handler = signal.getsignal(signal.SIGPROF)
    with pytest.raises(ConfigError, match=r"^inner: reading it takes over 0\.05 s"):  # noqa: SIM117, PT012
        with bounded("outer", seconds=0.05):
            with bounded("inner"):
                while True:
                    pass
    assert signal.getitimer(signal.ITIMER_PROF) == (0.0, 0.0)
    # the default action would end the process at a signal that comes late
    assert signal.getsignal(signal.SIGPROF) == (signal.SIG_IGN if handler == signal.SIG_DFL else handler)
    with bounded("again", seconds=5.0):
        pass


class Late:
    """Its destructor takes as long as the bound does: the interpreter drops what is raised there."""

    def __del__(self):
        until = time.thread_time() + 0.5
        while time.thread_time() < until:
            pass


def test_a_bound_that_strikes_in_a_destructor_is_told_at_the_end(monkeypatch):
    monkeypatch.setattr(read_bounds, "LOOK_S", 0.01)
    late = [Late()]
    with pytest.raises(ConfigError, match=r"^a file: reading it takes over 0\.05 s"), bounded("a file", seconds=0.05):
        late.clear()


LATE = """
import os, signal
from bms_gateway.config.read_bounds import bounded
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPROF})
with bounded("a"):
    os.kill(os.getpid(), signal.SIGPROF)
signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGPROF})
os.kill(os.getpid(), signal.SIGPROF)  # queued only after the end
print("alive")
"""


def test_a_timer_that_another_thread_has_not_yet_heard_ends_no_process():
    """Threads wait for a processor: the signal came when its action was again to end the process, and did."""
    done = subprocess.run([sys.executable, "-c", LATE], capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stdout) == (0, "alive\n")


def test_the_bounds_count_memory_that_grows_within(monkeypatch):
    monkeypatch.setattr(read_bounds, "LOOK_S", 0.01)
    kept = []
    with pytest.raises(ConfigError, match=r"^a: reading it takes over 30 MiB"):  # noqa: SIM117, PT012
        with bounded("a", mib=30):
            while True:
                kept.append(bytearray(b"x" * 100_000))
    assert len(kept) < 3000


def test_no_parser_swallows_the_end_of_its_time(monkeypatch):
    """As a destructor would, which Python lets raise nothing: the bound comes again."""
    monkeypatch.setattr(read_bounds, "LOOK_S", 0.01)
    monkeypatch.setattr(read_bounds, "ONCE_MORE_S", 0.05)
    swallowed = []
    with pytest.raises(ConfigError, match="takes over"):  # noqa: SIM117, PT012
        with bounded("a", seconds=0.05):
            try:
                while True:
                    pass
            except BaseException as e:
                swallowed.append(e)
            while True:
                pass
    assert len(swallowed) == 1


def test_in_another_thread_files_are_read_without_bounds(tmp_path):
    found = []
    thread = threading.Thread(target=lambda: found.append(load_config(write(tmp_path))))
    thread.start()
    thread.join()
    assert found[0].plan.strings[0].name == "string_1"
