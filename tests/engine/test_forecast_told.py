"""What a forecast says on the bus, and what it does not say of cells that are not known."""

import numpy as np
import pytest

from bms_gateway.engine import Alerted, Engine, Estimated, Foreseen, SendFrames, drive
from bms_gateway.frames.batch import FrameBatch
from tests.engine.packs import EPOCH_S, database, plan, traffic
from tests.engine.told_strings import S, said, warm, with_channels
from tests.frames.payloads import OWN, parsed


@pytest.fixture(scope="module")
def driven():
    """An engine after 45 s of a drive, its forecasts, and the frames of its last forecasts."""
    engine = Engine(plan(1), database())
    engine.foresee()
    events = list(drive(engine, [traffic(45, strings=1)]))
    foreseen = [e for e in events if isinstance(e, Foreseen)]
    sent = FrameBatch.concat([e.batch for e in events if isinstance(e, SendFrames)])
    return engine, foreseen, sent, [e for e in events if isinstance(e, Estimated)]


def test_every_ten_seconds_of_bus_time_there_is_one(driven) -> None:
    _, foreseen, _, _ = driven
    assert [e.time_ns // 1_000_000_000 % 10 for e in foreseen] == [0] * len(foreseen)
    assert len(foreseen) == 4


def test_the_bus_has_what_was_foreseen(driven) -> None:
    engine, foreseen, sent, _ = driven
    f = foreseen[-1].forecasts[0]
    assert f is not None
    message = parsed(OWN).get_message_by_name("string_1_forecast")
    mine = (sent.can_id & 0x1FFF_FFFF) == message.frame_id
    told: dict = {}
    for data in sent.data[mine][-4:]:
        told |= message.decode(bytes(data))
    k = f.hottest
    assert k is not None
    for h, part in enumerate(("1min", "5min", "10min"), start=1):
        assert told[f"point_in_{part}"] == pytest.approx(f.centre[h, k], abs=0.01)
        assert told[f"point_sd_{part}"] == pytest.approx(min(f.centre_sd[h, k], 25.0), abs=0.06)
    assert (told["limit_in"], told["limit_cell"]) == (600.0, 0)
    for i, part in enumerate(("10s", "1min", "10min")):
        assert told[f"discharge_{part}"] == pytest.approx(f.discharge[i], abs=0.06)
        assert told[f"charge_{part}"] == pytest.approx(f.charge[i], abs=0.06)
    assert engine.strings[0].forecast is f


def test_of_a_core_that_is_not_known_nothing_is_foreseen(driven) -> None:
    _, foreseen, _, estimated = driven
    by_time = {e.time_ns: e for e in estimated}
    for e in foreseen:
        f, core = e.forecasts[0], by_time[e.time_ns].core
        assert f is not None
        assert np.array_equal(np.isnan(f.core[0]), np.isnan(core))
        assert np.isinf(f.limit_s[np.isnan(core)]).all()


@pytest.mark.parametrize("drop_K", [5.0, 12.0, 25.0])
def test_a_thermocouple_that_comes_off_makes_no_forecast_of_its_neighbours_wild(drop_K) -> None:
    # Bug: 148 ± 8 °C were foreseen of a cell of 40 °C, since the core of its neighbour was estimated at 2,500 °C.
    off = 200.0
    engine = Engine(with_channels(), database())
    engine.foresee()
    frames = said(320, current=lambda t: 20.0, last=lambda t: warm(t) + 0.5 - drop_K * (t >= off))
    seen = [(e.time_ns // S - EPOCH_S, e.forecasts[0]) for e in drive(engine, [frames]) if isinstance(e, Foreseen)]
    assert engine.faults == []
    before = next(f for t, f in reversed(seen) if t <= off)
    after = [f for t, f in seen if t > off]
    assert before is not None
    for f in after:
        assert f is not None
        assert f.centre_sd[0, 3] < 1000.0
        told = f.centre_sd[:, :3] <= 12.0
        moved = np.abs(f.centre[:, :3] - before.centre[:, :3])
        assert (moved < 8.0 + 2.0 * np.hypot(f.centre_sd, before.centre_sd)[:, :3])[told].all()


def test_a_warning_of_a_forecast_is_of_the_load_of_before_while_the_bus_is_silent() -> None:
    engine = Engine(with_channels(), database())
    hot = said(150, current=lambda t: 90.0, surface=lambda t: 25.0 + 0.1 * t)
    later = said(5, surface=lambda t: 42.0, start=300)
    events = list(drive(engine, [hot]))
    engine.handle_timer(now_ns=(EPOCH_S + 165) * S)
    standing = [c.text for c in engine.alerts.raised if c.name == "forecast"]
    changes = [e.change for e in (*events, *drive(engine, [later])) if isinstance(e, Alerted)]
    told = [(c.state, c.condition.text) for c in changes if c.condition.name == "forecast"]
    assert (told[0][0], told[-1][0]) == ("raised", "over")
    assert all("at this load (90 A" in text for _, text in told[:-1])
    assert ["before the bus fell silent (90 A" in text for text in standing] == [True]
    assert told[-1][1] == "no forecast: the bus was silent"
