"""What was read of a DBC, written and read back: the same to the bit and in its order."""

from pathlib import Path

import numpy as np
import pytest

from bms_gateway.frames.database import Database
from bms_gateway.frames.dbc import parse
from bms_gateway.frames.packed import pack, unpack
from tests.frames.payloads import OWN, all_dbc, text_of
from tests.frames.same_messages import same


@pytest.mark.parametrize("path", all_dbc(), ids=lambda p: p.name)
def test_a_table_gives_back_what_was_parsed(path: Path) -> None:
    truth = parse(path.name, text_of(path))
    found = unpack(path.name, pack(truth))
    assert same(found, truth)
    paths = [s.path for m in truth for s in m.signals.values() if s.scale]
    tables = [Database(messages).compile(paths) for messages in (found, truth)]
    for part, names in {
        "nodes": ("keys", "first", "count"),
        "values": ("scale", "offset"),
        "limits": ("low", "high", "na_from", "label_keys"),
        "switches": ("declared",),
    }.items():
        for name in names:
            np.testing.assert_array_equal(*(getattr(getattr(t, part), name) for t in tables))


def test_the_same_messages_give_the_same_text_under_any_file_name() -> None:
    assert pack(parse("a.dbc", text_of(OWN))) == pack(parse("b.dbc", text_of(OWN)))


def test_what_signals_share_is_in_memory_once() -> None:
    messages = unpack("a.dbc", pack(parse("a.dbc", text_of(OWN))))
    tables = {id(s.choices) for m in messages for s in m.signals.values()}
    muxes = {id(s.mux) for m in messages for s in m.signals.values() if s.mux}
    assert max(len(tables), len(muxes)) < 60
