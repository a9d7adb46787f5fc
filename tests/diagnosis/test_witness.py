"""Witnesses: each hears what it should and nothing else."""

from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.diagnosis.model_error import ModelError
from bms_gateway.diagnosis.witness import agreement, electric_heat, implausible, strain
from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects import effect_named


def coordinate(name, *, prior=0.0, sd=0.6, effect=None, record=None):
    return SimpleNamespace(name=name, prior=prior, sd=sd, effect=effect, record=record)


def fit(values, sd, *, source="one", **more):
    coordinates = [coordinate(n) for n in values]
    for c in coordinates:
        for k, v in more.get(c.name, {}).items():
            setattr(c, k, v)
    names = [c.name for c in coordinates]
    problem = SimpleNamespace(coordinates=coordinates, index=names.index, records=[SimpleNamespace(source=source)])
    return SimpleNamespace(problem=problem, theta=np.array(list(values.values())), covariance=np.diag(np.square(sd)))


NUMBERS = {"R_e": 0.1, "R_c": -0.1, "C_s": 0.05}


def test_records_of_one_physics_agree():
    joint = fit(NUMBERS, [0.05] * 3)
    alone = [fit({k: v + d for k, v in NUMBERS.items()}, [0.1] * 3, source=s) for s, d in (("a", 0.08), ("b", -0.08))]
    assert not any(w.alarm for w in agreement(joint, alone))


def test_a_record_of_another_physics_is_named_with_the_number_that_differs():
    joint = fit(NUMBERS, [0.05] * 3)
    other = fit({**NUMBERS, "R_c": NUMBERS["R_c"] + 0.5}, [0.1] * 3, source="b")
    said = agreement(joint, [fit(NUMBERS, [0.1] * 3, source="a"), other])
    assert [w.alarm for w in said] == [False, True]
    assert "Alone, b asks for other numbers" in said[1].says
    assert "R_c +65 %" in said[1].says


def test_a_number_of_an_effect_is_told_in_its_own_unit():
    name = "entropic_heat.dUdT"
    effect = {name: {"effect": "entropic_heat", "sd": 2.5e-4}}
    joint = fit({name: 1e-4}, [2e-5], **effect)
    alone = [fit({name: x}, [4e-5], **effect) for x in (1e-4, 3e-4)]
    assert "entropic_heat.dUdT +0.2 mV/K" in agreement(joint, alone)[1].says


def test_what_the_other_records_did_not_sharpen_cannot_disagree():
    joint, alone = fit(NUMBERS, [0.1] * 3), fit({k: v + 0.05 for k, v in NUMBERS.items()}, [0.1] * 3)
    assert not agreement(joint, [alone, alone])[0].alarm


def test_a_capacity_far_from_its_data_sheet_is_an_alarm_and_a_likely_one_is_not():
    assert not implausible(fit({"C_c": 0.2}, [0.05], C_c={"sd": 0.1}))
    (said,) = implausible(fit({"C_c": 0.3}, [0.05], C_c={"sd": 0.1}))
    assert said.alarm
    assert "C_c ends +35 %" in said.says


def test_activation_temperature_out_of_range_is_an_alarm():
    name = "resistance_temperature.B"
    assert not implausible(fit({name: 4500.0}, [500.0], **{name: {"effect": "resistance_temperature"}}))
    (said,) = implausible(fit({name: 6000.0}, [500.0], **{name: {"effect": "resistance_temperature"}}))
    assert "6000 K" in said.says


def test_what_is_known_of_an_activation_stands_in_one_place():
    """The catalogue's prior is what both searches fit with, and what an alarm is held against."""
    name = "resistance_temperature.B"
    p = effect_named("resistance_temperature").parameter("B")
    assert name not in ModelError().beliefs([SimpleNamespace(drive=SimpleNamespace(I2=np.ones(3)))])
    (said,) = implausible(fit({name: p.prior + 2.1 * p.sd}, [50.0], **{name: {"effect": "resistance_temperature"}}))
    assert f"usual are {p.prior:.0f} ± {p.sd:.0f} K" in said.says
    assert not implausible(fit({name: p.prior - 1.9 * p.sd}, [50.0], **{name: {"effect": "resistance_temperature"}}))


def test_numbers_each_tolerable_are_strained_together():
    names = [f"n{i}" for i in range(8)]
    sd = {n: {"sd": 0.1} for n in names}
    assert not strain(fit(dict.fromkeys(names, 0.08), [0.01] * 8, **sd)).alarm
    assert strain(fit(dict.fromkeys(names, 0.17), [0.01] * 8, **sd)).alarm


def test_numbers_that_the_record_does_not_tell_are_no_testimony():
    said = strain(fit({"R_c": 0.0, "R_e": 0.0}, [0.59, 0.59]))
    assert not said.alarm
    assert "0 directions" in said.says


@pytest.mark.parametrize("ohm", [0.005, 0.02])
def test_heat_by_voltage_is_what_the_resistance_makes(ohm):
    rng = np.random.default_rng(1)
    I = np.repeat(rng.choice([-20.0, 0.0, 10.0, 25.0, -15.0], 150), 20)  # noqa: E741
    charge = np.cumsum(I) / 3600.0
    V = 3.3 - 0.05 * charge + 0.002 * charge**2 - ohm * I
    one = np.ones(len(I))
    drive = Drive(1.0, I, I**2, np.abs(I), 25 * one, one, 0.5 * one, V, I * V, one, frozenset({"voltage"}))
    q = electric_heat(drive)
    assert q is not None
    assert q.sum() == pytest.approx(ohm * np.sum(I**2), rel=0.01)


def test_no_heat_by_voltage_where_it_is_mostly_missing():
    one, V = np.ones(100), np.full(100, np.nan)
    V[:40] = 3.3
    drive = Drive(1.0, one, one, one, 25 * one, one, 0.5 * one, V, V, one, frozenset({"voltage"}))
    assert electric_heat(drive) is None


def test_no_heat_by_voltage_from_a_discharge_at_one_current():
    one = np.ones(2000)
    V = 3.6 - np.linspace(0.0, 0.8, 2000)
    drive = Drive(1.0, 3 * one, 9 * one, 3 * one, 25 * one, one, 0.5 * one, V, 3 * V, one, frozenset({"voltage"}))
    assert electric_heat(drive) is None
