"""Reads logged traffic as batches: candump with our own parser, every other format with python-can's readers."""

import gzip
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from difflib import get_close_matches
from pathlib import Path
from typing import BinaryIO, Final

from bms_gateway.bus.backwards import Steps, how_to_sort
from bms_gateway.bus.candump import CUT_SHORT, LogNotes, format_block, interfaces_in, parse_block
from bms_gateway.bus.sniff import misnamed
from bms_gateway.errors import DataError, UsageError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.gunzip import Gunzip
from bms_gateway.whole import whole

__all__ = ["FORMATS", "LogNotes", "interfaces_of", "no_such_log", "read_log", "write_log"]

CANDUMP: Final = (".log",)
FORMATS: Final = (*CANDUMP, ".asc", ".blf", ".csv", ".mf4", ".trc")
_PACKED: Final = (".zip", ".7z", ".rar", ".tar", ".tgz", ".xz", ".bz2", ".zst")
CHUNK: Final = 512 << 10  # about 10,000 lines: columns stay in the cache, and peak memory low
LONGEST_LINE: Final = 1 << 16  # without a newline in so many bytes it is no text
GIVE_UP: Final = (
    1_000_000  # damaged lines in a row: they cost some seconds, and are more than a damaged part of a disk contains
)


def interfaces_of(path: Path | str, size: int = CHUNK) -> Counter[str]:
    """Count the frames of each interface in the first bytes of a candump log; other formats name none.

    Raises
    ------
    UsageError
        As for `read_log`.
    OSError
    """
    path = Path(path)
    if _kind_of_file(path) not in CANDUMP:
        return Counter()
    with path.open("rb") as file:
        try:
            return interfaces_in(_unpacked(path, file).read(size))
        except EOFError:  # nothing whole before the cut
            return Counter()


def read_log(path: Path | str, *, chunk: int = CHUNK, notes: LogNotes | None = None) -> Iterator[FrameBatch]:
    """Read a log of any known format in pieces of bounded size.

    Parameters
    ----------
    path : Path or str
        `.log` (candump), `.asc`, `.blf`, `.mf4`, `.trc`, `.csv`, each also with `.gz`.
    chunk : int
        Bytes of text (candump) or bytes' worth of frames per batch; it only changes the division into batches.
    notes : LogNotes, optional
        Filled in while reading: records that were skipped, with line numbers.

    Yields
    ------
    FrameBatch
        Data frames in the order of the file; stamps exact for candump, to the µs for floats of other formats.

    Raises
    ------
    UsageError
        No such file, or no such format.
    DataError
        The file is not of the kind that its name says, or cannot be read; after the last frame: its time stamps run
        backwards.
    MissingExtraError
        The format needs an extra.
    """
    path = Path(path)
    notes, steps = LogNotes() if notes is None else notes, Steps()
    try:
        kind = _kind_of_file(path)
        if problem := misnamed(path, kind):
            raise DataError(f"{path}: {problem}")
        for batch in _batches(path, kind, chunk, notes):
            if len(batch):
                steps.take(batch)
            yield batch
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None
    if notes.broken and not notes.seen:
        number, text = notes.broken_at[0]
        if text == CUT_SHORT:
            raise DataError(f"{path}: {CUT_SHORT}; nothing before can be read")
        if "\x00" in text:
            raise DataError(f"{path}: not a {kind} log but binary data; a capture of a network is none either")
        raise DataError(f"{path}, line {number}: not a {kind} log: {text!r}")
    if steps.backwards:
        raise DataError(
            f"{path}: its time stamps run backwards, {steps.back} of {steps.back + steps.forth} steps: the frames are "
            f"in reverse order; {how_to_sort(path)}"
        )


