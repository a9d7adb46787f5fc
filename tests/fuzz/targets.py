"""What reads things from outside, with sound examples of what it reads: the targets of all fuzzing.

Each target takes bytes and a folder. It may do anything but raise something that is not ours.
"""

import gzip
import io
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import can
import numpy as np

from bms_gateway.bus.logfile import LogNotes, read_log
from bms_gateway.config import load_config, own_dbc_text, parse_model
from bms_gateway.engine import Engine, drain
from bms_gateway.errors import GatewayError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.database import Database
from bms_gateway.report.table import read_table
from bms_gateway.store import StateStore
from tests.config.files import DBC, MAPPED, write
from tests.config.model_texts import EXAMPLE
from tests.engine.packs import database, plan, traffic


@dataclass(frozen=True, slots=True)
class Target:
    """Sound inputs, and what is done with spoilt ones."""

    seeds: tuple[bytes, ...] = field(repr=False)
    run: Callable[[bytes, Path], None] = field(repr=False)


def _messages(count: int) -> list[can.Message]:
    return [
        can.Message(timestamp=1.7e9 + k / 100, arbitration_id=k, is_extended_id=bool(k % 2), data=bytes([k] * (k % 9)))
        for k in range(count)
    ]


@cache
def log(suffix: str, folder: Path) -> bytes:
    path = folder / f"seed{suffix}"
    with can.Logger(path) as writer:
        for message in _messages(30):
            writer(message)
    return path.read_bytes()


CANDUMP = b"".join(
    b"(1700000000.%06d) can0 %03X#%s\n" % (k, k, bytes(range(k % 9)).hex().encode()) for k in range(30)
) + (b"(1700000001.000000) can0 1ABCDEF0#R\n(1700000001.5) can0 123##1AABBCCDDEEFF00112233\n")
TABLE = b"time_s,current_A,coolant_inlet_C,surface_1_C\n" + b"".join(
    b"%d,%d.5,25.0,%d\n" % (k, k, k) for k in range(30)
)


def _reads(suffix: str) -> Callable[[bytes, Path], None]:
    def run(data: bytes, folder: Path) -> None:
        path = folder / f"a{suffix}"
        path.write_bytes(data)
        for batch in read_log(path, chunk=4_096, notes=LogNotes()):
            assert (batch.length <= batch.data.shape[1]).all()

    return run


def _table(suffix: str) -> Callable[[bytes, Path], None]:
    def run(data: bytes, folder: Path) -> None:
        path = folder / f"t{suffix}"
        path.write_bytes(data)
        table = read_table(path)
        assert (np.diff(table.time_s) > 0).all()

    return run


def _config(data: bytes, folder: Path) -> None:
    write(folder).write_bytes(data)
    load_config(folder / "gateway.toml")


def _model(data: bytes, folder: Path) -> None:
    parse_model(data.decode("utf-8", "replace"), "a.toml")


def _dbc(data: bytes, folder: Path) -> None:
    base = Database.load({"a.dbc": data.decode("cp1252", "replace")})
    names = [f"{m.name}.{s.name}" for m in base.messages.values() for s in m.signals.values()]
    base.compile(names)


def _state(data: bytes, folder: Path) -> None:
    (folder / "state").write_bytes(data)
    StateStore(folder).load()


def _snapshot(data: bytes, folder: Path) -> None:
    try:
        state = json.loads(data)
    except (ValueError, RecursionError):
        return
    if isinstance(state, dict):
        engine = Engine(plan(1), database())
        engine.restore(state)


def _frames(data: bytes, folder: Path) -> None:
    """16 bytes each: which identifier, its length, some nanoseconds, the payload."""
    engine = Engine(plan(1), database())
    rows = np.frombuffer(data[: len(data) // 16 * 16], np.uint8).reshape(-1, 16)
    if not len(rows):
        return
    ids = engine.can_ids[rows[:, 0] % len(engine.can_ids)]
    steps = rows[:, 2:6].copy().view("<u4").ravel().astype(np.int64)
    time_ns = 1_700_000_000_000_000_000 + np.cumsum(np.where(rows[:, 6] < 240, steps, -steps))
    length = rows[:, 1] % 9
    payload = np.where(np.arange(8) < length[:, None], rows[:, 8:], 0).astype(np.uint8)
    frames = FrameBatch(time_ns, ids.astype(np.uint32), length.astype(np.uint8), payload)
    engine.receive(frames, now_ns=int(time_ns.max()))
    for event in drain(engine):
        assert event.time_ns is not None


@cache
def _sound_frames() -> bytes:
    engine, frames = Engine(plan(1), database()), traffic(5, strings=1)
    index = {c: k for k, c in enumerate(engine.can_ids.tolist())}
    rows = np.zeros((len(frames), 16), np.uint8)
    rows[:, 0] = [index.get(c, 0) for c in frames.can_id.tolist()]
    rows[:, 1] = frames.length
    rows[:, 2:6] = np.diff(frames.time_ns, prepend=frames.time_ns[0]).astype("<u4").view(np.uint8).reshape(-1, 4)
    rows[:, 8:] = frames.data
    return rows.tobytes()


@cache
def _sound_snapshot() -> bytes:
    engine, frames = Engine(plan(1), database()), traffic(20, strings=1)
    engine.receive(frames, now_ns=int(frames.time_ns.max()))
    list(drain(engine))
    return json.dumps(engine.snapshot()).encode()


def _sound_state(folder: Path) -> bytes:
    StateStore(folder).save(json.loads(_sound_snapshot()), wall_ns=1)
    return (folder / "state").read_bytes()


def packed(data: bytes) -> bytes:
    with io.BytesIO() as out:
        with gzip.GzipFile("", "wb", 6, out, mtime=0) as file:
            file.write(data)
        return out.getvalue()


def targets(folder: Path) -> dict[str, Target]:
    """All of them; the folder is for making the examples."""
    text = {s: log(s, folder) for s in (".asc", ".csv", ".trc", ".blf")}
    found = {f"log{suffix}": Target((data,), _reads(suffix)) for suffix, data in text.items()}
    found |= {f"log{s}.gz": Target((packed(d),), _reads(f"{s}.gz")) for s, d in text.items()}
    found["log.log"] = Target((CANDUMP,), _reads(".log"))
    found["log.log.gz"] = Target((packed(CANDUMP),), _reads(".log.gz"))
    if find_spec("asammdf"):  # an extra
        found["log.mf4"] = Target((log(".mf4", folder),), _reads(".mf4"))
    (folder / "state-seed").mkdir(exist_ok=True)
    found |= {
        "table": Target((TABLE,), _table(".csv")),
        "table.gz": Target((packed(TABLE),), _table(".csv.gz")),
        "config": Target((MAPPED.encode(),), _config),
        "model": Target((EXAMPLE.encode(),), _model),
        "dbc": Target((DBC.encode(), own_dbc_text()[:6_000].rpartition("\n")[0].encode()), _dbc),
        "state": Target((_sound_state(folder / "state-seed"),), _state),
        "snapshot": Target((_sound_snapshot(),), _snapshot),
        "frames": Target((_sound_frames(),), _frames),
    }
    return found


LONGEST = 2_000


def survives(target: Target, data: bytes, folder: Path) -> bool:
    """Run a target; whether it took the input. Whatever it raises that is not ours goes on up."""
    try:
        target.run(data, folder)
    except GatewayError as error:
        said = str(error)
    else:
        return True
    if "\n" in said.strip() or len(said) > LONGEST:
        raise AssertionError(f"not one line for a person: {said[:LONGEST]!r}")
    return False
