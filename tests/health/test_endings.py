"""What is said when an alert is over says why it ended."""

from bms_gateway.health.alerts import Alerts, Condition, Severity
from bms_gateway.health.endings import Endings
from bms_gateway.health.nearing import BACK_HOLD, HOLD, Approach, Nearing

OPEN = "surface of cell 3 not used: its wire is open (T_3): check its wire and plug"
HOT = "surface of cell 3 reads 79.0 °C, was above the limit and is not known to be 2 K below it"


def sensor(cell, text=OPEN):
    return Condition("sensor", Severity.WARNING, text, "s1", cell, part="surface")


class Run:
    """Alerts with their endings, one tick a second."""

    def __init__(self):
        self.endings, self.measured, self.now = Endings(), "", 0.0
        self.alerts = Alerts(hold_s=0.0, clear_s=0.0, ended=lambda c: self.endings.of(c, self.measured))

    def tick(self, *conditions, quiet=False):
        self.now += 1.0
        self.endings.see(conditions, quiet=quiet)
        return [c.condition.text for c in self.alerts.update(self.now, conditions) if c.state == "over"]


def test_an_alert_without_a_known_reason_is_no_longer_so():
    alerts = Alerts(hold_s=0.0, clear_s=0.0)
    alerts.update(0.0, [sensor(3)])
    over = alerts.update(1.0, [])
    assert [(c.state, c.condition.text, c.condition.key) for c in over] == [
        ("over", f"no longer so: {OPEN}", sensor(3).key)
    ]


def test_a_sensor_that_is_good_again_ends_with_the_notice_and_not_with_its_fault():
    run = Run()
    run.endings.take("sensor", "s1", "surface", 3, "an old notice, before the fault")
    run.tick(sensor(3))
    run.endings.take("sensor", "s1", "surface", 3, "surface of cell 3 is good again (T_3)")
    run.endings.take("sensor", "s2", "surface", 3, "of another string")
    assert run.tick() == ["surface of cell 3 is good again (T_3)"]


def test_a_fault_that_is_not_judged_while_the_bus_is_quiet_is_not_said_to_be_gone():
    run = Run()
    run.tick(sensor(3))
    assert run.tick(quiet=True) == [f"not judged while no frames are received; before: {OPEN}"]


def test_a_fault_that_another_alert_tells_with_more_cells_is_not_said_to_be_gone():
    run, both = Run(), "surface of cells 3, 5 not used"
    run.tick(sensor(3))
    assert run.tick(sensor(None, both)) == [f"goes on as another alert: {both}"]


def test_an_alarm_that_a_person_ended_says_so_unless_it_came_back():
    hot = Condition("surface", Severity.ALARM, HOT, "s1", 3, wanders=True)
    run = Run()
    run.measured = "surface of cell 3 reads 70.0 °C: no surface is over the limit of 80 °C any more"
    run.tick(hot)
    run.endings.acknowledge([hot])
    assert run.tick() == ["ended by a person, who acknowledged it (cell 3)"]
    run.tick(hot)
    run.endings.acknowledge([hot])
    run.tick(hot)
    assert run.tick() == [run.measured]


def test_the_three_ends_of_a_forecast_have_their_own_reasons():
    soon, there = (Approach(2, 70.0, s, s, s, 50.0, 30.0) for s in (120.0, 0.0))
    for end, why in (
        (lambda n: n.take(there, 80.0), "hottest point of cell 2 has reached 80 °C"),
        (lambda n: n.forget(), "no forecast: the bus was silent"),
        (
            lambda n: [n.take(None, 71.5) for _ in range(BACK_HOLD)],
            "the load does not lead to 80 °C any more: at most 71.5 °C within 10 min",
        ),
    ):
        nearing = Nearing("s1", 80.0)
        for _ in range(HOLD):
            nearing.take(soon, 85.0)
        assert nearing.condition is not None
        end(nearing)
        assert nearing.condition is None
        assert nearing.why_over == why
