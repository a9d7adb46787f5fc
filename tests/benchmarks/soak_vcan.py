"""Real minutes at full load on a real vcan0, the service a process of its own, with a fault every 30 s.

What breaks is chosen from the catalogue of `bms_gateway.chaos`, and some of our own, for a service that is a process of
its own: it gets no processor time (SIGSTOP), so long that the kernel drops frames and for so short that it does not,
the process of a fit is stopped, a reload finds garbage, and at the very end it is killed and started again. Whether the
gateway reacted is read off its frames on the bus and its metrics, the truth is the simulated pack's. Left out is what
takes longer than a slot, what fills the bus to more than it carries, what puts seventeen frames of one counter in any
order, and the full transmit queue, which vcan does not have.

The minutes asked for come after those in which windows of twenty minutes fill and are fitted for the first time; load
and faults are the same then. Three things must hold: memory is flat afterwards; the kernel drops nothing but where the
fault is that it drops; after each fault every string, quality and state is as before within `RECOVERS_S`, and no core
is ever sent outside its band. Whether a core is proven is told by a window of twenty minutes, not by the fault of the
moment, and a vehicle without processor time sends its frames late, which no model explains: seconds in which strings
are doubtful are counted apart.
"""

import asyncio
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path

import numpy as np

from bms_gateway.bus.access import Access
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.chaos.bus_faults import bus_scenarios
from bms_gateway.chaos.catalogue import Chaos
from bms_gateway.chaos.observed_run import Bystander, Record
from bms_gateway.chaos.reaction import Counted, Reaction, Told, Uncounted
from bms_gateway.chaos.real_time import Vehicle
from bms_gateway.chaos.scenario import STEADY, Injection, Outcome, Scenario, is_sound, judge
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Engine
from bms_gateway.frames.quality import Quality
from tests.benchmarks.soak_vehicle import NOTHING, FullBus

CHANNEL = "vcan0"
LISTEN = "127.0.0.1:9105"
CYCLE_S, LASTS_S, RECOVERS_S = 30.0, 8.0, 15.0
WARM_S, PATIENCE_S = 60.0, 120.0
STALL_S = 1.5  # two thirds of what the receive buffer holds of a full bus
FIT_COMES_S = 600.0  # a fit of one of the strings begins sooner than that
FIT_ENDS_S = 120.0  # one that hangs is killed after a minute
STOPPED_FRAMES = 40_000  # twice what the receive buffer holds: five seconds of a full bus
MOST_LATE_S = 1.0
GROWTH_MIB = 8.0  # of a process in which nothing piles up: the allocator's scatter
SCENARIOS = (
    *("bus-off", "crc", "thermocouple-open", "down-up", "wrong-dlc", "inlet-missing", "removed", "unknown-multiplexer"),
    *("thermocouple-short", "impostor", "current-end-of-range", "clock-forward", "counter", "clock-back"),
)
HOUR_NS = 3600 * 10**9
CLOCKS = {"clock-forward": HOUR_NS, "clock-back": -HOUR_NS}
LINE = re.compile(r'^(?:bms_gateway_)?(\w+?)(?:\{\w+="([^"]*)".*\})? (\S+)$')
NAMES = {
    "samples_rejected_total": "{}",
    "bus_errors_total": "error_{}",
    "notices_total": "told {}",
    "frames_lost_total": "dropped",
    "bus_outages_total": "outages",
    "impostors_total": "impostors",
    "clock_steps_total": "clock_steps",
    "frames_received_total": "received",
    "process_cpu_seconds_total": "cpu_s",
    "jobs_total": "fits",
    "jobs_late_total": "late",
    "jobs_failed_total": "jobs_failed",
    "reloads_total": "reload {}",
    "frames_misdated_total": "misdated",
}
"""What scenarios call a metric."""


@dataclass
class Slot:
    """What one fault did."""

    outcome: Outcome
    at_s: float
    dropped: int
    missing: int
    paused_s: float
    """By which the vehicle was late: this machine had no time for it, and perhaps none for the gateway."""
    rss_MiB: float
    changes: list[str]
    """Cells whose quality differed from that before the fault, by second."""

    def row(self) -> dict[str, object]:
        o = self.outcome
        return {
            "at_s": round(self.at_s, 1),
            "fault": o.scenario.name,
            "expected": [r.text for r in o.scenario.expected],
            "reacted_s": o.reacted_s,
            "recovered_s": o.recovered_s,
            "in_band": o.in_band,
            "holds": o.holds,
            "dropped": self.dropped,
            "missing": self.missing,
            "paused_s": round(self.paused_s, 2),
            "rss_MiB": round(self.rss_MiB, 1),
            "changes": [] if o.holds else self.changes,
        }


