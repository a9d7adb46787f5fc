"""Names, errors and edges of the DBC look-up and of the decoder."""

import numpy as np
import pytest

from bms_gateway.errors import ConfigError
from bms_gateway.frames.batch import EXTENDED, FrameBatch
from bms_gateway.frames.database import Database
from bms_gateway.frames.decode import decode
from bms_gateway.frames.quality import Quality
from tests.data import need
from tests.frames.payloads import OWN, batch_of, text_of

HEAD = 'VERSION ""\nBS_:\nBU_: A\n'


def load(body: str) -> Database:
    return Database.load({"a.dbc": HEAD + body})


def refused(body: str) -> str:
    with pytest.raises(ConfigError) as problem:
        load(body)
    assert "\n" not in str(problem.value)
    return str(problem.value)


def test_val_lines_without_a_signal_are_named_with_the_remedy() -> None:
    path = need("dbc", "uwfe_2024CAR_original.dbc")
    with pytest.raises(ConfigError) as problem:
        Database.load({path.name: text_of(path)})
    text = str(problem.value)
    lines = text_of(path).splitlines()
    for number in (1321, 1322):
        assert f"line {number} " in text
        assert lines[number - 1].strip().startswith("VAL_ 2147483648 StateContactor")
    assert text.startswith(path.name)
    assert "remove these lines" in text


@pytest.mark.parametrize(
    ("body", "told"),
    [
        (
            'BO_ 1 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n SG_ t : 4|8@1+ (1,0) [0|0] "" A\n',
            "line 6: signals t and s",
        ),
        ('BO_ 1 M: 8 A\n SG_ s : 60|8@1+ (1,0) [0|0] "" A\n', "line 5: signal s does not fit"),
        (
            'BO_ 1 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\nVAL_ 1 t 0 "off";\n',
            "line 6 (VAL_ of t): no message has such a signal; remove this line",
        ),
        (
            'BO_ 1 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\nVAL_ 1 t 0 "off";\nVAL_ 1 u 0 "off";\n',
            "line 6 (VAL_ of t), line 7 (VAL_ of u): no message has such a signal; remove these lines",
        ),
        (
            'BO_ 1 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n'
            + "".join(f'VAL_ 1 t{k} 0 "off";\n' for k in range(2000)),
            "line 6 (VAL_ of t0), line 7 (VAL_ of t1), line 8 (VAL_ of t2), line 9 (VAL_ of t3), line 10 (VAL_ of t4) "
            "and 1995 more: no message has such a signal; remove these lines",
        ),
        ('BO_ 1 M: 8 A\n SG_ s 0|8@1+ (1,0) [0|0] "" A\n', "line 5, column"),
        ('BO_ 5000 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n', "0x1388"),
        ('BO_ 1 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\nBO_ 1 N: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n', "0x1"),
    ],
)
def test_a_refused_dbc_is_explained_in_one_line(body: str, told: str) -> None:
    text = refused(body)
    assert text.startswith("a.dbc: ")
    assert told in text


def test_one_identifier_in_two_files_is_refused() -> None:
    text = HEAD + 'BO_ 291 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n'
    with pytest.raises(ConfigError, match=r"b\.dbc: message N has the identifier 0x123 of M in a\.dbc"):
        Database.load({"a.dbc": text, "b.dbc": text.replace(" M:", " N:")})


def test_one_message_name_in_two_files_is_told_when_used() -> None:
    text = HEAD + 'BO_ 291 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n'
    database = Database.load({"a.dbc": text, "b.dbc": text.replace("291", "292")})
    with pytest.raises(ConfigError, match=r"in a\.dbc and in b\.dbc"):
        database.resolve("M.s")


