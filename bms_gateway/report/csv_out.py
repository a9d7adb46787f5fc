"""The files that `analyze` writes: estimates, parameters, events, alerts and the summary."""

import csv
import errno
import io
import json
import os
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field
from itertools import chain
from pathlib import Path
from stat import S_ISDIR
from types import MappingProxyType, TracebackType
from typing import Any, BinaryIO, Final, Self, TextIO

import numpy as np

from bms_gateway.engine.events import Alerted, Cells, Estimated, Event, Notice, Parameters
from bms_gateway.errors import UsageError
from bms_gateway.folders import open_folder
from bms_gateway.frames.quality import Quality
from bms_gateway.identify import Estimate
from bms_gateway.report.hottest import Hottest, hotter, hottest_core
from bms_gateway.thermal import KINDS

ESTIMATES = "time_s,string,cell,core_C,core_sd_K,surface_C,quality,centre_C,centre_sd_K,heat_W,heat_sd_W"
PARAMETERS = "time_s,string,name,value,sd,unit,status"

_OURS: Final = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_FRESH: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_QUALITY = {int(q): q.name.lower() for q in Quality}
_TO_SI = {kind.unit: kind.to_si for kind in KINDS.values()}


def seconds(time_ns: int) -> str:
    """Bus time as text, s; exact to the nanosecond where it is not whole milliseconds.

    Examples
    --------
    >>> seconds(1_436_509_053_650_000_000), seconds(1)
    ('1436509053.650', '0.000000001')
    """
    whole, rest = divmod(time_ns, 1_000_000_000)
    return f"{whole}.{rest // 1_000_000:03d}" if rest % 1_000_000 == 0 else f"{whole}.{rest:09d}"


@dataclass(slots=True)
class StringSummary:
    """Summary of one string.

    Attributes
    ----------
    max_core_C : float or None
        Highest core, the mean of a roll, of the run, however well it is known.
    hottest : dict or None
        Cell and time at which a hottest point was hottest by `report.hottest`, with its core there: cell, core_C,
        core_sd_K, centre_C, time_s.
    """

    cells: int = 0
    max_core_C: float | None = None
    hottest: dict[str, float] | None = None
    resistance_growth_pct: float | None = None
    flags: list[str] = field(default_factory=list)


NO_SIGNALS: Mapping[str, Mapping[str, Any]] = MappingProxyType({})
FILES = ("estimates.csv", "parameters.csv", "events.jsonl", "alerts.jsonl", "broadcast.log", "summary.json")


