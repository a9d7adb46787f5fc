"""A log from file to frames: `python -m tests.benchmarks.bench_files [--memory] [--json FILE]`.

Peer is what a careful script does today: python-can's candump reader and cantools' decoder for every frame that is in
the DBC, and nothing more. Against it, on the same file in the same rounds: reading alone, reading and decoding every
signal of the DBC, and the whole analysis, from text to estimates to the text of the frames that the service would have
sent. The last once with identification as configured (its jobs run inline) and once without.

Three logs: half an hour of the example pack (5 strings of 12 cells, 85 frames/s), the same pack for a minute among the
other traffic of a full 1 Mbit/s bus, and a race car's drive (141 thermistors), where the measurements are at hand. An
analysis costs so much a *tick* of a second, whatever the bus carries: per frame it is dear on a quiet bus.

With ``--memory`` instead: the greatest resident memory of the command `analyze` on 1 h and on 10 h of the example pack.
"""

import argparse
import gzip
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from tests.benchmarks.rounds import alternate, ratio
from tests.data import data_dir

EXAMPLE = Path(__file__).resolve().parents[2] / "deploy" / "example" / "gateway.toml"
RACE = "uwfe_autocross_2025-04-30_run10.log.gz"
RACE_DBC = "uwfe_2024CAR_fixed.dbc"
SIMULATED_S, CROWDED_S = 1800, 60
FULL_BUS = 8_500  # frames/s of 8 bytes on 1 Mbit/s
HOURS = (1, 10)

ANALYZE = """
import sys, time
from bms_gateway.cli.main import main
from tests.memory import peak_mib
begun = time.monotonic()
code = main(["analyze", sys.argv[1], "--config", sys.argv[2], "--out", sys.argv[3]])
print(f"\\n{code} {peak_mib()} {time.monotonic() - begun}")
"""


def simulate(log, seconds):
    """Write traffic of the example pack, in a process of its own."""
    words = ["simulate", "--config", str(EXAMPLE), "--out", str(log), "--duration", str(seconds), "--seed", "1"]
    subprocess.run([sys.executable, "-m", "bms_gateway", *words], check=True, stdout=subprocess.DEVNULL)


def crowd(quiet, log):
    """Copy a log with frames of others in between: random payloads, identifiers that no message of ours has."""
    import numpy as np

    from bms_gateway.bus.logfile import read_log, write_log
    from bms_gateway.frames.batch import FrameBatch

    pack = FrameBatch.concat(list(read_log(quiet)))
    rng = np.random.default_rng(0)
    n = FULL_BUS * CROWDED_S - len(pack)
    time = np.concatenate([pack.time_ns, pack.time_ns[0] + rng.integers(0, CROWDED_S * 1_000_000, n) * 1000])
    others = rng.choice(np.arange(0x100, 0x180, dtype=np.uint32), n)
    assert not np.isin(pack.can_id, others).any()
    order = np.argsort(time, kind="stable")
    can_id, length = np.concatenate([pack.can_id, others]), np.concatenate([pack.length, np.full(n, 8, np.uint8)])
    data = np.concatenate([pack.data, rng.integers(0, 256, (n, 8), np.uint8)])
    write_log(log, [FrameBatch(time[order], can_id[order], length[order], data[order])])


def peer(log, dbc):
    """Read with python-can and decode with cantools; frames that cantools refuses are counted."""
    import can
    import cantools

    database = cantools.database.load_file(dbc, strict=False)
    known = {(m.frame_id, m.is_extended_frame): m for m in database.messages}

    def run():
        refused = 0
        for frame in can.CanutilsLogReader(log):
            message = known.get((frame.arbitration_id, frame.is_extended_id))
            if message is not None:
                try:
                    message.decode(frame.data, decode_choices=False)
                except cantools.database.DecodeError:
                    refused += 1
        return refused

    return run, database


def ours(log, dbc, database):
    """Read and decode every signal that the DBC declares."""
    from bms_gateway.bus.logfile import read_log
    from bms_gateway.frames.database import Database
    from bms_gateway.frames.decode import decode

    signals = [f"{m.name}.{s.name}" for m in database.messages for s in m.signals]
    table = Database.load({dbc.name: dbc.read_text(encoding="utf-8", errors="replace")}).compile(signals)
    return lambda: sum(len(decode(table, batch)) for batch in read_log(log))


