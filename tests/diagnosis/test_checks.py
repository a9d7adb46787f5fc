"""Each fault of a record is found by its own check, and a sound record has none."""

import re

import numpy as np
import pytest

from bms_gateway.diagnosis.checks import check_record
from bms_gateway.diagnosis.record import make_record
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.errors import DataError
from bms_gateway.thermal import Prior, StringModel
from tests.diagnosis.logs import rows, string_model


def findings(columns, model=None, **more):
    model = model or string_model()
    found = check_record(make_record(Columns(**{**columns, **more}, source="log"), model), model)
    return {f.kind: f for f in found}


def first(columns, seconds):
    n = seconds + 1
    return {k: v[:n] if isinstance(v, np.ndarray) else {a: x[:n] for a, x in v.items()} for k, v in columns.items()}


def test_a_sound_record_raises_no_suspicion():
    assert {f.kind for f in findings(rows()).values() if f.severity != "note"} == set()


def test_the_worst_comes_first():
    model = string_model()
    c = first(rows(), 200)
    found = check_record(make_record(Columns(**c, source="log"), model), model)
    order = ["stop", "warn", "note"]
    assert [order.index(f.severity) for f in found] == sorted(order.index(f.severity) for f in found)
    assert found[0].severity == "stop"


def test_too_short_stops():
    assert findings(first(rows(), 200))["too_short"].severity == "stop"
    assert findings(first(rows(), 900))["short"].severity == "warn"


def test_a_short_record_is_shorter_than_what_is_asked_for():
    """Of 30 min it was said that they are less than twice 15 min."""
    for seconds in (700, 900, 1000, 1500):
        if short := findings(first(rows(), seconds)).get("short"):
            lasts, needed = (int(x) for x in re.findall(r"(\d+) min", short.sentence))
            assert lasts < needed
            assert 60 * lasts <= seconds


def test_a_record_of_two_rows_is_told_to_have_too_few_readings():
    """It was said to have none."""
    two = {k: v[:2] if isinstance(v, np.ndarray) else {a: x[:2] for a, x in v.items()} for k, v in rows().items()}
    with pytest.raises(
        DataError, match=r"log: no sensor of the model \(surface_1_C.*\) has 3 readings while the current"
    ):
        findings(two)


def test_no_heat_stops():
    c = rows()
    flat = {k: 22 + 0.1 * np.random.default_rng(k).standard_normal(3001) for k in (1, 3)}
    assert findings(c, surface_C=flat)["little_heat"].severity == "stop"
    assert findings(c, current_A=np.zeros(3001))["no_current"].severity == "stop"


def test_a_current_that_no_cell_carries_stops():
    c = rows()
    found = findings({k: v for k, v in c.items() if k != "soc"}, current_A=40.0 * c["current_A"])
    assert found["current_unit"].severity == "stop"
    assert "is it in mA" in found["current_unit"].sentence
    assert "current_unit" not in findings(c)


@pytest.mark.parametrize("step", [0.0, 0.5])
def test_a_stuck_sensor_is_named(step):
    c = rows(6000)
    if step:
        c["surface_C"] = {k: np.round(x / step) * step for k, x in c["surface_C"].items()}
    c["surface_C"][3][1500:] = c["surface_C"][3][1500]
    found = findings(c)
    assert "cell 3" in found["stuck_sensor"].sentence
    assert "all_stuck" not in found
    c["surface_C"][1][1500:] = c["surface_C"][1][1500]
    assert findings(c)["all_stuck"].severity == "stop"


def test_a_coarse_sensor_that_moves_seldom_is_not_stuck():
    c = rows(6000, noise=0.0)
    c["surface_C"] = {k: np.round(x) for k, x in c["surface_C"].items()}
    found = findings(c)
    assert "stuck_sensor" not in found
    assert "steps of 1 K" in found["coarse_sensor"].sentence


def test_a_wrong_sign_is_seen_by_the_voltage_and_by_the_charge():
    c = rows()
    flipped = {**c, "current_A": -c["current_A"]}
    assert "current_sign" in findings(flipped)
    assert "voltage" in findings(flipped)["current_sign"].sentence
    without = {k: v for k, v in flipped.items() if k != "voltage_V"}
    assert "charge" in findings(without)["current_sign"].sentence
    assert "current_sign" not in findings({k: v for k, v in c.items() if k != "voltage_V"})


