"""How late our frames are, and what is lost: the whole gateway on a full bus, with and without a fit beside it.

``python -m tests.benchmarks.bench_latency [--json FILE] [--seconds S]``, on vcan0 where there is one (as under
``tests/canvm/canvm``), else above a socket pair. The example pack (60 cells) among others' frames, 8,500 a second. A
listener in a process of its own writes down when the kernel put each frame of ours on the bus. Latency is counted
from the tick's deadline, which is before the frame that closes the tick by at most the gap between two frames; of the
tick's frames the first tells how fast we are, the last how they are spread on purpose (1,000 a second).

* quiet: nothing else to do.
* fitting: identification windows of the pack are fitted all the time, as the service does it: in a child process.
* in a thread: the same fits in a thread of the gateway's own process.
* peer: python-can's Notifier and cantools; it decodes the pack's frames, and sends one when the first frame stamped
  after a deadline comes. It estimates nothing. Also with the fits in a thread beside it.

On vcan0 also bursts of 2,000 frames back to back, with the receive buffer that the system grants by default and with
the one that is asked for: how many were lost, ours and python-can's.
"""

import argparse
import asyncio
import json
import os
import statistics
import tempfile
import threading
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from bms_gateway.bus.access import Access
from tests.benchmarks.bench_files import simulate
from tests.benchmarks.bench_live import RATE, database, engine, write_traffic
from tests.benchmarks.live_place import Place, channel, cpu, long_queues, our_port, python_can
from tests.memory import peak_mib

SECONDS = 60.0
SECOND = 1_000_000_000
WINDOW_S = 1_260  # a window is full after twenty minutes
BURST, BURSTS, BURST_GAP_S = 2_000, 10, 0.5
KINDS = ("quiet", "fitting", "in a thread", "peer quiet", "peer fitting")
DEFAULT_BUFFER = 212_992  # net.core.rmem_max as kernels have it


def window_jobs(folder):
    """Fits of the example pack's first full windows."""
    from bms_gateway.bus.logfile import read_log
    from bms_gateway.engine import StartJob

    log = folder / "window.log"
    simulate(log, WINDOW_S)
    estimator, jobs = engine(), []
    for batch in read_log(log):
        estimator.receive(batch, now_ns=int(batch.time_ns.max()))
        while (event := estimator.next_output()) is not None:
            if isinstance(event, StartJob):
                jobs.append(event.job)
    assert jobs
    return jobs


class Busy:
    """The engine, with one fit after the other handed out beside what it says itself."""

    def __init__(self, inner, jobs):
        self.dropped = 0
        self._inner, self._jobs = inner, jobs
        self._running = False
        self.fits = 0

    def __getattr__(self, name):
        return getattr(self._inner, name)

    def next_output(self):
        from bms_gateway.engine import StartJob

        if self._jobs and not self._running and (now := self._inner.next_deadline()) is not None:
            self._running = True
            return StartJob(now, 1_000_000 + self.fits, now + 30 * SECOND, self._jobs[self.fits % len(self._jobs)])
        return self._inner.next_output()

    def finish(self, job_id, result):
        self.fits += 1
        self._running = False


async def gateway(place, seconds, jobs, *, in_thread=False):
    """The service's own loop; gives fits done, frames lost and CPU time."""
    from bms_gateway.service.fit_process import Aside
    from bms_gateway.service.fits import run_here
    from bms_gateway.service.live import Gateway, Jobs

    busy = Busy(engine(), jobs)
    port = our_port(place, Access(busy.can_ids.tolist(), own=busy.sends))
    port.drain()
    start = cpu()
    await Gateway(busy, port, jobs=Jobs(run_here if in_thread else Aside().run)).run(seconds=seconds)
    used = cpu() - start
    port.close()
    return {"fits": busy.fits, "dropped": port.counters.dropped, "cpu_pct": 100 * used / seconds}


async def peer(place, seconds, jobs):
    """python-can's Notifier, cantools, one frame a second; the fits in a thread."""
    import can

    db, estimator = database(), engine()
    own = min(estimator.sends)
    bus = python_can(place, sorted(set(estimator.can_ids.tolist())))
    known = {m.frame_id: m for m in db.messages}
    second, fits, end = 0, 0, threading.Event()

    def fit():
        nonlocal fits
        while not end.is_set():
            jobs[fits % len(jobs)].run()
            fits += 1

    def listen(message):
        nonlocal second
        found = known.get(message.arbitration_id)
        if found is None:
            return  # its socket is bound before its filters are set: some others come in between
        found.decode(message.data, decode_choices=False)
        if int(message.timestamp) != second:
            second = int(message.timestamp)
            bus.send(can.Message(arbitration_id=own, data=bytes(8), is_extended_id=False))

    thread = threading.Thread(target=fit)
    if jobs:
        thread.start()
    listening = can.Notifier(bus, [listen], loop=asyncio.get_running_loop())
    await asyncio.sleep(seconds)
    end.set()
    if jobs:
        thread.join()
    listening.stop()
    bus.shutdown()
    return {"fits": fits}


