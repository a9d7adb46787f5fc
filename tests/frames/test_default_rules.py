"""What is believed of each quantity by default, number by number as the guide for users states it."""

import math

import pytest

from bms_gateway.frames.database import Database
from bms_gateway.frames.rules import Rule, default_rule
from bms_gateway.frames.signal_info import SignalInfo

S = 1_000_000_000
DBC = (
    'VERSION ""\nBS_:\nBU_: A\nBO_ 1 M: 32 A\n SG_ tenths : 0|16@1+ (0.1,-100) [0|0] "C" A\n'
    ' SG_ degrees : 16|8@1+ (1,-40) [0|0] "C" A\n SG_ twentieths : 24|16@1- (0.05,0) [0|0] "C" A\n'
    ' SG_ amps : 40|16@1- (0.1,5) [0|0] "A" A\n SG_ up : 56|8@1+ (2,0) [0|0] "A" A\n'
    ' SG_ down : 64|8@1+ (-2,0) [0|0] "A" A\n SG_ few : 72|16@1- (0.5,1) [-50|60] "A" A\n'
    ' SG_ real : 96|32@1- (1,0) [0|0] "C" A\n SG_ near : 128|8@1- (1,127.5) [0|0] "A" A\n'
    ' SG_ above : 136|8@1+ (1,0.25) [0|0] "A" A\n'
    'BO_ 4 TURNS: 8 A\n SG_ part M : 0|8@1+ (1,0) [0|0] "" A\n'
    ' SG_ tenths m0 : 8|16@1+ (0.1,-100) [0|0] "C" A\n SG_ other m0 : 24|16@1+ (0.1,-100) [0|0] "C" A\n'
    + "".join(f' SG_ t{k} m{k} : 8|16@1+ (0.1,-100) [0|0] "C" A\n' for k in range(1, 33))
    + 'BO_ 5 MANY: 8 A\n SG_ part M : 0|16@1+ (1,0) [0|0] "" A\n'
    + "".join(f' SG_ t{k} m{k} : 16|16@1+ (0.1,-100) [0|0] "C" A\n' for k in range(1, 100))
    + "BO_ 2 SLOW: 8 A\n"
    ' SG_ tenths : 0|16@1+ (0.1,-100) [0|0] "C" A\nBO_ 3 FAST: 8 A\n SG_ tenths : 0|16@1+ (0.1,-100) [0|0] "C" A\n'
    "SIG_VALTYPE_ 1 real : 1;\n"
    'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;\nBA_DEF_DEF_ "GenMsgCycleTime" 0;\n'
    'BA_ "GenMsgCycleTime" BO_ 2 4000;\nBA_ "GenMsgCycleTime" BO_ 3 10;\n'
)
DATABASE = Database.load({"a.dbc": DBC})


def signal(path: str) -> SignalInfo:
    return DATABASE.resolve(path)


@pytest.mark.parametrize(
    ("quantity", "lower", "upper"),
    [
        ("current", -3000.0, 3000.0),
        ("voltage", 0.0, 1500.0),
        ("coolant_inlet", -38.5, 120.0),
        ("coolant_flow", 0.0, 1.0),
        ("soc", -0.05, 1.05),
        ("surface", -38.5, 150.0),
        ("cell_voltage", 0.0, 6.0),
    ],
)
def test_what_is_plausible_where_nothing_is_known_of_the_signal(quantity: str, lower: float, upper: float) -> None:
    rule = default_rule(quantity, None)
    assert (rule.lower, rule.upper, rule.group, rule.quantity) == (lower, upper, 0, quantity)
    assert (rule.low_rail, rule.high_rail) == (-math.inf, math.inf)
    assert rule.stale_after_ns == (10 * S if quantity in ("surface", "coolant_inlet") else 5 * S)
    assert not rule.needs_proof
    if quantity == "surface":
        assert (rule.jump, rule.jump_rate, rule.stuck_after_s) == (2.5, 0.2, pytest.approx(20.0))
    elif quantity == "coolant_inlet":
        assert (rule.jump, rule.jump_rate, rule.stuck_after_s) == (10.0, 1.0, math.inf)
    else:
        assert not rule.remembers


def test_a_rule_that_says_nothing_believes_all() -> None:
    rule = Rule("voltage")
    assert (rule.lower, rule.upper) == (rule.low_rail, rule.high_rail) == (-math.inf, math.inf)
    assert (rule.group, rule.stale_after_ns, rule.jump, rule.jump_rate) == (0, 5 * S, math.inf, 0.0)
    assert not rule.remembers


@pytest.mark.parametrize("said", [{"jump": 2.0}, {"stuck_after_s": 5.0}, {"needs_proof": True}])
def test_each_rule_about_the_past_makes_a_channel_remember(said: dict[str, float]) -> None:
    assert Rule("surface", **said).remembers


