"""Corners of the tables that no DBC at hand goes into: layouts, limits and names that cannot be."""

import numpy as np
import pytest

from bms_gateway.errors import ConfigError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.counter import CounterGuard
from bms_gateway.frames.database import Database
from bms_gateway.frames.decode import decode
from bms_gateway.frames.encode import Encoder
from bms_gateway.frames.own_dbc import MAX_CELLS, MAX_STRINGS, input_messages, own_signal
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.rules import default_rule
from tests.frames.payloads import OWN, batch_of, loaded

HEAD = 'VERSION ""\nBS_:\nBU_: A\n'


def database(*lines: str, length: int = 8) -> Database:
    return Database.load({"a.dbc": HEAD + f"BO_ 1 M: {length} A\n" + "".join(f" SG_ {x} A\n" for x in lines)})


def frame(db: Database, **values: float) -> tuple[Encoder, np.ndarray]:
    encoder = Encoder(db, ["M"])
    row = np.full((1, encoder.width), np.nan)
    for name, value in values.items():
        row[0, encoder.column(0, name)] = value
    return encoder, encoder.encode(np.zeros(1, np.intp), row)[2]


def test_a_multiplexer_wider_than_32_bits_is_refused() -> None:
    db = database('mux M : 0|33@1+ (1,0) [0|0] ""', 'a m1 : 40|8@1+ (1,0) [0|0] ""')
    with pytest.raises(ConfigError, match=r"a.dbc: multiplexer M.mux is wider than 32 bits"):
        db.compile(["M.a"])


def test_a_signal_of_scale_0_is_neither_read_nor_sent() -> None:
    db = database('a : 0|8@1+ (0,5) [0|0] ""')
    assert db.message("M").signals["a"].raw_valid == (0.0, 255.0)
    for use in (lambda: db.compile(["M.a"]), lambda: Encoder(db, ["M"])):
        with pytest.raises(ConfigError, match=r"signal M.a has the scale 0"):
            use()


def test_an_inlet_may_jump_further_than_a_cell_and_need_not_move() -> None:
    rule = default_rule("coolant_inlet", None)
    assert (rule.jump, rule.needs_proof, rule.stuck_after_s) == (10.0, False, np.inf)
    assert rule.stale_after_ns == 10_000_000_000


@pytest.mark.parametrize("cell", [None, 0, MAX_CELLS + 1])
def test_our_dbc_has_no_room_for_more_cells_or_strings(cell) -> None:
    with pytest.raises(ConfigError, match=f"signals for cells 1 to {MAX_CELLS}"):
        own_signal(1, "surface", cell)
    with pytest.raises(ConfigError, match=f"has strings 1 to {MAX_STRINGS}"):
        input_messages(MAX_STRINGS + 1)
    with pytest.raises(ConfigError, match="string number 0"):
        own_signal(0, "current")


@pytest.mark.parametrize(
    ("place", "values"),
    [
        ("60|12@1+", (0, 1, 0xABC, 0xFFF)),
        ("60|12@1-", (-2048, -1, 5, 2047)),
        ("59|12@0+", (0, 1, 0xABC, 0xFFF)),
        ("32|40@1+", (0, 1, (1 << 40) - 1)),
    ],
)
def test_signals_across_words_are_written_and_read_alike(place, values) -> None:
    db = database(f'a : {place} (1,0) [0|0] ""', length=16)
    table = db.compile(["M.a"])
    for value in values:
        _, data = frame(db, a=value)
        assert decode(table, batch_of([(1, data[0].tobytes())])).value.tolist() == [value]


def test_more_layouts_than_anybody_sends_are_refused() -> None:
    signals, steps = [], []
    for k in range(13):
        signals.append(
            f' SG_ m{k} M : {4 * k}|1@1+ (1,0) [0|0] "" A\n SG_ a{k} m1 : {4 * k + 1}|1@1+ (1,0) [0|0] "" A\n'
        )
        steps.append(f"SG_MUL_VAL_ 1 a{k} m{k} 0-1;\n")
    db = Database.load({"a.dbc": HEAD + "BO_ 1 M: 8 A\n" + "".join(signals) + "\n" + "".join(steps)})
    with pytest.raises(ConfigError, match="message M has over 4096 multiplexer combinations"):
        Encoder(db, ["M"])


def test_a_big_endian_multiplexer_is_written_where_it_is_read() -> None:
    db = database('mux M : 7|12@0+ (1,0) [0|0] ""', 'a m2748 : 23|8@0+ (1,0) [0|0] ""')
    encoder, data = frame(db, a=7)
    assert encoder.row("M", 0xABC) == 0
    assert data[0, :3].tolist() == [0xAB, 0xC0, 7]
    assert decode(db.compile(["M.a"]), batch_of([(1, data[0].tobytes())])).value.tolist() == [7.0]


