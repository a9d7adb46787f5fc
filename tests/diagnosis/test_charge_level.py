"""The level of a counted charge: what voltages at rest and under load tell of it, and how well.

The truth's open-circuit curves and overpotential are those of `tests.truth` and share nothing with the package's.
"""

import numpy as np
import pytest

from bms_gateway.diagnosis.charge_level import within_capacity
from bms_gateway.diagnosis.record import make_record
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.thermal import Prior, StringModel
from tests.truth.hidden import open_circuit

CAPACITY, OHM = 5.0, 0.02


def cell(words=None):
    priors = {"C_c": 64.0, "C_s": 4.5, "R_e": OHM, "R_c": 1.2, "R_u": 9.0}
    return StringModel(
        1,
        (1,),
        "single",
        {k: Prior(v, 0.6) for k, v in priors.items()},
        capacity_Ah=CAPACITY,
        cell_format=words,
    )


def drive(seed, start, seconds=2400, rest=300, mean=0.0):
    """Current that rests first, then steps; true charge."""
    rng = np.random.default_rng(seed)
    amps = np.repeat(mean + rng.choice([-6.0, 0.0, 3.0, 8.0, -5.0], seconds // 20), 20)
    amps[:rest] = 0.0
    soc = start - np.concatenate([[0.0], np.cumsum(amps[:-1])]) / 3600.0 / CAPACITY
    return amps, soc


def record(amps, soc, *, phosphate, model=None, volts=True, time_s=None, soc_known=False):
    """Rows of a cell whose voltage has half its loss at once and half by a lag of 120 s."""
    slow = np.zeros(len(amps))
    for k in range(1, len(amps)):
        slow[k] = slow[k - 1] + (amps[k - 1] - slow[k - 1]) / 120.0
    V = open_circuit(soc, phosphate) - OHM * (0.6 * amps + 0.5 * slow)
    t = np.arange(len(amps), dtype=float) if time_s is None else time_s
    rng = np.random.default_rng(1)
    return make_record(
        Columns(
            time_s=t,
            current_A=amps,
            coolant_inlet_C=np.full(len(amps), 25.0),
            voltage_V=V if volts else None,
            soc=soc if soc_known else None,
            surface_C={1: 25.0 + 1e-3 * t + 0.05 * rng.standard_normal(len(t))},
            source="log",
        ),
        model or cell(),
    )


def start_of(r):
    return float(r.drive.soc[0])


def test_a_nickel_cell_s_rest_tells_its_charge_and_the_record_s_own_charge_needs_none():
    amps, soc = drive(1, 0.8)
    r = record(amps, soc, phosphate=False)
    assert 0.01 <= r.charge_sd < 0.1
    assert abs(start_of(r) - 0.8) < 2.0 * r.charge_sd
    assert any("at the start, by the voltage at rest" in n for n in r.notes)
    assert not any("assumption" in n for n in r.notes)
    assert record(amps, soc, phosphate=False, soc_known=True).charge_sd == 0.0


def test_a_half_full_phosphate_cell_s_rest_hardly_tells_and_the_sd_says_so():
    amps, soc = drive(2, 0.6)
    r = record(amps, soc, phosphate=True, model=cell("26650 LFP"))
    assert r.charge_sd > 0.1
    assert abs(start_of(r) - 0.6) < 2.0 * r.charge_sd


def test_a_chemistry_that_is_not_known_costs_certainty():
    amps, soc = drive(3, 0.55)
    told, untold = (record(amps, soc, phosphate=False, model=cell(w)) for w in ("21700 NMC", None))
    assert told.charge_sd < untold.charge_sd


@pytest.mark.parametrize("phosphate", [False, True])
def test_the_truth_lies_within_two_sd(phosphate):
    """Over starts and drives, at rest first, under load from the first row, with and without the chemistry."""
    inside, sd = [], []
    for seed in range(40):
        rng = np.random.default_rng([seed, 77])
        amps, soc = drive(seed, float(rng.uniform(0.2, 0.95)), rest=int(rng.choice([0, 20, 400])))
        soc = soc + min(0.99 - soc.max(), 0.0) + max(0.03 - soc.min(), 0.0)
        words = [None, "26650 LFP" if phosphate else "21700 NMC"][seed % 2]
        r = record(amps, soc, phosphate=phosphate, model=cell(words))
        true = 0.5 * (soc[0] + soc[1])
        inside.append(abs(start_of(r) - true) <= 2.0 * r.charge_sd)
        sd.append(r.charge_sd)
    assert np.mean(inside) >= 0.9
    assert np.median(sd) < (0.3 if phosphate else 0.12)


def test_a_whole_discharge_tells_its_level_by_what_the_cell_can_hold():
    amps = np.full(3500, 5.0)
    soc = 0.99 - np.arange(3500) * 5.0 / 3600.0 / CAPACITY
    for volts in (True, False):
        r = record(amps, soc, phosphate=True, volts=volts)
        assert start_of(r) == pytest.approx(0.99, abs=0.04)
        assert r.charge_sd < 0.05


def test_without_a_voltage_the_level_is_said_to_be_an_assumption():
    amps, soc = drive(4, 0.8)
    r = record(amps, soc, phosphate=False, volts=False)
    told = next(n for n in r.notes if "is an assumption" in n)
    assert f"{100 * start_of(r):.0f} ± {100 * r.charge_sd:.0f} % (1 sd) at the start" in told
    assert r.charge_sd > 0.2


@pytest.mark.parametrize("wrong", [0.95, 1.0, 1.05])
def test_what_the_cell_can_hold_tells_the_level_as_well_as_the_capacity_is_known(wrong):
    """Discharges of 10 to 95 % from every level that allows them, counted by a capacity that is wrong by 5 %."""
    z = []
    for k, share in enumerate(np.tile([0.1, 0.3, 0.5, 0.7, 0.9, 0.95], 20)):
        rng = np.random.default_rng([k, 78])
        start = float(rng.uniform(share, 1.0))
        level = within_capacity(-np.linspace(0.0, share / wrong, 400))
        assert level.sd > 0.0
        z.append((start - level.soc) / level.sd)
    assert np.mean(np.abs(z) <= 2.0) >= 0.95
    assert 0.7 <= np.sqrt(np.mean(np.square(z))) <= 1.3


def test_each_part_after_a_gap_has_a_level_of_its_own():
    amps, soc = drive(5, 0.9, seconds=3000)
    t = np.arange(3000, dtype=float)
    t[1500:] += 7200.0
    soc = np.concatenate([soc[:1500], soc[1500:] - 0.5])  # charge that nobody logged went out in the gap
    amps[1480:1700] = 0.0
    r = record(amps, soc, phosphate=False, time_s=t)
    assert len(r.segments) == 2
    second = r.drive.soc[r.segments[1] + 5]
    assert second == pytest.approx(soc[1510], abs=2.0 * r.charge_sd)
    assert any("2 parts" in n for n in r.notes)


def test_a_rest_of_one_row_before_the_load_is_heard():
    """Testers log the set point a millisecond later: its interval's mean is loaded, its row is not."""
    amps = np.concatenate([[0.0], np.full(60, 2.5)])
    t = np.concatenate([[0.0], 0.001 + 60.0 * np.arange(60)])
    soc = 0.97 - np.concatenate([[0.0], np.cumsum(2.5 * np.diff(t))]) / 3600.0 / CAPACITY
    r = record(amps, soc, phosphate=False, model=cell("21700 NMC"), time_s=t)
    assert start_of(r) == pytest.approx(0.97, abs=2.0 * r.charge_sd)
    assert any("at rest" in n for n in r.notes)
