"""Text files of the user as bytes and as text, with one rule for all of how much memory they may take.

A file is limited in bytes, and its text by the same number of bytes in memory: Python stores every character of a text
with as many bytes as the widest one, so a single character beyond the Latin ones doubles or quadruples a text.
"""

import codecs
import os
import re
import select
import stat
import time
from pathlib import Path
from typing import Final

from bms_gateway import errors
from bms_gateway.config.read_bounds import READ_S
from bms_gateway.errors import ConfigError

__all__ = ["WINDOWS", "decoded", "nearest_file", "read_bytes"]

PIECE: Final = 1 << 20
WINDOWS: Final = "cp1252"
"""Encoding of tools without UTF-8; undefined bytes are replaced."""
_WIDE: Final = ((4, re.compile("[\U00010000-\U0010ffff]")), (2, re.compile("[\u0100-\uffff]")))
"""Bytes per character of a text that contains a character like these."""


def decoded(raw: bytes, codec: str, path: Path, most: int) -> str:
    """Decode the content of a file, unless its text would take more than `most` bytes of memory.

    Parameters
    ----------
    raw : bytes
    codec : str
    path : Path
        Name of the file in errors.
    most : int

    Raises
    ------
    ConfigError
        The text is too large; the message names the widest character, with its line.
    UnicodeDecodeError
        The file has another encoding.
    """
    if len(raw) > most // _WIDE[0][0]:  # else it is small enough with any character
        _refuse_wide(raw, codec, path, most)
    return raw.decode(codec, errors="replace" if codec == WINDOWS else "strict")


def _refuse_wide(raw: bytes, codec: str, path: Path, most: int) -> None:
    """Count the characters piece by piece, and find the widest."""
    decoder = codecs.getincrementaldecoder(codec)("replace" if codec == WINDOWS else "strict")
    length, lines, width, why = 0, 1, 1, ""
    for at in range(0, len(raw), PIECE):
        kept = len(decoder.getstate()[0])  # the beginning of a character, from the piece before
        try:
            piece = decoder.decode(raw[at : at + PIECE], final=at + PIECE >= len(raw))
        except UnicodeDecodeError as e:
            e.start += at - kept
            raise
        length += len(piece)
        for size, characters in () if piece.isascii() else _WIDE:
            if size > width and (found := characters.search(piece)) is not None:
                line = lines + piece.count("\n", 0, found.start())
                width, why = size, f", {size} for each because of {found[0]!r} in line {line}"
        lines += piece.count("\n")
    if length * width > most:
        raise ConfigError(
            f"{path}: its {length:,} characters take {length * width >> 20} MiB of memory{why}; at most {most >> 20} "
            "MiB are read: leave out of it what the gateway does not need"
        )


def read_bytes(path: Path, most: int) -> bytes:
    """Read a file of the user of at most `most` bytes; a longer file is refused before it is read.

    Raises
    ------
    ConfigError
        Missing, unreadable or too long; a pipe whose writer does not finish in `READ_S`.
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        try:
            raw = _content(handle, most + 1)
        finally:
            os.close(handle)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file{nearest_file(path)}") from None
    except IsADirectoryError:
        raise ConfigError(f"{path}: is a directory; expected a file") from None
    except OSError as e:
        raise ConfigError(f"{path}: cannot be read: {e.strerror or e}") from None
    if len(raw) > most:
        raise ConfigError(f"{path}: longer than {most >> 20} MiB; leave out of it what the gateway does not need")
    return raw


def _content(handle: int, most: int) -> bytes:
    """Read up to `most` bytes; a file that is not plain, such as a pipe, may have no end."""
    plain = stat.S_ISREG(os.fstat(handle).st_mode)
    end = time.monotonic() + READ_S
    parts = []
    while most > 0:
        if not plain and not select.select([handle], [], [], max(0.0, end - time.monotonic()))[0]:
            raise TimeoutError(f"it came to no end in {READ_S:g} s")
        part = os.read(handle, min(most, PIECE))
        if not part:
            break
        parts.append(part)
        most -= len(part)
    return b"".join(parts)


def nearest_file(path: Path) -> str:
    """Name the nearest file in the same folder, else the files of the same kind, as the end of an error line."""
    try:
        return errors.nearest_file(path.name, [p.name for p in path.parent.iterdir() if p.is_file()])
    except FileNotFoundError:
        return f" (no such folder: {path.parent})"
    except OSError:  # a folder that may not be looked into gives no advice
        return ""
