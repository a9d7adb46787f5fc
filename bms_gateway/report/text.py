"""Encoding of a file that should be a table: UTF-8, UTF-16, Windows-1252, GB 18030; or that it is not text."""

import codecs
import io
import re
from typing import Any, Final

from bms_gateway.errors import DataError

__all__ = ["CALLED", "HEAD", "Recoded", "decoded", "refuse_others", "utf16"]

HEAD: Final = 512
"""First bytes that identify the kind of a file."""
_OTHERS: Final = (
    (b"PK\x03\x04", "an Excel workbook or a zip archive: save its sheet as CSV"),
    (b"\xd0\xcf\x11\xe0", "an Excel workbook: save its sheet as CSV"),
    (b"%PDF", "a PDF: a table is CSV or Parquet"),
    (b"PAR1", "a Parquet file: give it the ending .parquet"),
    (b"\x89HDF", "an HDF5 or MATLAB file: save its columns as CSV or Parquet"),
    (b"MATLAB", "a MATLAB file: save its columns as CSV or Parquet"),
    (b"\x1f\x8b", "packed by gzip: give it the ending .csv.gz"),
    (b"{", "JSON: a table is CSV or Parquet"),
    (b"[{", "JSON: a table is CSV or Parquet"),
)
_CONTROL: Final = frozenset(range(32)) - frozenset(b"\t\n\r\x0b\x0c\x1a\x1c\x1d\x1e\x1f")

CALLED: Final = {"cp1252": "Windows-1252", "gb18030": "GB 18030"}
"""Names of the encodings of one country or region."""
_HIGH: Final = re.compile(rb"[\x80-\xff]+")
_CHINESE: Final = re.compile(rb"([\xa1-\xa3\xb0-\xd7][\xa1-\xfe])+")
"""Signs (of which \u2103, a unit, is one) and the frequent characters; Windows-1252 has no words of such pairs."""


def refuse_others(path: object, head: bytes) -> None:
    """Refuse files that are clearly something else.

    Raises
    ------
    DataError
        The message says what to do.
    """
    for mark, what in _OTHERS:
        if head.startswith(mark):
            raise DataError(f"{path}: not a text table but {what}")
    if head.lstrip(b"\xef\xbb\xbf \t\r\n")[:14].lower().startswith((b"<!doctype html", b"<html", b"<?xml")):
        raise DataError(f"{path}: not a text table but a page of HTML or XML: a table is CSV or Parquet")


def utf16(head: bytes) -> str | None:
    """Name the codec of UTF-16, by its mark or by zeros in every second byte; None for another encoding.

    Examples
    --------
    >>> utf16("time_s;I".encode("utf-16-le")), utf16(b"time_s")
    ('utf-16-le', None)
    """
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    even, odd = head[: len(head) // 2 * 2 : 2], head[1::2]
    if len(odd) >= 4 and 0 not in even and odd.count(0) >= 0.9 * len(odd):
        return "utf-16-le"
    if len(even) >= 4 and 0 not in odd and even.count(0) >= 0.9 * len(even):
        return "utf-16-be"
    return None


class Recoded(io.RawIOBase):
    """UTF-16 as UTF-8, read in pieces.

    Parameters
    ----------
    source : binary file
    codec : str
        From `utf16`.
    path : object
        Name of the file in errors.
    """

    def __init__(self, source: Any, codec: str, path: object) -> None:
        self._source, self._path = source, path
        self._decoder = codecs.getincrementaldecoder(codec)()
        self._ready = b""

    def read(self, size: int = -1) -> bytes:
        """Return up to `size` bytes, nothing at the end.

        Raises
        ------
        DataError
            The content is not UTF-16.
        """
        while not self._ready:
            raw = self._source.read(size)
            try:
                self._ready = self._decoder.decode(raw, final=not raw).encode()
            except UnicodeError:
                raise DataError(f"{self._path}: not a text table: it begins as UTF-16 and is none") from None
            if not raw:
                break
        given, self._ready = self._ready[:size], self._ready[size:]
        return given


def decoded(path: object, raw: bytes, read: int, codec: str) -> tuple[str, str]:
    """Decode whole lines as UTF-8, and from the first byte that is not UTF-8 on as Windows-1252 or Chinese.

    Returns
    -------
    text, codec
        The codec of the following text.

    Raises
    ------
    DataError
        Neither.
    """
    bad = next((i for i, byte in enumerate(raw) if byte in _CONTROL), None) if _CONTROL.intersection(raw) else None
    if bad is None:
        try:
            return raw.decode("utf-8-sig" if not read and codec == "utf-8" else codec), codec
        except UnicodeDecodeError as e:
            bad = e.start
        try:
            codec = "gb18030" if all(map(_CHINESE.fullmatch, _HIGH.findall(raw))) else "cp1252"
            return raw.decode(codec), codec
        except UnicodeDecodeError as e:
            bad = e.start
    raise DataError(f"{path}: not a text table (byte {read + bad})")