class Service:
    """`bms-gateway run` on a config, and what can be seen of it from outside."""

    def __init__(self, config: Path, page: str, log: Path) -> None:
        self.config, self._page, self._log = config, page, log
        self.counts: dict[str, float] = {}

    def start(self) -> None:
        with self._log.open("a") as log:
            words = [sys.executable, "-m", "bms_gateway", "run", str(self.config)]
            self.process = subprocess.Popen(words, stdout=log, stderr=log)

    async def up(self) -> None:
        end = time.monotonic() + PATIENCE_S
        while not await self.look():
            if self.process.poll() is not None or time.monotonic() > end:
                raise SystemExit(f"the service did not start:\n{self._log.read_text()}")
            await asyncio.sleep(0.2)

    async def look(self) -> bool:
        """Read the metrics; False: none came, and the counts are those of before."""
        try:
            text = await asyncio.to_thread(lambda: urllib.request.urlopen(self._page, timeout=1.0).read().decode())
        except OSError:
            return False
        counts = {}
        for found in map(LINE.match, text.splitlines()):
            if found and found[1] in NAMES:
                counts[NAMES[found[1]].format(found[2])] = float(found[3])
        self.counts = counts
        return True

    def rss_MiB(self) -> float:
        return int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 2**20

    def children(self) -> list[int]:
        """Processes that it has started and that are not gone."""
        files = Path(f"/proc/{self.process.pid}/task").glob("*/children")  # each of the thread that started it
        return [int(pid) for file in files for pid in file.read_text().split()]

    def stop(self) -> None:
        self.process.terminate()
        self.process.wait(PATIENCE_S)


@dataclass
class Hands:
    """What the faults of `chaos.bus_faults` lay hands on, here in another process."""

    bus: FullBus
    own: tuple[int, ...]
    raw: Callable[[bytes], None]
    channel: str = CHANNEL

    @property
    def hushed(self) -> bool:
        return self.bus.told.hushed

    @hushed.setter
    def hushed(self, on: bool) -> None:
        self.bus.told.hushed = on

    async def ip(self, words: str) -> None:
        process = await asyncio.create_subprocess_exec("ip", "link", *words.split())
        assert await process.wait() == 0, words