def test_the_round_of_values_that_take_turns_is_what_the_dbc_lists() -> None:
    listed = (("TURNS.tenths", 33, 33), ("TURNS.part", 1, 0), ("MANY.t7", 99, 60), ("FAST.tenths", 1, 0))
    for path, turns, seconds in listed:
        info = signal(path)
        assert DATABASE.message(info.message).turns(info) == turns
        for quantity in ("surface", "coolant_inlet", "current"):
            rule = default_rule(quantity, info, turns=turns)
            assert rule.round_ns == seconds * S
            assert rule.stale_after_ns == default_rule(quantity, info).stale_after_ns


@pytest.mark.parametrize(
    ("path", "quantity", "seconds"),
    [
        *(("SLOW", "current", 20), ("FAST", "current", 1), ("M", "current", 5)),
        *(("SLOW", "surface", 20), ("FAST", "surface", 10), ("FAST", "coolant_inlet", 10)),
    ],
)
def test_a_value_is_stale_after_five_cycles_but_never_within_a_second(path: str, quantity: str, seconds: int) -> None:
    assert default_rule(quantity, signal(f"{path}.tenths")).stale_after_ns == seconds * S


def test_patience_with_a_sensor_that_stands_grows_with_its_step_from_20_s_to_half_an_hour() -> None:
    power = math.log(1800 / 20) / math.log(0.5 / 0.01)  # straight in logarithms
    for path, scale, step in (("tenths", 1.0, 0.1), ("tenths", -0.5, 0.05), ("twentieths", 1.0, 0.05)):
        rule = default_rule("surface", signal(f"M.{path}"), scale)
        assert rule.stuck_after_s == pytest.approx(20 * (step / 0.01) ** power)
    assert default_rule("surface", signal("M.tenths"), 0.01).stuck_after_s == pytest.approx(20.0)
    assert default_rule("surface", signal("M.degrees")).stuck_after_s == 1800.0


def test_proof_is_asked_of_signals_with_steps_of_up_to_a_twentieth() -> None:
    assert default_rule("surface", signal("M.twentieths")).needs_proof
    assert not default_rule("surface", signal("M.twentieths"), 1.01).needs_proof
    assert not default_rule("surface", signal("M.real")).needs_proof  # no steps to be seen


@pytest.mark.parametrize(("scale", "jump"), [(0.5, 2.5), (1.0, 2.5), (2.0, 5.0), (-2.0, 5.0)])
def test_a_coarse_signal_may_step_by_two_and_a_half_of_its_steps(scale: float, jump: float) -> None:
    assert default_rule("surface", signal("M.degrees"), scale).jump == jump


@pytest.mark.parametrize(
    ("path", "scale", "offset", "low", "high"),
    [
        ("degrees", 1.0, 0.0, -39.5, 214.5),
        ("degrees", 1.0, 3.0, -36.5, 217.5),
        ("degrees", -1.0, 3.0, -211.5, 42.5),
        ("twentieths", 2.0, 0.0, -3276.75, 3276.65),
        ("real", 1.0, 0.0, -math.inf, math.inf),
    ],
)
def test_the_ends_of_what_the_bits_can_show_are_rails(
    path: str, scale: float, offset: float, low: float, high: float
) -> None:
    for quantity in ("surface", "coolant_inlet"):
        rule = default_rule(quantity, signal(f"M.{path}"), scale, offset, group=3)
        assert (rule.low_rail, rule.high_rail) == (pytest.approx(low), pytest.approx(high))
        assert rule.group == 3


@pytest.mark.parametrize(
    ("path", "scale", "offset", "lower", "upper"),
    [
        ("amps", 0.5, 0.0, -1635.875, 1640.825),  # ±3276.8 A · 0.5, around 2.5 A, half a step inwards
        ("amps", 0.5, 7.0, -1628.875, 1647.825),
        ("amps", -0.5, 7.0, -1633.825, 1642.875),
        ("up", 1.0, 0.0, -3000.0, 509.0),
        ("up", 1.0, 0.5, -3000.0, 509.5),  # zero is within half a step of the end
        ("up", 1.0, 1.0, 2.0, 510.0),
        ("up", 1.0, 20.0, 21.0, 529.0),
        ("down", 1.0, 0.0, -509.0, 3000.0),
        ("down", 1.0, -0.5, -509.5, 3000.0),
        ("down", 1.0, -1.0, -510.0, -2.0),
        ("down", -1.0, 0.0, -3000.0, 509.0),
        ("few", 1.0, 0.0, -49.75, 59.75),
        ("real", 1.0, 0.0, -3000.0, 3000.0),
        ("near", 1.0, 0.0, 0.0, 254.0),
        ("above", 1.0, 0.0, -3000.0, 254.75),
        ("above", -1.0, 0.0, -254.75, 3000.0),
    ],
)
def test_a_current_may_be_anything_short_of_the_ends_of_its_signal_but_zero(
    path: str, scale: float, offset: float, lower: float, upper: float
) -> None:
    rule = default_rule("current", signal(f"M.{path}"), scale, offset)
    assert (rule.lower, rule.upper) == (pytest.approx(lower), pytest.approx(upper))
    assert not rule.remembers


def test_other_quantities_take_no_range_from_the_ends_of_their_signal() -> None:
    assert default_rule("voltage", signal("M.up")).upper == 1500.0
