"""What effects do to thermocouples, against the balance by hand: the watch over heat sees plain cells."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.health.heat.balances import even
from bms_gateway.health.heat.effect_share import EffectShare
from bms_gateway.observe import Measured
from bms_gateway.thermal import AddedEffect
from tests.observe.rig import STRING, model

TICKS, INLET, AMPS = 6, 25.0, 20.0
NAN = float("nan")


def share(effect: str, **values: float) -> EffectShare:
    """Of one cell whose model holds the effect."""
    added = AddedEffect(effect, None, values, dict.fromkeys(values, 0.0))
    found = EffectShare(replace(model(1, (1,)), effects=(added,)), 1.0, 0.5)
    found.begin(INLET)
    return found


def driven(s: EffectShare, amps: float = AMPS, inlet: float = INLET) -> float:
    """One step of as many ticks of a second; how much more the thermocouple reads on its mean, K."""
    for _ in range(TICKS):
        s.add(Measured(amps, amps**2, abs(amps), inlet))
    return float(even(TICKS) @ s.course(TICKS)[TICKS:, 0])


def test_heat_at_the_surface_warms_it_by_its_watts_times_the_resistance_to_the_coolant() -> None:
    R_s = 1.5e-3
    s = share("surface_joule", R_s=R_s)
    told = [driven(s) for _ in range(4000)]
    assert told[-1] == pytest.approx(AMPS**2 * R_s * STRING["R_u"], rel=1e-3)
    assert (np.diff(told) > -1e-9).all()
    adiabatic = AMPS**2 * R_s * TICKS / STRING["C_s"] / 2.0  # on the mean of the first step
    assert 0.1 * adiabatic < told[0] < adiabatic


def test_a_lagging_thermocouple_reads_less_by_the_rate_times_its_lag() -> None:
    tau = 20.0
    s = share("thermocouple_lag", tau=tau)
    rate = 0.002  # K/s of the coolant; long after its beginning all rises with it
    told = [driven(s, 0.0, INLET + rate * TICKS * k) for k in range(2000)]
    assert STRING["R_u"] * (STRING["C_c"] + STRING["C_s"]) < 2000 * TICKS / 5
    assert told[-1] == pytest.approx(-rate * tau, rel=0.05)


@pytest.mark.parametrize(("effect", "values"), [("surface_joule", {"R_s": 0.0}), ("current_offset", {"b": 0.0})])
def test_an_effect_of_no_size_does_nothing(effect: str, values: dict[str, float]) -> None:
    s = share(effect, **values)
    assert [driven(s, amps, 20.0) for amps in (0.0, 30.0, -15.0)] == pytest.approx([0.0] * 3, abs=1e-9)


def test_after_a_time_without_frames_nothing_is_known_until_it_begins_anew() -> None:
    s = share("surface_joule", R_s=1.5e-3)
    first = [driven(s) for _ in range(5)]
    s.pause()
    assert driven(s) == 0.0
    s.begin(INLET)
    assert [driven(s) for _ in range(5)] == first


def test_a_tick_whose_current_is_unknown_counts_by_the_others_of_its_step() -> None:
    known, gap = share("surface_joule", R_s=1.5e-3), share("surface_joule", R_s=1.5e-3)
    for k in range(TICKS):
        known.add(Measured(AMPS, AMPS**2, AMPS, INLET))
        gap.add(Measured(NAN, NAN, NAN, INLET) if k == 2 else Measured(AMPS, AMPS**2, AMPS, INLET))
    assert np.array_equal(known.course(TICKS), gap.course(TICKS))


def test_what_flowed_early_in_a_step_shows_more_than_what_flowed_late() -> None:
    """Bug: the share was that of a current even over the step, and the watch took what was left for lost cooling."""
    R_s, early, late = 1.5e-3, share("surface_joule", R_s=1.5e-3), share("surface_joule", R_s=1.5e-3)
    for k in range(TICKS):
        for s, flows in ((early, k < 2), (late, k >= TICKS - 2)):
            s.add(Measured(AMPS * flows, AMPS**2 * flows, AMPS * flows, INLET))
    ends = [s.course(TICKS)[TICKS:, 0] for s in (early, late)]
    # heat of its own at the casing: a node between core and coolant, here by steps of a millisecond
    C_c, C_s, R_c, R_u = (STRING[k] for k in ("C_c", "C_s", "R_c", "R_u"))
    for found, first in zip(ends, (0, TICKS - 2), strict=True):
        core = casing = 0.0
        for k in range(TICKS):
            for _ in range(1000):
                flux = (core - casing) / R_c
                heat = AMPS**2 * R_s * (first <= k < first + 2)
                core, casing = core - 1e-3 * flux / C_c, casing + 1e-3 * (heat + flux - casing / R_u) / C_s
            assert found[k + 1] == pytest.approx(casing, abs=2e-4)
