"""Told to end, a service ends within its time, whatever of it hangs."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from bms_gateway.cli.run import END_MOST_S, INTERRUPT_MOST_S
from bms_gateway.service import live
from bms_gateway.service import signals as module
from bms_gateway.service.signals import LAST_WORD_S, Signals
from tests.support.live_service import PATIENCE_S

EXAMPLE = Path(__file__).resolve().parents[2] / "deploy" / "example"
MOST_S, INTERRUPT_S = 1.0, 0.5
HEAD = f"""
import asyncio, os, signal, threading, time
from bms_gateway.service.signals import Signals

signals = Signals({MOST_S}, {INTERRUPT_S})
stop, pipe = [], os.pipe()

def be_patient():
    signals._most_s = {PATIENCE_S}
    print("USR1", flush=True)

async def main(*, hang):
    loop = asyncio.get_running_loop()
    actions = {{signal.SIGTERM: lambda: stop.append(1), signal.SIGINT: lambda: stop.append(1)}}
    actions |= {{signal.SIGHUP: lambda: print("HUP", flush=True)}}
    signals.take(loop, actions | {{signal.SIGUSR1: be_patient}})
    print("up", flush=True)
    hang()
    while not stop:
        await asyncio.sleep(0.01)
"""
HANGS = {
    "loop in a system call": "asyncio.run(main(hang=lambda: os.read(pipe[0], 1)))",
    "loop in a bug": "\ndef spin():\n    while True:\n        pass\nasyncio.run(main(hang=spin))",
    "after the loop": "asyncio.run(main(hang=lambda: None)); os.read(pipe[0], 1)",
    "a thread that Python waits for": (
        "threading.Thread(target=os.read, args=(pipe[0], 1)).start(); asyncio.run(main(hang=lambda: None))"
    ),
}


def started(code):
    process = subprocess.Popen([sys.executable, "-c", HEAD + code], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout.readline() == b"up\n"
    return process


@pytest.mark.parametrize("hang", HANGS.values(), ids=HANGS)
@pytest.mark.parametrize(
    ("number", "most_s", "status"), [(signal.SIGTERM, MOST_S, 1), (signal.SIGINT, INTERRUPT_S, 130)]
)
def test_what_hangs_is_ended_after_its_time_and_says_so(hang, number, most_s, status):
    process, begun = started(hang), time.monotonic()
    process.send_signal(number)
    _, said = process.communicate(timeout=PATIENCE_S)
    assert most_s <= time.monotonic() - begun < PATIENCE_S
    assert process.returncode == status
    assert said == b"%g s after it was told to stop the service still hangs: it is killed\n" % most_s


def test_what_ends_in_time_is_left_alone_and_other_signals_are_no_end():
    process = started("asyncio.run(main(hang=lambda: None)); signals.close(); print('ended', flush=True)")
    process.send_signal(signal.SIGHUP)
    assert process.stdout.readline() == b"HUP\n"
    time.sleep(1.2 * MOST_S)
    process.send_signal(signal.SIGUSR1)  # a busy machine may take over a second for what ends in time
    assert process.stdout.readline() == b"USR1\n"
    process.send_signal(signal.SIGTERM)
    assert process.communicate(timeout=PATIENCE_S) == (b"ended\n", b"")
    assert process.returncode == 0


class Pipe:
    """Stands for a socket with signals in it: keeps for how long each read may wait."""

    def __init__(self, *signals):
        self._left = list(signals)
        self.waits = []

    def settimeout(self, wait_s):
        self.waits.append(wait_s)

    def recv(self, most):
        if not self._left:
            raise TimeoutError
        got, self._left = self._left[:most], self._left[most:]
        return bytes(got)


@pytest.mark.parametrize(("most_s", "waits"), [(100.0, (90.0, 100.0)), (0.0, (0.001, 0.001))])
def test_each_signal_is_heard_and_none_puts_the_end_off(monkeypatch, most_s, waits):
    heard, ended, signals = [], [], Signals(most_s)
    monkeypatch.setattr(module.End, "now", lambda end: ended.append((end.after_s, end.status)))

    class Loop:
        def call_soon_threadsafe(self, action):
            action()

    signals._actions = {n: lambda n=n: heard.append(n) for n in (signal.SIGHUP, signal.SIGTERM)}
    pipe = Pipe(signal.SIGHUP, signal.SIGTERM, signal.SIGHUP, signal.SIGINT, signal.SIGTERM)
    signals._loop = Loop()
    signals._listen(pipe)
    assert heard == [signal.SIGHUP, signal.SIGTERM, signal.SIGHUP, signal.SIGTERM]
    assert ended == [(most_s, 1)]
    assert pipe.waits[:2] == [None, None]
    assert len(pipe.waits) == 6
    assert all(waits[0] <= wait <= waits[1] for wait in pipe.waits[2:])
    assert pipe.waits[2:] == sorted(pipe.waits[2:], reverse=True)


def test_closed_it_leaves_all_as_it_was():
    import asyncio

    before = signal.getsignal(signal.SIGHUP)

    async def main():
        opened = set(os.listdir("/proc/self/fd"))
        signals, heard = Signals(), []
        signals.take(asyncio.get_running_loop(), {signal.SIGHUP: lambda: heard.append(1)})
        os.kill(os.getpid(), signal.SIGHUP)
        end = time.monotonic() + PATIENCE_S
        while not heard and time.monotonic() < end:
            await asyncio.sleep(0.01)
        signals.drop()
        os.kill(os.getpid(), signal.SIGHUP)
        await asyncio.sleep(0.2)
        signals.close()
        signals.close()  # once more does nothing
        assert set(os.listdir("/proc/self/fd")) == opened
        return heard

    assert asyncio.run(main()) == [1]
    assert signal.getsignal(signal.SIGHUP) is before
    assert signal.set_wakeup_fd(-1) == -1


STARTS = """
import signal, sys, time
from bms_gateway.cli import main, run
from bms_gateway.store import StateStore

