"""The fast decoder says what cantools says, for every message of every DBC at hand."""

import random
import struct
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.frames.database import Database
from bms_gateway.frames.decode import decode
from tests.frames.payloads import all_dbc, batch_of, can_id, loaded, parsed, payloads, truth

PER_MESSAGE = 40
EXACT = 2.0**53


def same(ours: float, theirs: float) -> bool:
    """Equal bit for bit (any NaN is a NaN); integers beyond 2^53 to float precision."""
    if theirs != theirs:
        return ours != ours
    if abs(theirs) > EXACT:
        return ours == pytest.approx(theirs, rel=1e-15)
    return struct.pack("<d", ours) == struct.pack("<d", theirs) or (ours == 0.0 == theirs)


@pytest.mark.parametrize("path", all_dbc(), ids=lambda p: p.name)
def test_every_message_decodes_as_cantools_does(path: Path) -> None:
    oracle = parsed(path)
    database = loaded(path)
    paths = [f"{m.name}.{s.name}" for m in oracle.messages for s in m.signals]
    table = database.compile(paths)
    rng = random.Random(path.name)
    frames, expected = [], []
    for message in oracle.messages:
        for payload in payloads(message, rng, PER_MESSAGE):
            frames.append((can_id(message), payload))
            expected.append((message, truth(message, payload)))
    order = list(range(len(frames)))
    rng.shuffle(order)
    frames = [frames[i] for i in order]
    expected = [expected[i] for i in order]
    samples = decode(table, batch_of(frames))
    assert (np.diff(samples.frame) >= 0).all()
    got: list[dict[str, float]] = [{} for _ in frames]
    for f, s, v in zip(samples.frame, samples.signal, samples.value, strict=True):
        message_name, name = paths[s].split(".")
        assert message_name == expected[f][0].name
        assert name not in got[f]
        got[f][name] = float(v)
    assert samples.unknown.tolist() == [f for f, (_, theirs) in enumerate(expected) if theirs is None]
    for (message, theirs), ours, (_, payload) in zip(expected, got, frames, strict=True):
        if theirs is None:
            continue  # an unknown multiplexer value: what is outside the multiplexer is still decoded
        assert set(ours) == set(theirs), (message.name, payload.hex())
        for name, value in theirs.items():
            assert same(ours[name], value), (message.name, name, payload.hex(), ours[name], value)


def test_a_frame_too_short_for_its_multiplexer_is_told_and_gives_nothing_of_what_it_selects() -> None:
    text = (
        'VERSION ""\nBS_:\nBU_: A\nBO_ 1 M: 8 A\n SG_ mux M : 8|8@1+ (1,0) [0|0] "" A\n'
        ' SG_ head : 0|8@1+ (1,0) [0|0] "" A\n SG_ one m1 : 16|8@1+ (1,0) [0|0] "" A\n'
        ' SG_ two m2 : 16|8@1+ (1,0) [0|0] "" A\n'
    )
    table = Database.load({"a.dbc": text}).compile(["M.head", "M.one"])
    samples = decode(table, batch_of([(1, b"\x07"), (1, b"\x07\x01\x05"), (1, b"\x07\x02\x05"), (1, b"\x07\x03\x05")]))
    assert samples.unknown.tolist() == [0, 3]
    assert list(zip(samples.frame.tolist(), samples.value.tolist(), strict=True)) == [
        (0, 7.0),
        (1, 7.0),
        (1, 5.0),
        (2, 7.0),
        (3, 7.0),
    ]
