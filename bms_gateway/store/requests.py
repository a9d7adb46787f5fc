"""Wishes of a person to the service: small files in its state directory.

They are written whole, taken up while the service runs or at its next start, and removed once what came of them has
been saved.
"""

import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from bms_gateway.errors import StateError

PATTERN = "baseline.*.request"
MAX_BYTES = 10_000
MODE = 0o644  # the service runs as another user than the person at the keyboard


@dataclass(frozen=True, slots=True)
class BaselineReset:
    """A new baseline of R_e for a string or one of its cells (from 1), because parts were replaced.

    `time_ns` is the wall clock when it was asked for, and its name: the same wish is carried out once.
    """

    string: str
    cell: int | None
    reason: str
    time_ns: int


def ask(directory: Path, wish: BaselineReset) -> Path:
    """Put a wish where the service finds it; the file is whole or not there.

    Raises
    ------
    StateError
        The directory is missing or not writable.
    """
    path = directory / PATTERN.replace("*", str(wish.time_ns))
    beside = path.with_suffix(".new")
    try:
        handle = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, MODE)
        with os.fdopen(handle, "w", encoding="utf-8") as f:
            json.dump(asdict(wish), f)
            f.flush()
            os.fsync(f.fileno())
        beside.chmod(MODE)
        beside.replace(path)
    except OSError as e:
        raise StateError(f"{directory}: the request cannot be written: {e.strerror}") from None
    return path


def asked(directory: Path) -> Iterator[tuple[Path, BaselineReset | None]]:
    """Give the wishes that lie there, the oldest first; None for a file that holds none."""
    for path in sorted(directory.glob(PATTERN)):
        if not path.is_file():  # a pipe would never end
            yield path, None
            continue
        try:
            with path.open("rb") as f:
                content = json.loads(f.read(MAX_BYTES))
            wish = BaselineReset(**content)
        except (OSError, ValueError, TypeError, RecursionError):
            yield path, None
            continue
        cell_sound = wish.cell is None or (type(wish.cell) is int and wish.cell >= 1)
        sound = cell_sound and type(wish.time_ns) is int and isinstance(wish.string, str)
        yield path, wish if sound and isinstance(wish.reason, str) else None
