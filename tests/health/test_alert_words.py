"""In every sentence of an alert ± is the half width of the 95 % band, and a space stands before the per cent sign."""

from bms_gateway.health.causes import Cooling
from bms_gateway.health.heat.fault_evidence import Kind
from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.sentences import sentence
from bms_gateway.health.self_discharge import Leak

MIN = 60 * 10**9


def test_heat_is_told_with_its_band():
    found = Finding("unexplained_heat", 3, 2, 0, heat=2.0, heat_sd=0.3, others=(("cooling", 0.2),), sure=0.8)
    told = sentence(found, 12, 20 * MIN)
    assert "2 ± 0.6 W that no current makes" in told
    assert "(80 % sure; it may sit in cell 2 or 4, or in several of them); could also be cooling (20 %)" in told


def test_no_alert_says_that_a_cell_makes_negative_heat():
    """Bug: "heats by itself: -50 ± 10 W" was sent while the cell had not cooled."""
    found = Finding("unexplained_heat", 3, 2, 0, heat=-50.0, heat_sd=5.0, size=136.0)
    told = sentence(found, 12, 20 * MIN)
    assert "heats by itself: 136 W when it was found; none is seen now, but the cell has not cooled, since" in told
    assert "50" not in told


def test_shares_of_a_reading_are_per_cent():
    loose = Finding("thermocouple", 3, 1, 0, kind=Kind.LOOSE, size=0.4)
    assert "has come loose: 40 % of the coolant is in its reading" in sentence(loose, 12, MIN)
    jump = Finding("thermocouple", 3, 1, 0, kind=Kind.JUMP, size=-0.4)
    assert "has jumped by −0.4 K" in sentence(jump, 12, MIN)


def test_cooling_and_a_leak_are_told_with_their_bands():
    cooling = Cooling(growth=0.2, growth_sd=0.02)
    cooling.flag.level = 1
    assert "(R_u +20 ± 4 %)" in cooling.sentence(flow_known=True)
    leak = Leak(2, -1e-3, 1e-4, 5e-3, 1e-3, 0.02, 0, 4.0).text
    assert "5 ± 2 mA (0.02 W)" in leak
    assert "1 ± 0.2 mV/h for 4.0 h at rest (10 sd)" in leak


def test_numbers_have_a_true_minus():
    """ "Reads -3.8 K off" stood beside numbers with a minus."""
    inlet = Finding("inlet", 3, None, 0, size=3.84)
    assert "the coolant inlet reads −3.8 K off what the cells feel" in sentence(inlet, 12, MIN)
    slope = Finding("thermocouple", 3, 1, 0, kind=Kind.SLOPE, size=-1.25)
    assert "drifts by −1.2 K/h" in sentence(slope, 12, MIN)
    cooling = Finding("cooling", 3, None, 0, size=-0.2)
    assert "(R_u −20 %)" in sentence(cooling, 12, MIN)
