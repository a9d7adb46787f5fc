"""Reads log formats that python-can knows, as batches. A record that its reader cannot read does not end the run.

python-can's readers are generators, and the first error ends a generator. But they keep their position in the file. So
a text reader is started again behind the damaged line, with a blank line in place of the header that it expects at each
start. The binary readers continue with the next block of the file where they can.
"""

import gc
import io
import logging
import shutil
import struct
import sys
import tempfile
import traceback
import zlib
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO, Final

from bms_gateway.bus.candump import CUT_SHORT, LogNotes
from bms_gateway.bus.message import to_batch
from bms_gateway.errors import DataError, MissingExtraError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.gunzip import Gunzip

if TYPE_CHECKING:
    import can

BROKEN: Final = (
    ArithmeticError,
    AssertionError,
    EOFError,
    LookupError,
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
)
"""Exceptions that python-can's readers raise on bad records, besides its own."""
LONGEST_LINE: Final = 1 << 16  # characters; the longest record of a text format has some hundred
LONGEST_READ: Final = 1 << 26  # characters of one line that are read to find its end
MOST_BLANK: Final = 100_000  # lines in a row
MOST_IDLE: Final = 1_000_000  # lines in a row that give no frame: remarks, statistics
GIVE_UP: Final = 1_000  # broken records in a row: this is another kind of file
MDF_STARTS: Final = (b"MDF ", b"UnFinMF ")  # the second: the logger was switched off before it had finished the file
MDF_HEADER: Final = 168  # bytes of identification and header
SHOWN: Final = 60  # characters of a broken line


class LongLineError(ValueError):
    """A line without end."""


class Lines:
    """Lines of a text file, counted; `restart` puts a blank line before the next one.

    Attributes
    ----------
    number : int
        Number of the last line.
    idle : int
        Lines since the last frame; the caller sets it to 0 at each frame.
    """

    def __init__(self, path: Path, file: IO[str]) -> None:
        self._path, self._file = path, file
        self.number = self._blanks = self.idle = 0
        self.last = ""
        self._blank = False

    def restart(self) -> None:
        """Insert a blank line before the next one."""
        self._blank = True

    def __iter__(self) -> "Lines":
        return self

    def __next__(self) -> str:
        if self._blank:
            self._blank = False
            return "\n"
        line = self._file.readline(LONGEST_LINE)
        if not line:
            raise StopIteration
        self.number += 1
        self._blanks = 0 if line.strip() else self._blanks + 1
        if self._blanks > MOST_BLANK:
            raise DataError(f"{self._path}, line {self.number}: {self._blanks} blank lines in a row: not a log")
        self.idle += 1
        if self.idle > MOST_IDLE:
            raise DataError(
                f"{self._path}, line {self.number}: {MOST_IDLE:,} lines in a row without a frame: not a log"
            )
        if len(line) == LONGEST_LINE and not line.endswith("\n"):
            length = len(line)
            while (rest := self._file.readline(LONGEST_LINE)) and not rest.endswith("\n"):
                length += len(rest)  # only a piece of it is in memory
                if length > LONGEST_READ:
                    size = f"{LONGEST_READ >> 20} MiB"
                    raise DataError(f"{self._path}, line {self.number}: no end of line in {size}: not a log")
            raise LongLineError(f"a line of over {LONGEST_LINE >> 10} KiB")
        self.last = line
        return line

    def said(self, error: Exception) -> str:
        """Return the line itself as the fault: the error of python-can's reader would not help a user."""
        return str(error) if isinstance(error, LongLineError) else self.last.strip()[:SHOWN]

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_foreign(path: Path, kind: str, frames: int, notes: LogNotes) -> Iterator[FrameBatch]:
    """Read a log through python-can.

    Parameters
    ----------
    path : Path
    kind : str
        Suffix without `.gz`, lower case.
    frames : int
        Most messages per batch.
    notes : LogNotes
        Filled in.

    Yields
    ------
    FrameBatch

    Raises
    ------
    DataError
        The file is not of this kind.
    MissingExtraError
        MF4 without asammdf.
    """
    for logger in ("can.io.trc", "can.io.asc"):  # they log each line that they skip; here the lines are counted
        logging.getLogger(logger).setLevel(logging.ERROR)
    messages = _messages(path, kind, notes)
    while chunk := list(islice(messages, frames)):
        batch = to_batch(chunk, notes)
        notes.frames += len(batch)
        if len(batch):
            yield batch


