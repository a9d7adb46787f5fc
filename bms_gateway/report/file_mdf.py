"""Decoded signals of an MF4 file as rows: one row for each time stamp of any signal, blank where a signal has none."""

import gc
import io
import shutil
import struct
import sys
import tempfile
import traceback
import zlib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.errors import DataError, MissingExtraError
from bms_gateway.gunzip import Gunzip
from bms_gateway.report.dates import DateForm
from bms_gateway.report.file_rows import BATCH, Piece, Rows
from bms_gateway.thermal import Floats

TIME: Final = "time_s"
"""Column of the time stamps, s since the start of the recording."""
HEADER: Final = 64 + 104
"""Bytes of the identification and of the header block: less is no MF4 file."""
UNFINISHED: Final = b"UnFinMF "
"""First bytes where the recorder was cut off."""
STARTS: Final = (b"MDF ", UNFINISHED)
BROKEN: Final = (
    ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, MemoryError, TypeError, ValueError,
    struct.error, zlib.error,
)  # fmt: skip
"""What asammdf raises on damaged data."""
RAW: Final = ("CAN_DataFrame", "CAN_RemoteFrame", "CAN_ErrorFrame", "CAN_OverloadFrame")
"""Channels of raw traffic."""


@contextmanager
def open_mdf(path: Path) -> Iterator[Rows]:
    """Open an MF4 file of decoded signals.

    Raises
    ------
    DataError
        No MF4 file, damaged, or one of raw CAN frames.
    MissingExtraError
        asammdf is not installed.
    OSError
    """
    with _opened(path) as mdf:
        if _is_raw(mdf):
            raise DataError(f"{path}: an MF4 log of raw CAN frames, no table: analyze and init take it")
        yield _Mdf(path, mdf)


def holds_signals(path: Path) -> bool:
    """Whether an MF4 file holds decoded signals and no raw CAN frames; False where it is damaged or no such file.

    Raises
    ------
    MissingExtraError
        asammdf is not installed.
    """
    try:
        with _opened(path) as mdf:
            return not _is_raw(mdf) and any(True for _ in _channels(mdf))
    except (DataError, EOFError, OSError):  # who reads it as a log says what is wrong
        return False


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        from asammdf import MDF
        from asammdf.blocks.utils import MdfException
    except ImportError:
        raise MissingExtraError("reading .mf4 files", "mf4") from None
    with path.open("rb") as file, tempfile.TemporaryFile() as copy:
        packed = path.suffix.lower() == ".gz"
        source: Any = io.BufferedReader(Gunzip(file, str(path))) if packed else file
        if packed or file.peek(len(UNFINISHED)).startswith(UNFINISHED):  # asammdf writes its end
            shutil.copyfileobj(source, copy)
            source = copy
            source.seek(0)
        head = source.read(HEADER)
        source.seek(0)
        if len(head) < HEADER or not head.startswith(STARTS):
            raise DataError(f"{path}: not an MF4 file: it has no header of MDF")
        try:
            mdf = MDF(source)
        except (MdfException, *BROKEN) as error:
            said = " ".join(str(error).split())[:100] or type(error).__name__
            _forget(error)
            raise DataError(f"{path}: the MF4 file is cut short or damaged ({said})") from None
        try:
            yield mdf
        finally:
            mdf.close()


def _forget(error: BaseException) -> None:
    """Let go of a reader that is not complete: it fails again when it is deleted, and would print that."""
    before = sys.unraisablehook
    sys.unraisablehook = lambda said: None if issubclass(said.exc_type, AttributeError) else before(said)
    try:
        cause: BaseException | None = error
        while cause is not None:
            traceback.clear_frames(cause.__traceback__)
            cause = cause.__context__
        gc.collect()
    finally:
        sys.unraisablehook = before


def _is_raw(mdf: Any) -> bool:
    """Whether frames of a bus are in it, as bytes."""
    return any(name.split(".")[0] in RAW for name in mdf.channels_db)


def _channels(mdf: Any) -> Iterator[tuple[int, int, str, str]]:
    """Give group, index, name and unit of each signal that has values; the time stamps of a group are none."""
    for group, index in _places(mdf):
        channel = mdf.groups[group].channels[index]
        yield group, index, str(channel.name), _unit(channel)


