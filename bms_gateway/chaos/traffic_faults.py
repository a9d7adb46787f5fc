"""Faulty frames, and frames that do not belong to the battery."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bms_gateway.chaos.fault_targets import Facts
from bms_gateway.chaos.reaction import Counted, Quiet, Reaction, Told, Unmoved
from bms_gateway.chaos.scenario import Injection, Scenario
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.e2e import id_crc, protect
from bms_gateway.frames.signal_info import MessageInfo, SignalInfo

Change = Callable[[FrameBatch, np.random.Generator], FrameBatch]
LASTS_S, RECOVERS_S = 60.0, 60.0
LOAD = 800  # foreign frames in a tenth of a second: what a full 1 Mbit/s bus carries
UNPROTECTED = "its messages have neither check sum nor counter"


def frame_scenarios(facts: Facts) -> list[Scenario]:
    """Make all scenarios of this room for a config."""
    surface = facts.message("surface")
    unfit = facts.lacks("surface")
    unprotected = unfit or ("" if surface is not None and surface.e2e is not None else UNPROTECTED)
    switch = None if surface is None else next((s for s in surface.signals.values() if s.is_multiplexer), None)
    unused = None if surface is None or switch is None else _unused(surface, switch)
    no_switch = unfit or ("" if unused is not None else "no multiplexer of its messages has a value to spare")

    def one(name: str, fault: str, expected: tuple[Reaction, ...], change: Change, why: str) -> Scenario:
        return Scenario(name, "frame", fault, expected, LASTS_S, RECOVERS_S, Injection(frames=change), why)

    ids = np.array([] if surface is None else [surface.can_id], np.uint32)
    strange = _strange_ids(facts)
    return [
        one(
            "wrong-dlc",
            "thermocouple frames come with one byte",
            (Counted.of("error", "crc", "unknown_multiplexer"), Told("sensor", "is not used")),
            lambda f, _rng: _cut(f, np.isin(f.can_id, ids), 1),
            unfit,
        ),
        one(
            "unknown-multiplexer",
            "frames with a multiplexer value that the DBC does not know come in between",
            (Counted.of("unknown_multiplexer"), Unmoved()),
            lambda f, _rng: _with_unknown(f, surface, switch, unused),
            no_switch,
        ),
        one(
            "crc",
            "every second thermocouple frame has a flipped bit",
            (Counted.of("crc"),),
            lambda f, rng: _flipped(f, np.isin(f.can_id, ids), rng),
            unprotected,
        ),
        one(
            "counter",
            "alive counters of the thermocouple frames jump",
            (Counted.of("counter"), Told("sensor", "alive counter")),
            lambda f, rng: _miscounted(f, surface, rng),
            unprotected,
        ),
        one(
            "duplicated",
            "every frame comes twice",
            (Counted.of("repeated"), Unmoved()),
            lambda f, _rng: _pick(f, np.repeat(np.arange(len(f)), 2)),
            unprotected,
        ),
        one(
            "reordered",
            "frames of a tenth of a second come in any order",
            (Unmoved(),),
            lambda f, rng: _pick(f, rng.permutation(len(f))),
            unfit,
        ),
        one(
            "foreign-load",
            "a full bus of frames that concern nobody here",
            (Unmoved(),),
            lambda f, rng: _amid(f, _foreign(strange, LOAD, rng), rng),
            unfit,
        ),
        Scenario(
            "irrelevant-only",
            "frame",
            "the battery falls silent, others go on talking",
            (Told("silent"), Quiet(30)),
            facts.plan.silent_after_ns * 1e-9 + 60.0,
            RECOVERS_S,
            Injection(frames=lambda _f, rng: _foreign(strange, 20, rng)),
        ),
    ]


def _pick(f: FrameBatch, rows: NDArray[np.intp]) -> FrameBatch:
    return FrameBatch(f.time_ns[rows], f.can_id[rows], f.length[rows], f.data[rows])


def _cut(f: FrameBatch, mine: NDArray[np.bool_], length: int) -> FrameBatch:
    data = f.data.copy()
    data[mine, length:] = 0
    return FrameBatch(f.time_ns, f.can_id, np.where(mine, np.uint8(length), f.length), data)


def _flipped(f: FrameBatch, mine: NDArray[np.bool_], rng: np.random.Generator) -> FrameBatch:
    data = f.data.copy()
    rows = np.flatnonzero(mine)[::2]
    data[rows, rng.integers(2, 8, len(rows))] ^= (1 << rng.integers(0, 8, len(rows))).astype(np.uint8)
    return FrameBatch(f.time_ns, f.can_id, f.length, data)


def _miscounted(f: FrameBatch, message: MessageInfo | None, rng: np.random.Generator) -> FrameBatch:
    if message is None or message.e2e is None:
        return f
    data = f.data.copy()
    rows = np.flatnonzero(f.can_id == message.can_id)
    framed = data[rows, :8]
    # the right value plus five is never in sequence
    wrong = ((framed[:, 1] & 0x0F) * 5 + rng.integers(5, 9, len(rows))) % 15
    protect(framed, wrong.astype(np.uint8), id_crc(np.full(len(rows), message.e2e.data_id)))
    data[rows, :8] = framed
    return FrameBatch(f.time_ns, f.can_id, f.length, data)


def _unused(message: MessageInfo, switch: SignalInfo) -> int | None:
    """Find a value of the multiplexer that no signal of its message uses."""
    used = {v for s in message.signals.values() for step in s.mux if step.signal == switch.name for v in step.values}
    low, high = (int(x) for x in switch.raw_limits)
    return next((v for v in range(high, max(low, high - 1024) - 1, -1) if v not in used), None)


def _with_unknown(
    f: FrameBatch, message: MessageInfo | None, switch: SignalInfo | None, value: int | None
) -> FrameBatch:
    """After each frame of the message, insert a copy with this multiplexer value; the rest of the frame is valid."""
    if message is None or switch is None or value is None:
        return f
    rows = np.flatnonzero(f.can_id == message.can_id)
    more = _pick(f, rows)
    data = more.data.copy()
    for k in range(switch.place.size):
        if switch.place.big_endian:
            position = switch.place.first_bit + switch.place.size - 1 - k
            byte, bit = position // 8, 7 - position % 8
        else:
            byte, bit = divmod(switch.place.start + k, 8)
        data[:, byte] = (data[:, byte] & ~np.uint8(1 << bit)) | np.uint8(((value >> k) & 1) << bit)
    if message.e2e is not None and len(rows):
        framed = data[:, :8].copy()
        protect(framed, framed[:, 1] & np.uint8(0x0F), id_crc(np.full(len(rows), message.e2e.data_id)))
        data[:, :8] = framed
    both = FrameBatch.concat([f, FrameBatch(more.time_ns, more.can_id, more.length, data)])
    return _pick(both, np.argsort(np.r_[np.arange(len(f)), rows], kind="stable"))


def _strange_ids(facts: Facts) -> NDArray[np.uint32]:
    """List standard identifiers that no DBC of the config contains."""
    known = {m.can_id for m in facts.database.messages.values()}
    return np.array([i for i in range(0x7F0, 0x400, -1) if i not in known][:64], np.uint32)


def _foreign(ids: NDArray[np.uint32], count: int, rng: np.random.Generator) -> FrameBatch:
    data = rng.integers(0, 256, (count, 8), np.uint8)
    return FrameBatch(np.zeros(count, np.int64), rng.choice(ids, count), np.full(count, 8, np.uint8), data)


def _amid(f: FrameBatch, others: FrameBatch, rng: np.random.Generator) -> FrameBatch:
    """Mix two streams, each in its own order."""
    time = int(f.time_ns[0]) if len(f) else 0
    others = FrameBatch(np.full(len(others), time, np.int64), others.can_id, others.length, others.data)
    both = FrameBatch.concat([f, others])
    place = np.sort(rng.random(len(f))), np.sort(rng.random(len(others)))
    return _pick(both, np.argsort(np.concatenate(place), kind="stable"))
