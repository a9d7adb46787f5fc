"""Alive counters are followed as the rule in words says, one frame after the other, whatever is lost or repeated."""

import numpy as np
import pytest

from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.counter import CounterGuard
from bms_gateway.frames.decode import decode
from bms_gateway.frames.e2e import id_crc, protect
from bms_gateway.frames.encode import Encoder
from bms_gateway.frames.quality import Quality
from tests.frames.payloads import OWN, batch_of, loaded

DATABASE = loaded(OWN)
MESSAGES = ("string_1_surface", "string_2_electrical", "string_1_coolant")
TABLE = DATABASE.compile([s.path for m in MESSAGES for s in DATABASE.message(m).signals.values()])


def protected(message: str, mux: tuple[int, ...], counter: int) -> tuple[int, bytes]:
    """A frame with the counter wanted."""
    encoder = Encoder(DATABASE, [message])
    row = encoder.row(message, *mux)
    encoder.counters[row] = counter
    values = np.zeros((1, encoder.width))
    can_id, _, data = encoder.encode(np.array([row]), values)
    return int(can_id[0]), data[0].tobytes()


LAYOUTS = (
    ("string_1_surface", (0,)),
    ("string_1_surface", (1,)),
    ("string_2_electrical", ()),
    ("string_1_coolant", ()),
)
FRAMES = {(k, c): protected(*layout, c) for k, layout in enumerate(LAYOUTS) for c in range(15)}


@pytest.mark.parametrize("seed", range(3))
def test_counters_are_followed_as_told_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    guard = CounterGuard(TABLE)
    last = dict.fromkeys(range(len(LAYOUTS)), -1)
    met = set()
    for _ in range(60):
        count = int(rng.integers(0, 12))
        frames, repeated, wrong = [], [], []
        for n in range(count):
            k = int(rng.integers(len(LAYOUTS)))
            counter = int((last[k] + rng.choice([0, 1, 1, 1, 2, 3, 4, 7, 14])) % 15)
            can_id, payload = FRAMES[k, counter]
            if rng.random() < 0.1:  # broken on the way: nothing is followed
                frames.append((can_id, bytes([payload[0] ^ 0xFF]) + payload[1:]))
                continue
            frames.append((can_id, payload))
            step = (counter - last[k]) % 15 if last[k] >= 0 else 1
            if step == 0:
                repeated.append(n)
            if step not in (1, 2, 3):
                wrong.append(n)
            met.add(step)
            last[k] = counter
        samples = decode(TABLE, batch_of(frames))
        flag, told = guard.follow(samples)
        assert told.tolist() == repeated
        expected = samples.flag.copy()
        expected[np.isin(samples.frame, wrong) & (expected == Quality.GOOD)] = Quality.COUNTER
        assert flag.tolist() == expected.tolist()
        nodes = {k: decode(TABLE, batch_of([FRAMES[k, 0]])).protected.node[0] for k in last}
        assert {k: int(guard.last[n]) for k, n in nodes.items()} == last
    assert met == {0, 1, 2, 3, 4, 7, 14}


def test_a_multiplexer_value_that_nobody_knows_has_no_sequence() -> None:
    message = DATABASE.message("string_1_surface")
    place = next(s.place for s in message.signals.values() if s.is_multiplexer)
    assert not place.big_endian
    can_id, payload = protected("string_1_surface", (0,), 3)
    word = int.from_bytes(payload, "little") | ((1 << place.size) - 1) << place.start
    data = np.frombuffer(word.to_bytes(8, "little"), np.uint8).reshape(1, 8).copy()
    protect(data, np.array([3], np.uint8), id_crc(np.array([message.e2e.data_id])))
    guard = CounterGuard(TABLE)
    samples = decode(TABLE, batch_of([(can_id, data.tobytes())] * 3))
    assert samples.unknown.tolist() == [0, 1, 2]
    assert samples.protected.crc_ok.all()
    assert guard.follow(samples)[1].tolist() == []
    assert (guard.last == -1).all()


def test_nothing_is_followed_where_there_is_nothing() -> None:
    guard = CounterGuard(TABLE)
    flag, repeated = guard.follow(decode(TABLE, FrameBatch.empty()))
    assert (len(flag), len(repeated)) == (0, 0)
