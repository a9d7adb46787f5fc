"""What every effect must obey: the catalogue does, wrong ones are caught, and the truth knows the whole catalogue."""

import numpy as np
import pytest

from bms_gateway.thermal.effects import Effect, EffectParameter, catalogue
from bms_gateway.thermal.physics import Physics
from bms_gateway.thermal.properties import broken_properties
from tests.thermal import test_effects_truth
from tests.thermal.balances import VALUES, drive, model, place, states, values
from tests.truth import effects as truth
from tests.truth.sizes import SIZES

SIGMA = 5.670374e-8


def test_the_truth_knows_every_effect_of_the_catalogue():
    """An effect that nobody wrote a second time, elsewhere and by hand, is an effect that nobody checked."""
    names = set(catalogue())
    assert names == set(truth.CATALOGUE) | set(truth.SENSING), "tests/truth/effects.py"
    assert names == set(SIZES), "tests/truth/sizes.py: how large it is when it is hidden"
    assert names == set(test_effects_truth.CASES) | set(test_effects_truth.SENSING), "along a drive"


@pytest.mark.parametrize("name", catalogue())
def test_every_effect_of_the_catalogue_obeys(name):
    assert broken_properties(catalogue()[name]) == ()


@pytest.mark.parametrize("coolant", ["bulk", "ntu"])
@pytest.mark.parametrize("C_f", [11.33, 2.6, np.inf])
@pytest.mark.parametrize("by", ["probe", "lower", "upper"])
def test_heat_made_is_stored_or_leaves_with_every_effect(coolant, C_f, by):
    """The stream's gain is marched here, with R_u, C_f and the inlet that each effect is known to make of them."""
    N, cells, u = 80, 4, drive(80)
    for name in catalogue():
        own = Physics(model(cells, (name, place(name), values(name, by=by)), coolant=coolant, C_f=C_f))
        X, v = states(N, cells, catalogue()[name].states), own.numbers()
        z = own.point(X, u, v, own.memory(u, v)[0])
        rates = own.balances(z, v)
        p = v.effects[own.model.effects[0].key]
        R_u, share, inlet, bend = np.full((N, cells), VALUES["R_u"]), np.ones(cells), z.T_in[:, 0], 0.0
        if name == "cooling_drift":
            R_u = R_u * np.maximum(1 + p["a"] * 3600 * u.hours, 0.05)[:, None]
        if name == "flow_dependent_cooling":
            R_u = R_u * (u.flow ** -p["n"])[:, None]
        if name == "cell_cooling":
            R_u[:, 1] *= 1 + p["a"]
        if name == "coolant_bypass":
            share[1:] = 1 - p["b"]
        if name == "natural_convection":
            bend = p["n"]
        film = np.zeros(N)
        stream = inlet.copy()
        for k in range(cells):
            gap = z.T_s[:, k] - stream
            G = (np.maximum(np.abs(gap), 0.05) / 5) ** bend / R_u[:, k]
            if np.isinf(C_f):
                film += G * gap
                continue
            C = C_f * u.flow * share[k]
            leaves = stream + gap * (1 - np.exp(-G / C) if coolant == "ntu" else np.minimum(G / C, 1))
            film += C * (leaves - stream)
            stream = leaves
        stored = np.sum(z.C_c * rates[:, 0 : 2 * cells : 2] + z.C_s * rates[:, 1 : 2 * cells : 2], axis=1)
        made = np.sum(z.core, axis=1) + np.sum(np.broadcast_to(z.surface, z.T_s.shape), axis=1)
        flows = np.abs(z.core).sum(axis=1) + np.abs(z.film).sum(axis=1) + np.abs(made) + np.abs(stored)
        assert np.all(np.abs(stored - made + film) < 1e-9 * flows), name


class Radiation(Effect):
    """Casings radiate to a hall of 25 °C: right."""

    name = "radiation"
    title = "radiation"
    equation = "surface heat -> surface heat - eA*sigma*(T_s^4 - T_hall^4)"
    signature = "hot casings cool faster"
    node = "surface"
    constants = True
    parameters = (EffectParameter("eA", "emissivity times area", "m2", 1.0, 0.0, 0.01, 0.0, 1.0, probe=0.01),)

    def surroundings(self, z, p, at):
        z.surface = z.surface + p["eA"] * SIGMA * (298.15**4 - (z.T_s + 273.15) ** 4)


