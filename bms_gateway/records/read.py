"""Reads measurements as records: tables, and CAN logs through the gateway's own engine.

The engine that estimates from a log also reads it here: `fit` learns from exactly the samples that `analyze` uses.

`compare`, `diagnose`, `add`, `fit` and the workbench begin with these records.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_gateway.bus.logfile import read_log
from bms_gateway.config import load_config
from bms_gateway.config.load import LoadedConfig
from bms_gateway.diagnosis.record import Record, make_record
from bms_gateway.diagnosis.record_inputs import Columns, all_along
from bms_gateway.engine import Decoded, Engine
from bms_gateway.engine.plan import Channel, StringPlan
from bms_gateway.engine.reasons import why_not
from bms_gateway.engine.statistics import stand_in
from bms_gateway.errors import ConfigError, DataError, UsageError, did_you_mean
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.vocabulary import CELL, INPUTS, OPTIONAL, WHOLE, Quantity
from bms_gateway.records.kind import check_kelvin, check_seconds, log_kind
from bms_gateway.records.once import given_once
from bms_gateway.records.signal_use import WORTH_A_WORD
from bms_gateway.report.progress import progress
from bms_gateway.report.table import Table, read_table
from bms_gateway.thermal import Floats, StringModel

Place = tuple[Quantity, int | None]
"""A quantity, and its cell where it belongs to one."""
MOST_OF_A_LOG = 128 << 20
"""Numbers that a log may give, blanks included: 1 GiB."""


@dataclass(frozen=True, slots=True)
class Reading:
    """How files are read when the page of the workbench asks for them.

    Attributes
    ----------
    uploaded : bool
        See `load_config`.
    tell : callable, optional
        Called with the name of a table and the share of the table that has been read.
    most : int, optional
        Most numbers that each file may hold. Default: for a table, as many as a file of its size can hold; for a log,
        `MOST_OF_A_LOG`.
    seen : callable, optional
        Called with all rows of each file, in the order of the files; a record keeps only the rows that a fit can use.
    """

    uploaded: bool = False
    tell: Callable[[str, float], None] | None = None
    most: int | None = None
    seen: Callable[[Columns], None] | None = None


def read_measurements(
    paths: Iterable[Path],
    *,
    model: StringModel,
    config: Path | None = None,
    string: str | None = None,
    columns: Mapping[str, str] | Sequence[Mapping[str, str]] | None = None,
    reading: Reading | None = None,
) -> list[Record]:
    """Read tables and logs of one string, or of several of one kind.

    Parameters
    ----------
    paths : iterable of Path
        Tables, and logs where `config` is given.
    model : StringModel
        Its sensors, capacity and nominal flow.
    config : Path, optional
        Gateway config that says which signals of a log carry what.
    string : str, optional
        Name of the config's string; needed where it has several.
    columns : mapping, or sequence of mapping, optional
        From `report.table.parse_columns`: for all tables, or one for each path.
    reading : Reading, optional

    Returns
    -------
    list of Record
        One per file, in their order.

    Raises
    ------
    UsageError
        A log without a config, a string that is not in it, a file that is given twice.
    ConfigError, DataError
        One line: file, place, what is wrong.
    """
    if not model.sensors:
        raise ConfigError(
            "the model has no sensors (sensors = []): there is nothing to compare measurements with; a reading of "
            'cells 1 to n stands for a cell: max_of = "1-n" for n, min_of for 1, mean_of for n/2 + 1'
        )
    paths = list(paths)
    given_once(paths)
    how = reading or Reading()
    loaded: tuple[LoadedConfig, StringPlan] | None = None
    records = []
    for k, path in enumerate(paths):
        kind = log_kind(path)
        if kind is None:
            own = columns[k] if isinstance(columns, Sequence) else columns
            rows, notes = _from_table(path, model, own, partial(how.tell, path.name) if how.tell else None, how.most)
        elif config is None:
            raise UsageError(f"{path}: this is a {kind} log: --config is needed, it says which signals carry what")
        else:
            loaded = loaded or _load(config, string, how.uploaded)
            rows, notes = _from_log(path, model, *loaded, MOST_OF_A_LOG if how.most is None else how.most)
        record = make_record(rows, model, half_way=None if kind is None else True)
        records.append(replace(record, notes=(*record.notes, *notes)))
        if how.seen is not None:
            how.seen(rows)
    if string is not None and config is None:
        raise UsageError("--string names a string of a gateway config: give --config too")
    return records


def _from_table(
    path: Path,
    model: StringModel,
    columns: Mapping[str, str] | None,
    tell: Callable[[float], None] | None,
    most: int | None,
) -> tuple[Columns, list[str]]:

    table = read_table(path, columns, tell, most)
    check_seconds(table)
    check_kelvin(table)
    rows = replace(table, voltage_V=_whole_voltage(table, model), surface_C=_cells_of(table, model))
    notes = [f"The table: {'; '.join(table.notes)}."] if table.notes else []
    if table.ignored:
        notes.append(f"Columns with unknown names are not used: {', '.join(table.ignored)}.")
    return rows, notes


def _cells_of(table: Table, model: StringModel) -> Mapping[int, Floats]:
    """Surfaces of the table; a table without any sensor of the model is a matter of its column's names."""
    if not set(table.surface_C) & set(model.sensors):
        name = f"surface_{model.sensors[0]}_C"
        near = did_you_mean(name, [*(f"surface_{k}_C" for k in table.surface_C), *table.ignored])
        raise DataError(
            f"{table.source}: no column '{name}', nor of any other sensor of the model{near} "
            f"(map it: --columns {name}=COLUMN)"
        )
    return table.surface_C


