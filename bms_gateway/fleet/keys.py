"""Keys that say whether a log has been analysed already: the same log, the same config, the same program."""

import os
from collections.abc import Iterable
from hashlib import sha256
from pathlib import Path

from bms_gateway import __version__

FORMAT = 1
"""To be increased whenever the meaning of the rows changes."""


def config_key(files: Iterable[Path]) -> str:
    """Compute a digest of the config, of all files that it names, and of the program's version."""
    h = sha256(f"{__version__} {FORMAT}".encode())
    for file in files:
        content = file.read_bytes()
        h.update(f"\n{file.name} {len(content)}\n".encode())
        h.update(content)
    return h.hexdigest()[:16]


def place_key(log: Path) -> str:
    """Name a log by where it lies."""
    return sha256(os.fsencode(os.path.realpath(log))).hexdigest()[:16]


def content_key(log: Path, config: str, vehicle: str) -> str:
    """Compute a digest of a log's size and time of change, of the config's key and of the vehicle's name.

    Raises
    ------
    OSError
        The log does not exist or cannot be accessed.
    """
    s = log.stat()
    return sha256(f"{s.st_size} {s.st_mtime_ns} {config} {vehicle}".encode()).hexdigest()[:16]
