"""One rule for all text files of the user: the memory of the text counts, and where a file is no text is told."""

from pathlib import Path

import pytest

from bms_gateway.config import text_file
from bms_gateway.config.dbc_files import dbc_text
from bms_gateway.config.text_file import WINDOWS, decoded
from bms_gateway.config.toml import read_text
from bms_gateway.errors import ConfigError

MOST = 1000


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    monkeypatch.setattr(text_file, "PIECE", 7)


@pytest.mark.parametrize(
    ("text", "codec", "width"),
    [("a", "utf-8-sig", 1), ("ü", "utf-8-sig", 1), ("α", "utf-8-sig", 2), ("€", WINDOWS, 2), ("😀", "utf-8-sig", 4)],
)
def test_the_widest_character_counts_for_all(text, codec, width):
    for more, fits in ((0, True), (1, False)):
        whole = "x" * (MOST // width - 1 + more) + text
        raw = whole.encode(codec)
        if fits:
            assert decoded(raw, codec, Path("a"), MOST) == whole
        elif width > 1:
            with pytest.raises(ConfigError, match=rf"^a: its {len(whole)} .*, {width} for each because of '{text}'"):
                decoded(raw, codec, Path("a"), MOST)
        else:
            with pytest.raises(ConfigError, match=rf"^a: its {len(whole):,} characters take 0 MiB of memory; at most"):
                decoded(raw, codec, Path("a"), MOST)


@pytest.mark.parametrize("at", [0, 5, 6, 7, 8, 499])
def test_a_byte_that_is_no_text_is_found_in_a_large_file_too(at, tmp_path, monkeypatch):
    monkeypatch.setattr("bms_gateway.config.toml.MOST_BYTES", MOST)
    raw = bytearray(("ü" * 250).encode())
    raw[at - at % 2] = 0xFF
    (tmp_path / "a.toml").write_bytes(raw)
    with pytest.raises(ConfigError, match=rf"not UTF-8 text \(byte {at - at % 2}\)"):
        read_text(tmp_path / "a.toml")


def test_what_windows_does_not_define_is_replaced_in_a_large_file_too(tmp_path, monkeypatch):
    monkeypatch.setattr("bms_gateway.config.dbc_files.MOST_BYTES", MOST)
    (tmp_path / "a.dbc").write_bytes(b"x" * 400 + b"\xfc\x81")
    assert dbc_text(tmp_path / "a.dbc") == "x" * 400 + "ü\ufffd"