class Run:
    """One soak."""

    def __init__(self, folder: Path, minutes: float, settle: float, rate: float) -> None:
        config = prepared(folder)
        self.service = Service(config, f"http://{LISTEN}/metrics", folder / "log")
        loaded = load_config(config)
        chaos = Chaos(loaded.plan, loaded.database, CHANNEL)
        self.scenarios = {name: adapted(chaos.scenarios[name]) for name in SCENARIOS}
        unfit = {name: s.unfit for name, s in self.scenarios.items() if s.unfit}
        assert not unfit, unfit
        self.faults = {s.scenario.name: s.fault for s in bus_scenarios(CHANNEL)}
        self.injections = [s.injection for s in self.scenarios.values()]
        self.minutes, self.settle = minutes, settle
        seconds = round(60 * (settle + minutes) + 2 * WARM_S + 4 * CYCLE_S + PATIENCE_S + FIT_COMES_S + FIT_ENDS_S)
        self.bus = FullBus(loaded.plan, loaded.database, rate, seconds, self.injections, CHANNEL)
        own = Engine(loaded.plan, loaded.database).sends
        self.hands = Hands(self.bus, tuple(own), Vehicle(CHANNEL).raw)
        self.ears = SocketCanPort(CHANNEL, Access(own))
        self.bystander = Bystander(loaded.plan, loaded.database)
        sensed = [k in s.model.sensors for s in loaded.plan.strings for k in range(1, s.model.cells + 1)]
        self.proven = np.where(sensed, Quality.GOOD, Quality.ESTIMATED).astype(np.uint8)
        self.doubtful: list[int] = []  # cells in each second
        self.record = Record(np.inf, np.inf)
        self.rss: list[tuple[float, float]] = []
        self.rates: list[float] = []
        self.slots: list[Slot] = []

    async def go(self) -> int:
        """Run it all; status."""
        service = self.service
        service.start()
        try:
            await service.up()
            await asyncio.sleep(5.0)
            rest = service.rss_MiB()
            print(f"at rest: {rest:.1f} MiB", flush=True)
            self.bus.start()
            return await self._drive(rest)
        finally:
            self.bus.stop()
            service.stop()

    async def _drive(self, rest: float) -> int:
        await self._until(WARM_S)
        real_s = time.monotonic()
        at_begin = dict(self.service.counts), self.bus.told.sent
        end, settled_s = real_s + 60.0 * (self.settle + self.minutes), None
        for name in cycle((*SCENARIOS, *(name for name in OURS if name != "killed"))):
            await self._slot(name, self.bus.now_s + CYCLE_S)
            if settled_s is None and time.monotonic() > real_s + 60.0 * self.settle:
                settled_s = self.bus.now_s
            if time.monotonic() > end:
                break
        took = time.monotonic() - real_s
        received = self.service.counts["received"] - at_begin[0]["received"]
        cpu = self.service.counts["cpu_s"] - at_begin[0]["cpu_s"]
        fits = {name: self.service.counts[name] for name in ("fits", "late")}
        sent = self.bus.told.sent - at_begin[1]
        memory = [r for t, r in self.rss if t >= (settled_s or 0.0)]
        await self._slot("killed", self.bus.now_s + CYCLE_S)
        growth = max(memory) - memory[0]
        injected = {s.outcome.scenario.name: s.dropped for s in self.slots if s.dropped}
        failed = [s.outcome.scenario.name for s in self.slots if not s.outcome.holds]
        stray = {name: n for name, n in injected.items() if name != "unserved"}
        result = {
            "minutes": took / 60.0,
            "of_which_settling": self.settle,
            "frames_sent": sent,
            "frames_received": received,
            "sent_per_s": sent / took,
            "sent_per_s_in_5_50_95_percent_of_seconds": np.percentile(self.rates, [5, 50, 95]).tolist(),
            "gateway_us_per_frame": 1e6 * cpu / received,
            "pauses_of_the_vehicle": self.bus.told.pauses,
            "paused_s": self.bus.told.paused_s,
            "rss_MiB": {"rest": rest, "settled": memory[0], "max": max(memory), "end": memory[-1]},
            "rss_MiB_by_minute": [round(r, 1) for _, r in self.rss[::60]],
            "growth_MiB": growth,
            "dropped": injected,
            "share_of_cells_doubtful": float(np.mean(self.doubtful)) / len(self.proven),
            **fits,
            "tried": len(self.slots),
            "failed": failed,
        }
        print(json.dumps(result, indent=1))
        ok = not failed and not stray and growth <= GROWTH_MIB
        print(
            f"{len(self.slots)} faults tried, {len(self.slots) - len(failed)} survived; "
            f"memory grew by {growth:.1f} MiB once settled; dropped beside the injected: {stray or 'nothing'}"
        )
        self.result = result | {"holds": ok, "faults": [s.row() for s in self.slots]}
        return 0 if ok else 1

    async def _slot(self, name: str, end_s: float) -> None:
        record = self.record = Record(np.inf, np.inf)
        at = self.bus.now_s
        await self._steady()
        before, sent, paused_s = dict(self.service.counts), self.bus.told.sent, self.bus.told.paused_s
        record.start_s = self.bus.now_s
        doing = asyncio.ensure_future(self._break(name))
        while not doing.done():
            await self._until(self.bus.now_s + 1.0, doing)
        await doing
        record.end_s = self.bus.now_s
        scenario = OURS[name] if name in OURS else self.scenarios[name]
        sound = 0
        while sound < STEADY and self.bus.now_s < record.end_s + scenario.recovers_s + STEADY + 1.0:
            await self._until(self.bus.now_s + 1.0)
            sound = sound + 1 if is_sound(record.seen[-1], record.before()) else 0
        while self.bus.now_s < end_s - 1.0:
            await self._until(self.bus.now_s + 1.0)
        counts = self.service.counts
        dropped = round(counts["dropped"] - before["dropped"]) if name != "killed" else 0
        missing = self.bus.told.sent - sent - round(counts["received"] - before["received"]) - dropped
        outcome, paused_s = judge(scenario, record), self.bus.told.paused_s - paused_s
        rss = max(r for t, r in self.rss if t >= at)
        missing = missing if name != "killed" else 0
        self.slots.append(Slot(outcome, record.start_s, dropped, missing, paused_s, rss, changes(record)))
        print(
            f"{record.start_s:7.0f} s {name:20} {'held' if outcome.holds else 'FAILED':6} {outcome.seen}; "
            f"recovered {outcome.recovered_s if outcome.recovered_s is None else round(outcome.recovered_s, 1)} s; "
            f"dropped {dropped}, otherwise not received {missing}; "
            f"vehicle paused {paused_s:.1f} s; {rss:.1f} MiB",
            flush=True,
        )
        if not outcome.holds:
            print("\n".join(self.slots[-1].changes), flush=True)

    async def _break(self, name: str) -> None:
        pid = self.service.process.pid
        if name == "unserved":
            os.kill(pid, signal.SIGSTOP)
            full, end_s = self.bus.told.sent + STOPPED_FRAMES, self.bus.now_s + CYCLE_S
            while self.bus.told.sent < full and self.bus.now_s < end_s:  # a starved vehicle fills it later
                await asyncio.sleep(0.1)
            os.kill(pid, signal.SIGCONT)
        elif name == "stalled":
            os.kill(pid, signal.SIGSTOP)
            await asyncio.sleep(STALL_S)
            os.kill(pid, signal.SIGCONT)
        elif name == "fit-stopped":
            await self._stop_a_fit()
        elif name == "garbage":
            sound, before = self.service.config.read_text(), self.service.counts["reload refused"]
            self.service.config.write_text("[[string]\n" + "x = [" * 3000)
            os.kill(pid, signal.SIGHUP)
            await self._counted("reload refused", before, PATIENCE_S)
            self.service.config.write_text(sound)
        elif name == "killed":
            self.service.process.kill()
            self.service.process.wait()
            self.service.start()
            await self.service.up()
        elif name in CLOCKS:
            time.clock_settime_ns(time.CLOCK_REALTIME, time.time_ns() + CLOCKS[name])
            await asyncio.sleep(LASTS_S)
        elif name in self.faults:
            await self.faults[name](self.hands)
        else:
            self.bus.told.fault = list(self.scenarios).index(name)
            await asyncio.sleep(LASTS_S)
            self.bus.told.fault = NOTHING

    async def _stop_a_fit(self) -> None:
        """Stop the next one; where none comes, or none is given up, what is expected is not counted."""
        before, end = self.service.counts["jobs_failed"], time.monotonic() + FIT_COMES_S
        while time.monotonic() < end:
            if children := self.service.children():
                with suppress(ProcessLookupError):  # it has just ended
                    os.kill(children[0], signal.SIGSTOP)
                    await self._counted("jobs_failed", before, FIT_ENDS_S)
                    return
            await asyncio.sleep(0.01)

    async def _counted(self, name: str, before: float, most_s: float) -> None:
        """Wait until a counter has gone up, which is read once a second."""
        end = time.monotonic() + most_s
        while self.service.counts[name] <= before and time.monotonic() < end:
            await asyncio.sleep(0.1)

    @property
    def heard(self) -> bool:
        """Whether all that the gateway sends in a second has come."""
        return self.bystander.known and self.bystander.state is not None

    async def _steady(self) -> None:
        """Until three seconds look alike, and every core is known."""
        end = self.bus.now_s + PATIENCE_S
        while True:
            await self._until(self.bus.now_s + 1.0)
            last = self.record.seen[-3:]
            if len(last) == 3 and np.isfinite(last[-1].sd).all() and all(is_sound(s, last[0]) for s in last):
                return
            if self.bus.now_s > end:
                s = last[-1]
                raise SystemExit(f"not steady: state {s.state}, in band {s.in_band}, quality {s.quality}, sd {s.sd}")

    async def _until(self, end_s: float, doing: Awaitable[None] | None = None) -> None:
        """Listen to the gateway for a second, or until the fault is over; then sum up.

        A machine without time for the gateway may delay a tick: the second then lasts until every core was heard.
        """
        from_s, sent = time.monotonic(), self.bus.told.sent
        while (late := self.bus.now_s - end_s) < MOST_LATE_S:
            if (late >= 0 or (doing is not None and doing.done())) and self.heard:
                break
            self.ears.pump()
            self.bystander.take(self.ears.drain())
            await asyncio.sleep(0.02)
        await self.service.look()
        now = self.bus.now_s
        truth = self.bus.truth[int(now)]
        seen = self.bystander.close_second(now, truth, {k: int(v) for k, v in self.service.counts.items()})
        doubtful = seen.quality == Quality.DOUBTFUL
        self.doubtful.append(int(doubtful.sum()))
        self.record.seen.append(replace(seen, quality=np.where(doubtful, self.proven, seen.quality)))
        if self.service.process.poll() is None:
            self.rss.append((now, self.service.rss_MiB()))
        if doing is None and now > WARM_S:
            self.rates.append((self.bus.told.sent - sent) / (time.monotonic() - from_s))


