"""`minimum`, `maximum`, `byte_order`, `signed` and `mask` of a signal: the config against its DBC."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.config.load import load_config
from bms_gateway.errors import ConfigError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.decode import decode
from bms_gateway.frames.quality import Quality
from tests.config.bench_cell import PARAMETERS, one_cell

DBC = """VERSION ""
BU_: X
BO_ 256 Pack: 8 X
 SG_ Current : 0|16@1+ (0.1,0) [0|819] "A" X
 SG_ Inner : 20|3@1+ (1,0) [0|0] "" X
 SG_ Odd : 36|12@1+ (1,0) [0|0] "" X
BO_ 257 Temps: 8 X
 SG_ T1 : 7|16@0- (0.1,0) [-40|60] "C" X
"""


def config(folder: Path, current: str, surface: str = '"Temps.T1"') -> Path:
    (folder / "car.dbc").write_text(DBC)
    (folder / "cell.toml").write_text(one_cell(2.3, **PARAMETERS["authors"]))
    path = folder / "gateway.toml"
    path.write_text(
        '[bus]\ndbc = ["car.dbc"]\n[[string]]\nname = "s"\nmodel = "cell.toml"\n[string.signals]\n'
        f"current = {current}\ncoolant_inlet = {{ constant_C = 20.0 }}\n[string.signals.surface]\n1 = {surface}\n"
    )
    return path


def read(path: Path, data: bytes, can_id: int = 256) -> dict[str, tuple[float, int]]:
    """Values and qualities of one frame by signal, as the engine would have them."""
    loaded = load_config(path)
    signals = [c.signal for c in loaded.plan.strings[0].channels if c.signal]
    row = np.frombuffer(data.ljust(8, b"\0"), np.uint8)[None]
    batch = FrameBatch(np.zeros(1, np.int64), np.array([can_id], np.uint32), np.array([8], np.uint8), row)
    s = decode(loaded.database.compile(signals), batch)
    return {signals[i]: (v, f) for i, v, f in zip(s.signal, s.value, s.flag, strict=True)}


def test_a_range_of_the_config_replaces_that_of_the_dbc(tmp_path) -> None:
    raw = (9000).to_bytes(2, "little")  # 900.0 A
    plain = read(config(tmp_path, '"Pack.Current"'), raw)
    assert plain["Pack.Current"] == (pytest.approx(900.0), Quality.OUT_OF_RANGE)
    wider = read(config(tmp_path, '{ signal = "Pack.Current", maximum = 1000.0 }'), raw)
    assert wider["Pack.Current"] == (pytest.approx(900.0), Quality.GOOD)
    narrower = read(config(tmp_path, '{ signal = "Pack.Current", minimum = 10.0 }'), (50).to_bytes(2, "little"))
    assert narrower["Pack.Current"][1] == Quality.OUT_OF_RANGE


def test_bits_are_read_as_the_config_says(tmp_path) -> None:
    signed = '{ signal = "Pack.Current", signed = true, minimum = -400, maximum = 400 }'
    assert read(config(tmp_path, signed), (-123).to_bytes(2, "little", signed=True))["Pack.Current"] == (
        pytest.approx(-12.3),
        Quality.GOOD,
    )
    turned = '{ signal = "Pack.Current", byte_order = "big_endian" }'
    assert read(config(tmp_path, turned), (1234).to_bytes(2, "big"))["Pack.Current"][0] == pytest.approx(123.4)
    back = '{ signal = "Temps.T1", byte_order = "little_endian" }'
    path = config(tmp_path, '"Pack.Current"', back)
    assert read(path, (-55).to_bytes(2, "little", signed=True), 257)["Temps.T1"][0] == pytest.approx(-5.5)


@pytest.mark.parametrize(
    ("mask", "signed", "raw", "value"),
    [
        (0x0FFF, False, 0xA07B, 12.3),  # the upper four bits are somebody else's
        (0x0FFF, True, 0xAF85, -12.3),  # the highest bit of the mask is the sign
        (0xFFF0, False, 0x0C3F, 312.0),  # what is left keeps the weight of its bits
        (0xFFFF, False, 0x007B, 12.3),
    ],
)
def test_bits_outside_the_mask_are_no_part_of_the_signal(mask, signed, raw, value, tmp_path) -> None:
    rest = f"mask = {mask:#x}, signed = {str(signed).lower()}, minimum = -400, maximum = 400 }}"
    little = config(tmp_path, f'{{ signal = "Pack.Current", {rest}')
    assert read(little, raw.to_bytes(2, "little"))["Pack.Current"] == (pytest.approx(value), Quality.GOOD)
    surface = f'{{ signal = "Temps.T1", {rest}'
    found = read(config(tmp_path, '"Pack.Current"', surface), raw.to_bytes(2, "big"), 257)["Temps.T1"]
    assert found == (pytest.approx(value), Quality.GOOD)


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("mask", [0x1, 0x800, 0x0F0, 0xFFF, 0xFFC, 0x7FF])
def test_a_mask_is_an_and_for_every_place(mask: int, big_endian: bool) -> None:
    from bms_gateway.config.overrides import overridden
    from bms_gateway.config.schema import Source
    from bms_gateway.frames.bits import BitFields, Place, words_of
    from bms_gateway.frames.dbc import parse

    info = {s.name: s for m in parse("car.dbc", DBC) for s in m.signals.values()}["Odd"]
    place = Place(33 if big_endian else 36, 12, big_endian=big_endian)
    narrow = overridden(replace(info, place=place), Source(signal="Pack.Odd", mask=mask))
    data = np.random.default_rng(1).integers(0, 256, (200, 8), np.uint8)
    row, field = np.arange(200), np.zeros(200, np.intp)

    def raw(p: Place) -> np.ndarray:
        fields = BitFields.build([p], 1, big_endian=True)
        return fields.raw(words_of(data, row, fields.words, fields.stride), row, field).astype(float)

    whole = raw(place).astype(int)
    assert (raw(narrow.place) * narrow.scale == (whole & mask)).all()


@pytest.mark.parametrize("byte", range(256))
def test_within_a_byte_both_orders_are_the_same_bits(byte: int) -> None:
    from bms_gateway.config.overrides import turned
    from bms_gateway.frames.bits import Place
    from bms_gateway.frames.dbc import parse

    info = {s.name: s for m in parse("car.dbc", DBC) for s in m.signals.values()}["Inner"]
    place = turned(info, True)
    assert place == Place(22, 3, big_endian=True)
    assert (byte >> 4) & 7 == (byte >> (place.start % 8 - place.size + 1)) & 7


@pytest.mark.parametrize(
    ("current", "part"),
    [
        ('{ signal = "Pack.Current", minimum = 5, maximum = 5 }', "not below maximum"),
        ('{ signal = "Pack.Current", minimum = 900 }', "as the DBC declares it"),
        ('{ signal = "Pack.Odd", byte_order = "big_endian" }', "not of whole bytes"),
        ('{ signal = "Pack.Current", byte_order = "motorola" }', "byte_order"),
        ('{ signal = "Pack.Current", maximun = 5 }', "did you mean 'maximum'"),
        ('{ signal = "Pack.Current", mask = 0x0F0F }', "not one run of ones"),
        ('{ signal = "Pack.Current", mask = 0x1FFFF }', "has 16 bits; valid: up to 0xffff"),
        ('{ signal = "Pack.Current", mask = 0 }', "mask"),
        ('{ signal = "Pack.Current", maximum = "5" }', "maximum"),
    ],
)
def test_what_cannot_be_is_one_line(current: str, part: str, tmp_path) -> None:
    with pytest.raises(ConfigError) as told:
        load_config(config(tmp_path, current))
    assert part in str(told.value)
    assert "gateway.toml" in str(told.value)
    assert "\n" not in str(told.value)


def test_a_constant_has_no_range(tmp_path) -> None:
    path = config(tmp_path, '"Pack.Current"')
    path.write_text(path.read_text().replace("constant_C = 20.0", "constant_C = 20.0, minimum = 3.0"))
    with pytest.raises(ConfigError, match="belong to a signal"):
        load_config(path)


def test_strings_that_say_different_things_of_a_signal_are_refused(tmp_path) -> None:
    path = config(tmp_path, '{ signal = "Pack.Current", maximum = 1000.0 }')
    again = path.read_text().split("[[string]]")[1].replace('"s"', '"t"').replace("1000.0", "900.0")
    path.write_text(path.read_text() + "[[string]]" + again)
    with pytest.raises(ConfigError, match="is otherwise at"):
        load_config(path)


@pytest.mark.parametrize("scale", ["1", "-1", "0.001", "1000", "2.5E-7"])
@pytest.mark.parametrize("kind", [1, 2])
def test_a_floating_point_signal_may_have_any_sensible_scale(scale: str, kind: int, tmp_path) -> None:
    path = config(tmp_path, '"Pack.Current"')
    float_dbc = DBC.replace("0|16@1+ (0.1,0) [0|819]", f"0|{32 * kind}@1- ({scale},0) [0|0]")
    float_dbc = "\n".join(line for line in float_dbc.splitlines() if "Inner" not in line and "Odd" not in line)
    (tmp_path / "car.dbc").write_text(f"{float_dbc}\nSIG_VALTYPE_ 256 Current : {kind};\n")
    raw = np.array([12.5 / float(scale)], "<f4" if kind == 1 else "<f8").tobytes()
    value, quality = read(path, raw)["Pack.Current"]
    assert (value, quality) == (pytest.approx(12.5, rel=1e-6), Quality.GOOD)


def test_a_floating_point_signal_of_a_senseless_scale_is_one_line(tmp_path) -> None:
    path = config(tmp_path, '"Pack.Current"')
    text = DBC.replace("0|16@1+ (0.1,0) [0|819]", "0|32@1- (1E300,0) [0|0]")
    text = "\n".join(line for line in text.splitlines() if "Inner" not in line and "Odd" not in line)
    (tmp_path / "car.dbc").write_text(f"{text}\nSIG_VALTYPE_ 256 Current : 1;\n")
    with pytest.raises(ConfigError, match=r"scale 1e\+300 .* valid: 6e-09 to 6e\+15"):
        load_config(path)
