"""Frames of one string's inputs, and the ticks that they make."""

from dataclasses import replace

import numpy as np

from bms_gateway.engine import Channel, Plan, StringPlan
from bms_gateway.engine.inputs import Inputs
from bms_gateway.engine.readings import Readings
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.encode import Encoder
from bms_gateway.frames.own_dbc import own_signal
from bms_gateway.thermal import AddedEffect
from tests.engine.packs import EPOCH_S, database, plan

S = 1_000_000_000


START = EPOCH_S * S


FALLING = AddedEffect("resistance_temperature", None, {"B": 3000.0}, {"B": 300.0})


def strings() -> Plan:
    """One with everything on the bus; one that shares its current and has constants; one with effects; one blind."""
    model = plan(1).strings[0].model
    first = StringPlan(
        "string_1",
        1,
        model,
        (
            Channel("current", None, own_signal(1, "current")),
            Channel("voltage", None, own_signal(1, "voltage")),
            Channel("coolant_inlet", None, own_signal(1, "coolant_inlet")),
            Channel("coolant_flow", None, own_signal(1, "coolant_flow"), 3e-4),
            Channel("surface", 1, own_signal(1, "surface", 1)),
            Channel("surface", 4, own_signal(1, "surface", 4)),
        ),
    )
    second = StringPlan(
        "string_2",
        2,
        replace(model, sensors=(2,)),
        (
            Channel("current", None, own_signal(1, "current")),
            Channel("coolant_inlet", None, None, 18.5),
            Channel("coolant_flow", None, None, 2e-4),
            Channel("surface", 2, own_signal(2, "surface", 2), scale=2.0, offset=-20.0),
        ),
    )
    third = StringPlan(
        "string_3",
        3,
        replace(model, sensors=(3,), effects=(FALLING,)),
        (
            Channel("current", None, own_signal(1, "current"), scale=-0.5),
            Channel("coolant_inlet", None, own_signal(1, "coolant_inlet")),
            Channel("soc", None, own_signal(3, "soc")),
            Channel("surface", 3, own_signal(3, "surface", 3)),
        ),
    )
    blind = StringPlan("string_4", 4, model, (Channel("coolant_inlet", None, None, None),), "off")
    return Plan((first, second, third, blind))


def amps(t: float) -> float:
    return round(30.0 + 25.0 * float(np.sin(1.7 * t)), 1)


def volts(t: float) -> float:
    return round(13.3 - 4e-3 * amps(t), 2)


Put = list[tuple[float, str, str, int | None, float]]


def put(seconds: int, *, current=amps, silent: float = 1e9) -> Put:
    """(time, message, signal, multiplexer, value); the flow and a surface cease at `silent`."""
    found: Put = []
    for k in range(10 * seconds):
        t = k / 10
        found.append((t, "string_1_electrical", "current", None, current(t)))
        found.append((t, "string_1_electrical", "voltage", None, volts(t)))
        if k % 10 == 3:
            found.append((t, "string_1_coolant", "coolant_inlet", None, 20.0 + 0.1 * t))
            if t < silent:
                found.append((t, "string_1_coolant", "coolant_flow", None, 1e-4))
                found.append((t, "string_3_coolant", "soc", None, 0.5))
        if k % 10 == 6:
            found.append((t, "string_1_surface", "surface_01", 0, 25.0 + 0.1 * t))
            if t < silent:
                found.append((t, "string_2_surface", "surface_02", 0, 24.0 + 0.1 * t))
        if k % 10 == 8:
            found.append((t, "string_1_surface", "surface_04", 1, 26.0 + 0.1 * t))
            found.append((t, "string_3_surface", "surface_03", 0, 27.0 + 0.1 * t))
    return found


def frames(content: Put) -> FrameBatch:
    encoder = Encoder(database(), sorted({message for _, message, *_ in content}))
    lines: dict[tuple[float, int], np.ndarray] = {}
    for t, message, signal, mux, value in content:
        row = encoder.row(message) if mux is None else encoder.row(message, mux)
        line = lines.setdefault((t, row), np.full(encoder.width, np.nan))
        line[encoder.column(row, signal)] = value
    rows = np.array([row for _, row in lines])
    can_id, length, data = encoder.encode(rows, np.array(list(lines.values())))
    return FrameBatch(np.array([START + round(t * 10) * (S // 10) for t, _ in lines], np.int64), can_id, length, data)


def ticks(inputs: Inputs, content: Put, count: int, first: int = 0) -> list[Readings]:
    samples, found = inputs.decode(inputs.wanted(frames(content))), []
    for k in range(first, first + count):
        a, b = np.searchsorted(samples.time_ns, [START + k * S, START + (k + 1) * S])
        found.append(inputs.update(samples.between(a, b), START + k * S, START + (k + 1) * S))
    return found