def test_a_declared_range_that_holds_no_raw_value_does_not_stop_sending() -> None:
    db = database('a : 0|8@1+ (10,0) [3|7] ""')
    _, data = frame(db, a=120)
    assert data[0, 0] == 12


def test_a_signal_named_without_its_message_is_told_with_it() -> None:
    db = database('a : 0|8@1+ (1,0) [0|0] ""')
    with pytest.raises(ConfigError, match=r"did you mean 'M.a'"):
        db.resolve("a")
    own = loaded(OWN)
    with pytest.raises(ConfigError, match=r"not of the form Message.Signal; did you mean 'gateway_status'"):
        own.resolve("gateway_stats")


def test_where_all_check_sums_are_wrong_no_counter_is_followed() -> None:
    db = loaded(OWN)
    table = db.compile(["string_1_electrical.current"])
    can_id = db.message("string_1_electrical").can_id
    samples = decode(table, batch_of([(can_id, bytes(8)), (can_id, b"\x01" * 8)]))
    guard = CounterGuard(table)
    flag, repeated = guard.follow(samples)
    assert flag.tolist() == [Quality.CRC, Quality.CRC]
    assert repeated.tolist() == []
    assert (guard.last == -1).all()


EXTENDED_MUX = HEAD + (
    "BO_ 1 M: 8 A\n"
    ' SG_ s0 M : 0|8@1+ (1,0) [0|0] "" A\n SG_ s1 m0M : 8|8@1+ (1,0) [0|0] "" A\n'
    ' SG_ a m1 : 16|8@1+ (1,0) [0|0] "" A\n SG_ b m5 : 24|8@1+ (1,0) [0|0] "" A\n SG_ c m6 : 32|8@1+ (1,0) [0|0] "" A\n'
    "\nSG_MUL_VAL_ 1 s1 s0 0-0;\nSG_MUL_VAL_ 1 a s0 1-1;\nSG_MUL_VAL_ 1 b s1 5-5;\nSG_MUL_VAL_ 1 c s1 6-6;\n"
)


def test_nested_multiplexers_are_followed_as_far_as_the_frame_reaches() -> None:
    table = Database.load({"a.dbc": EXTENDED_MUX}).compile(["M.a", "M.b"])
    frames = [b"\x01\0\x0b", b"\0\x05\0\x0c", b"\0\x06\0\0\x0d", b"\0\x07", b"\0", b"\x02"]
    samples = decode(table, batch_of([(1, f) for f in frames]))
    assert list(zip(samples.frame.tolist(), samples.value.tolist(), strict=True)) == [(0, 11.0), (1, 12.0)]
    assert samples.unknown.tolist() == [3, 4, 5]


def test_independent_multiplexers_are_followed_side_by_side() -> None:
    text = HEAD + (
        "BO_ 1 M: 8 A\n"
        ' SG_ s0 M : 0|8@1+ (1,0) [0|0] "" A\n SG_ s1 M : 8|8@1+ (1,0) [0|0] "" A\n'
        ' SG_ a m1 : 16|8@1+ (1,0) [0|0] "" A\n SG_ b m2 : 24|8@1+ (1,0) [0|0] "" A\n'
        "\nSG_MUL_VAL_ 1 a s0 1-1;\nSG_MUL_VAL_ 1 b s1 2-2;\n"
    )
    table = Database.load({"a.dbc": text}).compile(["M.a", "M.b"])
    assert table.switches.several
    for frames, expected in (
        ([b"\x01\x02\x0b\x0c"], [(0, 11.0), (0, 12.0)]),
        ([b"\x01\x02\x0b\x0c", b"\x01"], [(0, 11.0), (0, 12.0), (1, np.nan)]),
        ([b"\x09\x09\0\0"], []),
        ([b"\x01\x09\x0b\0"], [(0, 11.0)]),
    ):
        samples = decode(table, batch_of([(1, f) for f in frames]))
        got = list(zip(samples.frame.tolist(), samples.value.tolist(), strict=True))
        np.testing.assert_array_equal(np.array(got), np.array(expected))