OURS = {
    "unserved": Scenario(
        "unserved",
        "bus",
        f"no processor time for {STOPPED_FRAMES} frames of others",
        (Counted.of("dropped"),),
        0.0,
        RECOVERS_S,
    ),
    "stalled": Scenario(
        "stalled",
        "service",
        f"no processor time for {STALL_S:g} s of a full bus",
        (Uncounted.of("dropped", "misdated"),),
        0.0,
        RECOVERS_S,
    ),
    "fit-stopped": Scenario(
        "fit-stopped",
        "service",
        "the process of a fit is stopped",
        (Counted.of("jobs_failed"),),
        0.0,
        RECOVERS_S,
    ),
    "garbage": Scenario(
        "garbage",
        "service",
        "a reload of what no parser should see",
        (Counted.of("reload refused"),),
        0.0,
        RECOVERS_S,
    ),
    "killed": Scenario("killed", "bus", "killed (-9), started again", (), 0.0, RECOVERS_S),
}


def adapted(scenario: Scenario) -> Scenario:
    """The scenario with reactions that a metric shows: lines for people are throttled, their counters are not."""
    expected: list[Reaction] = []
    for r in scenario.expected:
        if not isinstance(r, Told):
            expected.append(r)
        elif r.code not in ("bus", "impostor"):  # those lines are the port's; what it counts is expected beside them
            expected.append(Counted.of(f"told {r.code}"))
    injection = scenario.injection if scenario.kind != "time" else Injection()
    return replace(scenario, expected=tuple(expected), injection=injection, recovers_s=RECOVERS_S)