def _places(mdf: Any) -> Iterator[tuple[int, int]]:
    for group, of in enumerate(mdf.groups):
        master = mdf.masters_db.get(group)
        if of.channel_group.cycles_nr and master is not None:
            yield from ((group, index) for index in range(len(of.channels)) if index != master)


def _unit(channel: Any) -> str:
    conversion = getattr(channel, "conversion", None)
    return str(getattr(channel, "unit", "") or getattr(conversion, "unit", "") or "").strip()


class _Mdf:
    """Signals of an MF4 file."""

    word = "row"
    began_s = None

    def __init__(self, path: Path, mdf: Any) -> None:
        self.path, self._mdf = path, mdf
        found = list(_channels(mdf))
        if not found:
            raise DataError(f"{path}: the MF4 file holds no signal with values")
        count = Counter(name for _, _, name, _ in found)
        self._place: dict[str, tuple[int, int]] = {}
        units = []
        for group, index, name, unit in found:
            own = name if count[name] == 1 and name != TIME else f"{name} (group {group + 1})"
            if own not in self._place:
                self._place[own] = (group, index)
                units.append(unit)
        self.names = [TIME, *self._place]
        self.units: list[str] | None = ["s", *units]
        groups = len({group for group, _, _, _ in found})
        self.notes = [f"read as an MF4 file of decoded signals, {len(found)} in {groups} groups"]

    def sample(self, column: str) -> list[str]:  # noqa: ARG002 - stamps are seconds
        """See `Rows`."""
        return []

    def pieces(self, columns: Collection[str], dates: Mapping[str, DateForm]) -> Iterator[Piece]:  # noqa: ARG002
        """See `Rows`."""
        named = {c: c if c in self.names else c[1:] for c in columns}
        signals = {name: self._signal(name) for name in sorted(set(named.values()) - {TIME})}
        if not signals:
            return
        t = np.unique(np.concatenate([stamps for stamps, _ in signals.values()]))
        share = self.path.stat().st_size / max(len(t), 1)
        for first in range(0, len(t), BATCH):
            part = t[first : first + BATCH]
            rows = {TIME: part} | {name: _at(part, *signal) for name, signal in signals.items()}
            values = {c: rows[name] if c == name else -rows[name] for c, name in named.items()}
            yield Piece(np.arange(first + 1, first + 1 + len(part)), values, share * len(part))

    def _signal(self, name: str) -> tuple[Floats, Floats]:
        """Time stamps and values of a signal; a value that its recorder calls invalid is blank."""
        group, index = self._place[name]
        try:
            signal = self._mdf.get(group=group, index=index, ignore_invalidation_bits=True)
        except BROKEN as error:
            said = " ".join(str(error).split())[:100] or type(error).__name__
            raise DataError(f"{self.path}: signal {name!r} cannot be read ({said})") from None
        values = signal.samples
        if values.ndim != 1 or values.dtype.kind not in "iufb":
            raise DataError(f"{self.path}: signal {name!r}: not numbers")
        known = np.array(values, np.float64)
        if signal.invalidation_bits is not None:
            known[np.asarray(signal.invalidation_bits, bool)] = np.nan
        return _sorted(np.asarray(signal.timestamps, np.float64), known)


def _sorted(t: Floats, x: Floats) -> tuple[Floats, Floats]:
    """Put samples in the order of their stamps; of several at one stamp the last one counts."""
    sound = np.isfinite(t)
    order = np.argsort(t[sound], kind="stable")
    t, x = t[sound][order], x[sound][order]
    last = np.append(np.diff(t) > 0, True)[: len(t)]
    return t[last], x[last]


def _at(part: NDArray[np.float64], t: Floats, x: Floats) -> Floats:
    """Values at these stamps; blank where the signal has none."""
    out = np.full(len(part), np.nan)
    inside = slice(*np.searchsorted(t, [part[0], np.nextafter(part[-1], np.inf)]))
    out[np.searchsorted(part, t[inside])] = x[inside]
    return out
