"""A thermocouple that is reported to be wrong ends no alarm of its cell."""

import pytest

from bms_gateway.engine import Engine, drive
from bms_gateway.engine.events import Alerted
from bms_gateway.health.heat import Finding
from bms_gateway.health.string_health import StringHealth
from tests.engine.packs import EPOCH_S, database
from tests.engine.told_strings import S, said, with_channels

HOT_S, FALL_K_S, LEFT_C = 120.0, 0.2, 45.0  # a thermocouple that slips off falls no faster than a cell cools


def slipping(t: float) -> float:
    return max(85.0 - FALL_K_S * max(t - HOT_S, 0.0), LEFT_C)


def ends(events: list) -> list[tuple[str, int]]:
    return [
        (e.change.condition.name, e.time_ns // S - EPOCH_S)
        for e in events
        if isinstance(e, Alerted) and e.change.state == "over" and e.change.condition.name in ("core", "surface")
    ]


@pytest.mark.parametrize("wrong", [False, True])
def test_a_thermocouple_that_is_reported_to_be_wrong_ends_no_alarm(
    monkeypatch: pytest.MonkeyPatch, wrong: bool
) -> None:
    # Bug: a cell with a short of 30 W got a thermocouple that slips off. The report of it did not keep the alarm up.
    found = [Finding("thermocouple", k, 1, 0) for k in (1, 4)] if wrong else []
    monkeypatch.setattr(StringHealth, "heat", property(lambda _: found, lambda *_: None), raising=False)
    engine = Engine(with_channels(), database())
    events = list(drive(engine, [said(480, surface=slipping)]))
    assert engine.faults == []
    raised = {e.change.condition.name for e in events if isinstance(e, Alerted) and e.change.state == "raised"}
    assert {"core", "surface"} <= raised
    assert ("surface" in dict(ends(events))) is not wrong
    if wrong:
        assert ends(events) == []
