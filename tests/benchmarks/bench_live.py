"""What a live bus costs: our port, drained every 10 ms, against python-can's Notifier with cantools.

``python -m tests.benchmarks.bench_live [--json FILE]`` on a host without CAN: both above a datagram socket pair
(python-can through a bus of a few lines that parses as its own SocketCAN bus does). Under ``tests/canvm/canvm``, and
wherever there is a vcan0: both on that, python-can with its own SocketCAN bus. A process of its own sends 8,500
frames/s, evenly; each round runs every peer for three seconds on the same traffic; CPU time is that of the receiving
process alone. Kernel time stamps on; every signal is decoded, ours once a second as the engine does.
"""

import argparse
import asyncio
import json
import os
import resource
import socket
import statistics
import struct
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

RATE = 8_500
SECONDS = 3.05  # three ticks
ROUNDS = 7
DBC = Path(__file__).resolve().parents[2] / "dbc" / "bms_gateway.dbc"
CAN = struct.Struct("=IB3x8s")

SENDER = """
import socket, sys, time
fd, channel, rate = int(sys.argv[1]), sys.argv[2], float(sys.argv[3])
frames = [bytes.fromhex(w) for w in sys.stdin.readline().split()]
if fd >= 0:
    sock = socket.socket(fileno=fd)
else:
    sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
    sock.bind((channel,))
begun, k = time.monotonic(), 0
while True:
    due = int((time.monotonic() - begun) * rate)
    while k < due:
        try:
            sock.send(frames[k % len(frames)])
        except OSError:
            pass  # the receiver is behind: a bus would not wait either
        k += 1
    time.sleep(1 / rate)
"""


def database():
    import cantools

    return cantools.database.load_file(DBC)


