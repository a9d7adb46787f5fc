"""Logs and tables that a person gives: each only once, because the samples of a copy are no new evidence."""

import filecmp
from collections.abc import Iterable
from pathlib import Path

from bms_gateway.errors import UsageError


def given_once(files: Iterable[Path]) -> None:
    """Refuse a log or table that is given twice, also under another name: its samples would count as new evidence.

    Raises
    ------
    UsageError
        Two of the files have the same content.
    """
    by_size: dict[int, list[Path]] = {}
    for file in files:
        try:
            size = file.stat().st_size if file.is_file() else 0  # a pipe can be read only once
            others = by_size.setdefault(size, []) if size else []
            same = next((other for other in others if filecmp.cmp(file, other, shallow=False)), None)
        except OSError:  # told by whoever reads it
            continue
        if same is not None:
            copy = "" if same == file else f" has the same content as {same}"
            raise UsageError(f"{file}{copy or ' is given twice'}: give each file once")
        others.append(file)