class RadiationReversed(Radiation):
    def surroundings(self, z, p, at):
        z.surface = z.surface + p["eA"] * SIGMA * ((z.T_s + 273.15) ** 4 - 298.15**4)


class RadiationInCelsius(Radiation):
    def surroundings(self, z, p, at):
        z.surface = z.surface + p["eA"] * SIGMA * (25.0**4 - z.T_s**4)


class RadiationReversedInCelsius(Radiation):
    def surroundings(self, z, p, at):
        z.surface = z.surface + p["eA"] * SIGMA * (z.T_s**4 - 25.0**4)


class EntropyInCelsius(Effect):
    name = "entropy"
    title, equation, signature, node = "t", "e", "s", "core"
    parameters = (EffectParameter("s", "dU/dT", "mV/K", 1e-3, 0.0, 1e-3, -1e-2, 1e-2, probe=1e-3),)

    def heats(self, z, p, at):
        z.core = z.core - z.I * z.T_c * p["s"]


class MilliohmsTakenForOhms(Effect):
    name = "lug"
    title, equation, signature, node = "t", "e", "s", "surface"
    parameters = (EffectParameter("R", "resistance", "mOhm", 1.0, 0.0, 1.0, 0.0, 5.0, probe=0.2),)

    def surroundings(self, z, p, at):
        z.surface = z.surface + z.I2 * p["R"]


class CurrentForItsSquare(Effect):
    """Watts from amperes and ohms."""

    name = "lug"
    title, equation, signature, node = "t", "e", "s", "surface"
    parameters = (EffectParameter("R", "resistance", "mOhm", 1e-3, 0.0, 1e-3, 0.0, 5.0, probe=2e-4),)

    def surroundings(self, z, p, at):
        z.surface = z.surface + z.I * p["R"]


class FilmTheStreamKnowsNothingOf(Effect):
    name = "fins"
    title, equation, signature, node = "t", "e", "s", "surface"
    parameters = (EffectParameter("a", "more film", "1", 1.0, 0.0, 1.0, 0.0, 5.0, probe=0.2),)

    def surroundings(self, z, p, at):
        z.film = z.film * (1.0 + p["a"])


class AlwaysThere(Effect):
    name = "always"
    title, equation, signature, node = "t", "e", "s", "surface"
    parameters = (EffectParameter("P", "heat", "W", 1.0, 0.0, 1.0, -5.0, 5.0, probe=0.2),)

    def surroundings(self, z, p, at):
        z.surface = z.surface + p["P"] + 0.1


class SaysItWarms(AlwaysThere):
    warms = 1

    def surroundings(self, z, p, at):
        z.surface = z.surface - p["P"]


class PoleAtItsBound(AlwaysThere):
    parameters = (EffectParameter("a", "share", "1", 1.0, 0.0, 1.0, -1.0, 5.0, probe=0.2),)

    def coefficients(self, z, p, at):
        z.R_c = z.R_c * (1.0 + p["a"])

    def surroundings(self, z, p, at):
        pass


def test_a_right_effect_of_ones_own_passes():
    assert broken_properties(Radiation) == ()
    assert broken_properties(Radiation()) == ()


KELVIN = "reversed sign, or °C where a law needs kelvin"


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (RadiationReversed, KELVIN),
        (RadiationInCelsius, KELVIN),
        (RadiationReversedInCelsius, KELVIN),
        (EntropyInCelsius, "0 °C of the core is a special point: a law needs kelvin"),
        (MilliohmsTakenForOhms, "R is in mOhm, which is 0.001 in SI: to_si is 1"),
        (CurrentForItsSquare, "in other units of charge it is another law"),
        (FilmTheStreamKnowsNothingOf, "heat made is not heat stored"),
        (AlwaysThere, "P at its neutral value still changes something"),
        (SaysItWarms, "says that it warms a string on discharge, and does not"),
        (PoleAtItsBound, "not finite with a at its lower value"),
    ],
)
def test_a_wrong_effect_is_caught_and_told_why(wrong, says):
    found = broken_properties(wrong)
    assert any(says in sentence for sentence in found), found
    assert all(sentence.startswith(f"{wrong.name}: ") for sentence in found)