INDEPENDENT = (
    "BO_ 1 M: 8 A\n"
    ' SG_ s0 M : 16|8@1+ (1,0) [0|0] "" A\n SG_ s1 M : 24|8@1+ (1,0) [0|0] "" A\n'
    ' SG_ a m0 : 32|8@1+ (1,0) [0|0] "" A\n SG_ b m0 : 40|8@1+ (1,0) [0|0] "" A\n SG_ c m1 : 48|8@1+ (1,0) [0|0] "" A\n'
)
SELECTED = "\nSG_MUL_VAL_ 1 a s0 0-0;\nSG_MUL_VAL_ 1 b s1 0-0;\nSG_MUL_VAL_ 1 c s1 1-1;\n"


def test_a_frame_too_short_for_one_of_its_multiplexers_is_told_and_the_other_followed() -> None:
    """Bytes that are not there are zero, which is a value that selects something."""
    table = Database.load({"a.dbc": HEAD + INDEPENDENT + SELECTED}).compile(["M.a", "M.b"])
    samples = decode(table, batch_of([(1, bytes((0, 0, 0, 0, 7, 8))), (1, bytes(3))]))
    assert samples.unknown.tolist() == [1]
    assert samples.frame.tolist() == [0, 0, 1]
    np.testing.assert_array_equal(samples.value, [7.0, 8.0, np.nan])
    assert samples.flag.tolist() == [Quality.GOOD, Quality.GOOD, Quality.ERROR]


def test_a_multiplexer_value_that_the_dbc_knows_is_not_strange_though_nobody_wants_it() -> None:
    for signals in (["M.b"], ["M.a", "M.b"]):
        table = Database.load({"a.dbc": HEAD + INDEPENDENT + SELECTED}).compile(signals)
        samples = decode(table, batch_of([(1, bytes((0, 0, 1, 1, 7, 8, 9)))]))
        assert samples.unknown.tolist() == ([0] if "M.a" in signals else [])
        samples = decode(table, batch_of([(1, bytes((0, 0, 0, 1, 7, 8, 9)))]))
        assert samples.unknown.tolist() == []
        assert samples.value.tolist() == ([7.0] if "M.a" in signals else [])


def test_frames_with_independent_multiplexers_are_checked_once_each() -> None:
    plain = 'BO_ 2 N: 8 A\n SG_ d : 16|8@1+ (1,0) [0|0] "" A\n'
    protection = (
        'BA_DEF_ BO_ "E2EProfile" ENUM "None","AUTOSAR_P01_1A";\nBA_DEF_ BO_ "E2EDataID" INT 0 65535;\n'
        'BA_DEF_DEF_ "E2EProfile" "None";\nBA_DEF_DEF_ "E2EDataID" 0;\n'
        'BA_ "E2EProfile" BO_ 1 1;\nBA_ "E2EDataID" BO_ 1 4660;\n'
    )
    db = Database.load({"a.dbc": HEAD + INDEPENDENT + plain + protection + SELECTED})
    table = db.compile(["M.a", "M.b", "N.d"])
    assert table.switches.several
    encoder = Encoder(db, ["M", "N"])
    rows = np.array([encoder.row("M", 0, 0), encoder.row("N"), encoder.row("M", 0, 0), encoder.row("M", 0, 1)])
    values = np.full((4, encoder.width), 5.0)
    can_id, length, data = encoder.encode(rows, values)
    data[2, 4] ^= 1
    samples = decode(table, FrameBatch(np.arange(4), can_id, length, data))
    p = samples.protected
    assert (p.frame.tolist(), p.crc_ok.tolist()) == ([0, 2, 3], [True, False, True])
    assert p.counter.tolist() == [0, 1, 0]
    assert list(zip(samples.frame.tolist(), samples.flag.tolist(), strict=True)) == [
        *((0, Quality.GOOD), (0, Quality.GOOD), (1, Quality.GOOD)),
        *((2, Quality.CRC), (2, Quality.CRC), (3, Quality.GOOD)),
    ]


def test_joined_batches_keep_their_frames_in_order_and_are_as_wide_as_the_widest() -> None:
    one, two = batch_of([(1, b"a"), (2, b"bc")]), batch_of([(3, bytes(range(12)))])
    none = FrameBatch.empty()
    assert len(FrameBatch.concat([])) == len(FrameBatch.concat([none, none])) == 0
    assert FrameBatch.concat([none, one, none]) is one
    assert FrameBatch.concat([one, one]).data.shape == (4, 8)
    both = FrameBatch.concat([one, none, two])
    assert both.can_id.tolist() == [1, 2, 3]
    assert both.length.tolist() == [1, 2, 12]
    assert both.time_ns.tolist() == [*one.time_ns, *two.time_ns]
    assert [bytes(d[:n]) for d, n in zip(both.data, both.length, strict=True)] == [b"a", b"bc", bytes(range(12))]
    assert both[1:].can_id.tolist() == [2, 3]