def analysis(log, config, method=None):
    """Analyze a log and write the frames that go out as text."""
    from bms_gateway.bus.candump import format_block
    from bms_gateway.bus.logfile import read_log
    from bms_gateway.config import load_config
    from bms_gateway.engine import Engine, SendFrames, drive

    loaded = load_config(config)
    plan = loaded.plan
    if method is not None:
        plan = replace(plan, strings=tuple(replace(s, identify=method) for s in plan.strings))

    def run():
        out = ticks = 0
        for event in drive(Engine(plan, loaded.database), read_log(log)):
            if isinstance(event, SendFrames):
                ticks += 1
                out += len(format_block(event.batch, "can0"))
        return ticks

    return run


def compare(title, log, dbc, config):
    """Print one table; returns its figures."""
    from bms_gateway.bus.logfile import read_log

    decode_peer, database = peer(log, dbc)
    runs = {
        "python-can + cantools": decode_peer,
        "read": lambda: sum(map(len, read_log(log))),
        "read + decode": ours(log, dbc, database),
        "analyze, no identification": analysis(log, config, "off"),
        "analyze": analysis(log, config),
    }
    frames, refused, ticks = runs["read"](), decode_peer(), runs["analyze, no identification"]()
    samples = runs["read + decode"]()
    times = alternate(runs)
    base = times["python-can + cantools"]
    print(f"\n{title}: {frames} frames, {samples / frames:.1f} signals each, {ticks} ticks; peer refused {refused}")
    print(f"{'':28}{'µs/frame (min…max)':>26}{'frames/s':>12}{'µs/tick':>9}{'x real time':>13}   peer / this")
    for name, t in times.items():
        low, middle, high = (1e6 * s / frames for s in (min(t.seconds), t.median, max(t.seconds)))
        per_tick = f"{1e6 * t.median / ticks:9.0f}" if name.startswith("analyze") else " " * 9
        per_tick += f"{ticks / t.median:13,.0f}"
        figures = f"{middle:.3f} ({low:.3f}…{high:.3f})"
        print(f"{name:28}{figures:>26}{1e6 / middle:12,.0f}{per_tick}   {ratio(base, t)}")
    return {"frames": frames, "ticks": ticks, "seconds": {name: t.seconds for name, t in times.items()}}


def speed(folder):
    figures = {}
    log = folder / "pack.log"
    simulate(log, SIMULATED_S)
    dbc = EXAMPLE.parents[2] / "dbc" / "bms_gateway.dbc"
    figures["pack"] = compare("Example pack, 5 x 12 cells, simulated", log, dbc, EXAMPLE)
    quiet, log = folder / "quiet.log", folder / "crowded.log"
    simulate(quiet, CROWDED_S)
    crowd(quiet, log)
    figures["crowded"] = compare("The same pack on a full bus", log, dbc, EXAMPLE)
    race = data_dir() / "can" / RACE
    if not race.exists():
        print(f"\nrace car: left out, {race} is not here")
        return figures
    from tests.config.race_car import write_race_car

    log = folder / "race.log"
    log.write_bytes(gzip.decompress(race.read_bytes()))
    config = write_race_car(folder)
    figures["race"] = compare("Race car, 141 thermistors", log, data_dir() / "dbc" / RACE_DBC, config)
    return figures


def memory(folder):
    figures = {}
    print(f"{'analyze':>8}{'log MB':>8}{'peak MiB':>10}{'seconds':>9}")
    for hours in HOURS:
        log = folder / f"{hours}h.log"
        simulate(log, 3600 * hours)
        words = [str(log), str(EXAMPLE), str(folder / f"{hours}h")]
        done = subprocess.run([sys.executable, "-c", ANALYZE, *words], check=True, stdout=subprocess.PIPE, text=True)
        code, peak, seconds = done.stdout.splitlines()[-1].split()
        if code not in ("0", "None"):
            raise SystemExit(f"analyze ended with {code}")
        print(f"{hours:6} h{log.stat().st_size / 1e6:8.0f}{float(peak):10.1f}{float(seconds):9.1f}")
        figures[f"{hours}h"] = {"peak_mib": float(peak), "seconds": float(seconds)}
        log.unlink()
    return figures


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--memory", action="store_true", help="peak memory of 1 h and 10 h instead of times")
    parser.add_argument("--json", type=Path, help="write the figures there")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        figures = memory(Path(folder)) if args.memory else speed(Path(folder))
    if args.json:
        args.json.write_text(json.dumps(figures))


if __name__ == "__main__":
    main()
