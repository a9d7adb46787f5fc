"""Cell voltages on the bus: cells of unequal R_e are told apart live, and the cores that are sent get better."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bms_gateway.bus.traffic import SECOND, Traffic, lines, steps
from bms_gateway.engine import Channel, Engine, Estimated, Notice, Parameters, Plan, StringPlan, drive
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.own_dbc import own_signal
from bms_gateway.thermal import Prior, StringModel
from tests.engine.packs import EPOCH_S, cut, database, text
from tests.truth.string import C_F, TABLE_1
from tests.truth.unequal import drives

SENSORS = (1, 5)
MINUTES = 35
PACK = drives([11], minutes=MINUTES, swing=4.0)


def plan(cell_voltages: bool = True, method: str = "window") -> Plan:
    values = {**TABLE_1, "R_cc": 4.0, "C_f": C_F}
    sd = {"C_c": 0.05, "C_s": 0.05, "R_e": 0.3, "R_c": 0.1, "R_u": 0.2, "R_cc": 0.2, "C_f": 0.05}
    model = StringModel(5, SENSORS, "full", {k: Prior(v, sd[k]) for k, v in values.items()}, "ntu", capacity_Ah=8.0)
    wanted = [("current", None), ("coolant_inlet", None), *(("surface", k) for k in SENSORS)]
    if cell_voltages:
        wanted += [("cell_voltage", k) for k in range(1, 6)]
    channels = tuple(Channel(q, k, own_signal(1, q, k)) for q, k in wanted)
    return Plan((StringPlan("string_1", 1, model, channels, method),))


@cache
def frames() -> FrameBatch:
    """The truth as frames of our DBC: current ten times a second, everything else once."""
    K = len(PACK.current)
    t = np.arange(K + 1.0)
    series = {("current", None): steps(t[:-1], PACK.current), ("coolant_inlet", None): lines(t, PACK.inlet)}
    for k in SENSORS:
        series["surface", k] = lines(t[1:], PACK.readings[0, :, k - 1])
    V = PACK.voltage(0, 0.03)
    for k in range(5):
        series["cell_voltage", k + 1] = steps(t[:-1], V[:, k])
    got = Traffic(plan(), database(), noise_K=0.0, seed=0).between([series], 0, K * SECOND)
    return FrameBatch(got.time_ns + EPOCH_S * SECOND, got.can_id, got.length, got.data)


@cache
def driven(cell_voltages: bool = True) -> tuple[Engine, list]:
    engine = Engine(plan(cell_voltages), database())
    return engine, list(drive(engine, cut(frames(), list(range(0, len(frames()), 5000)))))


def events(cell_voltages: bool = True) -> list:
    return driven(cell_voltages)[1]


def error(told: list, cells: slice) -> np.ndarray:
    """Core errors of the last minutes (K, cells), K."""
    got = [e for e in told if isinstance(e, Estimated)][-100:]
    seconds = [round(e.time_ns / SECOND) - EPOCH_S for e in got]
    return np.array([e.core - PACK.core[0, s] for e, s in zip(got, seconds, strict=True)])[:, cells]


@pytest.mark.slow
def test_the_unread_hot_cells_are_sent_much_closer() -> None:
    without, with_voltages = (np.sqrt(np.mean(error(events(v), slice(1, 4)) ** 2)) for v in (False, True))
    assert with_voltages < 2.0
    assert with_voltages < 0.6 * without


def test_the_bands_hold_the_truth() -> None:
    got = [e for e in events() if isinstance(e, Estimated)][-100:]
    off = np.abs(error(events(), slice(0, 5))) / np.array([e.core_sd for e in got])
    assert np.mean(off < 2.0) > 0.8
    assert off.max() < 4.0


def test_each_cell_is_told_with_its_status() -> None:
    last = [e for e in events() if isinstance(e, Parameters)][-1]
    cells = {e.name: e for e in last.estimates if e.name.startswith("R_e_")}
    assert list(cells) == [f"R_e_{k}" for k in range(1, 6)]
    assert {e.status for e in cells.values()} == {"identified"}
    for k in range(5):
        e = cells[f"R_e_{k + 1}"]
        assert abs(e.value - PACK.R_e[0, k]) < 3 * e.sd
    notices = {e.code: e.text for e in events() if isinstance(e, Notice)}
    assert "unheard" not in notices
    assert "the surfaces determine R_e of cell 1 against cell" in notices["cells"]
    assert "skew" not in notices


@pytest.mark.slow
def test_the_stream_does_not_depend_on_how_frames_are_cut() -> None:
    rng = np.random.default_rng(4)
    other = list(drive(Engine(plan(), database()), cut(frames(), rng.integers(0, len(frames()), 300).tolist())))
    assert text(other) == text(events())


def test_a_bus_without_cell_voltages_is_estimated_as_ever() -> None:
    """Wired, as our own DBC always is, but never sent: no notice, no other number."""
    voltage_id = database().resolve(own_signal(1, "cell_voltage", 1)).can_id
    some = frames()
    keep = some.can_id != voltage_id
    silent = FrameBatch(some.time_ns[keep], some.can_id[keep], some.length[keep], some.data[keep])
    first = [e for e in drive(Engine(plan(), database()), [silent[:2000]]) if isinstance(e, Estimated | Notice)]
    usual = [e for e in drive(Engine(plan(False), database()), [silent[:2000]]) if isinstance(e, Estimated | Notice)]
    assert text(first) == text(usual)


def test_a_restart_keeps_the_cells_and_what_is_sent() -> None:
    one, _ = driven(True)
    two = Engine(plan(), database())
    two.restore(json.loads(json.dumps(one.snapshot(), allow_nan=False)))
    assert two.strings[0].estimates == one.strings[0].estimates
    later = replace(frames(), time_ns=frames().time_ns + MINUTES * 60 * SECOND)
    after = next(e for e in drive(two, [later[:1000]]) if isinstance(e, Estimated))
    assert np.isfinite(after.core).all()
    assert np.abs(after.core - one.strings[0].core).max() < 3.0
    old = json.loads(json.dumps(one.snapshot(), allow_nan=False))
    del old["estimators"]["strings"]["string_1"]["cells"]
    Engine(plan(), database()).restore(old)  # of before cells were told apart


@pytest.mark.parametrize("method", ["rls", "off"])
def test_only_the_windowed_method_listens_to_cells(method: str) -> None:
    engine = Engine(plan(method=method), database())
    assert database().resolve(own_signal(1, "cell_voltage", 1)).can_id not in engine.can_ids.tolist()
    assert engine.strings[0].cells is None
