"""Rows of any shape become one record: nothing is shifted, nothing is made up without a word."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.diagnosis.checks import check_record
from bms_gateway.diagnosis.record import in_held_out, make_record
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.errors import DataError
from tests.diagnosis.logs import rows, string_model


def record(columns, model=None, **more):
    return make_record(Columns(**{**columns, **more}, source="log"), model or string_model())


def said(r, *words):
    return any(all(w in note for w in words) for note in r.notes)


def test_regular_rows_become_intervals_of_their_own():
    c = rows()
    r = record(c)
    d = r.drive
    assert (d.N, d.dt, r.segments) == (3000, 1.0, (0,))
    assert d.I.tolist() == c["current_A"][:-1].tolist()
    assert np.allclose(d.I2, c["current_A"][:-1] ** 2)
    assert np.allclose(d.I_abs, np.abs(c["current_A"][:-1]))
    assert np.allclose(d.IV, d.I * d.V, atol=0.01)
    assert d.known == {"flow", "soc", "voltage"}
    assert d.hours[-1] == pytest.approx(2999.5 / 3600)
    assert r.cells == (1, 3)
    for j, k in enumerate(r.cells):
        assert np.array_equal(r.y[r.sensor == j], c["surface_C"][k])
        assert np.array_equal(r.grid[:, j], c["surface_C"][k])


def test_readings_lie_where_their_stamps_are():
    c = rows()
    rng = np.random.default_rng(2)
    c["time_s"] = c["time_s"] + rng.uniform(-0.3, 0.3, len(c["time_s"]))
    r = record(c)
    first = r.sensor == 0
    inside = (c["time_s"] >= r.instants[0]) & (c["time_s"] <= r.instants[-1])
    assert r.surface.at(r.instants)[first] == pytest.approx(c["time_s"][inside], abs=1e-9)
    assert ((r.share >= 0) & (r.share <= 1)).all()


def test_the_charge_moved_is_the_same_on_every_grid():
    c = rows()
    rng = np.random.default_rng(3)
    keep = np.sort(rng.choice(np.arange(1, 3000), 2000, replace=False))
    keep = np.concatenate([[0], keep, [3000]])
    few = {k: v[keep] if isinstance(v, np.ndarray) else {a: x[keep] for a, x in v.items()} for k, v in c.items()}
    d = record(few).drive
    held = np.sum(few["current_A"][:-1] * np.diff(few["time_s"]))
    assert np.sum(d.I) * d.dt == pytest.approx(held, abs=300)  # the last part of an interval may be lost
    assert np.sum(d.I2) * d.dt == pytest.approx(np.sum(few["current_A"][:-1] ** 2 * np.diff(few["time_s"])), rel=0.003)


def test_ten_rows_a_second_keep_their_mean_square_and_the_readings_their_mean():
    rng = np.random.default_rng(4)
    t = np.arange(6001) / 10
    fast = rng.normal(0, 40, 6001)
    y = 25 + t / 60 + 0.1 * rng.standard_normal(6001)
    r = make_record(
        Columns(time_s=t, current_A=fast, coolant_inlet_C=np.full(6001, 20.0), surface_C={1: y}, source="fast"),
        string_model(1, (1,)),
    )
    assert r.drive.N == 600
    assert pytest.approx((fast[:6000] ** 2).reshape(600, 10).mean(axis=1), rel=1e-12) == r.drive.I2
    assert len(r.y) <= 601
    assert r.noise.sigma[0] == pytest.approx(0.1 / np.sqrt(10), rel=0.15)


def test_a_mean_square_that_the_source_states_is_taken():
    c = rows()
    stated = c["current_A"] ** 2 + 50.0
    assert np.allclose(record(c, mean_square_current=stated).drive.I2, stated[:-1])
    assert np.allclose(record(c, mean_square_current=0.5 * stated).drive.I2, np.maximum(0.5 * stated, stated - 50)[:-1])


def test_a_tester_that_logs_in_bursts_has_its_steps_half_way():
    t = np.sort(np.concatenate([np.arange(0.0, 600.0), np.arange(9.9996, 600.0, 10)]))
    amps = np.where((t // 20) % 2 == 0, 10.0, -10.0)
    r = make_record(
        Columns(
            time_s=t,
            current_A=amps,
            coolant_inlet_C=np.full(len(t), 20.0),
            surface_C={1: 20 + t / 100},
            source="tester",
        ),
        string_model(1, (1,)),
    )
    assert said(r, "half-way")
    assert np.mean(r.drive.I2) == pytest.approx(100.0, rel=1e-3)


def test_a_hole_of_the_current_is_bridged_and_told():
    c = rows()
    c["current_A"][1000:1030] = np.nan
    r = record(c)
    assert r.segments == (0,)
    assert said(r, "current is missing", "31 s")
    a, b = c["current_A"][999], c["current_A"][1030]
    assert r.drive.I[999:1030] == pytest.approx(a + (b - a) * (np.arange(31) + 0.5) / 31)


def test_a_long_hole_parts_the_record_and_nothing_is_read_in_it():
    c = rows()
    c["current_A"][1000:1500] = np.nan
    r = record(c)
    assert r.segments == (0, 1000)
    assert r.instants[999] == 999.0
    assert r.instants[1000] == 1500.0
    assert said(r, "2 parts")
    t = r.surface.at(r.instants)
    assert not ((t > 999.0) & (t < 1500.0)).any()
    assert r.drive.hours[1000] == pytest.approx(1500.5 / 3600)
    assert r.drive.N == 999 + 1 + 1500


def test_missing_readings_are_simply_not_there():
    c = rows()
    gone = np.random.default_rng(5).random(3001) < 0.1
    c["surface_C"][3][gone] = np.nan
    r = record(c)
    assert np.sum(r.sensor == 1) == np.sum(~gone)
    assert np.isfinite(r.y).all()


def test_held_out_parts_are_a_third_and_lie_where_they_should():
    r = record(rows())
    share = (r.left + r.share) / r.drive.N
    expected = ((share >= 0.22) & (share < 0.32)) | ((share >= 0.55) & (share < 0.65)) | (share >= 0.88)
    assert np.array_equal(r.held, expected)
    assert in_held_out((np.arange(1000) + 0.5) / 1000).mean() == pytest.approx(0.32, abs=0.001)


def test_long_records_get_longer_intervals_and_long_strings_still_longer_ones():
    c = rows(9000)
    assert record(c).drive.dt == 2.0
    assert record(c, string_model(12)).drive.dt == 3.0
    assert said(record(c), "2 s")


def test_sentinels_and_spikes_are_no_temperatures():
    c = rows()
    c["surface_C"][1][[100, 200]] = 555.35
    c["surface_C"][1][300] = -40.0
    c["surface_C"][1][400] += 20.0
    r = record(c)
    assert np.sum(r.sensor == 0) == 2997
    assert said(r, "4 readings", "cell 1")


class TestCharge:
    def test_the_counted_shape_stands_at_the_recorded_level(self):
        c = rows()
        coarse = np.round(c["soc"] * 50) / 50
        r = record(c, soc=coarse)
        assert r.drive.soc == pytest.approx(0.5 * (c["soc"][1:] + c["soc"][:-1]), abs=0.01)

    def test_where_counting_contradicts_the_record_the_recorded_one_is_used(self):
        c = rows()
        r = record(c, string_model(capacity_Ah=1.5))
        assert r.drive.soc == pytest.approx(0.5 * (c["soc"][1:] + c["soc"][:-1]), abs=1e-9)
        assert said(r, "SOC", "as if the capacity were 8")

    def test_an_offset_of_the_current_shows_in_the_charge(self):
        c = rows()
        r = record(c, string_model(capacity_Ah=8.0), current_A=c["current_A"] + 2.0)
        assert said(r, "SOC", "as if the current read +2 A too much")

    def test_counted_from_half_full_where_neither_charge_nor_voltage_is_recorded(self):
        c = rows()
        r = record(c, soc=None, voltage_V=None)
        true = 0.5 * (c["soc"][1:] + c["soc"][:-1])
        assert np.diff(r.drive.soc) == pytest.approx(np.diff(true), abs=1e-12)
        assert "soc" in r.drive.known
        assert said(r, "assumption")

    def test_unknown_without_record_and_capacity(self):
        r = record(rows(), string_model(capacity_Ah=None), soc=None)
        assert "soc" not in r.drive.known
        assert (r.drive.soc == 0.5).all()


class TestVoltage:
    def test_the_string_s_is_shared_out(self):
        assert record(rows()).drive.V.mean() == pytest.approx(3.3, abs=0.05)

    def test_a_cell_s_is_taken_as_it_is_and_told(self):
        c = rows()
        r = record(c, voltage_V=c["voltage_V"] / 3)
        assert r.drive.V.mean() == pytest.approx(3.3, abs=0.05)
        assert said(r, "voltage_V", "mean of the cells")

    def test_a_pack_s_is_not_used_and_told(self):
        c = rows()
        r = record(c, voltage_V=c["voltage_V"] * 32)
        assert "voltage" not in r.drive.known
        assert np.isnan(r.drive.IV).all()
        assert said(r, "voltage", "not used")


class TestFlow:
    @pytest.mark.parametrize(("factor", "unit"), [(1e3, "L/s"), (6e4, "L/min")])
    def test_a_flow_in_another_unit_is_found_out(self, factor, unit):
        c = rows()
        r = record(c, coolant_flow_m3_s=c["coolant_flow_m3_s"] * factor * 1.1)
        assert r.drive.flow == pytest.approx(np.full(3000, 1.1))
        assert said(r, unit, "converted")

    def test_one_that_fits_no_unit_is_not_used(self):
        c = rows()
        r = record(c, coolant_flow_m3_s=c["coolant_flow_m3_s"] * 30)
        assert "flow" not in r.drive.known
        assert (r.drive.flow == 1.0).all()

    def test_without_a_nominal_flow_the_usual_one_is_it(self):
        r = record(rows(), string_model(flow=None))
        assert r.drive.flow == pytest.approx(np.ones(3000))
        assert said(r, "nominal")


class TestRefusals:
    def test_time_that_stands_still(self):
        c = rows()
        c["time_s"][5] = c["time_s"][4]
        with pytest.raises(DataError, match="log: row 6: time_s does not increase"):
            record(c)

    @pytest.mark.parametrize("name", ["current_A", "coolant_inlet_C"])
    def test_an_input_without_values(self, name):
        c = rows()
        with pytest.raises(DataError, match=f"log: {name} has no values"):
            record(c, **{name: np.full(3001, np.nan)})

    def test_no_sensor_of_the_model(self):
        c = rows()
        with pytest.raises(DataError, match="surface_1_C, surface_3_C"):
            record(c, surface_C={2: c["surface_C"][1]})


def test_cores_are_kept_apart():
    c = rows()
    r = record(c, core_C={2: c["surface_C"][1] + 5})
    assert r.core.cells == (2,)
    assert np.array_equal(r.core.y, c["surface_C"][1] + 5)
    assert record(c).core.cells == ()


def test_the_same_rows_give_the_same_bits():
    a, b = record(rows()), record(rows())
    for name in ("I", "I2", "I_abs", "T_in", "flow", "soc", "V", "IV"):
        assert np.array_equal(getattr(a.drive, name), getattr(b.drive, name))


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_whatever_is_missing_the_outcome_is_a_sound_record_or_one_line(data):
    n = data.draw(st.integers(2, 400))
    rng = np.random.default_rng(data.draw(st.integers(0, 10_000)))
    spacing = data.draw(st.sampled_from([0.01, 0.1, 1.0, 7.0]))
    t = np.cumsum(spacing * rng.uniform(0.5, 1.5, n) + np.where(rng.random(n) < 0.02, 1000.0, 0.0))

    def column(scale, centre):
        x = centre + scale * rng.standard_normal(n)
        x[rng.random(n) < data.draw(st.sampled_from([0.0, 0.1, 0.9, 1.0]))] = np.nan
        return np.full(n, centre) if data.draw(st.booleans()) else x

    model = string_model(capacity_Ah=data.draw(st.sampled_from([None, 8.0])))
    try:
        r = make_record(
            Columns(
                time_s=t,
                current_A=column(50, 0.0),
                coolant_inlet_C=column(1, 22.0),
                voltage_V=column(0.1, data.draw(st.sampled_from([0.0, 3.3, 9.9, 400.0]))),
                soc=column(0.1, 0.5),
                coolant_flow_m3_s=column(0.001, data.draw(st.sampled_from([0.0, 0.0095, 9.5]))),
                surface_C={1: column(1, 25.0), 3: column(600, 25.0)},
                core_C={2: column(1, 30.0)},
                source="log",
            ),
            model,
        )
    except DataError as e:
        line = str(e)
    else:
        line = ""
        sound(r, model)
    assert not line or (line.startswith("log: ") and "\n" not in line)


def sound(r, model):
    d = r.drive
    assert len(r.instants) == d.N + 1 == len(r.grid)
    assert (np.diff(r.instants) > 0).all()
    for name in ("I", "I2", "I_abs", "T_in", "flow", "soc", "hours"):
        assert np.isfinite(getattr(d, name)).all(), name
    assert (d.I2 >= d.I**2 - 1e-6 * (1 + d.I2)).all()
    assert (d.I_abs >= np.abs(d.I) - 1e-9).all()
    assert ((r.left >= 0) & (r.left < d.N) & (r.share >= 0) & (r.share <= 1)).all()
    assert np.isfinite(r.y).all()
    assert ((r.noise.sigma > 0) & (r.noise.step >= 0)).all()
    parts = np.diff(np.concatenate([r.segments, [d.N + 1]]))
    assert (parts > 1).all()
    assert all(f.sentence.endswith((".", "?")) for f in check_record(r, model))