@pytest.mark.parametrize("witness", ["voltage", "SOC"])
@pytest.mark.parametrize(("first", "last"), [(0.5, 1.0), (0.0, 0.5), (0.25, 0.75)])
def test_a_current_whose_sign_changes_within_the_record_is_told_with_its_time(witness, first, last):
    """Half an hour with the other sign, and a true voltage: it said that nothing was missing."""
    c = rows(3600)
    if witness == "SOC":
        c = {k: v for k, v in c.items() if k != "voltage_V"}
    assert "current_sign" not in findings(c)
    part = slice(int(first * 3600), int(last * 3600))
    c["current_A"] = np.array(c["current_A"])
    c["current_A"][part] *= -1.0
    said = findings(c)["current_sign"].sentence
    told = re.match(f"The {witness} rises with the current for (.*) min between (.*) and (.*) min of the record", said)
    assert [float(x) for x in told.groups()] == pytest.approx([30, 60 * first, 60 * last], abs=1)


def every(columns, k):
    return {n: v[::k] if isinstance(v, np.ndarray) else {a: x[::k] for a, x in v.items()} for n, v in columns.items()}


def test_rows_of_a_jumping_current_that_are_too_far_apart_are_told():
    """Against the mean squares of minutes of many currents, seen only now and then."""
    rng = np.random.default_rng(5)
    for k in (5, 10):
        fine = rng.choice([-60.0, 0.0, 20.0, 60.0], (200, 300)).repeat(20, axis=1)  # levels of 20 s
        at = rng.integers(0, 20, 200)  # that do not begin with the log
        fine = np.stack([row[a : a + 5900] for row, a in zip(fine, at, strict=True)]) ** 2
        coarse = fine[:, ::k].repeat(k, axis=1)[:, :5900]
        minute = (coarse - fine)[:, :5880].reshape(200, -1, 60).mean(axis=2)
        true = float(np.std(minute) / fine.mean())
        found = findings(every(rows(6000), k))["current_coarse"]
        assert found.severity == "warn"
        assert f"{k} s apart" in found.sentence
        told = float(re.search(r"± (\d+) % \(1 sd\)", found.sentence)[1]) / 100.0
        assert told == pytest.approx(true, rel=0.3), k


def test_a_current_that_is_seen_every_second_or_hardly_moves_is_fine_enough():
    assert "current_coarse" not in findings(rows())
    slow = rows(6000)
    slow["current_A"] = 60.0 + 5.0 * np.sin(slow["time_s"] / 300.0)
    assert "current_coarse" not in findings(every(slow, 10))


def test_an_offset_at_rest_is_read_off():
    c = rows()
    assert "1.5 A" in findings(c, current_A=c["current_A"] + 1.5)["current_at_rest"].sentence


def test_an_offset_after_a_soak_is_read_off():
    c = rows()
    c["surface_C"][3] = c["surface_C"][3] + 0.8
    assert "the surface of cell 3 reads 0.8 K above the inlet:" in findings(c)["soak_offset"].sentence


def twelve(**more):
    """Columns and model of a string with a sensor on each of its twelve cells."""
    cells = tuple(range(1, 13))
    return rows(sensors=cells, **more), string_model(12, cells)


def sentences(kind, columns, model):
    return [
        f.sentence for f in check_record(make_record(Columns(**columns, source="log"), model), model) if f.kind == kind
    ]


def test_surfaces_that_the_model_has_no_sensor_of_are_told():
    c, _ = twelve()
    told = "temperatures of the table are not used, because the model has no sensor there: cells"
    assert sentences("unused_readings", c, string_model(12, (1, 12))) == [f"10 {told} 2 to 11."]
    (one,) = sentences("unused_readings", c, string_model(12, (1, 2, 3, 4, 6, 7, 8, 9, 10, 11, 12)))
    assert one == "1 temperature of the table is not used, because the model has no sensor there: cell 5."
    assert sentences("unused_readings", *twelve()) == []


def test_a_pack_that_starts_warm_is_one_sentence():
    c, model = twelve()
    c["surface_C"] = {k: y + 3.0 for k, y in c["surface_C"].items()}
    assert sentences("soak_offset", c, model) == [
        "At rest at the start the surfaces of cells 1 to 12 read 3 K above the inlet: a sensor has an offset, or the "
        "pack was not yet at the coolant's temperature."
    ]
    c["surface_C"][5] = c["surface_C"][5] + 0.9
    c["surface_C"][9] = c["surface_C"][9] - 5.0
    above, below = sentences("soak_offset", c, model)
    assert "cells 1 to 8, 10 to 12 read 3 to 3.9 K above the inlet, cell 5 the most:" in above
    assert "the surface of cell 9 reads 2 K below the inlet:" in below
    c["surface_C"] = {k: y + 0.2 * k for k, y in twelve()[0]["surface_C"].items()}
    assert "K above the inlet, growing along the coolant:" in sentences("soak_offset", c, model)[0]


