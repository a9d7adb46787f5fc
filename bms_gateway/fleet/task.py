"""One log through the engine that also runs live: the same function in this process, in another, or on a cluster.

It reads files and writes none. A fault of a log is returned as a value, so that no log ends the run of a fleet.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from bms_gateway import __version__
from bms_gateway.bus.logfile import LogNotes, read_log
from bms_gateway.config.load import LoadedConfig, load_config
from bms_gateway.engine import Engine, drive
from bms_gateway.errors import DataError, GatewayError
from bms_gateway.fleet.day import Days, Row
from bms_gateway.fleet.keys import config_key
from bms_gateway.records.span import Span, expect_estimates


@dataclass(frozen=True, slots=True)
class Task:
    """A log to analyse.

    Attributes
    ----------
    log, config : str
        Paths, the same on every machine that takes part.
    config_key : str
        Result of `keys.config_key` on the machine that started the run: every other machine must read the same config.
    vehicle : str
    """

    log: str
    config: str
    config_key: str
    vehicle: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a task: rows, or one line that says why there are none."""

    rows: tuple[Row, ...] = ()
    error: str | None = None


def analyse(task: Task) -> Outcome:
    """Run one log; a pure function of the files that the task names."""
    try:
        return Outcome(tuple(_rows(task)))
    except (GatewayError, OSError) as e:
        return Outcome(error=" ".join(str(e).split()))


def _rows(task: Task) -> list[Row]:
    loaded = _loaded(task.config, task.config_key)
    engine = Engine(replace(loaded.plan, transmit=False), loaded.database)
    engine.judging = True
    notes, span, days = LogNotes(), Span(), Days(loaded.plan)
    log = Path(task.log)
    for batch in read_log(log, notes=notes):
        if len(batch):
            span.note(batch)
            for event in drive(engine, [batch]):
                days.take(event)
    expect_estimates([log], Path(task.config), engine, span)
    head: Row = {"vehicle": task.vehicle, "log": task.log, "error": None}
    tail: Row = {"dropped": engine.dropped, "broken_lines": notes.broken}
    return [head | row | tail for row in days.finish()]


@lru_cache(maxsize=2)
def _loaded(config: str, key: str) -> LoadedConfig:
    """Read the config once per process."""
    loaded = load_config(Path(config))
    if config_key(loaded.files) != key:
        raise DataError(
            f"{config}: not the same as where the run was started, or there is another bms-gateway than {__version__}; "
            "share the folder of the config, install one version"
        )
    return loaded
