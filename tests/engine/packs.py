"""Plans and traffic for engine tests: two strings of four cells, ends sensed, by our own DBC."""

from dataclasses import fields, is_dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from bms_gateway.bus.traffic import SECOND, Traffic
from bms_gateway.bus.virtual import VirtualPack
from bms_gateway.config import own_dbc_text
from bms_gateway.config.dbc_files import read_dbc
from bms_gateway.engine import Channel, Event, Plan, StringPlan
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.database import Database
from bms_gateway.frames.own_dbc import OWN_DBC, own_signal
from bms_gateway.thermal import Prior, StringModel

CELLS = 4
SENSORS = (1, 4)
EPOCH_S = 1_700_000_000  # bus time is wall-clock time


@cache
def database() -> Database:
    return Database.load({OWN_DBC: own_dbc_text()}, read_dbc)


def model(rel_sd: float) -> StringModel:
    values = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79, "R_cc": 4.0, "C_f": 11.33}
    sd = {k: 0.05 if k.startswith("C_") else rel_sd for k in values}
    return StringModel(CELLS, SENSORS, "full", {k: Prior(v, sd[k]) for k, v in values.items()}, capacity_Ah=8.0)


def plan(strings: int = 2, rel_sd: float = 0.3) -> Plan:
    made = []
    for k in range(1, strings + 1):
        channels = [Channel("current", None, own_signal(k, "current"))]
        channels.append(Channel("coolant_inlet", None, own_signal(k, "coolant_inlet")))
        channels += [Channel("surface", c, own_signal(k, "surface", c)) for c in SENSORS]
        made.append(StringPlan(f"string_{k}", k, model(rel_sd), tuple(channels)))
    return Plan(tuple(made))


def traffic(seconds: int, seed: int = 1, strings: int = 2) -> FrameBatch:
    """Frames of a drive, stamped from `EPOCH_S` on."""
    the_plan = plan(strings)
    source = Traffic(the_plan, database(), noise_K=0.1, seed=seed)
    parts = []
    for segments in VirtualPack(the_plan, seed).segments(seconds):
        time = segments[0].time_s
        parts.append(source.between([s.series for s in segments], int(time[0]) * SECOND, int(time[-1]) * SECOND))
    frames = FrameBatch.concat(parts)
    return FrameBatch(frames.time_ns + EPOCH_S * SECOND, frames.can_id, frames.length, frames.data)


def cut(frames: FrameBatch, edges: list[int]) -> list[FrameBatch]:
    """Cut a batch at the given places."""
    at = [0, *sorted(edges), len(frames)]
    return [frames[a:b] for a, b in pairwise(at)]


def text(events: list[Event]) -> list[str]:
    """Events as text in which every bit shows."""
    return [_bits(e) for e in events]


def _bits(value: object) -> str:
    if isinstance(value, np.ndarray):
        return value.tobytes().hex()
    if is_dataclass(value):
        return type(value).__name__ + "".join(f" {_bits(getattr(value, f.name))}" for f in fields(value))
    return repr(value)