def _messages(path: Path, kind: str, notes: LogNotes) -> Iterator["can.Message"]:
    import can
    from can.io.blf import BLFParseError

    make_reader, *own_errors = _reader(kind)
    broken = (*BROKEN, can.CanError, BLFParseError, *own_errors)
    packed = path.suffix.lower() == ".gz"
    lines: Lines | None = None
    source: Any = _opened(path, kind) if packed else path.open("rb")
    if kind not in (".blf", ".mf4"):
        source = lines = Lines(path, io.TextIOWrapper(source, encoding="utf-8", errors="replace"))
    with closing(source):
        try:
            reader = make_reader(source)
        except broken as error:
            raise DataError(f"{path}: not a {kind} log ({str(error) or type(error).__name__})") from None
        record = in_a_row = 0
        while in_a_row < GIVE_UP:
            try:
                for message in _heard(reader, lines):
                    record += 1
                    in_a_row = 0
                    yield message
            except broken as error:
                if lines is not None and packed and isinstance(error, EOFError | zlib.error):
                    notes.note_broken(lines.number + 1, CUT_SHORT)
                    return
                in_a_row += 1
                number = record + notes.broken + 1 if lines is None else lines.number
                said = str(error) if lines is None else lines.said(error)
                notes.note_broken(number, said or type(error).__name__)
                if lines is not None:
                    lines.restart()
                elif kind == ".mf4":
                    return
            else:
                return
    raise DataError(f"{path}: {GIVE_UP} records in a row cannot be read as {kind}: is it another format?")


def _heard(reader: Any, lines: Lines | None) -> Iterator["can.Message"]:
    """Yield the messages of a reader, and report each of them to the line counter."""
    for message in reader:
        if lines is not None:
            lines.idle = 0
        yield message


def _mf4_reader(source: BinaryIO) -> Any:
    """Open an MF4 file if it has a header: without one, python-can's reader prints a traceback when it is deleted."""
    import can

    head = source.read(MDF_HEADER)
    source.seek(0)
    if len(head) < MDF_HEADER or not head.startswith(MDF_STARTS):
        raise EOFError("it has no header of MDF")
    version = head[8:12].decode("latin-1")
    if version[:2] in ("2.", "3."):
        raise ValueError(f"it is MDF {version}: save it as MF4, version 4.00 or later, with the tool that recorded it")
    try:
        reader = can.MF4Reader(source)
    except Exception as error:
        with unraised(AttributeError):  # the reader, which is not complete, fails again when it is deleted
            cause: BaseException | None = error
            while cause is not None:
                traceback.clear_frames(cause.__traceback__)
                cause = cause.__context__
            gc.collect()
        raise
    if names := _decoded_only(reader):
        reader.stop()
        shown = ", ".join(names[:2])
        raise ValueError(
            f"{len(names)} decoded signals, as {shown}, and no CAN frames: this is a table, no log: encode makes "
            "frames of it, and compare, fit and diagnose take it as it is"
        )
    return reader


def _decoded_only(reader: Any) -> list[str]:
    """Names of the signals of an MF4 file without raw CAN frames; empty if it has such frames."""
    file = getattr(reader, "_mdf", None)  # another version of python-can may keep it elsewhere
    names = [name for name in getattr(file, "channels_db", ()) if name not in ("t", "time", "Timestamp", "timestamps")]
    if any(name.startswith("CAN_") for name in names):
        return []
    return [name for name in names if "CAN_DataFrame" not in name]


@contextmanager
def unraised(kind: type[Exception]) -> Iterator[None]:
    """Suppress the report of one kind of error that is raised in `__del__`."""
    before = sys.unraisablehook
    sys.unraisablehook = lambda said: None if issubclass(said.exc_type, kind) else before(said)
    try:
        yield
    finally:
        sys.unraisablehook = before


def _opened(path: Path, kind: str) -> IO[bytes]:
    """Open gzip data; for a reader that seeks, unpack it to the disk first."""
    source = io.BufferedReader(Gunzip(path.open("rb"), str(path)))
    if kind != ".mf4":
        return source
    with source:
        unpacked = tempfile.TemporaryFile()  # noqa: SIM115 - closed by who reads it
        with suppress(EOFError):  # the reader sees that it ends too early
            shutil.copyfileobj(source, unpacked)
    unpacked.seek(0)
    return unpacked


def _reader(kind: str) -> tuple[Any, ...]:
    """python-can's reader of a format, and further exceptions that it may raise."""
    import can

    if kind == ".mf4":
        try:
            from asammdf.blocks.utils import MdfException
        except ImportError:
            raise MissingExtraError("reading .mf4 logs", "mf4") from None
        return _mf4_reader, MdfException
    if kind == ".asc":
        # with the date of the header, so that records of one day can be put in order
        return (partial(can.ASCReader, relative_timestamp=False),)
    if kind == ".blf":
        from bms_gateway.bus.blf import BoundedBlf

        return (BoundedBlf,)
    return ({".csv": can.CSVReader, ".trc": can.TRCReader}[kind],)