def latencies(heard):
    """First and last frame of each whole second, ms after it began; the first second is that of the start."""
    by_tick = {}
    for stamp, _ in heard:
        by_tick.setdefault(stamp // SECOND, []).append(stamp % SECOND / 1e6)
    ticks = sorted(by_tick)[2:-1]
    return {"first_ms": [min(by_tick[t]) for t in ticks], "last_ms": [max(by_tick[t]) for t in ticks]}


def quantile(values, share):
    """The value that a share of them does not exceed."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def measured(frames, run, seconds, jobs, own):
    """One kind of service for some seconds."""
    place = Place(frames, RATE, hear=own)
    told = asyncio.run(run(place, seconds, jobs))
    return {**told, **latencies(place.stop())}


async def bursts(place, receive_buffer):
    """What our port loses of bursts while it is drained as the service does it."""
    port = our_port(place, receive_buffer=receive_buffer)
    port.drain()
    before = port.counters.received
    for _ in range(round(BURSTS * BURST_GAP_S / port.gather_s)):
        await asyncio.sleep(port.gather_s)
        port.drain()
    port.close()
    return {"received": port.counters.received - before, "lost": port.counters.dropped}


async def peer_bursts(place):
    """What python-can's Notifier does not see of as many frames; its socket has no counter of losses."""
    import can

    bus = python_can(place)
    count = 0

    def listen(message):
        nonlocal count
        count += 1

    listening = can.Notifier(bus, [listen], loop=asyncio.get_running_loop())
    await asyncio.sleep(BURSTS * BURST_GAP_S)
    listening.stop()
    bus.shutdown()
    return {"received": count}


def measure_bursts(frames):
    """Bursts on vcan0; the sender goes on beyond what is counted, so that equal times are compared."""
    from bms_gateway.bus.socketcan import RECEIVE_BUFFER

    kinds = {
        "default buffer": lambda p: bursts(p, DEFAULT_BUFFER),
        "buffer as asked": lambda p: bursts(p, RECEIVE_BUFFER),
        "Notifier": peer_bursts,
    }
    found = {}
    for name, run in kinds.items():
        place = Place(frames, BURST / BURST_GAP_S, burst=BURST)
        found[name] = asyncio.run(run(place))
        place.stop()
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of each measurement")
    args = parser.parse_args()
    where = channel() or "socketpair"
    result = {"place": where, "seconds": args.seconds}
    with long_queues(), tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        kinds = write_traffic(folder)
        jobs = window_jobs(folder)
        own = list(engine().sends)
        for title, run, work in (
            ("quiet", gateway, []),
            ("fitting", gateway, jobs),
            ("in a thread", lambda *given: gateway(*given, in_thread=True), jobs),
            ("peer quiet", peer, []),
            ("peer fitting", peer, jobs),
        ):
            result[title] = measured(kinds["crowded"], run, args.seconds, work, own)
        if channel():
            result["bursts"] = measure_bursts(kinds["messages"])
    result["peak_mib"] = peak_mib()
    show(result)
    if args.json:
        args.json.write_text(json.dumps(result))


def show(result):
    """Print the tables."""
    print(f"on {result['place']}, {RATE} frames/s, {result['seconds']:.0f} s each; ms after the deadline")
    print(f"{'':14}{'first: p50':>12}{'p99':>9}{'max':>9}{'last: p50':>12}{'max':>9}{'ticks':>7}{'fits':>6}")
    for title in KINDS:
        first, last = result[title]["first_ms"], result[title]["last_ms"]
        figures = (statistics.median(first), quantile(first, 0.99), max(first))
        text = "".join(f"{x:{w}.2f}" for x, w in zip(figures, (12, 9, 9), strict=True))
        print(f"{title:14}{text}{statistics.median(last):12.1f}{max(last):9.1f}{len(first):7}{result[title]['fits']:6}")
    print(f"most that the windows' fits add to the first frame: {max(added(result)):.2f} ms")
    for title in KINDS[:3]:
        print(f"{title}: {result[title]['cpu_pct']:.2f} % of a core, {result[title]['dropped']} frames lost")
    for name, told in result.get("bursts", {}).items():
        print(f"bursts of {BURST}, {name}: {told}")


def added(result):
    """What fits add, tick by tick: beyond the median without them, ms."""
    usual = statistics.median(result["quiet"]["first_ms"])
    return [ms - usual for ms in result["fitting"]["first_ms"]]


if __name__ == "__main__":
    main()
