"""Random frames of DBC messages, and cantools as the oracle of what is in them."""

import math
import random
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import cantools
import numpy as np
from cantools.database import DecodeError
from cantools.database.can import Database as Parsed
from cantools.database.can import Message

from bms_gateway.frames.batch import EXTENDED, FrameBatch
from bms_gateway.frames.database import Database
from tests.data import data_dir

ROOT = Path(__file__).resolve().parents[2]
OWN = ROOT / "dbc" / "bms_gateway.dbc"
KINDS = Path(__file__).with_name("kinds.dbc")
"""What our own DBC has none of: floats of either size and order, integers of 57 and 64 bits."""
FOLDERS = ("conformance/cantools", "conformance/asammdf_css", "dbc")
REFUSED = {"uwfe_2024CAR_original.dbc", "leaf_EV-can_ZE1.dbc"}
"""DBC files that cantools itself refuses when strict."""


def text_of(path: Path) -> str:
    return path.read_text(encoding="cp1252")


def all_dbc() -> list[Path]:
    found = [p for f in FOLDERS for p in sorted((data_dir() / f).glob("*.dbc")) if p.name not in REFUSED]
    return [*([OWN] if OWN.exists() else []), KINDS, *found]


@cache
def loaded(path: Path) -> Database:
    """A DBC as we read it: once for all tests, since ours alone takes a third of a second."""
    return Database.load({path.name: text_of(path)})


@cache
def parsed(path: Path) -> Parsed:
    """The same as cantools reads it."""
    made = cantools.database.load_string(text_of(path), "dbc", strict=True)
    assert isinstance(made, Parsed)
    return made


def batch_of(frames: list[tuple[int, bytes]], *, width: int | None = None, step_ns: int = 1_000_000) -> FrameBatch:
    """Frames (can_id with the EXTENDED bit, payload) as a batch."""
    longest = max([8, *(len(d) for _, d in frames)])
    data = np.zeros((len(frames), width or 8 * math.ceil(longest / 8)), np.uint8)
    for i, (_, d) in enumerate(frames):
        data[i, : len(d)] = np.frombuffer(d, np.uint8)
    return FrameBatch(
        np.arange(len(frames), dtype=np.int64) * step_ns,
        np.array([c for c, _ in frames], np.uint32),
        np.array([len(d) for _, d in frames], np.uint8),
        data,
    )


def can_id(message: Message) -> int:
    return message.frame_id | EXTENDED if message.is_extended_frame else message.frame_id


def _set_bits(payload: bytearray, message: Message, name: str, raw: int) -> None:
    signal = message.get_signal_by_name(name)
    for k in range(signal.length):
        if signal.byte_order == "big_endian":
            start = 8 * (signal.start // 8) + 7 - signal.start % 8
            position = start + signal.length - 1 - k
            byte, bit = position // 8, 7 - position % 8
        else:
            byte, bit = divmod(signal.start + k, 8)
        payload[byte] = (payload[byte] & ~(1 << bit)) | (((raw >> k) & 1) << bit)


def payloads(message: Message, rng: random.Random, count: int) -> Iterator[bytes]:
    """Random payloads; extreme ones among them; multiplexers mostly at values that exist."""
    switches = [s for s in message.signals if s.is_multiplexer]
    for i in range(count):
        if i == 0:
            payload = bytearray(message.length)
        elif i == 1:
            payload = bytearray(b"\xff" * message.length)
        else:
            payload = bytearray(rng.randbytes(message.length))
        if i > 1 or switches:
            for switch in switches:
                known = sorted(
                    {v for s in message.signals if s.multiplexer_signal == switch.name for v in s.multiplexer_ids or ()}
                )
                if known and rng.random() < 0.95:
                    _set_bits(payload, message, switch.name, rng.choice(known))
        yield bytes(payload)


def truth(message: Message, payload: bytes) -> dict[str, float] | None:
    """What cantools decodes; None where it refuses the multiplexer value."""
    try:
        decoded = message.decode(payload, decode_choices=False, scaling=True, allow_excess=True)
    except DecodeError:
        return None
    assert isinstance(decoded, dict)
    return {name: float(value) for name, value in decoded.items()}  # type: ignore[arg-type]
