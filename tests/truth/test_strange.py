"""Effects in no catalogue keep the books of heat: written anew from the traces, nothing of the right-hand side."""

import numpy as np
import pytest

from tests.truth.cycle import repeated
from tests.truth.hidden import Scenario, make_logs
from tests.truth.pack import NOMINAL, REACTION_LIMIT, integrate, terms
from tests.truth.strange import OUTSIDE, STRANGE, UNKNOWN, bubbles, foreign_sink, loose_thermocouple, self_heating
from tests.truth.string import wavy_inlet

N, K = 4, 1500


def traced(effect, size, start=None):
    t = terms(N, repeated(25, 4)[:K], wavy_inlet(K), np.ones(K), 0.6, start=start)
    effect(t, size, np.random.default_rng(5))
    return t, integrate([t])[0]


def over(x):
    """Integral (n,) over the drive of a quantity (K + 1, n) given at the instants."""
    return ((x[1:] + x[:-1]) / 2).sum(axis=0)


def left_over(t, got, made, film):
    """What the books miss of the heat made, of all cells."""
    stored = NOMINAL["C_c"] * (got.core[-1] - got.core[0]) + NOMINAL["C_s"] * (got.surface[-1] - got.surface[0])
    return (made - stored - film).sum()


def test_heat_that_grows_with_the_core_is_what_the_pack_stores_and_sheds():
    t, got = traced(self_heating, 2.5, start=38.0)
    rising = 0.5 * 2.5 * np.exp((got.core - 45.0) / t.reaction_K)
    reaction = over(rising / (1 + rising / REACTION_LIMIT))
    joule = NOMINAL["R_e"] * np.sum(t.I**2)
    missing = left_over(t, got, joule + reaction, over(got.surface - got.coolant) / NOMINAL["R_u"])
    assert reaction.sum() > 0.1 * N * joule
    assert abs(missing) < 2e-3 * N * joule


def test_bubbles_hold_heat_back_and_make_none():
    t, got = traced(bubbles, 1.0)
    gas = t.R_u / NOMINAL["R_u"]
    assert gas.max() > 1.2
    assert np.median(gas) == 1.0  # most of the time there is none
    assert np.array_equal(gas[5:, 1], gas[:-5, 0])  # the next cell feels the same bubble five seconds later
    # the film's resistance is held for a second: its flux by the mean gap of that second
    gap = got.surface - got.coolant
    film = ((gap[1:] + gap[:-1]) / 2 / t.R_u).sum(axis=0)
    joule = NOMINAL["R_e"] * np.sum(t.I**2)
    assert abs(left_over(t, got, joule, film)) < 1e-2 * N * joule
    assert got.core.mean() > integrate([terms(N, t.rows, t.inlet, np.ones(K), 0.6)])[0].core.mean() + 0.2


def test_what_a_foreign_sink_takes_leaves_the_cores():
    t, got = traced(foreign_sink, 2.5)
    sink = np.interp(np.arange(K + 1.0), np.arange(K) + 0.5, t.sink)[:, None]
    taken = over(t.core_G * (got.core - sink))
    joule = NOMINAL["R_e"] * np.sum(t.I**2)
    film = over(got.surface - got.coolant) / NOMINAL["R_u"]
    assert abs(left_over(t, got, joule - taken, film)) < 2e-3 * N * joule
    assert np.abs(taken).min() > 0.05 * joule
    assert (np.abs(t.sink - t.start) >= 5.0 - 1e-9).all()


def test_a_loose_thermocouple_reads_between_casing_and_coolant_and_moves_no_heat():
    rng = np.random.default_rng(2)
    surface, coolant = 30 + rng.normal(size=(K + 1, N)), 20 + rng.normal(size=(K + 1, N))
    y = loose_thermocouple(surface, coolant, (1, 4), 2.5, rng)
    (c,) = np.flatnonzero((y != surface).any(axis=0))
    assert c in (0, 3)
    share = ((surface - y) / (surface - coolant))[:, c]
    assert share.max() == pytest.approx(0.3, abs=1e-6)
    assert share.min() == pytest.approx(0.0, abs=1e-6)
    assert 0.1 < (share > 0.15).mean() < 0.9  # it comes and goes
    same = {"cells": 3, "sensors": (1, 3), "seconds": 300, "seed": 8}
    plain, loose = make_logs([Scenario(**same), Scenario({"loose_thermocouple": ("strong", None)}, **same)])
    assert np.array_equal(plain.core, loose.core)


def test_the_suite_of_unknowns_keeps_its_numbers():
    assert set(UNKNOWN) < set(OUTSIDE)
    assert set(STRANGE) - set(UNKNOWN) == {"bubbles", "foreign_sink"}
