"""Stops and restarts in the middle of drives and after parking, the truth by the independent integrator."""

import json
from dataclasses import dataclass

import numpy as np

from bms_gateway.bus.traffic import SECOND
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Engine, Estimated, drive
from bms_gateway.frames.batch import FrameBatch
from tests.acceptance.drives import EPOCH_S, frames_of
from tests.truth.cycle import repeated
from tests.truth.string import C_F, TruthString, rk4, wavy_inlet

STRINGS, CELLS = 5, 12
TRUTH = TruthString.of(CELLS, R_cc=4.0, C_f=C_F)
AFTER_S = 4


@dataclass(frozen=True)
class Restart:
    """Errors and standard deviations (STRINGS, CELLS), K, at the first tick and one tick later; NaN: not sent."""

    error: tuple[np.ndarray, np.ndarray]
    sd: tuple[np.ndarray, np.ndarray]

    def outside(self, tick: int) -> int:
        """Cores that are sent and off by more than two of their standard deviations."""
        return int(np.sum(np.abs(self.error[tick]) > 2.0 * self.sd[tick]))

    def sent(self, tick: int) -> int:
        return int(np.isfinite(self.sd[tick]).sum())


def gateway(folder):
    """Config and model with the truth's numbers, known to 3 %, as after some windows: narrow bands."""
    text = shipped("deploy/example/gateway.toml").read_text().replace('"window"', '"off"', 1)
    (folder / "gateway.toml").write_text(text)
    model = shipped("deploy/example/string.toml").read_text()
    for wide in ("rel_sd = 0.3", "rel_sd = 0.2"):
        model = model.replace(wide, "rel_sd = 0.03")
    (folder / "string.toml").write_text(model)
    return load_config(folder / "gateway.toml")


def driven(seconds, seed, start=None):
    """One drive of each string: current, inlet, cores, surfaces; `start` are its temperatures, by string."""
    found = []
    for k in range(STRINGS):
        current = repeated(seconds // 60 + 1, 10 * seed + k)[:seconds]
        inlet = wavy_inlet(seconds, amplitude=2.0, period=300.0, phase=float(seed + k))
        core, surface = rk4(TRUTH, current, inlet, (27.0 + k, 26.0 + k) if start is None else start[k])
        found.append((current, inlet, core, surface))
    return found


def parked(drives, at_s, seconds):
    """Temperatures of each string after standing, from those at a second of its drive."""
    step = 4.0
    n = max(1, round(min(seconds, 6 * 3600) / step))  # after that it is at rest
    ends = []
    for _, _, core, surface in drives:
        c, s = rk4(TRUTH, np.zeros(n), np.full(n + 1, 25.0), (core[at_s], surface[at_s]), dt=step)
        ends.append((c[-1], s[-1]))
    return ends


def part(frames: FrameBatch, start_s: int, stop_s: int) -> FrameBatch:
    a, b = np.searchsorted(frames.time_ns, [(EPOCH_S + s) * SECOND for s in (start_s, stop_s)])
    return frames[int(a) : int(b)]


def restart(loaded, drives, frames, state, at_s, *, clock_s=0) -> Restart:
    """Restart from a state with the first frames at `at_s` of a drive, whose stamps are moved by `clock_s`."""
    engine = Engine(loaded.plan, loaded.database)
    engine.restore(json.loads(json.dumps(state)))
    some = part(frames, at_s, at_s + AFTER_S)
    moved = FrameBatch(some.time_ns + clock_s * SECOND, some.can_id, some.length, some.data)
    seen: dict[int, list] = {}
    for e in drive(engine, [moved]):
        if isinstance(e, Estimated):
            k = e.time_ns // SECOND - EPOCH_S - clock_s
            seen[k] = [(s.core - drives[int(s.string[-1]) - 1][2][k], s.core_sd) for s in e.strings()]
    ticks = [seen[at_s + 1], seen[at_s + 2]]
    error, sd = (tuple(np.array([x[i] for x in tick]) for tick in ticks) for i in (0, 1))
    return Restart(error, sd)


def states_at(loaded, frames, seconds):
    """Snapshots of one running engine at the given seconds of the drive."""
    engine, states, at = Engine(loaded.plan, loaded.database), {}, 0
    for s in sorted(seconds):
        for _ in drive(engine, [part(frames, at, s)]):
            pass
        states[s], at = json.loads(json.dumps(engine.snapshot())), s
    return states


def frames(loaded, drives, seed):
    return frames_of(loaded.plan, loaded.database, drives, seed)
