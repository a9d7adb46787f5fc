"""Refuses logs and tables that are given twice, because a copy is no new evidence, or not in order of time."""

import filecmp
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

from bms_gateway.bus.logfile import read_log
from bms_gateway.engine.engine import CLOCK_SET_NS
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
        except OSError:  # the reader reports it
            continue
        if same is not None:
            copy = "" if same == file else f" has the same content as {same}"
            raise UsageError(f"{file}{copy or ' is given twice'}: give each file once")
        others.append(file)


def in_order(logs: Sequence[Path]) -> None:
    """Refuse logs of one drive that are not in the order of recording: the engine's state only goes forward in time.

    Raises
    ------
    UsageError
        A log begins before the one that is given before it. Stamps of a clock that was not set have no order.
    """
    if len(logs) < 2:
        return
    first_ns = {log: next((int(b.time_ns[0]) for b in read_log(log) if len(b)), 0) for log in logs}
    for before, after in pairwise(logs):
        if CLOCK_SET_NS <= first_ns[after] < first_ns[before]:
            seconds = (first_ns[before] - first_ns[after]) * 1e-9
            right = " ".join(str(log) for log in sorted(logs, key=first_ns.__getitem__))
            raise UsageError(f"{after} begins {seconds:.0f} s before {before}: give the logs in order of time: {right}")
