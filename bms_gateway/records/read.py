"""Measurements as records: tables, and CAN logs through the gateway's own mapping.

What `compare`, `diagnose`, `add`, `fit` and the workbench begin with.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bms_gateway.bus.logfile import read_log
from bms_gateway.config import load_config
from bms_gateway.config.load import LoadedConfig
from bms_gateway.diagnose.record import Record, make_record
from bms_gateway.engine.clock import Clock
from bms_gateway.engine.inputs import REASONS
from bms_gateway.engine.plan import Channel, StringPlan
from bms_gateway.errors import ConfigError, DataError, UsageError, did_you_mean
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.counter import CounterGuard
from bms_gateway.frames.database import Database
from bms_gateway.frames.decode import decode
from bms_gateway.frames.guard import Guard, default_rule
from bms_gateway.frames.quality import Quality
from bms_gateway.records.kind import check_time, log_kind
from bms_gateway.report.progress import progress
from bms_gateway.report.table import Table, read_table
from bms_gateway.thermal import StringModel

Floats = NDArray[np.float64]
SECOND = 1_000_000_000
ACTIVE_A2 = 1.0
"""Mean square of a second's current above which the guard expects temperatures to move, as in the engine."""
OPTIONAL = ("voltage", "cell_voltage", "soc", "coolant_flow")
WORTH_A_WORD = 0.05
"""Share of refused samples from which on a signal is named; every start refuses a few."""


def read_measurements(
    paths: Iterable[Path],
    *,
    model: StringModel,
    config: Path | None = None,
    string: str | None = None,
    columns: Mapping[str, str] | None = None,
) -> list[Record]:
    """Read tables and logs of one string, or of several of one kind.

    Parameters
    ----------
    paths : iterable of Path
        Tables, and logs where `config` is given.
    model : StringModel
        Its sensors, capacity and nominal flow.
    config : Path, optional
        Gateway config whose mapping logs are decoded by.
    string : str, optional
        Name of the config's string; needed where it has several.
    columns : mapping, optional
        From `report.table.parse_columns`, for the tables.

    Returns
    -------
    list of Record
        One per file, in their order.

    Raises
    ------
    UsageError
        A log without a config, a string that is not in it.
    ConfigError, DataError
        One line: file, place, what is wrong.
    """
    if not model.sensors:
        raise ConfigError("the model has no sensors (sensors = []): there is nothing to hold measurements against")
    loaded: tuple[LoadedConfig, StringPlan] | None = None
    records = []
    for path in paths:
        kind = log_kind(path)
        if kind is None:
            records.append(_from_table(path, model, columns))
            continue
        if config is None:
            raise UsageError(f"{path}: this is a {kind} log: --config is needed, it says which signals carry what")
        if loaded is None:
            loaded = _load(config, string)
        records.append(_from_log(path, model, *loaded))
    if string is not None and config is None:
        raise UsageError("--string names a string of a gateway config: give --config too")
    return records


def _from_table(path: Path, model: StringModel, columns: Mapping[str, str] | None) -> Record:

    table = read_table(path, columns)
    if table.time_s[0] >= 0.0:
        check_time(table)
    record = make_record(
        time_s=table.time_s,
        current_A=table.current_A,
        coolant_inlet_C=table.coolant_inlet_C,
        voltage_V=_whole_voltage(table, model),
        soc=table.soc,
        coolant_flow_m3_s=table.coolant_flow_m3_s,
        surface_C=_cells_of(table, model),
        core_C=table.core_C,
        cell_voltage_V=table.cell_voltage_V,
        model=model,
        source=table.source,
    )
    if table.ignored:
        more = f"Columns without a meaning here, so not used: {', '.join(table.ignored)}."
        record = replace(record, notes=(*record.notes, more))
    return record


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
    """Voltage of the string, where only those of cells were recorded from their mean."""
    if table.voltage_V is not None:
        return table.voltage_V
    return _from_cells(table.cell_voltage_V, model)


def _from_cells(cells: Mapping[int, Floats], model: StringModel) -> Floats | None:
    if not cells:
        return None
    V = np.array([cells[k] for k in sorted(cells)])
    return np.asarray(V.mean(axis=0) * model.cells)  # NaN where one is missing: cells differ by more than heat allows


def _load(config: Path, name: str | None) -> tuple[LoadedConfig, StringPlan]:

    loaded = load_config(config)
    strings = {s.name: s for s in loaded.plan.strings}
    if name is None:
        if len(strings) > 1:
            raise UsageError(f"--string is needed, {config} has several; valid: {', '.join(strings)}")
        name = next(iter(strings))
    if name not in strings:
        raise UsageError(f"--string '{name}' is not in {config}{did_you_mean(name, strings)}")
    return loaded, strings[name]