def hang(store):  # as on a disk that does not answer: the main thread comes to no handler
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM, signal.SIGINT, signal.SIGURG])
    print("up", flush=True)
    time.sleep(600)

signal.signal(signal.SIGINT, signal.default_int_handler)  # a test run in the background would ignore it
run.END_MOST_S, run.INTERRUPT_MOST_S = MOST_S, INTERRUPT_S
StateStore.lock = hang
sys.exit(main.main(["run", sys.argv[1]]))
"""


@pytest.mark.parametrize(
    ("number", "most_s", "status"), [(signal.SIGTERM, MOST_S, 1), (signal.SIGINT, INTERRUPT_S, 130)]
)
def test_a_start_that_hangs_is_ended_after_its_time_too(tmp_path, number, most_s, status):
    """It waited for a disk that did not answer, and SIGTERM, which ends other programs there, was not heard."""
    for name in ("gateway.toml", "string.toml"):
        (tmp_path / name).write_text((EXAMPLE / name).read_text())
    config = tmp_path / "gateway.toml"
    config.write_text(config.read_text().replace("# [store]", f'[store]\npath = "{tmp_path / "state"}"\n#', 1))
    code = STARTS.replace("MOST_S, INTERRUPT_S\n", f"{MOST_S}, {INTERRUPT_S}\n")
    process = subprocess.Popen([sys.executable, "-c", code, config], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout.readline() == b"up\n", process.stderr.read()
    time.sleep(1.0)  # it has said so, and now it hangs
    begun = time.monotonic()
    process.send_signal(number)
    _, said = process.communicate(timeout=PATIENCE_S)
    assert most_s <= time.monotonic() - begun < PATIENCE_S
    assert process.returncode == status
    assert b"the service still hangs: it is killed" in said


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 128 + 15), (signal.SIGINT, 130)])
def test_a_start_that_waits_for_a_pipe_ends_at_once(tmp_path, number, status):
    os.mkfifo(tmp_path / "gateway.toml")
    code = STARTS.replace("StateStore.lock = hang", "print('up', flush=True)").replace(
        "MOST_S, INTERRUPT_S\n", "600, 600\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, tmp_path / "gateway.toml"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout.readline() == b"up\n", process.stderr.read()
    time.sleep(1.0)
    process.send_signal(number)
    process.communicate(timeout=PATIENCE_S)
    assert process.returncode in (status, -number)


class Ended(Exception):
    pass


def test_a_wait_of_the_start_is_ended_by_the_signal():
    def end(*_):
        raise Ended

    before, signals = signal.signal(signal.SIGTERM, end), Signals()
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGTERM))
    begun = time.monotonic()
    signals.listen()
    try:
        timer.start()
        with pytest.raises(Ended):
            time.sleep(PATIENCE_S)
    finally:
        signals.close()
        signal.signal(signal.SIGTERM, before)
    assert time.monotonic() - begun < PATIENCE_S
    timer.join()


def test_while_it_starts_a_program_is_as_it_was_before_but_for_the_signals_that_end_it():
    before = signal.getsignal(signal.SIGURG), signal.pthread_sigmask(signal.SIG_BLOCK, [])
    signals = Signals()
    signals.listen()
    try:
        assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == before[1] | module.ENDING
    finally:
        signals.close()
    assert (signal.getsignal(signal.SIGURG), signal.pthread_sigmask(signal.SIG_BLOCK, [])) == before
    assert signal.set_wakeup_fd(-1) == -1


def test_when_it_has_started_its_own_thread_hears_signals_again():
    import asyncio

    shut = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    signals = Signals()
    signals.listen()

    async def main():
        signals.take(asyncio.get_running_loop(), {signal.SIGHUP: lambda: None})
        assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == shut

    try:
        asyncio.run(main())
    finally:
        signals.close()
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == shut


def test_a_person_waits_a_second_and_systemd_five():
    assert live.HASTE * (live.SAVE_LAST_S + live.END_S) < 0.8  # and the interpreter takes its time to end
    assert live.SAVE_LAST_S + live.END_S < END_MOST_S < 5.0
    assert END_MOST_S + LAST_WORD_S < 5.0  # `TimeoutStopSec` of the unit
    assert INTERRUPT_MOST_S < END_MOST_S


@pytest.mark.parametrize(
    ("number", "lets_go", "status", "most_s"),
    [
        (signal.SIGTERM, "break", 0, PATIENCE_S),
        (signal.SIGINT, "break", 130, PATIENCE_S),
        (signal.SIGTERM, "pass", 1, PATIENCE_S),
        pytest.param(signal.SIGTERM, "pass", 1, 5.0, marks=pytest.mark.slow),
    ],
)
def test_a_service_whose_fit_and_disk_hang_ends_within_five_seconds(number, lets_go, status, most_s):
    """Where a busy machine takes longer it ends all the same: by itself it never would.

    Put together as `run` does: a fit that is stopped, a save that never returns, a part that does not let go or does.
    """
    code = """
