"""Frames of the logs that a command was given, with a progress bar for each log."""

from collections.abc import Iterable, Iterator
from pathlib import Path

from bms_gateway.bus.logfile import LogNotes, read_log
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.records.span import Span
from bms_gateway.report.progress import progress


def logged_frames(logs: Iterable[Path], notes: Iterable[LogNotes], span: Span) -> Iterator[FrameBatch]:
    """Yield the batches of all logs that contain frames.

    Parameters
    ----------
    logs : iterable of Path
    notes : iterable of LogNotes
        One for each log; filled in.
    span : Span
        Filled in.
    """
    for log, note in zip(logs, notes, strict=True):
        with progress(log.name, None) as advance:
            for batch in read_log(log, notes=note):
                if len(batch):
                    span.note(batch)
                    advance(len(batch))
                    yield batch