@pytest.mark.parametrize(
    ("path", "told"),
    [
        ("string_1_electric.current", "did you mean 'string_1_electrical'"),
        ("string_1_electrical.curent", "did you mean 'current'"),
        ("hottest_core", "did you mean 'string_1_summary.hottest_core'"),
    ],
)
def test_misspelt_names_get_the_nearest(path: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        Database.load({"bms_gateway.dbc": text_of(OWN)}).resolve(path)


def test_a_signal_of_scale_zero_is_refused_when_it_is_wanted() -> None:
    database = load('BO_ 1 M: 8 A\n SG_ s : 0|8@1+ (0,0) [0|0] "" A\n')
    with pytest.raises(ConfigError, match="scale 0"):
        database.compile(["M.s"])


NESTED = (
    'BO_ 1 M: 8 A\n SG_ a M : 0|4@1+ (1,0) [0|0] "" A\n SG_ b m1M : 4|4@1+ (1,0) [0|0] "" A\n'
    ' SG_ x m0 : 8|8@1+ (1,0) [0|0] "" A\n SG_ y m2 : 8|8@1+ (1,0) [0|0] "" A\n SG_ z m3 : 8|8@1+ (1,0) [0|0] "" A\n'
    ' SG_ r : 56|8@1+ (1,0) [0|0] "" A\nSG_MUL_VAL_ 1 b a 1-1;\nSG_MUL_VAL_ 1 x a 0-0, 5-6;\n'
    "SG_MUL_VAL_ 1 y b 2-2;\nSG_MUL_VAL_ 1 z b 3-3;\n"
)


def test_nested_multiplexers_and_ranges_select_their_signals() -> None:
    names = ["M.r", "M.x", "M.y", "M.z"]
    table = load(NESTED).compile(names)
    first = [0x00, 0x05, 0x16, 0x21, 0x31, 0x41, 0x20, 0x07]
    samples = decode(table, batch_of([(1, bytes([b, 9, 0, 0, 0, 0, 0, 7])) for b in first]))
    got = [[names[s] for s in samples.signal[samples.frame == f]] for f in range(len(first))]
    assert got == [
        ["M.r", "M.x"],
        ["M.r", "M.x"],
        ["M.r", "M.x"],
        ["M.r", "M.y"],
        ["M.r", "M.z"],
        ["M.r"],
        ["M.r", "M.x"],
        ["M.r"],
    ]


def test_frames_too_short_for_a_signal_are_errors_and_too_short_for_a_multiplexer_say_nothing() -> None:
    table = load(NESTED).compile(["M.r", "M.x"])
    samples = decode(table, batch_of([(1, b"\x00\x09"), (1, b"\x00"), (1, b""), (1, bytes(8) + b"\x01" * 4)]))
    told = [
        (int(f), int(s), Quality(q).name) for f, s, q in zip(samples.frame, samples.signal, samples.flag, strict=True)
    ]
    assert told == [
        *((0, 0, "ERROR"), (0, 1, "GOOD")),
        *((1, 0, "ERROR"), (1, 1, "ERROR")),
        (2, 0, "ERROR"),
        *((3, 0, "GOOD"), (3, 1, "GOOD")),
    ]
    assert np.isnan(samples.value[samples.flag == Quality.ERROR]).all()


def test_eleven_and_29_bit_identifiers_of_one_number_are_different() -> None:
    table = load('BO_ 2147483649 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n').compile(["M.s"])
    assert list(decode(table, batch_of([(1, bytes(8)), (1 | EXTENDED, bytes(8))])).frame) == [1]


def test_values_at_a_declared_end_are_good_and_one_step_beyond_are_not() -> None:
    # 655.35 − 100 is not a binary number: comparing physical values would reject the end of the range
    table = load('BO_ 1 M: 8 A\n SG_ s : 0|16@1+ (0.01,-100) [-99.99|555.34] "" A\n').compile(["M.s"])
    raws = [0, 1, 2, 65533, 65534, 65535]
    flags = decode(table, batch_of([(1, r.to_bytes(2, "little") + bytes(6)) for r in raws])).flag
    assert [Quality(f).name for f in flags] == ["OUT_OF_RANGE", "GOOD", "GOOD", "GOOD", "GOOD", "OUT_OF_RANGE"]


def test_labels_of_the_value_table_and_j1939_ranges_tell_missing_from_failed() -> None:
    labelled = load(
        'BO_ 1 M: 8 A\n SG_ s : 0|8@1+ (0.5,-40) [-40|80] "C" A\n'
        'VAL_ 1 s 254 "Sensor error" 255 "SNA" 3 "Invalid" 4 "warm" ;\n'
    ).compile(["M.s"])
    flags = decode(labelled, batch_of([(1, bytes([r, *bytes(7)])) for r in (3, 4, 250, 254, 255)])).flag
    assert [Quality(f).name for f in flags] == ["ERROR", "GOOD", "OUT_OF_RANGE", "ERROR", "NOT_AVAILABLE"]
    standard = load(
        'BO_ 2364540158 M: 8 A\n SG_ s : 0|16@1+ (0.125,0) [0|8031.875] "" A\n'
        'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
        'BA_DEF_DEF_ "VFrameFormat" "J1939PG";\nBA_ "VFrameFormat" BO_ 2364540158 3;\n'
    ).compile(["M.s"])
    raws = (0xFAFF, 0xFB00, 0xFE00, 0xFEFF, 0xFF00, 0xFFFF)
    flags = decode(standard, batch_of([(2364540158, r.to_bytes(2, "little") + bytes(6)) for r in raws])).flag
    expected = ["GOOD", "OUT_OF_RANGE", "ERROR", "ERROR", "NOT_AVAILABLE", "NOT_AVAILABLE"]
    assert [Quality(f).name for f in flags] == expected


def test_batches_of_any_width_and_none_at_all_are_read() -> None:
    text = 'BO_ 1 M: 8 A\n SG_ s : 7|16@0- (1,0) [0|0] "" A\nBO_ 2 L: 64 A\n SG_ t : 500|12@1+ (1,0) [0|0] "" A\n'
    table = load(text).compile(["M.s", "L.t"])
    narrow = decode(table, batch_of([(1, b"\xff\xfe" + bytes(6)), (2, bytes(8))]))
    assert list(narrow.value[:1]) == [-2.0]
    assert list(narrow.flag) == [Quality.GOOD, Quality.ERROR]
    wide = decode(load(text).compile(["M.s"]), batch_of([(1, b"\xff\xfe" + bytes(6))], width=64))
    assert list(wide.value) == [-2.0]
    assert len(decode(table, FrameBatch.empty())) == 0
    assert len(decode(load(text).compile([]), batch_of([(1, bytes(8))]))) == 0


def test_how_a_batch_is_cut_changes_nothing() -> None:
    database = Database.load({"bms_gateway.dbc": text_of(OWN)})
    table = database.compile([s.path for m in database.messages.values() for s in m.signals.values()])
    rng = np.random.default_rng(5)
    ids = np.array([m.can_id for m in database.messages.values()], np.uint32)
    n = 300
    batch = FrameBatch(
        np.arange(n, dtype=np.int64),
        rng.choice(ids, n),
        np.full(n, 8, np.uint8),
        rng.integers(0, 256, (n, 8)).astype(np.uint8),
    )
    whole = decode(table, batch)
    for cut in (1, 7, 64):
        parts = [(start, decode(table, batch[start : start + cut])) for start in range(0, n, cut)]
        np.testing.assert_array_equal(np.concatenate([start + p.frame for start, p in parts]), whole.frame)
        np.testing.assert_array_equal(np.concatenate([p.signal for _, p in parts]), whole.signal)
        np.testing.assert_array_equal(np.concatenate([p.value for _, p in parts]), whole.value)
        np.testing.assert_array_equal(np.concatenate([p.flag for _, p in parts]), whole.flag)
