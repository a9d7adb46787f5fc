"""Frames of measured quantities by hand: which value a series has, when each frame goes out, and what is in it."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.bus import traffic
from bms_gateway.bus.traffic import Series, Traffic, feed_of, lines, steps, voltage_steps
from bms_gateway.config import load_config
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.errors import UsageError
from bms_gateway.frames.batch import EXTENDED, FrameBatch
from tests.bus.frames import rows
from tests.config.files import DBC, MAPPED, OWN, write

NAN = float("nan")
SECOND = 1_000_000_000


def array(*values):
    return np.array(values, float)


def test_the_bounds():
    assert (traffic.SECOND, traffic.ELECTRICAL_NS, traffic.OTHER_NS) == (10**9, 10**8, 10**9)
    assert (traffic.HOLE_S, traffic.HOLE_INTERVALS, traffic.EDGE_S, traffic.SAME_CURRENT) == (10.0, 10.0, 1e-6, 0.01)
    assert traffic.CHUNK_S == 600


# series


def test_a_series_is_known_between_near_points_and_a_little_beyond_its_ends():
    s = Series(array(0, 1, 6, 14, 15), array(0, 10, 20, 100, 110), 5.0)
    known = {-5.0: 0, -0.5: 0, 0.0: 0, 0.5: 5, 3.5: 15, 6.0: 20, 14.0: 100, 14.5: 105, 15.0: 110, 20.0: 110}
    assert s.at(array(*known)).tolist() == list(known.values())
    assert np.isnan(s.at(array(-5.001, 6.001, 10.0, 13.999, 20.001, 30.0))).all()
    assert np.isnan(Series(array(0, 8, 9), array(1, 2, 3), 5.0).at(array(4.0)))
    assert np.isnan(Series(array(0, 1, 9), array(1, 2, 3), 5.0).at(array(4.0)))
    one = Series(array(3), array(7), 10.0)
    assert one.at(array(-7, 3, 13)).tolist() == [7, 7, 7]
    assert np.isnan(one.at(array(-7.1, 13.1))).all()


@pytest.mark.parametrize(
    ("t", "hole"), [((3,), 10.0), ((0, 0.5, 1), 10.0), ((0, 2, 4, 5), 20.0), ((0, 5), 50.0), ((), 10.0)]
)
def test_a_hole_is_ten_seconds_and_ten_usual_intervals_long(t, hole):
    assert lines(array(*t), array(*t)).hole_s == hole
    assert steps(array(*t), array(*t)).hole_s == hole


@pytest.mark.parametrize("step", [0.1, 0.25, 0.5, 1.0])
def test_a_temperature_in_coarse_steps_keeps_them_between_its_rows(step):
    """Lines between rows hid from the guard how coarse a sensor is, and halved its noise."""
    t = np.arange(600.0)
    x = np.round((30.0 + 0.01 * t + 0.4 * step * np.random.default_rng(1).standard_normal(600)) / step) * step
    at = np.arange(0.0, 599.0, 0.3)
    read = lines(t, x).at(at)
    assert read == pytest.approx(x[np.floor(at + 0.5).astype(int)], abs=1e-9)  # of the nearest row
    off = (read - x[0]) / step
    assert np.abs(off - np.round(off)).max() < 1e-6


def test_a_fine_or_smooth_temperature_is_a_line_between_its_rows():
    t = np.arange(600.0)
    for x in (30.0 + 0.01 * t, np.round(30.0 + 0.01 * t, 2), 30.0 + 0.25 * t):
        assert x[10] != x[11]
        assert lines(t, x).at(array(10.5)).tolist() == [0.5 * (x[10] + x[11])]


def test_steps_are_as_narrow_as_rows_allow():
    s = steps(array(0, 1, 2), array(1, 3, 5))
    assert s.at(array(0.5, 0.9999985, 1.0, 1.9, 2.0)).tolist() == [1, 1, 3, 3, 5]
    near = steps(array(0, 1e-6, 2e-6), array(1, 3, 5))
    assert np.all(np.diff(near.time_s) > 0)
    assert near.at(array(0.4e-6, 1e-6, 1.4e-6, 2e-6)).tolist() == [1, 3, 3, 5]
    assert steps(array(0, 1), array(1, 3)).at(array(0.9)).tolist() == [1]
    assert steps(array(4), array(3)).at(array(4)).tolist() == [3]
    with_blank = steps(array(0, 1, 2, 3), array(1, NAN, 5, 7), np.array([True, False, False, True]))
    assert with_blank.at(array(1.0, 2.0, 2.5, 3.0)).tolist() == [3, 5, 5, 7]


def test_a_voltage_steps_where_the_current_moves_by_more_than_a_hundredth_of_its_greatest():
    t, volts = np.arange(5.0), array(10, 8, 6, 4, 9)
    at = array(0.5, 1.5, 2.5, 3.5)
    assert voltage_steps(t, volts, array(0, 100, 99, 98.5, 95)).at(at).tolist() == [10, 7, 5, 4]
    assert voltage_steps(t, volts, array(0, -0.005, -0.005, 0, 0)).at(at).tolist() == [10, 7, 6, 6.5]
    gaps = voltage_steps(t, array(10, NAN, 6, 4, 9), array(0, 0, 0, 50, 50))
    assert gaps.at(at).tolist() == [9, 7, 6, 6.5]


@pytest.fixture
def loaded(tmp_path):
    def load(config=MAPPED, dbc=DBC):
        path = write(tmp_path, config)
        (tmp_path / "vehicle.dbc").write_text(dbc)
        return load_config(path)

    return load


def test_what_a_person_has_measured_is_held_or_drawn_as_each_quantity_moves(loaded):
    string = loaded().plan.strings[0]
    more = replace(string.channels[0], quantity="surface", cell=None, statistic="max", among=(1, 2, 3))
    least = replace(more, statistic="min", among=(2, 4))
    string = replace(string, channels=(*string.channels, more, least))
    t = array(0, 1, 2)
    measured = Columns(
        time_s=t,
        current_A=array(0, 9, 9),
        coolant_inlet_C=array(20, 22, 24),
        surface_C={1: array(25, 27, 29), 3: array(31, 29, 27)},
        voltage_V=array(16, 15, 14),
        cell_voltage_V={2: array(3.3, 3.2, 3.1)},
        soc=array(0.5, 0.4, 0.3),
    )
    feed = feed_of(measured, string)
    at = array(0.5, 1.5)
    assert {key: s.at(at).tolist() for key, s in feed.items()} == {
        ("current", None): [0, 9],
        ("coolant_inlet", None): [21, 23],
        ("surface", 1): [26, 28],
        ("surface", 3): [30, 28],
        ("voltage", None): [16, 14.5],
        ("cell_voltage", 2): [3.3, pytest.approx(3.15)],
        ("soc", None): [pytest.approx(0.45), pytest.approx(0.35)],
        ("max_surface", None): [30, 29],
    }


# frames

FEED = {
    ("current", None): 5.0,
    ("voltage", None): 12.3,
    ("soc", None): 0.5,
    ("coolant_flow", None): 5.0 / 60_000,
    ("coolant_inlet", None): 25.0,
    **{("surface", cell): 25.0 for cell in (1, 3, 5)},
}
TEMPS = 2566844672 - (1 << 31) | EXTENDED
# by hand: −5000 mA of 10, 12300 mV of 100, 50 % of 0.5, 5 l/min of 0.1, 77 °F of 0.1
PACK = (-500).to_bytes(2, "little", signed=True) + (123).to_bytes(2, "little") + bytes([100, 50])
PACK += (770).to_bytes(2, "little")
# … 125 K above −100 °C of 0.01, half a kelvin less, 125 K above 173.15 K of 0.1
T1, T3, T5 = (bytes([mux]) + raw.to_bytes(2, "little") for mux, raw in enumerate((12500, 12450, 1250)))


def constant(values):
    return {key: lines(array(0, 2000), array(value, value)) for key, value in values.items()}


def short(batch):
    """Frames without what a multiplexed one leaves empty."""
    return [(t, i, payload[:3] if i == TEMPS else payload) for t, i, payload in rows(batch)]


def test_each_message_goes_out_at_its_cycle_with_every_value_in_its_place(loaded):
    c = loaded()
    bus = Traffic(c.plan, c.database)
    # the current's message ten times a second, the three kinds of the other once, spread over it behind the first
    second = [(k * SECOND // 10, 0x100, PACK) for k in range(10)]
    second += [(1_000_000, TEMPS, T1), (334_333_333, TEMPS, T3), (667_666_666, TEMPS, T5)]
    feeds = [constant(FEED)]
    assert short(bus.between(feeds, 0, SECOND)) == sorted(second)
    assert short(bus.between(feeds, 100_000_000, 100_000_001)) == [(100_000_000, 0x100, PACK)]
    assert len(bus.between(feeds, 100_000_001, 200_000_000)) == 0
    assert short(bus.between(feeds, 7 * SECOND, 8 * SECOND)) == sorted((t + 7 * SECOND, i, p) for t, i, p in second)


CYCLES = 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;\nBA_DEF_DEF_ "GenMsgCycleTime" 0;\n'


@pytest.mark.parametrize(
    ("pack_ms", "temps_ms", "pack", "temps"), [(50, 200, 60, 9), (500, 3000, 6, 3), (0, 0, 30, 9), (20, 1000, 150, 9)]
)
def test_cycles_are_those_of_the_dbc_but_each_multiplexed_value_comes_once_a_second_at_most(
    loaded, pack_ms, temps_ms, pack, temps
):
    told = f'BA_ "GenMsgCycleTime" BO_ 256 {pack_ms};\nBA_ "GenMsgCycleTime" BO_ 2566844672 {temps_ms};\n'
    c = loaded(dbc=f"{DBC}\n{CYCLES}{told}")
    ids = Traffic(c.plan, c.database).between([constant(FEED)], 0, 3 * SECOND).can_id
    assert (np.sum(ids == 0x100), np.sum(ids == TEMPS)) == (pack, temps)


def test_a_message_without_a_current_or_voltage_comes_once_a_second(loaded):
    c = loaded()
    string = c.plan.strings[0]
    channels = tuple(x for x in string.channels if x.quantity not in ("current", "voltage"))
    plan = replace(c.plan, strings=(replace(string, channels=channels),))
    ids = Traffic(plan, c.database).between([constant(FEED)], 0, 3 * SECOND).can_id
    assert np.sum(ids == 0x100) == 3


def test_a_frame_that_has_nothing_to_say_is_left_out_where_it_cannot_say_so(loaded):
    c = loaded()
    bus = Traffic(c.plan, c.database)
    assert len(bus.between([{}], 0, SECOND)) == 0
    feed = constant({("surface", 3): 25.0})
    assert short(bus.between([feed], 0, SECOND)) == [(334_333_333, TEMPS, T3)]
    own = loaded(OWN)
    silent = Traffic(own.plan, own.database).between([{}], 0, SECOND)
    assert len(silent) == 10 + 1 + 2 + 2  # all say that they are not available


def test_strings_are_fed_in_order_and_a_shared_signal_by_the_first(loaded):
    more = MAPPED.replace("[identify]", '[[string]]\nname = "string_2"\nmodel = "string_1.toml"\n[identify]')
    c = loaded(more)
    of_first = c.plan.strings[0]
    second = replace(c.plan.strings[1], channels=of_first.channels)
    shared = replace(c.plan, strings=(of_first, second))
    feeds = [constant(FEED), constant(dict.fromkeys(FEED, 1.0))]
    assert short(Traffic(shared, c.database).between(feeds, 0, 1)) == [(0, 0x100, PACK)]
    assert short(Traffic(shared, c.database, [1]).between(feeds[:1], 0, 1)) == [(0, 0x100, PACK)]
    assert short(Traffic(shared, c.database, [1, 0]).between(feeds[::-1], 0, 1)) != [(0, 0x100, PACK)]
    ours = {m.can_id for m in c.database.messages.values() if m.name.startswith("string_2")}
    assert ours >= set(Traffic(c.plan, c.database, [1]).between(feeds[:1], 0, SECOND).can_id.tolist())


def test_a_plan_of_constants_has_nothing_to_send(loaded):
    c = loaded()
    string = c.plan.strings[0]
    channels = tuple(replace(channel, signal=None, constant=1.0) for channel in string.channels)
    with pytest.raises(UsageError, match=r"^nothing to send: every quantity of these strings is a constant$"):
        Traffic(replace(c.plan, strings=(replace(string, channels=channels),)), c.database)


def test_a_stream_is_the_same_in_pieces_of_ten_minutes(loaded):
    c = loaded()
    feeds = [{key: lines(array(0, 1300), array(value, 1.2 * value)) for key, value in FEED.items()}]
    pieces = list(Traffic(c.plan, c.database).stream(feeds, 0, 1300 * SECOND))
    assert [int(p.time_ns[-1]) // (600 * SECOND) for p in pieces] == [0, 1, 2]
    whole = Traffic(c.plan, c.database).between(feeds, 0, 1300 * SECOND)
    assert rows(FrameBatch.concat(pieces)) == rows(whole)


def test_noise_is_of_its_size_and_seed_on_temperatures_only(loaded):
    c = loaded()
    feeds = [constant(FEED)]

    def temperatures(**noise):
        batch = Traffic(c.plan, c.database, **noise).between(feeds, 0, 1500 * SECOND)
        pack = batch.data[batch.can_id == 0x100]
        assert np.all(pack[:, :6] == np.frombuffer(PACK[:6], np.uint8))
        at = (batch.can_id == TEMPS) & (batch.data[:, 0] == 0)
        return 0.01 * batch.data[at, 1:3].copy().view("<u2").ravel() - 100.0

    assert np.ptp(temperatures()) == 0
    noisy = temperatures(noise_K=0.5)
    assert noisy.std() == pytest.approx(0.5, rel=0.1)
    assert noisy.mean() == pytest.approx(25.0, abs=0.06)
    assert np.array_equal(noisy, temperatures(noise_K=0.5, seed=0))
    assert not np.array_equal(noisy, temperatures(noise_K=0.5, seed=1))