def _from_log(path: Path, model: StringModel, loaded: LoadedConfig, string: StringPlan) -> Record:

    channels = [c for c in string.channels if c.signal is not None]
    samples = _read(path, channels, loaded.database)
    if not len(samples.time_ns):
        wanted = ", ".join(c.signal or "" for c in channels[:3])
        raise DataError(
            f"{path}: no frame carries a signal of {loaded.path} for {string.name}; expected {wanted}"
            f"{', …' if len(channels) > 3 else ''}"
        )
    quality = _guarded(samples, channels, loaded.database, string.number)
    good = quality == 0
    time_ns = np.unique(samples.time_ns[good])
    columns: dict[tuple[str, int | None], Floats] = {}
    for i, c in enumerate(channels):
        mine = good & (samples.channel == i)
        values = np.full(len(time_ns), np.nan)
        values[np.searchsorted(time_ns, samples.time_ns[mine])] = samples.value[mine]
        if mine.any():
            columns[c.quantity, c.cell] = values
    for c in string.channels:
        if c.signal is None and c.constant is not None:
            columns[c.quantity, c.cell] = np.full(len(time_ns), c.constant)
    unknown = np.full(len(time_ns), np.nan)
    cell_voltage = {k: x for (q, k), x in columns.items() if q == "cell_voltage" and k is not None}
    voltage = columns.get(("voltage", None))
    record = make_record(
        time_s=time_ns * 1e-9,
        current_A=columns.get(("current", None), unknown),
        coolant_inlet_C=columns.get(("coolant_inlet", None), unknown),
        voltage_V=_from_cells(cell_voltage, model) if voltage is None else voltage,
        soc=columns.get(("soc", None)),
        coolant_flow_m3_s=columns.get(("coolant_flow", None)),
        surface_C={k: x for (q, k), x in columns.items() if q == "surface" and k is not None},
        cell_voltage_V=cell_voltage,
        model=model,
        source=str(path),
        half_way=True,
    )
    return replace(record, notes=(*record.notes, *_told(samples, quality, channels)))


@dataclass(frozen=True, slots=True)
class _Samples:
    """Decoded samples of a log in the order of the bus, `flag` as the decoder has it."""

    time_ns: NDArray[np.int64]
    channel: NDArray[np.intp]
    value: Floats
    flag: NDArray[np.uint8]
    clock_faults: str


def _told(samples: _Samples, quality: NDArray[np.uint8], channels: Sequence[Channel]) -> Iterator[str]:
    """Tell per signal what the guard refused, and what was wrong with the log's clock."""
    if samples.clock_faults:
        yield f"The clock of this log misbehaves ({samples.clock_faults}): only its steps forward are believed."
    by_value = {int(k): text for k, text in REASONS.items()}
    for i, c in enumerate(channels):
        mine = quality[samples.channel == i]
        refused = mine[mine != 0]
        if c.quantity in OPTIONAL and (mine == int(Quality.NOT_AVAILABLE)).all():
            continue  # a sender that has none; nothing is lost that was ever there
        if not len(mine):
            yield f"{c.signal} never comes in this log."
        elif len(refused) > WORTH_A_WORD * len(mine):
            most = int(np.bincount(refused).argmax())
            yield f"{c.signal}: {len(refused)} of {len(mine)} samples are not used, mostly: {by_value[most]}."


def _read(path: Path, channels: Sequence[Channel], database: Database) -> _Samples:
    """Decode a log's samples, with their times put onto the engine's line."""
    table = database.compile([c.signal or "" for c in channels])
    scale, offset = np.array([c.scale for c in channels]), np.array([c.offset for c in channels])
    clock, counters = Clock(), CounterGuard(table)
    parts: list[tuple[NDArray[np.int64], NDArray[np.intp], Floats, NDArray[np.uint8]]] = []
    with progress(path.name, None) as advance:
        for batch in read_log(path):
            advance(len(batch))
            keep = np.flatnonzero(np.isin(batch.can_id, table.can_ids))
            wanted = FrameBatch(batch.time_ns[keep], batch.can_id[keep], batch.length[keep], batch.data[keep])
            frames = clock.straighten(wanted)
            s = decode(table, frames)
            flag = counters.update(s)
            parts.append((frames.time_ns[s.frame], s.signal, s.value * scale[s.signal] + offset[s.signal], flag))
    if not parts:
        raise DataError(f"{path}: no data frames")
    time_ns, channel, value, flag = (np.concatenate(x) for x in zip(*parts, strict=True))
    return _Samples(time_ns, channel, value, flag, clock.faults())


def _guarded(samples: _Samples, channels: Sequence[Channel], database: Database, number: int) -> NDArray[np.uint8]:
    """Judge the samples second by second, as the engine does; returns their `Quality`."""
    guard = Guard(
        [default_rule(c.quantity, database.resolve(c.signal or ""), c.scale, c.offset, number) for c in channels]
    )
    is_current = np.array([c.quantity == "current" for c in channels])
    second = samples.time_ns // SECOND
    edges = np.flatnonzero(np.diff(second, prepend=second[0] - 1, append=second[-1] + 1))
    quality = np.empty(len(second), np.uint8)
    active = False
    for first, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        part = slice(first, end)
        channel, value = samples.channel[part], samples.value[part]
        t1 = (int(second[first]) + 1) * SECOND
        judged = guard.update(samples.time_ns[part], channel, value, samples.flag[part], t1, active)
        quality[part] = judged.quality
        currents = value[is_current[channel] & (judged.quality == 0)]
        active = bool(len(currents)) and float(np.mean(currents**2)) > ACTIVE_A2
    return quality
