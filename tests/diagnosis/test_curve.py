"""dU/dT over the charge as a curve with a band, against a truth that winds between the effect's own knots."""

import numpy as np
import pytest

from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.curve import entropic_curve
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.record import make_record
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.identify.map_fit import fitted
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import Prior, StringModel
from bms_gateway.thermal.effects import effect_named
from tests.truth.pack import CAPACITY_AH, NOMINAL, integrate, terms

AMPS = 16.0
STILL_AIR = 6.0
"""K/W, as on a bench: R_c is a fifth of R_u there, so that the heat capacity tells how much heat there is."""


def model(R_u=STILL_AIR):
    """A cell cooled so, its heat capacity known to 5 % and its resistances to 60 %."""
    numbers = {**NOMINAL, "R_u": R_u}
    sd = {"C_c": 0.05, "C_s": 0.05, "R_e": 0.6, "R_c": 0.6, "R_u": 0.6}
    return StringModel(1, (1,), "single", {k: Prior(numbers[k], sd[k]) for k in sd}, capacity_Ah=CAPACITY_AH)


def wound(seed):
    """dU/dT, V/K, of a random layered oxide: three waves over the charge, up to 0.4 mV/K."""
    rng = np.random.default_rng([seed, 5])
    size, phase, level = rng.uniform(0.05, 0.15, 3), rng.uniform(0, 2 * np.pi, 3), rng.uniform(-0.1, 0.1)
    return lambda s: (
        1e-3
        * (level + sum(a * np.sin(2 * np.pi * n * s / 1.5 + p) for n, a, p in zip((1, 2, 3), size, phase, strict=True)))
    )


def record(seed, law, soc_known=True, span=(0.95, 0.05), R_u=STILL_AIR):
    """Steps of a tenth of the charge with rests, out and in again; the truth integrated by its own code."""
    high, low = span
    amps = []
    for sign in (1.0, -1.0):
        for _ in range(round((high - low) / 0.1)):
            amps += [AMPS * sign] * round(0.1 * CAPACITY_AH * 3600 / AMPS) + [0.0] * 240
    amps = np.array([0.0] * 200 + amps)
    t = terms(1, amps, np.full(len(amps) + 1, 25.0), np.ones(len(amps)), high, start=25.0, R_u=R_u)
    t.entropic += law(t.soc)
    (trace,) = integrate([t])
    rng = np.random.default_rng([seed, 6])
    return make_record(
        Columns(
            time_s=np.arange(len(amps), dtype=float),
            current_A=amps,
            coolant_inlet_C=np.full(len(amps), 25.0),
            soc=t.soc if soc_known else None,
            surface_C={1: np.asarray(trace.surface)[:-1, 0] + 0.02 * rng.standard_normal(len(amps))},
            source="log",
        ),
        model(R_u),
    )


def curve(r, charge_sd=0.0, effect="entropic_heat", R_u=STILL_AIR):
    m = measured(r, model(R_u))
    e = effect_named(effect)
    free = Candidate(e, free=e.determined(m.drive)).put_into(model(R_u))
    return entropic_curve(fitted(Problem(free, [m])), charge_sd)


@pytest.mark.parametrize("R_u", [NOMINAL["R_u"], 2.0, STILL_AIR])
@pytest.mark.slow
def test_the_truth_lies_within_the_band_of_a_tenth_of_a_millivolt(R_u):
    # Bug: with R_c > R_u a second set of numbers explains the surface too; the curve was 39 % low, 7 sd away.
    inside, sd = [], []
    for seed in range(6):
        law = wound(seed)
        c = curve(record(seed, law, R_u=R_u), R_u=R_u)
        inside.append(np.abs(c.value - 1e3 * law(c.soc)) <= 2.0 * c.sd)
        sd.append(c.sd)
        assert np.abs(c.value - 1e3 * law(c.soc)).max() < 0.15
    assert np.mean(np.concatenate(inside)) >= 0.9
    assert np.median(np.concatenate(sd)) <= 0.1


def test_the_curve_ends_where_the_record_did():
    c = curve(record(7, wound(7), span=(0.8, 0.3)))
    assert c.soc[0] == pytest.approx(0.3, abs=0.051)
    assert c.soc[-1] == pytest.approx(0.8, abs=0.051)


def test_an_unknown_level_of_the_charge_widens_the_band_where_the_curve_is_steep():
    r = record(8, wound(8))
    sure, unsure = curve(r), curve(r, 0.1)
    assert unsure.value == pytest.approx(sure.value)
    slope = np.abs(np.gradient(sure.value, sure.soc))
    assert (unsure.sd >= sure.sd).all()
    steep = int(np.argmax(slope[1:-1])) + 1
    assert unsure.sd[steep] ** 2 - sure.sd[steep] ** 2 == pytest.approx((0.1 * slope[steep]) ** 2, rel=0.3)


def test_without_the_effect_or_with_a_level_only_there_is_no_curve():
    assert curve(record(9, wound(9)), effect="resistance_temperature") is None
    assert curve(record(9, wound(9), span=(0.6, 0.5))) is None