def changes(record: Record) -> list[str]:
    """What was not as before, by second."""
    before, found = record.before(), []
    for s in record.since():
        cells = np.flatnonzero(s.quality != before.quality)
        what = [f"{k}: {Quality(before.quality[k]).name} {Quality(s.quality[k]).name}" for k in cells[:4].tolist()]
        if len(cells) or s.state != before.state or not s.in_band:
            found.append(f"{s.time_s:.1f} s: state {s.state}, in band {s.in_band}, {len(cells)} cells: {what}")
    return found


def prepared(folder: Path) -> Path:
    """The example config, with a state directory and metrics."""
    text = shipped("deploy/example/gateway.toml").read_text(encoding="utf-8")
    ours = f'[store]\npath = "{folder / "state"}"\n\n[metrics]\nlisten = "{LISTEN}"\n\n[[string]]'
    text = text.replace("[[string]]", ours, 1)
    (folder / "gateway.toml").write_text(text, encoding="utf-8")
    (folder / "string.toml").write_text(shipped("deploy/example/string.toml").read_text(encoding="utf-8"))
    return folder / "gateway.toml"


def vcan(minutes: float, settle: float, rate: float, json_file: Path | None) -> int:
    """Run it; status 1 where something does not hold."""
    if os.environ.get("CANVM") != "1":
        raise SystemExit("soak vcan sets the system's clock and removes vcan0: only in the guest of tests/canvm/canvm")
    with tempfile.TemporaryDirectory() as name:
        run = Run(Path(name), minutes, settle, rate)
        try:
            status = asyncio.run(run.go())
        finally:
            print("".join(f"| {line}\n" for line in (Path(name) / "log").read_text().splitlines()[-60:]))
        if json_file:
            json_file.write_text(json.dumps(run.result, indent=1))
    return status