import asyncio, os, socket, sys, threading
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.cli.run import END_MOST_S, INTERRUPT_MOST_S
from bms_gateway.service import live
from bms_gateway.service.fit_process import Aside
from bms_gateway.service.signals import Signals
from tests.service.engine import TickEngine
from tests.support.fit_jobs import EndedBy

live.SAVE_S = 0.1
pipe = os.pipe()
engine = TickEngine()
engine.queue.append(live.StartJob(0, 1, 10**18, EndedBy(19)))
fits, signals = Aside(), Signals(END_MOST_S, INTERRUPT_MOST_S)
ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
port = SocketCanPort.over(ours)
gateway = live.Gateway(
    engine, port, save=lambda _: os.read(pipe[0], 1), jobs=live.Jobs(fits.run, fits.close)
)

async def clings():
    while True:
        try:
            await asyncio.sleep(0.1)
            if fits.process and gateway.tally.saves_failed:
                print("up", fits.process, flush=True)
                await asyncio.sleep(100)
        except asyncio.CancelledError:
            LETS_GO

gateway.beside["clings"] = clings
try:
    gateway.serve(signals=signals)
except KeyboardInterrupt:
    sys.exit(130)
""".replace("LETS_GO", lets_go)
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": os.getcwd()}
    )
    word, fit = process.stdout.readline().split()
    assert word == b"up"
    begun = time.monotonic()
    process.send_signal(number)
    assert process.wait(PATIENCE_S) == status
    process.stdout.close()
    assert time.monotonic() - begun < most_s
    with pytest.raises(ProcessLookupError):
        os.kill(int(fit), 0)
