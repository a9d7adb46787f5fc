"""What is encoded, cantools reads back; what cannot be carried leaves as not available; nothing raises."""

import random
from pathlib import Path

import cantools
import numpy as np
import pytest

from bms_gateway.errors import ConfigError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.database import Database
from bms_gateway.frames.decode import decode
from bms_gateway.frames.encode import Encoder
from bms_gateway.frames.quality import Quality
from tests.frames.payloads import OWN, all_dbc, loaded, parsed

PER_ROW = 4


def as_batch(encoded: tuple[np.ndarray, np.ndarray, np.ndarray]) -> FrameBatch:
    can_id, length, data = encoded
    return FrameBatch(np.arange(len(can_id), dtype=np.int64), can_id, length, data)


@pytest.mark.parametrize("path", all_dbc(), ids=lambda p: p.name)
def test_cantools_and_our_decoder_read_back_what_was_encoded(path: Path) -> None:
    oracle = parsed(path)
    database = loaded(path)
    encoder = Encoder(database, list(database.messages))
    names = {int(m.can_id): m for m in database.messages.values()}
    rng = random.Random(path.name)
    rows = np.repeat(np.arange(len(encoder.can_id)), PER_ROW)
    values = np.full((len(rows), encoder.width), np.nan)
    for i, row in enumerate(rows):
        message = names[int(encoder.can_id[row])]
        for column, name in enumerate(encoder.columns(row)):
            s = message.signals[name]
            low, high = max(s.raw_valid[0], s.raw_limits[0]), min(s.raw_valid[1], s.raw_limits[1])
            if s.is_float:
                low, high = max(low, -1e30), min(high, 1e30)
            if low > high:
                low, high = s.raw_limits
            values[i, column] = rng.uniform(low, high) * s.scale + s.offset
    encoded = encoder.encode(rows, values)
    for i, row in enumerate(rows):
        message = names[int(encoder.can_id[row])]
        frame = oracle.get_message_by_name(message.name)
        theirs = frame.decode(bytes(encoded[2][i, : encoded[1][i]]), decode_choices=False)
        for column, name in enumerate(encoder.columns(row)):
            s = message.signals[name]
            tolerance = (
                abs(values[i, column]) * 1e-7
                if s.is_float
                else (0.5 + 1e-6) * abs(s.scale) + abs(values[i, column]) * 1e-15
            )
            assert abs(float(theirs[name]) - values[i, column]) <= tolerance, (message.name, name)
    # the same through our own decoder, which also vouches for check sums
    paths = [s.path for m in database.messages.values() for s in m.signals.values()]
    samples = decode(database.compile(paths), as_batch(encoded))
    assert not (samples.flag == Quality.CRC).any()
    column_of = {
        (i, f"{names[int(encoder.can_id[r])].name}.{n}"): c
        for i, r in enumerate(rows)
        for c, n in enumerate(encoder.columns(r))
    }
    for f, s, v in zip(samples.frame, samples.signal, samples.value, strict=True):
        if (int(f), paths[s]) in column_of:
            info = database.resolve(paths[s])
            meant = values[f, column_of[int(f), paths[s]]]
            assert v == pytest.approx(meant, rel=1e-7, abs=0.51 * abs(info.scale))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e9, -1e9, 5e300])
def test_what_our_own_signals_cannot_carry_leaves_as_not_available(bad: float) -> None:
    database = loaded(OWN)
    encoder = Encoder(database, list(database.messages))
    rows = np.arange(len(encoder.can_id))
    encoded = encoder.encode(rows, np.full((len(rows), encoder.width), bad))
    paths = [s.path for m in database.messages.values() for s in m.signals.values() if s.j1939]
    samples = decode(database.compile(paths), as_batch(encoded))
    assert len(samples) == len(paths)
    assert (samples.flag == Quality.NOT_AVAILABLE).all()