def traffic(db):
    """One frame of every message that the pack sends, in turn."""
    messages = [m for m in db.messages if "BMS" in m.senders]
    wire = []
    for k in range(8 * len(messages)):
        m = messages[k % len(messages)]
        payload = bytes((k * 37 + j * 11) % 200 for j in range(m.length))
        if m.is_multiplexed():
            mux = next(s for s in m.signals if s.is_multiplexer)
            tree = next(e for e in m.signal_tree if isinstance(e, dict))
            value = sorted(tree[mux.name])[k % len(tree[mux.name])]
            number = bytearray(payload)
            for bit in range(mux.length):
                at = mux.start + bit
                number[at // 8] = number[at // 8] & ~(1 << at % 8) | (value >> bit & 1) << at % 8
            payload = bytes(number)
        wire.append(CAN.pack(m.frame_id | (0x80000000 if m.is_extended_frame else 0), len(payload), payload))
    return wire


class Place:
    """Where frames come from: vcan0, or a socket pair."""

    def __init__(self, channel, wire):
        self.channel, self.wire = channel, wire

    def start(self):
        self.ours = theirs = None
        if self.channel is None:
            self.ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        fd = theirs.fileno() if theirs else -1
        self.process = subprocess.Popen(
            [sys.executable, "-c", SENDER, str(fd), self.channel or "-", str(RATE)],
            stdin=subprocess.PIPE,
            pass_fds=[fd] if theirs else [],
            text=True,
        )
        self.process.stdin.write(" ".join(w.hex() for w in self.wire) + "\n")
        self.process.stdin.flush()
        if theirs:
            theirs.close()

    def stop(self):
        self.process.kill()
        self.process.wait()
        self.process.stdin.close()


def cpu():
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


async def ours(place, decode):
    """Our port as the service uses it: drained by a timer, all signals decoded at the tick, once a second."""
    from bms_gateway.bus.socketcan import SocketCanPort
    from bms_gateway.frames.batch import FrameBatch

    port = SocketCanPort.over(place.ours) if place.channel is None else SocketCanPort(place.channel)
    loop = asyncio.get_running_loop()
    pending, count, tick = [], 0, time.monotonic() + 1.0

    def drain():
        nonlocal count, tick
        pending.append(port.drain())
        count += len(pending[-1])
        if time.monotonic() >= tick:
            tick += 1.0
            if decode is not None:
                decode(FrameBatch.concat(pending))
            pending.clear()
        loop.call_later(0.01, drain)

    start = cpu()
    loop.call_later(0.01, drain)
    await asyncio.sleep(SECONDS)
    used = cpu() - start
    port.close()
    return used, count


async def theirs(place, db):
    """python-can's Notifier on the event loop, cantools in the listener."""
    import can

    bus = _pair_bus(place.ours) if place.channel is None else can.Bus(interface="socketcan", channel=place.channel)
    known = {m.frame_id: m for m in db.messages}
    count = 0

    def listen(message):
        nonlocal count
        count += 1
        known[message.arbitration_id].decode(message.data, decode_choices=False)

    notifier = can.Notifier(bus, [listen], loop=asyncio.get_running_loop())
    start = cpu()
    await asyncio.sleep(SECONDS)
    used = cpu() - start
    notifier.stop()
    bus.shutdown()
    return used, count


def _pair_bus(sock):
    """python-can above one end of a socket pair: `capture_message` is its own."""
    import can
    from can.interfaces.socketcan.socketcan import capture_message

    class PairBus(can.BusABC):
        def __init__(self):
            self.socket = sock
            sock.setsockopt(socket.SOL_SOCKET, 29 + 6, 1)  # SO_TIMESTAMPNS
            super().__init__(channel="pair")

        def fileno(self):
            return self.socket.fileno()

        def _recv_internal(self, timeout):
            import select

            ready, _, _ = select.select([self.socket], [], [], timeout)
            return (capture_message(_NoName(self.socket)) if ready else None), True

        def send(self, msg, timeout=None):
            raise RuntimeError("this bus only listens")

        def shutdown(self):
            super().shutdown()
            self.socket.close()

    class _NoName:
        """A socket pair names no channel: python-can wants one."""

        def __init__(self, inner):
            self._inner = inner

        def recvmsg(self, *sizes):
            data, ancillary, flags, _ = self._inner.recvmsg(*sizes)
            return data, ancillary, flags, ("pair",)

        def __getattr__(self, name):
            return getattr(self._inner, name)

    return PairBus()


def table_decoder(db):
    """The gateway's own decoder of every signal of the traffic."""
    from bms_gateway.frames.database import Database
    from bms_gateway.frames.decode import decode

    signals = [f"{m.name}.{s.name}" for m in db.messages if "BMS" in m.senders for s in m.signals]
    table = Database.load({"bms_gateway.dbc": DBC.read_text()}).compile(signals)
    return lambda batch: decode(table, batch)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    with long_queues():
        measure(args.json)


@contextmanager
def long_queues():
    """Let socket pairs queue a drain's worth of frames, where we may; the default of ten holds the sender back."""
    queue = Path("/proc/sys/net/unix/max_dgram_qlen")
    if not os.access(queue, os.W_OK):
        yield
        return
    before = queue.read_text()
    queue.write_text("1000")
    try:
        yield
    finally:
        queue.write_text(before)


def measure(json_file):
    channel = "vcan0" if Path("/sys/class/net/vcan0").exists() else None
    db = database()
    place = Place(channel, traffic(db))
    table = table_decoder(db)
    peers = {
        "port alone": lambda: ours(place, None),
        "Notifier + cantools": lambda: theirs(place, db),
        "port + table decode": lambda: ours(place, table),
    }
    results = {name: [] for name in peers}
    for _ in range(ROUNDS):
        for name, run in peers.items():
            place.start()
            used, count = asyncio.run(run())
            place.stop()
            results[name].append((used / count * 1e6, used / SECONDS * 100, count / SECONDS))
    print(f"on {channel or 'a socket pair'}, {ROUNDS} alternating rounds of {SECONDS:.0f} s at {RATE} frames/s")
    print(f"{'':22}{'µs CPU/frame':>26}{'% of a core':>14}{'frames/s':>10}")
    for name, rows in results.items():
        cost, core, rate = zip(*rows, strict=True)
        spread = f"{statistics.median(cost):.2f} ({min(cost):.2f}…{max(cost):.2f})"
        print(f"{name:22}{spread:>26}{statistics.median(core):14.2f}{statistics.median(rate):10.0f}")
    peer = [r[0] for r in results["Notifier + cantools"]]
    ratios = {}
    for name, rows in results.items():
        if name != "Notifier + cantools":
            ratio = sorted(p / r[0] for p, r in zip(peer, rows, strict=True))
            ratios[name] = ratio
            middle = statistics.median(ratio)
            print(f"Notifier + cantools / {name}: {middle:.1f} (min {ratio[0]:.1f}, max {ratio[-1]:.1f})")
    if json_file:
        json_file.write_text(json.dumps({"place": channel or "socketpair", "rounds": results, "ratios": ratios}))


if __name__ == "__main__":
    main()
