"""Faults of an interface while the service runs on it."""

import asyncio
import errno
import os
import signal
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from bms_gateway.bus.canframe import ERR, to_wire
from bms_gateway.chaos.reaction import Counted, Reaction, Told, Uncounted
from bms_gateway.chaos.real_time import BusScenario, Fault, LiveBench
from bms_gateway.chaos.scenario import Scenario
from bms_gateway.config import shipped
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
MESSAGE: Final = """\
VERSION ""
BS_:
BU_: V
BO_ 256 Pack: 8 V
 SG_ A m0M : 0|8@1+ (1,0) [0|2] "" V
 SG_ B m0M : 8|8@1+ (1,0) [0|2] "" V
"""
BROKEN_DBC: Final = (
    'BA_DEF_ BO_ "E2EProfile" ENUM "None","AUTOSAR_P01_1A";\nBA_DEF_DEF_ "E2EProfile" "None";\n'
    'BA_ "E2EProfile" BO_ 256 1;\n',  # and no E2EDataID
    'BA_DEF_ BO_ "GenMsgCycleTime" FLOAT 0 65535;\nBA_DEF_DEF_ "GenMsgCycleTime" 0;\n'
    'BA_ "GenMsgCycleTime" BO_ 256 1e400;\n',
    "SG_MUL_VAL_ 256 A B 0-0;\nSG_MUL_VAL_ 256 B A 0-0;\n",  # each selected by the other
    "SG_MUL_VAL_ 256 A B 0-4294967296;\n",
)
WITH_DBC: Final = (
    '[bus]\nchannel = "vcan0"\ndbc = ["vehicle.dbc"]\n[[string]]\nname = "string_1"\nmodel = "string.toml"\n'
)
NET: Final = Path("/sys/class/net")


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
            f"{len(GARBAGE) + len(BROKEN_DBC) + 1} reloads (SIGHUP) of files that no parser should see",
            (Counted.of("garbage_refused"), Uncounted.of("garbage_unanswered")),
            _garbage,
        ),
    ]


async def _garbage(bench: LiveBench) -> None:
    with TemporaryDirectory(prefix="bms-gateway-chaos-") as name:
        folder = Path(name)
        bench.config = folder / "gateway.toml"
        for text in GARBAGE:
            bench.config.write_text(text, encoding="utf-8")
            await _refused(bench)
        (folder / "string.toml").write_bytes(shipped("deploy/example/string.toml").read_bytes())
        bench.config.write_text(WITH_DBC, encoding="utf-8")
        for text in BROKEN_DBC:
            (folder / "vehicle.dbc").write_text(MESSAGE + text, encoding="utf-8")
            await _refused(bench)
        bench.config.unlink()
        os.mkfifo(bench.config)
        await _refused(bench)


async def _refused(bench: LiveBench) -> None:
    """Make the service read its configuration again, and wait until it refuses the configuration."""
    loop, tally = asyncio.get_running_loop(), bench.gateway.tally
    before, end = tally.reloads_refused, loop.time() + RECOVERS_S
    os.kill(os.getpid(), signal.SIGHUP)
    while tally.reloads_refused == before and loop.time() < end:
        await asyncio.sleep(0.1)
    bench.count("garbage_refused" if tally.reloads_refused > before else "garbage_unanswered")


def _is_virtual(channel: str) -> bool:
    return "virtual" in (NET / channel).resolve().parts


def _error(bits: int) -> bytes:
    return (ERR | bits).to_bytes(4, sys.byteorder) + bytes([8, 0, 0, 0]) + bytes(8)


async def _bus_off(bench: LiveBench) -> None:
    bench.hushed = True  # a controller that is off receives nothing
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
    _flood(bench, bench.wanted, FLOOD)  # without a pause, so that the gateway cannot read in between
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
