"""Signals of a CAN log as arrays: `decode`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bms_gateway.bus.logfile import read_log
from bms_gateway.config.dbc_files import dbc_text, read_dbc
from bms_gateway.frames import decode as frames
from bms_gateway.frames.database import Database
from bms_gateway.frames.quality import Quality
from bms_gateway.thermal import Floats

__all__ = ["Signal", "decode"]


@dataclass(frozen=True, slots=True)
class Signal:
    """One signal of a log, K samples in the order of the bus.

    Attributes
    ----------
    time_s : ndarray (K,)
        Stamp of each frame, s.
    value : ndarray (K,)
        Physical value by the DBC; NaN where the sender says that there is none, or the DBC's range forbids it.
    unit : str
        Unit as the DBC writes it.
    """

    time_s: Floats
    value: Floats
    unit: str


def decode(
    log: Path | str, dbc: Path | str | Sequence[Path | str], signals: Sequence[str] | None = None
) -> dict[str, Signal]:
    """Decode signals of a log by the code that also decodes them live.

    Parameters
    ----------
    log : Path or str
        `.log` (candump), `.asc`, `.blf`, `.mf4`, `.trc`, `.csv`, each also with `.gz`.
    dbc : Path or str, or several
    signals : sequence of str, optional
        "Message.Signal" of each; default all that the DBC has and the log carries.

    Returns
    -------
    dict of "Message.Signal" to Signal
        Every requested signal; without a request, all signals that have a sample.

    Raises
    ------
    UsageError, ConfigError, DataError, MissingExtraError
        One line: file, what is wrong, the nearest valid choice.
    """
    files = [Path(f) for f in ([dbc] if isinstance(dbc, Path | str) else dbc)]
    database = Database.load({str(file): dbc_text(file) for file in files}, read_dbc)
    every = [s.path for m in database.messages.values() for s in m.signals.values() if s.scale != 0.0]
    wanted = every if signals is None else list(dict.fromkeys(signals))
    table = database.compile(wanted)
    time: list[NDArray[np.int64]] = []
    parts: list[tuple[NDArray[np.intp], Floats]] = []
    for batch in read_log(log):
        s = frames.decode(table, batch)
        value = np.where(s.flag == Quality.GOOD, s.value, np.nan)
        time.append(batch.time_ns[s.frame])
        parts.append((s.signal, value))
    stamp = np.concatenate([np.empty(0, np.int64), *time]) * 1e-9
    number = np.concatenate([np.empty(0, np.intp), *(p[0] for p in parts)])
    value = np.concatenate([np.empty(0), *(p[1] for p in parts)])
    order = np.argsort(number, kind="stable")
    ends = np.searchsorted(number[order], np.arange(len(wanted) + 1))
    found = {}
    for i, path in enumerate(wanted):
        mine = order[ends[i] : ends[i + 1]]
        if len(mine) or signals is not None:
            found[path] = Signal(stamp[mine], value[mine], database.resolve(path).unit)
    return found
