"""The string against heat balances written out by hand, the paper's figures, and the truth simulator."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.errors import ConfigError
from bms_gateway.thermal import (
    KINDS,
    Prior,
    StringModel,
    StringParameters,
    continuous,
    coolant_path,
    discretize,
    exchange,
    film,
    simulate,
    steady_state,
)
from tests.truth.string import C_F, TABLE_1, TruthString, lsoda


def table_1(n, **other):
    return StringParameters.of(n, **{**TABLE_1, **other})


def twin(p):
    """The truth's string with the same numbers."""
    values = {k: getattr(p, k) for k in TABLE_1}
    return TruthString.of(p.cells, R_cc=p.R_cc, C_f=p.C_f, coolant=p.coolant, **values)


@st.composite
def strings(draw):
    n = draw(st.integers(1, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    R_u = rng.uniform(0.3, 6.0, n)
    coolant = draw(st.sampled_from(["bulk", "ntu"]))
    return StringParameters(
        rng.uniform(20, 900, n),
        rng.uniform(3, 90, n),
        rng.uniform(0.5e-3, 20e-3, n),
        rng.uniform(0.3, 5.0, n),
        R_u,
        draw(st.sampled_from([np.inf, 0.5, 4.0, 32.0])),
        draw(st.sampled_from([np.inf, 1.05 / R_u.min(), 11.33])) if coolant == "bulk" else 0.7,
        coolant,
    )


def temperatures(n):
    return st.lists(st.floats(-30, 90), min_size=2 * n, max_size=2 * n).map(np.array)


def test_poles_of_the_single_cell_are_the_papers():
    poles = np.sort(np.linalg.eigvals(continuous(table_1(1)).A))
    assert poles == pytest.approx([-0.110498, -0.00179594], rel=5e-6)


@settings(max_examples=60, deadline=None)
@given(strings(), st.data())
def test_rates_are_those_of_the_heat_balances(p, data):
    s = continuous(p)
    x = data.draw(temperatures(p.cells))
    q = np.linspace(0, 20, p.cells)
    dT_c, dT_s = twin(p).rates(x[0::2], x[1::2], 17.0, None, heat=q)
    rates = s.A @ x + s.B_q @ q + s.B_f * 17.0
    np.testing.assert_allclose(rates[0::2], dT_c, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(rates[1::2], dT_s, rtol=1e-9, atol=1e-9)


def test_entries_are_those_of_equation_21_with_its_slips_mended():
    p = table_1(5, R_cc=4.0, C_f=C_F)
    C_c, C_s, _, R_c, R_u = TABLE_1.values()
    A, B_f, e = continuous(p).A, continuous(p).B_f, 1 / (R_u * C_F)
    assert A[0, 0] == pytest.approx(-1 / (R_c * C_c))
    assert A[2, 3] == pytest.approx(1 / (R_c * C_c))  # printed without its capacity
    assert A[1, 1] == pytest.approx(-(1 / R_c + 1 / R_u + 1 / 4.0) / C_s)  # one neighbour
    assert A[9, 9] == pytest.approx(-(1 / R_c + 1 / R_u + 1 / 4.0) / C_s)
    assert A[3, 3] == pytest.approx(-(1 / R_c + 1 / R_u + 2 / 4.0) / C_s)  # two
    assert A[3, 1] == pytest.approx((1 / 4.0 + e / R_u) / C_s)
    assert A[1, 3] == pytest.approx(1 / 4.0 / C_s)  # the stream carries nothing upwards
    assert A[5, 1] == pytest.approx(e * (1 - e) / (R_u * C_s))  # printed without (1 − e)
    assert A[9, 1] == pytest.approx(e * (1 - e) ** 3 / (R_u * C_s))
    assert B_f[1::2] == pytest.approx((1 - e) ** np.arange(5) / (R_u * C_s))


@settings(max_examples=40, deadline=None)
@given(strings(), st.floats(-30, 60), st.floats(0.05, 1e5))
def test_a_string_as_warm_as_its_inlet_stays_so_over_any_step(p, T, dt):
    d = discretize(continuous(p), dt)
    x = d.step(np.full(2 * p.cells, T), np.zeros(p.cells), T, T)
    np.testing.assert_allclose(x, T, atol=1e-7)


@settings(max_examples=40, deadline=None)
@given(strings(), st.data())
def test_heat_is_stored_or_leaves_with_the_coolant(p, data):
    """Conduction and the core–surface exchange move heat about and make none, whatever the temperatures."""
    x = data.draw(temperatures(p.cells))
    q = np.linspace(5, 1, p.cells)
    s = continuous(p)
    rates = s.A @ x + s.B_q @ q + s.B_f * 20.0
    stream, units, carried = 20.0, 1 / (p.R_u * p.C_f), 0.0
    for k in range(p.cells):
        gap = x[2 * k + 1] - stream
        if np.isfinite(p.C_f):
            after = stream + gap * (units[k] if p.coolant == "bulk" else 1 - np.exp(-units[k]))
            carried, stream = carried + p.C_f * (after - stream), after
        else:
            carried += gap / p.R_u[k]
    stored = p.C_c @ rates[0::2] + p.C_s @ rates[1::2]
    assert stored == pytest.approx(q.sum() - carried, rel=1e-9, abs=1e-9 * (1 + abs(carried)))


@settings(max_examples=40, deadline=None)
@given(strings(), st.data())
def test_the_stream_warms_by_exactly_the_heat_it_takes(p, data):
    if not np.isfinite(p.C_f):
        return
    T_s = data.draw(temperatures(p.cells))[: p.cells]
    M, m = coolant_path(p)
    T_f = M @ T_s + m * 20.0
    warmed = p.C_f * np.diff(T_f)
    np.testing.assert_allclose(warmed, ((T_s - T_f) * film(p))[:-1], rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("C_f", [0.6, 1.9, 4.2, 24.0])
def test_a_film_of_many_transfer_units_is_that_of_a_stream_that_warms_along_the_cell(C_f):
    """Marched along the casing in 100,000 slices: the stream's gain is the film, which R_u alone would put too high."""
    slices, R_u, gap = 100_000, 0.79, 10.0
    stream, T_s = 0.0, gap
    for _ in range(slices):
        stream += (T_s - stream) / (R_u * slices) / C_f
    p = table_1(1, C_f=C_f, coolant="ntu")
    assert film(p)[0] * gap == pytest.approx(C_f * stream, rel=1e-5)
    assert film(p)[0] < 1 / R_u


@settings(max_examples=30, deadline=None)
@given(strings())
def test_steady_state_rests_and_gives_off_all_its_heat(p):
    q = np.linspace(1, 12, p.cells)
    x = steady_state(p, q, 25.0)
    dT_c, dT_s = twin(p).rates(x[0::2], x[1::2], 25.0, None, heat=q)
    np.testing.assert_allclose([dT_c, dT_s], 0.0, atol=1e-8)
    np.testing.assert_allclose(x[0::2] - x[1::2], q * p.R_c, rtol=1e-9)


@pytest.mark.parametrize("coolant", ["bulk", "ntu"])
@pytest.mark.parametrize("dt", [1.0, 7.0])
def test_discretisation_is_exact_for_held_heat_and_straight_inlets(coolant, dt):
    rng = np.random.default_rng(3)
    R_e = 3.5e-3 * rng.uniform(0.8, 1.2, 5)
    p = table_1(5, R_cc=4.0, C_f=C_F, coolant=coolant, R_e=R_e)
    current, inlet = rng.uniform(-90, 160, 60), 25.0 + np.cumsum(rng.normal(0, 0.5, 61))
    core, surface = lsoda(twin(p), current, inlet, (31.0, 28.0), dt=dt)
    x0 = np.tile([31.0, 28.0], 5)
    x = simulate(discretize(continuous(p), dt), x0, current[:, None] ** 2 * R_e, inlet)
    np.testing.assert_allclose(x[:, 0::2], core, atol=2e-6)
    np.testing.assert_allclose(x[:, 1::2], surface, atol=2e-6)


def test_one_long_step_is_many_short_ones():
    s = continuous(table_1(4, R_cc=4.0, C_f=C_F))
    x0, q = np.linspace(20, 50, 8), np.array([3.0, 5.0, 8.0, 1.0])
    many = simulate(discretize(s, 1.0), x0, np.tile(q, (3600, 1)), np.linspace(20, 30, 3601))
    one = discretize(s, 3600.0).step(x0, q, 20.0, 30.0)
    np.testing.assert_allclose(one, many[-1], atol=1e-8)


def test_five_cells_heat_up_and_cool_down_as_in_figures_7_and_8():
    p = table_1(5, R_cc=32.0, C_f=C_F)
    hot = steady_state(p, np.full(5, 62.2**2 * 3.5e-3), 25.0)
    assert hot[0::2] == pytest.approx([52.9, 54.1, 55.2, 56.4, 57.6], abs=0.1)
    s = continuous(p)
    after = discretize(s, 600.0).step(hot, np.zeros(5), 25.0, 25.0)
    assert np.mean(after[0::2] - after[1::2]) == pytest.approx(6.4, abs=0.15)
    x = simulate(discretize(s, 6.0), hot, np.zeros((600, 5)), np.full(601, 25.0))
    minutes = np.argmax((np.abs(x - 25.0) <= 0.5).all(axis=1)) / 10
    assert minutes == pytest.approx(43.7, abs=1.0)


def test_exchange_formulas_differ_by_the_six_per_cent_of_the_nominal_flow():
    bulk, ntu = (exchange(table_1(5, C_f=C_F, coolant=c))[0] for c in ("bulk", "ntu"))
    assert bulk / ntu - 1 == pytest.approx(0.057, abs=0.001)


def test_exchange_never_exceeds_one_with_ntu_and_bulk_says_when_it_would():
    slow = {"R_u": 0.79, "C_f": 1.2}
    assert 0 < exchange(table_1(3, coolant="ntu", **slow))[0] < 1
    with pytest.raises(ConfigError, match=r"R_u\*C_f = 0\.948 .*ntu"):
        exchange(table_1(3, **slow))


def test_without_coolant_warming_and_conduction_cells_do_not_know_each_other():
    A = continuous(table_1(4)).A
    for k in range(4):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = 0
    assert not A.any()


def test_more_flow_warms_up_less_and_films_stay_as_they_are():
    p = table_1(3, C_f=C_F)
    fast = p.with_flow_ratio(2.0)
    assert fast.C_f == pytest.approx(2 * C_F)
    assert fast.R_u is p.R_u
    assert fast.R_c is p.R_c


@pytest.mark.parametrize(
    ("condition", "conducts", "warms"),
    [("full", True, True), ("natural", True, False), ("no-conduction", False, True), ("single", False, False)],
)
def test_condition_decides_which_couplings_there_are(condition, conducts, warms):
    priors = {k: Prior(v) for k, v in {**TABLE_1, "R_cc": 4.0, "C_f": C_F}.items()}
    p = StringModel(3, (1,), condition, priors).nominal
    assert np.isfinite(p.R_cc) == conducts
    assert np.isfinite(p.C_f) == warms


def test_values_replace_medians_and_may_differ_between_cells():
    priors = {k: Prior(v, 0.1) for k, v in TABLE_1.items()}
    p = StringModel(2, (1,), "single", priors).parameters({"R_e": np.array([3e-3, 4e-3])})
    assert p.R_e.tolist() == [3e-3, 4e-3]
    assert p.R_c.tolist() == [1.266, 1.266]


def test_bounds_hold_the_nominal_cell_and_catch_slips_of_unit():
    for symbol, value in {**TABLE_1, "R_cc": 4.0, "C_f": C_F}.items():
        kind = KINDS[symbol]
        assert kind.lower < value < kind.upper
    assert TABLE_1["R_e"] * 1e3 > KINDS["R_e"].upper  # mΩ taken for Ω
    assert KINDS["R_e"].to_si == 1e-3


def test_numbers_of_a_string_cannot_be_changed_by_accident():
    with pytest.raises(dataclasses.FrozenInstanceError):
        table_1(1).C_f = 3.0
