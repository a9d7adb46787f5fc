"""Gzip data as a file: the same bytes as gzip gives, and an end to those that never end."""

import gzip
import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_gateway import gunzip
from bms_gateway.errors import DataError
from bms_gateway.gunzip import Gunzip


def read(packed, size=1000):
    """All that comes, and whether it ended well."""
    source, found = Gunzip(io.BytesIO(packed), "a.gz"), b""
    try:
        while piece := source.read(size):
            found += piece
    except EOFError:
        return found, False
    return found, True


@given(
    parts=st.lists(st.binary(max_size=3000), min_size=1, max_size=4),
    zeros=st.integers(0, 20),
    size=st.integers(1, 5000),
)
def test_it_reads_what_gzip_reads(parts, zeros, size):
    packed = b"".join(map(gzip.compress, parts)) + bytes(zeros)
    assert gzip.decompress(packed) == b"".join(parts)
    assert read(packed, size) == (b"".join(parts), True)


@given(data=st.binary(min_size=1, max_size=3000), at=st.floats(0, 1, exclude_max=True))
def test_data_that_are_cut_give_what_is_before_and_say_so(data, at):
    packed = gzip.compress(data)
    cut = packed[: max(1, int(at * len(packed)))]
    found, whole = read(cut)
    assert data.startswith(found)
    assert not whole


def test_what_is_no_gzip_data_or_damaged_says_so():
    packed = gzip.compress(bytes(1000))
    for data in (b"abc", packed[:-8] + bytes(8), packed + b"abc"):
        assert not read(data)[1]
    assert read(b"") == (b"", True)


def test_what_unpacks_to_far_too_much_is_refused(monkeypatch):
    monkeypatch.setattr(gunzip, "FREE", 1 << 20)
    bomb = gzip.compress(bytes(8 << 20))
    with pytest.raises(DataError, match=r"a\.gz: unpacks to over 256 times its size"):
        read(bomb, 1 << 16)
    assert read(gzip.compress(bytes(1 << 20)))[1]
    sound = gzip.compress(bytes(range(256)) * 64, 0)
    assert len(read(sound * 200)[0]) == 200 * 256 * 64  # however much it is


def test_no_more_is_unpacked_than_is_asked_for():
    source = Gunzip(io.BytesIO(gzip.compress(bytes(10 << 20))), "a.gz")
    assert [len(source.read(10)) for _ in range(3)] == [10, 10, 10]
