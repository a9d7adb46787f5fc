"""What the gateway tells of health on the bus, read back by cantools."""

import numpy as np
import pytest

from bms_gateway.engine import Engine, SendFrames, drive
from bms_gateway.frames.own_dbc import string_message
from tests.engine.packs import database, plan, traffic
from tests.frames.payloads import OWN, parsed

DBC = parsed(OWN)
FRAMES = traffic(25)


def told(engine: Engine) -> dict[str, dict[int, dict]]:
    """Newest content of each of our messages, by multiplexer value where there is one."""
    found: dict[str, dict[int, dict]] = {}
    for event in drive(engine, [FRAMES]):
        if isinstance(event, SendFrames):
            for can_id, data in zip(event.batch.can_id.tolist(), event.batch.data, strict=True):
                message = DBC.get_message_by_frame_id(can_id & 0x1FFF_FFFF)
                content = message.decode(bytes(data), decode_choices=False, scaling=True)
                found.setdefault(message.name, {})[int(content.get("mux", 0))] = content
    return found


def test_before_commissioning_flags_are_not_available_but_mismatch_is() -> None:
    frames = told(Engine(plan(), database()))
    flags = frames[string_message(1, "flags")][0]
    for name in ("ageing_flag", "cooling_flag", "thermocouple_flag", "current_flag"):
        assert flags[name] == 15, name
    assert flags["mismatch_flag"] == 0
    growth = frames[string_message(2, "growth")]
    assert sorted(growth) == [1, 2, 3, 4]
    assert growth[3]["flag_03"] == 15
    assert growth[3]["growth_03"] > 500  # raw all ones


def test_every_flag_has_its_place() -> None:
    engine = Engine(plan(), database())
    h = engine.strings[0].health
    names = tuple(h.model.priors)
    mean = np.log([float(p.value) for p in h.model.priors.values()])
    for _ in range(3):
        h.offer(names, mean, 1e-4 * np.eye(len(names)), 3.5e-3, True)
    assert h.commissioned
    for _ in range(3):
        h.ageing.update(0.213, 0.012)
    h.fitted(np.array([0.0, 0.0, 0.1, 0.0]), np.full(4, 0.01), np.zeros(4))
    h.ageing.flag.level, h.cooling.flag.level, h.drift.flag.level = 2, 1, 2
    h.current.flag.level, h.mismatch.flag.level = 1, 2
    h.drift.kelvin, h.drift.sd = np.array([0.1, -2.2]), np.array([0.1, 0.1])
    h.cooling.growth = 0.314
    frames = told(engine)
    flags = frames[string_message(1, "flags")][0]
    assert [flags[f"{x}_flag"] for x in ("ageing", "cooling", "thermocouple", "current", "mismatch")] == [2, 1, 2, 1, 2]
    assert flags["thermocouple_cell"] == 4
    assert flags["R_u_growth"] == pytest.approx(31.4)
    growth = frames[string_message(1, "growth")]
    assert growth[1]["growth_01"] == pytest.approx(100 * h.cells.ageing[0].growth, abs=0.01)
    assert growth[3]["growth_sd_03"] == pytest.approx(100 * h.cells.ageing[2].growth_sd, abs=0.01)
    assert growth[3]["flag_03"] == h.cells.ageing[2].flag.level
    labels = DBC.get_message_by_name(string_message(1, "flags")).get_signal_by_name("cooling_flag").choices
    assert {k: str(v) for k, v in labels.items()} == {
        0: "none", 1: "warning", 2: "alarm", 14: "error", 15: "not available"
    }  # fmt: skip
    assert engine.strings[0].flags == (
        "current_suspected", "R_e_warning", "cooling_warning", "thermocouple_alarm:4", "mismatch_confirmed"
    )  # fmt: skip
