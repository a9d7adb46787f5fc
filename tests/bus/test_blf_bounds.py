"""What a damaged or hostile BLF can make its reader hold, and how each kind of damage is told."""

import io
import struct
import zlib

import can
import pytest
from can.io import blf
from can.io.blf import BLFParseError

from bms_gateway.bus import blf as bounds
from bms_gateway.bus.blf import BoundedBlf

MIB = 1 << 20


@pytest.fixture(autouse=True)
def one_mib(monkeypatch):
    assert bounds.MOST == 16 * MIB
    monkeypatch.setattr(bounds, "MOST", MIB)


def of(*objects):
    """A reader of a BLF with these objects behind its header."""
    written = io.BytesIO()
    writer = can.BLFWriter(written)
    header = written.getvalue()
    del writer
    return BoundedBlf(io.BytesIO(header + b"".join(objects)))


def put(kind, body, signature=b"LOBJ", size=None):
    """An object of a BLF with what follows its header, padded as writers do."""
    size = 16 + len(body) if size is None else size
    return struct.pack("<4sHHII", signature, 16, 1, size, kind) + body + bytes(len(body) % 4)


def container(data, method=2):
    packed = zlib.compress(data) if method == 2 else data
    return put(10, struct.pack("<H6xI4x", method, len(data)) + packed)


def frame(can_id):
    return struct.pack("<4sHHIIIHHQHBBI8s", b"LOBJ", 32, 1, 48, 1, 2, 0, 0, 0, 1, 0, 8, can_id, bytes(8))


def read(reader, most=10):
    """Identifiers, and the errors between them."""
    found = []
    for _ in range(most):
        try:
            for message in reader:
                found.append(message.arbitration_id)
        except BLFParseError as error:
            found.append(str(error))
        else:
            return found
    raise AssertionError("no end")


def test_containers_packed_or_not_are_read_and_other_objects_passed_over():
    other = put(65, b"a comment of 19 b..")
    assert read(of(container(frame(1) + frame(2)), other, container(frame(3), method=0))) == [1, 2, 3]


def test_what_is_none_is_told_by_its_kind():
    junk = put(10, bytes(16), signature=b"JUNK")
    assert read(of(container(frame(1)), junk, container(frame(2)))) == [1, *["not an object of a BLF"] * 2, 2]
    assert read(of(container(frame(1), method=7), container(frame(2)))) == ["a container packed by method 7", 2]


def test_a_container_unpacks_to_so_many_bytes_and_no_more():
    for size, told in ((MIB - 1, None), (MIB + 1, "a container of over 1 MiB")):
        packed = struct.pack("<H6xI4x", 2, size) + zlib.compress(bytes(size))
        if told is None:
            assert len(bounds.unpacked(packed)) == size
        else:
            with pytest.raises(BLFParseError, match=f"^{told}$"):
                bounds.unpacked(packed)


def test_an_object_that_claims_the_containers_behind_it_is_left_at_some_length():
    claims = struct.pack("<4sHHIIIHHQ", b"LOBJ", 32, 1, 10 * MIB, 1, 2, 0, 0, 0)
    reader = of(container(claims + bytes(MIB - 5000)), container(bytes(5000 - len(claims))))
    assert read(reader) == []
    reader = of(container(claims + bytes(MIB - 5000)), container(bytes(5001 - len(claims))), container(frame(4)))
    assert read(reader) == ["an object of over 1 MiB", 4]


def test_nothing_huge_is_read_at_once_whatever_a_header_claims():
    source = io.BytesIO(bytes(3 * MIB))
    file = bounds.Bounded(source)
    assert (len(file.read(0)), len(file.read(MIB))) == (0, MIB)
    for size, told in ((MIB + 1, "a record of 1 MiB"), (5 * MIB, "a record of 5 MiB"), (-1, "a record of -1 MiB")):
        with pytest.raises(BLFParseError, match=f"^{told}$"):
            file.read(size)
    file.close()
    assert source.closed
    assert read(of(put(10, b"", size=7 * MIB + 16)))[:1] == ["a record of 7 MiB"]
    assert blf.OBJ_HEADER_BASE_STRUCT.size == 16