def test_an_error_is_told_from_a_missing_value() -> None:
    database = loaded(OWN)
    encoder = Encoder(database, list(database.messages))
    rows = np.arange(len(encoder.can_id))
    shape = (len(rows), encoder.width)
    encoded = encoder.encode(rows, np.zeros(shape), np.ones(shape, np.bool_))
    paths = [s.path for m in database.messages.values() for s in m.signals.values() if s.j1939]
    assert (decode(database.compile(paths), as_batch(encoded)).flag == Quality.ERROR).all()


@pytest.mark.parametrize("path", all_dbc(), ids=lambda p: p.name)
def test_no_value_raises(path: Path) -> None:
    database = loaded(path)
    encoder = Encoder(database, list(database.messages))
    rng = np.random.default_rng(1)
    rows = rng.integers(0, len(encoder.can_id), 500)
    values = rng.choice(
        [np.nan, np.inf, -np.inf, 0.0, -0.0, 1e308, -1e308, 1e-308, 1e19, -1e19, 2.0**63], (500, encoder.width)
    )
    encoder.encode(rows, values)


def test_a_message_without_signals_leaves_empty() -> None:
    encoder = Encoder(Database.load({"a.dbc": 'VERSION ""\nBS_:\nBU_: A\nBO_ 1 M: 3 A\n'}), ["M"])
    can_id, length, data = encoder.encode(np.zeros(2, np.intp), np.empty((2, encoder.width)))
    assert (can_id.tolist(), length.tolist(), data.any()) == ([1, 1], [3, 3], False)


def test_out_of_range_saturates_where_nothing_means_not_available() -> None:
    text = (
        'VERSION ""\nBS_:\nBU_: A\nBO_ 1 M: 8 A\n SG_ s : 0|8@1- (0.5,0) [-10|10] "" A\n'
        ' SG_ u : 8|8@1+ (1,0) [0|0] "" A\n'
        'BA_DEF_ SG_ "GenSigStartValue" FLOAT 0 255;\nBA_DEF_DEF_ "GenSigStartValue" 0;\n'
        'BA_ "GenSigStartValue" SG_ 1 u 7;\n'
    )
    database = Database.load({"a.dbc": text})
    encoder = Encoder(database, ["M"])
    values = np.array([[99.0, 300.0], [-99.0, -1.0], [np.nan, np.nan], [np.inf, -np.inf]])
    data = encoder.encode(np.zeros(4, np.intp), values)[2]
    oracle = cantools.database.load_string(text, "dbc")
    decoded = [oracle.decode_message("M", bytes(d)) for d in data]
    assert [d["s"] for d in decoded] == [10, -10, 0, 10]
    assert [d["u"] for d in decoded] == [255, 0, 7, 0]


def test_every_layout_counts_for_itself_and_goes_on_after_a_restart() -> None:
    database = loaded(OWN)
    encoder = Encoder(database, ["string_1_core"])
    rows = np.array([encoder.row("string_1_core", 1), encoder.row("string_1_core", 2), encoder.row("string_1_core", 1)])
    values = np.zeros((3, encoder.width))

    def counters() -> list[int]:
        return [int(b & 0x0F) for b in encoder.encode(rows, values)[2][:, 1]]

    assert counters() == [0, 0, 1]
    assert counters() == [2, 1, 3]
    kept = encoder.counters.copy()
    encoder = Encoder(database, ["string_1_core"])
    encoder.counters = kept
    assert counters() == [4, 2, 5]
    for _ in range(5):
        last = counters()
    assert last == [14, 7, 0]


def test_unknown_names_are_told_with_the_nearest() -> None:
    encoder = Encoder(loaded(OWN), ["string_1_core", "gateway_status"])
    with pytest.raises(ConfigError, match="did you mean 'gateway_status'"):
        encoder.row("gateway_stats")
    with pytest.raises(ConfigError, match="no layout for multiplexer '19'"):
        encoder.row("string_1_core", 19)
    with pytest.raises(ConfigError, match="did you mean 'core_01'"):
        encoder.column(encoder.row("string_1_core", 1), "core_1")
