"""Faults of the service itself: no processor time, a fit that hangs, a disk that hangs or cannot be read."""

import asyncio
import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from bms_gateway.chaos.bus_faults import AWAY_S, RECOVERS_S
from bms_gateway.chaos.reaction import Counted, Reaction, Told, Uncounted
from bms_gateway.chaos.real_time import BusScenario, Fault, LiveBench
from bms_gateway.chaos.scenario import Scenario

STALL_S: Final = 8.0
STALL_RATE: Final = 300  # frames/s that the port receives meanwhile: more than one system call reads
TRIES: Final = 3
PATIENCE_S: Final = 30.0  # a child process starts in some tenths of a second, on a busy machine in some seconds


def service_scenarios(channel: str | None) -> list[BusScenario]:
    """Make all scenarios of this room for an interface; None: a socket pair."""
    kernel = "needs an interface: --on vcan0" if channel is None else ""

    def one(
        name: str, fault: str, expected: tuple[Reaction, ...], do: Fault, unfit: str = "", *, all_frames: bool = False
    ) -> BusScenario:
        scenario = Scenario(name, "service", fault, expected, 0.0, RECOVERS_S, unfit=unfit)
        return BusScenario(scenario, do, load=STALL_RATE if all_frames else 0, all_frames=all_frames)

    return [
        one(
            "stall",
            f"the service gets no processor time for {STALL_S:g} s, on a bus of which it takes every frame",
            (Uncounted.of("misdated", "dropped"),),
            _stall,
            kernel,
            all_frames=True,
        ),
        one(
            "fit-hangs",
            "the process of a fit is stopped",
            (Counted.of("jobs_failed"), Told("fit", "was killed"), Counted.of("saves")),
            _fit_hangs,
        ),
        one(
            "disk-hangs",
            f"the disk does not answer for {AWAY_S:g} s",
            (Counted.of("saves_failed"), Told("save", "has not answered")),
            _disk_hangs,
        ),
        one(
            "state-unreadable",
            "the newest state on disk cannot be read any more",
            (Counted.of("unread"), Counted.of("saves")),
            _state_unreadable,
        ),
    ]


@dataclass(frozen=True, slots=True)
class StoppedFit:
    """A job whose process stops itself, as a debugger or a frozen control group stops it."""

    def run(self) -> object:
        """Never end."""
        os.kill(os.getpid(), signal.SIGSTOP)
        return None


async def _stall(bench: LiveBench) -> None:
    end = time.monotonic() + STALL_S
    while time.monotonic() < end:
        bench.talk()
        time.sleep(0.01)  # the fault is that nothing else of this loop runs
    await asyncio.sleep(1.0)


async def _fit_hangs(bench: LiveBench) -> None:
    bench.start_fit(StoppedFit())
    tally = bench.gateway.tally
    await _come(lambda: tally.jobs_failed > 0)
    saves = tally.saves
    await _come(lambda: tally.saves > saves)


async def _disk_hangs(bench: LiveBench) -> None:
    bench.disk.clear()
    await asyncio.sleep(AWAY_S)
    bench.disk.set()


async def _state_unreadable(bench: LiveBench) -> None:
    await _come(lambda: (bench.folder / "state").is_file())
    spoilt, gateway = bench.folder / "spoilt", bench.gateway
    for _ in range(TRIES):
        spoilt.symlink_to("state")  # the name becomes a link to itself, which nobody can read, not even root
        spoilt.replace(bench.folder / "state")
        saves = gateway.tally.saves
        await _come(lambda: bool(gateway.unread()) or gateway.tally.saves >= saves + 2)  # noqa: B023 (used at once)
        if gateway.unread():
            return  # otherwise the link came in the very moment of a save, which replaced it: try again


async def _come(true: Callable[[], bool]) -> None:
    """Wait until a condition holds; if it never does, the missing reaction shows this in the outcome."""
    end = time.monotonic() + PATIENCE_S
    while not true() and time.monotonic() < end:
        await asyncio.sleep(0.05)