def test_sensors_that_stand_still_together_are_one_sentence():
    c, model = twelve()
    for k in (2, 3, 4, 9):
        c["surface_C"][k][1000 + 10 * k : 2500] = 24.0 + k
    (told,) = sentences("stuck_sensor", c, model)
    assert re.fullmatch(
        r"The surfaces of cells 2 to 4, 9 stand still at 26 to 33 °C for 1\d\.\d to 1\d\.\d min under current, the "
        r"first from 17\.0 min on: are their sensors stuck\?",
        told,
    )


def test_a_constant_current_is_told():
    assert "constant_current" in findings(rows(), current_A=np.full(3001, 20.0))
    assert "one_direction" in findings(rows(), current_A=np.abs(rows()["current_A"]))


def test_a_current_that_stands_at_its_end_is_told():
    c = rows()
    noisy = c["current_A"] + np.random.default_rng(1).normal(0, 10, 3001)
    assert "current_saturated" in findings(c, current_A=np.clip(noisy, -60, 60))
    assert "current_saturated" not in findings(c, current_A=noisy)


def test_an_inlet_that_is_none_is_told():
    c = rows()
    assert "inlet_constant" in findings(c, coolant_inlet_C=np.full(3001, 22.0))
    assert "inlet_warmer" in findings(c, coolant_inlet_C=c["coolant_inlet_C"] + 25.0)


def test_a_coolant_that_enters_at_the_other_end_is_told():
    c = rows()
    rise = c["surface_C"][1] - 22
    assert "coolant_backwards" in findings(c, surface_C={1: 22 + 1.5 * rise, 3: 22 + 0.7 * rise})
    assert "coolant_backwards" not in findings(c, surface_C={1: 22 + 0.7 * rise, 3: 22 + 1.5 * rise})


def test_a_fan_that_follows_the_temperature_is_told():
    c = rows()
    hot = c["surface_C"][3]
    fan = 0.0095 * (1 + 0.1 * (hot - hot.mean()))
    assert "flow_follows_temperature" in findings(c, coolant_flow_m3_s=fan)
    steps = np.where(c["time_s"] % 1000 < 500, 0.008, 0.012)
    assert "flow_follows_temperature" not in findings(c, coolant_flow_m3_s=steps)


def test_what_the_charge_cannot_tell_is_told():
    assert "soc_span" in findings(rows(), string_model(capacity_Ah=80.0), soc=None)
    assert "no_soc" in findings(rows(), string_model(capacity_Ah=None), soc=None)


def test_missing_readings_are_counted():
    c = rows()
    c["surface_C"][3][np.random.default_rng(1).random(3001) < 0.4] = np.nan
    sentence = findings(c)["readings_missing"].sentence
    assert "cell 3" in sentence
    assert "40 %" in sentence or "39 %" in sentence or "41 %" in sentence


@pytest.mark.parametrize(
    ("gaps", "told"),
    [
        ([(1000, 1060)], (60, 60)),  # a current frame that stopped for a minute
        ([(1000, 1020)], None),  # too short to matter
        ([(200 + 200 * k, 228 + 200 * k) for k in range(13)], (364, 28)),  # many short ones
        ([(1000, 1400)], None),  # the record is divided there
    ],
)
def test_a_current_that_is_missing_for_long_is_told(gaps, told):
    c = rows()
    for first_s, last_s in gaps:
        c["current_A"][first_s + 1 : last_s] = np.nan
    found = findings(c).get("current_missing")
    if told is None:
        assert found is None
    else:
        assert found.severity == "warn"
        assert f"missing for {told[0]} s of 3000 s, at the longest for {told[1]} s" in found.sentence