def _whole_voltage(table: Table, model: StringModel) -> Floats | None:
    """Give the voltage of the string; if only cell voltages were recorded, their mean times the number of cells."""
    if table.voltage_V is not None:
        return table.voltage_V
    return _from_cells(table.cell_voltage_V, model)


def _from_cells(cells: Mapping[int, Floats], model: StringModel) -> Floats | None:
    if not cells:
        return None
    V = np.array([cells[k] for k in sorted(cells)])
    return np.asarray(V.mean(axis=0) * model.cells)  # NaN if one is missing: cells differ too much


def _load(config: Path, name: str | None, uploaded: bool) -> tuple[LoadedConfig, StringPlan]:

    loaded = load_config(config, uploaded=uploaded)
    strings = {s.name: s for s in loaded.plan.strings}
    if name is None:
        if len(strings) > 1:
            raise UsageError(f"--string is needed, {config} has several; valid: {', '.join(strings)}")
        name = next(iter(strings))
    if name not in strings:
        raise UsageError(f"--string '{name}' is not in {config}{did_you_mean(name, strings)}")
    return loaded, strings[name]


def _from_log(
    path: Path, model: StringModel, loaded: LoadedConfig, string: StringPlan, most: int
) -> tuple[Columns, list[str]]:

    heard = accepted_samples(path, loaded, string, most)
    if not heard.taken.any():
        wanted = [c.signal or "" for c in string.carried]
        raise DataError(
            f"{path}: no frame carries a signal of {loaded.path} for {string.name}; expected {', '.join(wanted[:3])}"
            f"{', …' if len(wanted) > 3 else ''}"
        )
    time_ns, signals = np.unique(heard.time_ns), len(np.unique(heard.input))
    if (
        len(time_ns) * (signals + 1) > most
    ):  # each signal has its own time stamps; the other columns of such a row are blank
        raise _too_long(path, f"{len(time_ns):,} stamps of {signals} signals", most)
    columns: dict[Place, Floats] = {}
    for place, i in heard.inputs.items():
        of_it = heard.input == i
        values = np.full(len(time_ns), np.nan)
        values[np.searchsorted(time_ns, heard.time_ns[of_it])] = heard.value[of_it]
        if of_it.any():
            columns[place] = values
    assumed: dict[Quantity, str] = {}
    for c in string.channels:
        if c.signal is None and c.constant is not None:
            if c.cell is None:
                assumed[c.quantity] = f"{all_along(c.quantity, c.constant)}, by the configuration"
            columns[c.quantity, c.cell] = np.full(len(time_ns), c.constant)
    unknown = np.full(len(time_ns), np.nan)
    rows: dict[str, Any] = {
        INPUTS[q].field: columns.get((q, None), unknown if INPUTS[q].needed else None) for q in WHOLE
    }
    for q in CELL:
        rows[INPUTS[q].field] = {k: x for (of, k), x in columns.items() if of == q and k is not None}
    if rows["voltage_V"] is None:
        rows["voltage_V"] = _from_cells(rows["cell_voltage_V"], model)
    return Columns(time_s=np.asarray(time_ns * 1e-9, np.float64), source=str(path), assumed=assumed, **rows), [
        *_told(heard, string)
    ]