def _batches(path: Path, kind: str, chunk: int, notes: LogNotes) -> Iterator[FrameBatch]:
    if kind in CANDUMP:
        return _read_candump(path, chunk, notes)
    from bms_gateway.bus.foreign import read_foreign  # python-can loads slowly and candump does not need it

    return read_foreign(path, kind, max(1, chunk // 50), notes)


def write_log(path: Path | str, batches: Iterable[FrameBatch], channel: str = "can0") -> int:
    """Write frames as a candump log; an older file of that name is kept until the last frame is written.

    Parameters
    ----------
    path : Path or str
        `.log`, or `.log.gz`.
    batches : iterable of FrameBatch
    channel : str
        Name of the interface in the file.

    Returns
    -------
    int
        Number of frames.

    Raises
    ------
    UsageError
        The name asks for another format.
    DataError
        The file cannot be written.
    """
    path = Path(path)
    if _kind(path) not in CANDUMP:
        raise UsageError(f"logs are written as candump text: name {path.name} '.log' or '.log.gz'")
    try:
        with whole(path) as file:
            # neither time nor name in the gzip header: the same frames give the same bytes
            packed = path.suffix.lower() == ".gz"
            with gzip.GzipFile("", "wb", 6, file, mtime=0) if packed else nullcontext(file) as out:
                return write_frames(out, batches, channel)
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror or error})") from None


def write_frames(out: BinaryIO | gzip.GzipFile, batches: Iterable[FrameBatch], channel: str = "can0") -> int:
    """Write frames as lines of candump to an open file; return their number."""
    count = 0
    for batch in batches:
        out.write(format_block(batch, channel))
        count += len(batch)
    return count


def no_such_log(path: Path) -> str:
    """Say that a log does not exist, with the nearest name."""
    return f"no such log: {path}{_nearest_file(path)}"


def _kind_of_file(path: Path) -> str:
    """Tell the format of a log by its name, if the file exists; raise `OSError` if it cannot be looked at."""
    if path.is_dir():
        raise UsageError(f"{path}: is a directory; expected a log")
    kind = _kind(path)
    if not path.exists():
        raise UsageError(no_such_log(path))
    if not path.is_file():
        raise UsageError(f"{path}: is no plain file; expected a log")
    return kind


def _kind(path: Path) -> str:
    suffixes = [s.lower() for s in path.suffixes]
    if suffixes and suffixes[-1] == ".gz":
        suffixes.pop()
    kind = suffixes[-1] if suffixes else ""
    if kind in _PACKED:
        raise UsageError(f"{path}: packed as {kind}: unpack it first; only gzip (.gz) is read as it is")
    if kind not in FORMATS:
        raise UsageError(f"{path}: no log format {kind or '(no suffix)'}; valid: {', '.join(FORMATS)}, also with .gz")
    return kind


def _nearest_file(path: Path) -> str:
    if not path.parent.is_dir():
        return f" (no such folder: {path.parent})"
    try:
        beside = [p.name for p in path.parent.iterdir()]
    except OSError:  # a folder that may not be looked into gives no advice
        return ""
    near = get_close_matches(path.name, beside, n=1, cutoff=0.6)
    return f"; did you mean '{path.parent / near[0]}'?" if near else ""


def _unpacked(path: Path, file: BinaryIO) -> BinaryIO | Gunzip:
    return Gunzip(file, str(path)) if path.suffix.lower() == ".gz" else file


def _read_candump(path: Path, chunk: int, notes: LogNotes) -> Iterator[FrameBatch]:
    carry = b""
    line = 1
    unread = 0
    with path.open("rb") as file:
        source = _unpacked(path, file)
        try:
            while block := source.read(chunk):
                text = carry + block
                cut = text.rfind(b"\n") + 1
                carry = text[cut:]
                if len(carry) > LONGEST_LINE:
                    raise DataError(
                        f"{path}, line {line}: no end of line in {LONGEST_LINE >> 10} KiB: not a candump log"
                    )
                if cut:
                    seen, broken = notes.seen, notes.broken
                    frames, lines = parse_block(text[:cut], line, notes)
                    line += lines
                    unread = 0 if notes.seen > seen else unread + notes.broken - broken
                    if unread > GIVE_UP:
                        raise DataError(
                            f"{path}, line {line}: {unread} lines in a row cannot be read: not a candump log"
                        )
                    if len(frames):
                        yield frames
        except EOFError:
            # the rest of a cut last line may look like a complete, shorter frame
            notes.note_broken(line, CUT_SHORT)
            return
    if carry:
        frames, _ = parse_block(carry, line, notes)
        if len(frames):
            yield frames