class ResultFolder:
    """Writes the events of a run into a folder; a context manager.

    All files are first written in a folder beside them, and get their places when the run has succeeded. A run that
    fails leaves the results of the earlier run unchanged. Both folders are held open, so that nobody can redirect the
    results by changing names meanwhile.

    Parameters
    ----------
    directory : Path
        Created if it is missing; files of an earlier run are replaced.
    strings : mapping of str to int
        Names of the strings and their numbers of cells.

    Attributes
    ----------
    strings : dict of name to StringSummary
        Collected from the events; the caller adds growth and flags.
    hottest : dict of name to Hottest
        The hottest core of each string of which one is known.

    Raises
    ------
    UsageError
        The folder cannot be written.
    """

    def __init__(self, directory: Path, strings: Mapping[str, int]) -> None:
        self.directory = directory
        self.strings = {name: StringSummary(cells) for name, cells in strings.items()}
        self.hottest: dict[str, Hottest] = {}
        self._point: dict[str, Hottest] = {}
        self._rows: dict[str, tuple[str, list[str]]] = {}
        self._made = not directory.exists()
        self._names: list[str] = []
        self._name = f".part-{os.urandom(8).hex()}"
        try:
            directory.mkdir(parents=True, exist_ok=True)
            self._at = open_folder(directory)
            try:
                self._part = _new_folder(self._at, self._name)
            except OSError:
                os.close(self._at)
                raise
        except OSError as e:
            raise UsageError(f"{directory}: cannot write results there: {e.strerror}") from None
        self._estimates = self._open("estimates.csv")
        self._parameters = self._open("parameters.csv")
        self._events = self._open("events.jsonl")
        self._alerts = self._open("alerts.jsonl")
        self._estimates.write(ESTIMATES + "\n")
        self._parameters.write(PARAMETERS + "\n")
        self._parameter_rows = csv.writer(self._parameters, lineterminator="\n")

    def create(self, name: str) -> BinaryIO:
        """Open a further file of the results; it is closed by the caller."""
        file = os.fdopen(os.open(name, _FRESH, 0o666, dir_fd=self._part), "wb")
        self._names.append(name)
        return file

    def write(self, event: Event) -> None:
        """Write one event; frames to send and jobs are not written here."""
        if isinstance(event, Estimated):
            for cells in event.strings():
                self._write_estimates(cells)
        elif isinstance(event, Parameters):
            self._write_parameters(event)
        elif isinstance(event, Notice):
            self._events.write(json.dumps(notice_json(event), ensure_ascii=False) + "\n")
        elif isinstance(event, Alerted):
            self._alerts.write(json.dumps(alert_json(event), ensure_ascii=False) + "\n")

    def write_summary(
        self,
        *,
        frames: int,
        duration_s: float,
        dropped: int,
        rejected: Mapping[str, int],
        signals: Mapping[str, Mapping[str, Any]] = NO_SIGNALS,
    ) -> dict[str, Any]:
        """Write `summary.json` from the collected values and these counts, and return it."""
        document = {
            "frames": frames,
            "duration_s": duration_s,
            "strings": {name: asdict(s) for name, s in self.strings.items()},
            "dropped": dropped,
            "rejected": dict(sorted(rejected.items())),
            "signals": dict(signals),
        }
        with self._open("summary.json") as f:
            f.write(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n")
        return document

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give the files their own names, or delete them after an exception."""
        done = False
        try:
            with ExitStack() as files:  # closes all files, even if the disk has no space for the rest of one of them
                for f in (self._estimates, self._parameters, self._events, self._alerts):
                    files.callback(f.close)
            if kind is None:
                self._put()
                done = True
        finally:
            for name in self._names:
                with suppress(FileNotFoundError):
                    os.unlink(name, dir_fd=self._part)
            with suppress(OSError):  # somebody else may have renamed it
                os.rmdir(self._name, dir_fd=self._at)
            os.close(self._part)
            os.close(self._at)
            if not done and self._made:
                with suppress(OSError):
                    self.directory.rmdir()

    def _put(self) -> None:
        """Put all files in their places, or none if a folder is in the way."""
        for name in self._names:
            with suppress(FileNotFoundError):
                if S_ISDIR(os.stat(name, dir_fd=self._at, follow_symlinks=False).st_mode):
                    raise UsageError(f"{self.directory / name}: is a folder; the results have a file of this name")
        for name in self._names:
            os.rename(name, name, src_dir_fd=self._part, dst_dir_fd=self._at)

    def _open(self, name: str) -> TextIO:
        return io.TextIOWrapper(self.create(name), encoding="utf-8", newline="\n")

    def _write_estimates(self, e: Cells) -> None:
        n = len(e.core)
        if e.string not in self._rows:
            self._rows[e.string] = (
                "%.3f,%.3f,%.3f,%s,%.3f,%.3f,%.3g,%.3g\n" * n,
                [f",{e.string},{k + 1}," for k in range(n)],
            )
        form, heads = self._rows[e.string]
        own = [x.tolist() for x in (e.core, e.core_sd, e.surface, e.centre, e.centre_sd, e.heat, e.heat_sd)]
        columns = *own[:3], [_QUALITY[q] for q in e.quality.tolist()], *own[3:]
        rows = form % tuple(chain.from_iterable(zip(*columns, strict=True)))
        at = seconds(e.time_ns)
        lines = rows.replace("nan", "").splitlines()
        self._estimates.writelines(f"{at}{head}{line}\n" for head, line in zip(heads, lines, strict=True))
        self._sum_up(e, at)

    def _sum_up(self, e: Cells, at: str) -> None:
        summary = self.strings[e.string]
        core = hotter(self.hottest.get(e.string), hottest_core(e, e.core))
        point = hotter(self._point.get(e.string), hottest_core(e, e.centre))
        if core is not None:
            self.hottest[e.string] = core
        highest = float(np.fmax.reduce(e.core))
        if highest == highest and (summary.max_core_C is None or highest > summary.max_core_C):
            summary.max_core_C = highest
        if point is not None and point.time_ns == e.time_ns:
            self._point[e.string] = point
            summary.hottest = {
                "cell": point.cell,
                "core_C": point.core_C,
                "core_sd_K": point.core_sd_K,
                "centre_C": point.centre_C,
                "time_s": float(at),
            }

    def _write_parameters(self, e: Parameters) -> None:
        at = seconds(e.time_ns)
        for p in e.estimates:
            factor = _to_si(p)
            row = (at, e.string, p.name, _blank(p.value / factor), _blank(p.sd / factor), p.unit, p.status)
            self._parameter_rows.writerow(row)


def _new_folder(at: int, name: str) -> int:
    """Make a folder in an open one, and open it."""
    os.mkdir(name, 0o700, dir_fd=at)
    made = os.open(name, _OURS, dir_fd=at)
    if os.fstat(made).st_uid != os.geteuid():  # another user has replaced it
        os.close(made)
        raise PermissionError(errno.EPERM, "another user changes its names")
    return made


def _to_si(p: Estimate) -> float:
    """Return the factor of a number to SI; an effect states its own factor."""
    key, dot, parameter = p.name.rpartition(".")
    if not dot:
        return _TO_SI.get(p.unit, 1.0)
    # importing the catalogue takes long, so it is done only if needed
    from bms_gateway.thermal.effects import effect_named

    return effect_named(key.partition(":")[0]).parameter(parameter).to_si


def notice_json(e: Notice) -> dict[str, Any]:
    """One line of `events.jsonl`."""
    return {
        "time_s": e.time_ns / 1e9,
        "level": e.level.name.lower(),
        "code": e.code,
        "string": e.string,
        "cell": e.cell,
        "text": e.text,
    }


def alert_json(e: Alerted) -> dict[str, Any]:
    """One line of `alerts.jsonl`."""
    c = e.change.condition
    return {
        "time_s": e.time_ns / 1e9,
        "state": e.change.state,
        "name": c.name,
        "severity": c.severity.name.lower(),
        "string": c.string,
        "cell": c.cell,
        "text": c.text,
        **c.facts,
    }


def _blank(x: float) -> str:
    return f"{x:.6g}" if x == x else ""
