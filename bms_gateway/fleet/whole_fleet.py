"""A whole fleet: take the results that exist, analyse the other logs, and join everything."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from bms_gateway.config.load import LoadedConfig
from bms_gateway.errors import UsageError
from bms_gateway.fleet.day import Row
from bms_gateway.fleet.keys import config_key, content_key, place_key
from bms_gateway.fleet.parquet import SCHEMA, join, read_rows, write_rows
from bms_gateway.fleet.pool import on_cluster, on_this_machine
from bms_gateway.fleet.task import Outcome, Task

LOGS, FLEET, ATLAS_FILE = "logs", "fleet.parquet", "atlas.parquet"


@dataclass(frozen=True, slots=True)
class Run:
    """Result of a run of a fleet.

    Attributes
    ----------
    parts : tuple of Path
        Results of the good logs, in the order given.
    bad : tuple of (str, str)
        Log and reason.
    analysed, skipped : int
        Good logs that were analysed in this run, and those whose result existed already.
    """

    parts: tuple[Path, ...]
    bad: tuple[tuple[str, str], ...]
    analysed: int
    skipped: int

    def rows(self) -> Iterator[Row]:
        """Yield the rows of all good logs, with one file in memory at a time."""
        for part in self.parts:
            yield from read_rows(part) or ()


def run_fleet(
    logs: Sequence[tuple[Path, str]],
    loaded: LoadedConfig,
    out: Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    advance: Callable[[float], None] = lambda _: None,
) -> Run:
    """Analyse logs, write one file of results per log, and join these files.

    Parameters
    ----------
    logs : sequence of (Path, str)
        Logs and their vehicles, no log twice.
    loaded : LoadedConfig
    out : Path
        `logs/` gets a file per log, `fleet.parquet` the rows of all logs of this run in their order.
    jobs : int
        Processes of this machine.
    scheduler : str, optional
        Address of a Dask scheduler, in place of processes.
    advance : callable, optional
        Called with 1 for each log that is done.

    Raises
    ------
    UsageError
        The folder cannot be written, or the scheduler does not answer.
    """
    key, folder = config_key(loaded.files), out / LOGS
    try:
        folder.mkdir(parents=True, exist_ok=True)
        results = _Results(folder)
        parts: dict[int, Path] = {}
        bad: dict[int, str] = {}
        tasks: list[tuple[int, Task, Path]] = []
        for i, (log, vehicle) in enumerate(logs):
            try:
                part = results.place(log, content_key(log, key, vehicle))
            except OSError as e:
                bad[i] = f"{log}: cannot be read ({e.strerror})"
                advance(1)
                continue
            if read_rows(part) is not None:
                parts[i] = part
                advance(1)
            else:
                task = Task(str(log.absolute()), str(loaded.path.absolute()), key, vehicle)
                tasks.append((i, task, part))
        skipped = len(parts)
        for number, outcome in _spread([t for _, t, _ in tasks], jobs, scheduler):
            i, _, part = tasks[number]
            if outcome.error is None:
                write_rows(part, outcome.rows)
                results.only(part)
                parts[i] = part
            else:
                bad[i] = outcome.error
            advance(1)
        whole = tuple(parts[i] for i in sorted(parts))
        wrong = tuple((i, str(logs[i][0]), logs[i][1], bad[i]) for i in sorted(bad))
        join(out / FLEET, whole, [_bad_row(log, vehicle, why) for _, log, vehicle, why in wrong])
    except OSError as e:
        raise UsageError(f"--out {out}: cannot be written: {e.strerror or e}") from None
    return Run(whole, tuple((log, why) for _, log, _, why in wrong), len(whole) - skipped, skipped)


def _spread(tasks: Sequence[Task], jobs: int, scheduler: str | None) -> Iterator[tuple[int, Outcome]]:
    if not tasks:
        return iter(())
    return on_this_machine(tasks, jobs) if scheduler is None else on_cluster(tasks, scheduler)


def _bad_row(log: str, vehicle: str, why: str) -> Row:
    return dict.fromkeys(SCHEMA.names) | {"vehicle": vehicle, "log": log, "error": why}


class _Results:
    """Files of earlier results, by the place of their log; one per log."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._old: dict[str, set[Path]] = defaultdict(set)
        for file in folder.glob("*.parquet"):
            self._old[file.stem.split("-")[0]].add(file)

    def place(self, log: Path, content: str) -> Path:
        """Give the path of the result of this log in its present state."""
        return self._folder / f"{place_key(log)}-{content}.parquet"

    def only(self, part: Path) -> None:
        """Remove the results of earlier states of this log."""
        for file in self._old[part.stem.split("-")[0]] - {part}:
            file.unlink(missing_ok=True)