@dataclass(frozen=True, slots=True)
class Accepted:
    """The samples of a log that the engine accepted.

    Attributes
    ----------
    time_ns, input, value : ndarray (N,)
        Of the string's samples, in the order of the bus.
    inputs : mapping of (quantity, cell) to int
        The string's inputs.
    taken : ndarray of int64 (C, 16)
        Samples of each input by `Quality`.
    clock_faults : str
    """

    time_ns: NDArray[np.int64]
    input: NDArray[np.intp]
    value: Floats
    inputs: Mapping[Place, int]
    taken: NDArray[np.int64]
    clock_faults: str


def accepted_samples(path: Path, loaded: LoadedConfig, string: StringPlan, most: int) -> Accepted:
    """Let the engine read a log; its estimates are not used, so its models have no effects."""
    plain = [replace(s, identify="off", model=replace(s.model, effects=())) for s in loaded.plan.strings]
    engine = Engine(replace(loaded.plan, transmit=False, strings=tuple(plain)), loaded.database, whole=True)
    engine.recording = True
    wire = next(w for s, w in zip(plain, engine.wires, strict=True) if s.name == string.name)
    inputs = {place: wire.of(c) for place, c in _places(string).items()}
    mine = list(inputs.values())
    parts, samples = [(np.empty(0, np.int64), np.empty(0, np.intp), np.empty(0))], 0
    with progress(path.name, None) as advance:
        for batch in read_log(path):
            advance(len(batch))
            engine.receive(batch, now_ns=int(batch.time_ns.max(initial=0)))
            while (event := engine.next_output()) is not None:  # jobs are taken and never computed
                if isinstance(event, Decoded):
                    of_it = np.isin(event.input, mine)
                    parts.append((event.sample_ns[of_it], event.input[of_it], event.value[of_it]))
                    samples += len(parts[-1][0])
            if samples > most:
                raise _too_long(path, f"{samples:,} samples", most)
    time_ns, number, value = (np.concatenate(x) for x in zip(*parts, strict=True))
    return Accepted(time_ns, number, value, inputs, engine.counts, engine.clock_faults)


def _places(string: StringPlan) -> dict[Place, Channel]:
    """Say what each signal of a string measures; a reading of several cells goes to the cell that stands for them.

    A cell that has a sensor of its own stands for no others.
    """
    told = [c for c in string.channels if c.signal is not None]
    places: dict[Place, Channel] = {(c.quantity, c.cell): c for c in told if c.statistic is None}
    for c in told:
        if c.statistic is not None:
            places.setdefault((c.quantity, stand_in(c.statistic, c.among)), c)
    return places


def _too_long(path: Path, what: str, most: int) -> DataError:
    return DataError(f"{path}: {what}: over {most:,} numbers, more than this program accepts; cut the log into several")


def _told(heard: Accepted, string: StringPlan) -> Iterator[str]:
    """Describe the refused samples of each signal, and the faults of the log's clock."""
    if heard.clock_faults:
        yield f"The time stamps of this log are wrong ({heard.clock_faults}): only steps forward are used."
    for place, c in _places(string).items():
        taken = heard.taken[heard.inputs[place]]
        refused = taken.copy()
        refused[Quality.GOOD] = 0
        count, of = int(refused.sum()), int(taken.sum())
        if c.quantity in OPTIONAL and refused[Quality.NOT_AVAILABLE] == of:
            continue  # the sender has no such value; no measurement is lost
        if not of:
            yield f"{c.source} never comes in this log."
        elif count > WORTH_A_WORD * of:
            most = Quality(int(refused.argmax()))
            yield f"{c.source}: {count} of {of} samples are not used, mostly: {why_not(c.quantity, most)}."
