"""Strings whose events are looked at."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bms_gateway.engine import Channel, Plan
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.encode import Encoder
from bms_gateway.identify.cell_prior import Layout
from bms_gateway.thermal import Commissioning, Prior
from tests.engine.packs import EPOCH_S, database, plan

S = 1_000_000_000


MESSAGES = ("string_1_electrical", "string_1_coolant", "string_1_surface")


Course = Callable[[float], float]


def with_channels(*more: Channel, without: tuple[str, ...] = (), strings: int = 1) -> Plan:
    made = []
    for s in plan(strings).strings:
        kept = tuple(c for c in s.channels if c.quantity not in without)
        made.append(replace(s, channels=(*kept, *more)))
    return Plan(tuple(made))


def drawn(t: float) -> float:
    """A current that moves every second, both ways."""
    return 40.0 + 60.0 * np.sin(2.1 * np.floor(t) ** 2)


def volts(t: float) -> float:
    return 300.0 - 0.1 * drawn(t)


def warm(t: float) -> float:
    return 25.0 + 0.03 * t


def said(
    seconds: int,
    current: Course = drawn,
    voltage: Course = volts,
    surface: Course = warm,
    start: int = 0,
    last: Course | None = None,
) -> FrameBatch:
    """One string's frames: current and voltage ten times a second, the rest once; `last`: surface of cell 4."""
    encoder = Encoder(database(), MESSAGES)
    times, rows, values = [], [], []

    def put(t: float, row: int, **content: float) -> None:
        line = np.full(encoder.width, np.nan)
        for name, value in content.items():
            line[encoder.column(row, name)] = value
        times.append(round((EPOCH_S + start + t) * 10) * (S // 10))
        rows.append(row)
        values.append(line)

    for k in range(10 * seconds):
        t = k / 10
        put(t, encoder.row("string_1_electrical"), current=current(t), voltage=voltage(t))
        if k % 10 == 5:
            put(t, encoder.row("string_1_coolant"), coolant_inlet=20.0 + 0.02 * t, coolant_flow=1e-4, soc=0.5)
            put(t, encoder.row("string_1_surface", 0), surface_01=surface(t))
            put(t, encoder.row("string_1_surface", 1), surface_04=last(t) if last else surface(t) + 0.5)
    can_id, length, data = encoder.encode(np.array(rows), np.array(values))
    return FrameBatch(np.array(times, np.int64), can_id, length, data)


def commissioned(error: float) -> Plan:
    """Four cells told apart by a fit, each number with the same error of its own."""
    one = with_channels().strings[0]
    R_e = 3.5e-3 * np.array([0.9, 1.0, 1.2, 1.05])
    model = replace(one.model, priors=one.model.priors | {"R_e": Prior(R_e, 0.3)})
    labels = Layout.of(model).labels
    n = len(labels)
    told = Commissioning(labels, np.full(n, error), np.eye(n), np.full(4, np.nan))
    return Plan((replace(one, model=replace(model, commissioning=told)),))