def test_an_inlet_that_is_missing_or_stuck_for_long_is_told():
    c = rows()
    rng = np.random.default_rng(3)
    c["coolant_inlet_C"] = 20 + np.sin(c["time_s"] / 300) + 0.02 * rng.standard_normal(3001)
    assert not {"inlet_missing", "inlet_stuck"} & set(findings(c))
    lost = c["coolant_inlet_C"].copy()
    lost[800:1400] = np.nan
    assert "missing for 601 s" in findings(c, coolant_inlet_C=lost)["inlet_missing"].sentence
    lost[:] = c["coolant_inlet_C"]
    lost[2700:] = np.nan  # it ends before the drive does
    assert "missing for 301 s" in findings(c, coolant_inlet_C=lost)["inlet_missing"].sentence
    stuck = c["coolant_inlet_C"].copy()
    stuck[800:1400] = stuck[800]
    told = findings(c, coolant_inlet_C=stuck)["inlet_stuck"].sentence
    assert re.search(r"for 10 min, from 13 min on", told)
    tenths = np.round(
        c["coolant_inlet_C"] + 1.5 * np.sin(c["time_s"] / 120), 1
    )  # it stands for some readings at a time
    assert "inlet_stuck" not in findings(c, coolant_inlet_C=tenths)
    tenths[1000:2600] = tenths[1000]
    assert "for 27 min, from 17 min on" in findings(c, coolant_inlet_C=tenths)["inlet_stuck"].sentence
    steps = np.round(c["coolant_inlet_C"])  # whole degrees stand still, and are not stuck
    assert "inlet_stuck" not in findings(c, coolant_inlet_C=steps)
    assert not {"inlet_missing", "inlet_stuck"} & set(findings(c, coolant_inlet_C=np.full(3001, 22.0)))


def test_an_inlet_that_is_missing_with_the_current_is_not_called_bridged():
    """Bug: beside "the record is taken as 2 parts" stood that the inlet of this gap was bridged by straight lines."""
    c = rows()
    for name in ("current_A", "coolant_inlet_C"):
        c[name][1001:1400] = np.nan
    assert "inlet_missing" not in findings(c)
    c["coolant_inlet_C"][2001:2400] = np.nan
    assert "missing for 400 s" in findings(c)["inlet_missing"].sentence


def test_a_current_that_passes_through_zero_does_not_rest():
    c = rows()
    wave = 20.0 * np.sin(2 * np.pi * (c["time_s"] + 0.3) / 60.0) - 0.5
    assert "current_at_rest" not in findings(c, current_A=wave)
    wave[1000:1060] = -0.5
    assert "reads -0.5 A" in findings(c, current_A=wave)["current_at_rest"].sentence
    wave[1400:1460], wave[1800:1830] = -0.1, -0.55  # low loads of different sizes are no rest
    assert "current_at_rest" not in findings(c, current_A=wave)


def test_a_square_wave_is_not_called_by_its_mean():
    c = rows()
    wave = np.where(np.arange(3001) // 50 % 2, 79.0, -79.0)
    wave[1000:1500] = -79.0
    said = findings(c, current_A=wave)["constant_current"].sentence
    assert said.startswith("The current is 79 A all along, in both directions")


def slow_charge(step=0.1, stuck_at=None):
    """A cell of 5 Ah charged at C/20 for eight hours in still air: 0.07 W, it warms by 0.6 K in steps of 0.1 K."""
    t = np.arange(0.0, 8 * 3600.0, 10.0)
    rise = 0.6 * (1 - np.exp(-t / 1500.0))
    y = np.round((25.0 + rise) / step) * step
    if stuck_at is not None:
        y[:] = stuck_at
    model = single_model()
    return {
        "time_s": t,
        "current_A": np.full(len(t), -1.5),
        "coolant_inlet_C": np.full(len(t), 25.0),
        "surface_C": {1: y},
    }, model


def single_model():
    values = {"C_c": 64.0, "C_s": 4.5, "R_e": 0.03, "R_c": 1.2, "R_u": 9.0}
    return StringModel(1, (1,), "single", {k: Prior(v, 0.5) for k, v in values.items()}, capacity_Ah=5.0)


def test_a_slow_charge_in_steps_of_a_tenth_is_no_stuck_sensor():
    columns, model = slow_charge()
    assert not {"stuck_sensor", "all_stuck"} & set(findings(columns, model))


def test_a_sensor_that_stands_still_under_load_is_stuck_all_the_same():
    columns, model = slow_charge(stuck_at=25.0)
    columns["current_A"] = np.where(np.arange(len(columns["time_s"])) % 720 < 360, 8.0, -8.0)
    columns["surface_C"][1][:200] += 0.1 * (np.arange(200) // 40)
    assert findings(columns, model)["all_stuck"].severity == "stop"


def test_a_column_without_usable_values_is_told():
    c, model = twelve()
    assert sentences("no_readings", c, model) == []
    blank = np.full(len(c["time_s"]), np.nan)
    c["core_C"] = {1: c["surface_C"][1] + 3.0, 5: blank, 6: np.full(len(blank), 1e6)}
    c["surface_C"][12] = blank
    assert sentences("no_readings", c, model) == [
        "The record has no usable surface temperature of cell 12: there are no values, or impossible ones.",
        "The record has no usable core temperature of cells 5, 6: there are no values, or impossible ones.",
    ]
