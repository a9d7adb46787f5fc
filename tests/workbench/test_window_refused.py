"""What the live page knows of its thermocouples goes along with a window that is diagnosed."""

import numpy as np
import pytest

from bms_gateway.bus.logfile import write_log
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Alerted, Engine, Notice
from bms_gateway.engine.events import Level
from bms_gateway.health.alerts import Change, Condition, Severity
from bms_gateway.report.look import look
from bms_gateway.report.table import read_table
from bms_gateway.workbench.desk import Desk
from bms_gateway.workbench.incidents import Events
from bms_gateway.workbench.live_estimates import Watch
from bms_gateway.workbench.sources import Playback
from bms_gateway.workbench.stretch import on_desk
from tests.support.desk_steps import done
from tests.support.vehicle_traffic import traffic
from tests.workbench.browser import come

EXAMPLE = "deploy/example/gateway.toml"
SECOND = 1_000_000_000
LOOSE = 'the thermocouple of cell 12 has come loose, "84 %" of the coolant in its reading: fasten it, or replace it'
DEAD = "surface of cell 1 is not used: nothing new is received (T_1)"


def alert(at_s, cell, text=LOOSE, *, raised=True, string="string_1"):
    return Alerted(at_s * SECOND, Change(Condition("thermocouple", Severity.WARNING, text, string, cell), raised))


def heard(at_s, cell, text=DEAD, level=Level.WARNING, part="surface"):
    return Notice(at_s * SECOND, level, "sensor", text, "string_1", cell, part)


@pytest.mark.parametrize(
    ("events", "expected"),
    [
        ((), {}),
        ((alert(10, 8),), {8: LOOSE}),  # before, and it stands
        ((alert(150, 8),), {8: LOOSE}),
        ((alert(250, 8),), {}),  # nobody knew it then
        ((alert(10, 8), alert(50, 8, "again", raised=False)), {}),
        ((alert(10, 8), alert(150, 8, "again", raised=False)), {8: LOOSE}),  # the reason of the doubt, not of its end
        ((alert(10, 8, string="string_2"),), {}),
        ((heard(10, 1),), {1: DEAD}),
        ((heard(110, 1), heard(150, 1, "good again", Level.NOTICE)), {}),
        ((heard(110, 1, part="cell_voltage"),), {}),
        ((heard(10, 8), alert(20, 8), heard(30, 1)), {1: DEAD, 8: LOOSE}),
    ],
)
def test_what_is_refused_in_a_stretch(events, expected):
    all_of_it = Events()
    for e in events:
        all_of_it.take(e)
    found = all_of_it.refused("string_1", 100 * SECOND, 200 * SECOND)
    assert found == expected


@pytest.fixture(scope="module")
def watch(tmp_path_factory):
    frames = traffic(400.0)
    path = tmp_path_factory.mktemp("log") / "drive.log"
    write_log(path, [frames])
    config = load_config(shipped(EXAMPLE))
    engine, source = Engine(config.plan, config.database), Playback([path])
    watch = Watch(engine, "log", path.name, 500e3, source.traffic)
    source.start(engine, watch)
    come(lambda: watch.whole, "the end of the log")
    yield watch
    watch.signals.close()


def test_a_window_that_is_diagnosed_leaves_out_what_the_live_page_refuses(watch):
    """The page fitted all cells to a thermocouple that hung in the coolant, and named none of it."""
    name = watch.about()["strings"][0]["name"]
    sensors = watch.about()["strings"][0]["sensors"]
    cell = sensors[-1]
    desk = Desk("test")
    try:
        watch.steer("test", {"play": False, "seek": 399})
        on_desk(watch, desk, {"string": 0, "span": 0, "view": "test"})
        before = done(desk)
        assert before["error"] == ""
        assert cell in before["opened"]["records"][0]["cells"]
        watch.take(alert(100, cell, LOOSE, string=name))
        table, _ = on_desk(watch, desk, {"string": 0, "span": 0, "view": "test"})
        after = done(desk)
        assert after["error"] == ""
        assert after["opened"]["records"][0]["cells"] == [k for k in sensors if k != cell]
        said = [c for c in after["opened"]["checks"] if "not fitted" in c["sentence"]]
        assert [c["severity"] for c in said] == ["warn"]
        assert said[0]["sentence"].startswith(
            f"The readings of cell {cell} are not fitted: the thermocouple of cell 12"
        )
        assert not any("no usable surface" in c["sentence"] for c in after["opened"]["checks"])
        assert after["steps"][-1]["variant"]["cells"][cell - 1]["error_K"] is None
        # the reason is in the table: it is there again after a restart, and on the command line
        read = read_table(desk.folder / table)
        assert read.refused == {cell: LOOSE}
        assert cell not in read.surface_C
        assert read.ignored == ()
        assert np.isfinite(read.current_A).any()
        (column,) = [c for c in look(desk.folder / table, {})["columns"] if "not used" in c["name"]]
        assert column["by"] not in ("name", "guess")
    finally:
        desk.close()
