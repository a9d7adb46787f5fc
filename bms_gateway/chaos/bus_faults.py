"""Faults of an interface while the service runs on it."""

import asyncio
import errno
import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from bms_gateway.bus.canframe import ERR, to_wire
from bms_gateway.chaos.live import Fault, LiveBench
from bms_gateway.chaos.reaction import Counted, Reaction, Told
from bms_gateway.chaos.scenario import Scenario
from bms_gateway.frames.batch import FrameBatch

AWAY_S: Final = 3.0
RECOVERS_S: Final = 30.0
BUS_OFF, RESTARTED = 0x040, 0x100
FLOOD: Final = 4_000  # frames at once: half a second of a full 1 Mbit/s bus
STORM_S: Final = 3.0
GARBAGE: Final = (
    "",
    "x = " + "9" * 5_000,
    "x = " + "[" * 3_000 + "]" * 3_000,
    ".".join("k" * 200_000) + " = 1",
    '[bus]\nchannel = "\\u0000"\n',
)
NET: Final = Path("/sys/class/net")


@dataclass(frozen=True, slots=True)
class BusScenario:
    """A scenario in real time, and what is done.

    Attributes
    ----------
    scenario : Scenario
    fault : Fault
    small_buffer : bool
        Of the gateway's socket.
    load : int
        Frames of others beside those of the pack, 1/s.
    all_frames : bool
        Whether the gateway's port takes these, too, as it does where it needs their identifiers.
    """

    scenario: Scenario
    fault: Fault
    small_buffer: bool = False
    load: int = 0
    all_frames: bool = False


def bus_scenarios(channel: str | None) -> list[BusScenario]:
    """Make all scenarios of this room for an interface; None: a socket pair."""
    virtual = "" if channel is None or _is_virtual(channel) else "only on a virtual interface: error frames are made up"
    kernel = "needs an interface: --on vcan0" if channel is None else ""
    rights = kernel or ("" if os.geteuid() == 0 else "needs the right to switch interfaces: run it as root")
    removable = rights or virtual

    def one(
        name: str, fault: str, expected: tuple[Reaction, ...], do: Fault, unfit: str = "", *, small: bool = False
    ) -> BusScenario:
        return BusScenario(Scenario(name, "bus", fault, expected, 0.0, RECOVERS_S, unfit=unfit), do, small)

    return [
        one(
            "bus-off",
            f"the controller goes bus-off for {AWAY_S:g} s",
            (Counted.of("error_bus-off"), Counted.of("outages"), Told("bus", "bus-off"), Told("bus", "is back after")),
            _bus_off,
            virtual,
        ),
        one(
            "transmit-queue-full",
            f"no frame is taken for {AWAY_S:g} s (ENOBUFS)",
            (Counted.of("stale"),),
            _full_queue,
        ),
        one(
            "impostor",
            "somebody else sends a frame of the gateway",
            (Counted.of("impostors"), Told("impostor")),
            _impostor,
        ),
        one(
            "down-up",
            f"the interface is switched off for {AWAY_S:g} s",
            (Counted.of("outages"), Told("bus", "is down"), Told("bus", "is back after")),
            _down_up,
            rights,
        ),
        one(
            "removed",
            f"the interface is removed, and made again after {AWAY_S:g} s",
            (Counted.of("outages"), Told("bus", "is absent"), Told("bus", "is back after")),
            _removed,
            removable,
        ),
        one(
            "burst",
            f"{FLOOD} frames at once while the gateway is not served, receive buffer too small for them",
            (Counted.of("dropped"), Told("bus", "lost in the kernel")),
            _burst,
            kernel,
            small=True,
        ),
        one(
            "full-load",
            f"a bus as full as this machine can make it for {STORM_S:g} s",
            (),
            _storm,
        ),
        one(
            "config-garbage",
            f"{len(GARBAGE)} reloads (SIGHUP) of configurations that no parser should see",
            (Counted.of("reloads_refused"),),
            _garbage,
        ),
    ]


async def _garbage(bench: LiveBench) -> None:
    loop = asyncio.get_running_loop()
    with TemporaryDirectory(prefix="bms-gateway-chaos-") as folder:
        bench.config = Path(folder) / "gateway.toml"
        for refused, text in enumerate(GARBAGE):
            bench.config.write_text(text, encoding="utf-8")
            os.kill(os.getpid(), signal.SIGHUP)
            end = loop.time() + RECOVERS_S
            while bench.gateway.tally.reloads_refused <= refused and loop.time() < end:
                await asyncio.sleep(0.1)


def _is_virtual(channel: str) -> bool:
    return "virtual" in (NET / channel).resolve().parts


def _error(bits: int) -> bytes:
    return (ERR | bits).to_bytes(4, sys.byteorder) + bytes([8, 0, 0, 0]) + bytes(8)


async def _bus_off(bench: LiveBench) -> None:
    bench.hushed = True  # a controller that is off hears nothing
    bench.raw(_error(BUS_OFF))
    await asyncio.sleep(AWAY_S)
    bench.raw(_error(RESTARTED))
    bench.hushed = False


async def _full_queue(bench: LiveBench) -> None:
    bench.port.refuses = OSError(errno.ENOBUFS, "No buffer space available")
    await asyncio.sleep(AWAY_S)
    bench.port.refuses = None


async def _impostor(bench: LiveBench) -> None:
    for wire in to_wire(_frames(bench.own[:1] * 3)):
        bench.raw(wire)
    await asyncio.sleep(1.0)


async def _down_up(bench: LiveBench) -> None:
    await bench.ip(f"set {bench.channel} down")
    await asyncio.sleep(AWAY_S)
    await bench.ip(f"set {bench.channel} up")


async def _removed(bench: LiveBench) -> None:
    await bench.ip(f"del {bench.channel}")
    await asyncio.sleep(AWAY_S)
    await bench.ip(f"add {bench.channel} type vcan")
    await bench.ip(f"set {bench.channel} up")


async def _burst(bench: LiveBench) -> None:
    _flood(bench, bench.wanted, FLOOD)  # without a pause in which the gateway could read
    await asyncio.sleep(1.0)


async def _storm(bench: LiveBench) -> None:
    loop = asyncio.get_running_loop()
    end = loop.time() + STORM_S
    while loop.time() < end:
        _flood(bench, (0x7E5,), 80)  # a hundredth of a second of a full bus
        await asyncio.sleep(0.002)


def _flood(bench: LiveBench, ids: tuple[int, ...], count: int) -> None:
    chosen = tuple(ids[i % len(ids)] for i in range(count))
    bench.send_all(_frames(chosen))


def _frames(ids: tuple[int, ...]) -> FrameBatch:
    n = len(ids)
    return FrameBatch(
        np.zeros(n, np.int64), np.array(ids, np.uint32), np.full(n, 8, np.uint8), np.full((n, 8), 0x55, np.uint8)
    )
