"""Every effect against its equation, written out here by hand, cell by cell and interval by interval."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.thermal.physics import Physics
from tests.thermal.balances import VALUES, drive, model, states, values

N, CELLS = 60, 4
C_C, C_S, R_E, R_C, R_U = (VALUES[k] for k in ("C_c", "C_s", "R_e", "R_c", "R_u"))
U = drive(N)
X = states(N, CELLS)
T_C, T_S = X[:, 0::2], X[:, 1::2]


def stream(T_in, flow=U.flow, R_u=None, C_f=None, n=0.0, cells=CELLS, surface=T_S):
    """Coolant at each cell and the film flux, marching along the string: what the stream takes up is what the casing
    gives off, by the bulk node, and the stream leaves no warmer than the casing."""
    R_u = np.full((N, cells), R_U) if R_u is None else R_u
    C_f = np.tile((VALUES["C_f"] * flow)[:, None], (1, cells)) if C_f is None else C_f
    T_f, film = np.empty((N, cells)), np.empty((N, cells))
    for i in range(N):
        here = T_in[i]
        for k in range(cells):
            gap = surface[i, k] - here
            T_f[i, k] = here
            units = (max(abs(gap), 0.05) / 5.0) ** n / R_u[i, k] / C_f[i, k]
            share = min(units, 1.0)
            film[i, k] = C_f[i, k] * gap * share
            here = here + gap * share
    return T_f, film


def balances(*, heat=None, R_c=R_C, R_u=None, C_s=C_S, surface=0.0, T_in=U.T_in, C_f=None, n=0.0):
    """Rates of cores and surfaces with terms replaced; heat in W."""
    heat = np.tile((U.I2 * R_E)[:, None], (1, CELLS)) if heat is None else heat
    inner = (T_C - T_S) / R_c
    _, film = stream(T_in, R_u=R_u, C_f=C_f, n=n)
    net = inner - film + surface
    for k in range(CELLS):
        for other in (k - 1, k + 1):
            if 0 <= other < CELLS:
                net[:, k] += (T_S[:, other] - T_S[:, k]) / VALUES["R_cc"]
    out = np.empty((N, 2 * CELLS))
    out[:, 0::2], out[:, 1::2] = (heat - inner) / C_C, net / C_s
    return out


def rates(name, cell=None, X=X, **given):
    own = Physics(model(CELLS, (name, cell, values(name, **given))))
    v = own.numbers()
    memory, _ = own.memory(U, v)
    return own.rates(X, U, v, memory)


def readings(name, cell=None, X=X, **given):
    own = Physics(model(CELLS, (name, cell, values(name, **given))))
    v = own.numbers()
    return own.readings(X, U, v, own.memory(U, v)[0])


def same(got, expected):
    assert np.allclose(got, expected, rtol=1e-10, atol=1e-10)


def column(x):
    return np.asarray(x)[:, None] * np.ones((1, CELLS))


def arrhenius(kelvin):
    return np.array([[math.exp(kelvin * (1 / (T + 273.15) - 1 / 298.15)) for T in row] for row in T_C])


def test_the_balances_without_effects_are_those_written_here():
    bare = Physics(model(CELLS))
    same(bare.rates(X, U, bare.numbers(), {}), balances())


def test_entropic_heat():
    knots, level, departures = (0.05, 0.35, 0.65, 0.95), 0.2e-3, (0.1e-3, -0.3e-3, 0.05e-3, 0.4e-3)
    heat = np.empty((N, CELLS))
    for i in range(N):
        soc = min(max(U.soc[i], 0.05), 0.95)
        j = min(int((soc - 0.05) / 0.3), 2)
        part = (soc - knots[j]) / 0.3
        slope = level + departures[j] * (1 - part) + departures[j + 1] * part
        heat[i] = U.I2[i] * R_E - U.I[i] * (T_C[i] + 273.15) * slope
    given = {"dUdT": level} | {f"dUdT_{k}": d for k, d in enumerate(departures, 1)}
    same(rates("entropic_heat", **given), balances(heat=heat))


@given(st.floats(-1.5e-3, 1.5e-3))
@settings(deadline=None, max_examples=25)
def test_a_constant_entropic_coefficient_is_the_level_alone(level):
    heat = column(U.I2) * R_E - column(U.I) * (T_C + 273.15) * level
    same(rates("entropic_heat", dUdT=level), balances(heat=heat))


def test_voltage_heat_and_where_there_is_no_voltage():
    given = {"U": 3.3, "U_1": -0.2, "U_2": -0.05, "U_3": 0.0, "U_4": 0.03, "U_5": 0.15}
    curve = 3.3 + np.interp(U.soc, (0.05, 0.275, 0.5, 0.725, 0.95), (-0.2, -0.05, 0.0, 0.03, 0.15))
    heat = np.where(np.isnan(U.V), U.I2 * R_E, U.I * curve - U.IV)
    assert np.isnan(U.V).any()
    same(rates("voltage_heat", **given), balances(heat=column(heat)))


@pytest.mark.parametrize("B", [-1000.0, 3100.0, 8000.0])
def test_resistance_temperature(B):
    same(rates("resistance_temperature", B=B), balances(heat=column(U.I2) * R_E * arrhenius(B)))


def test_resistance_soc_and_never_a_negative_one():
    for s_1, s_2 in ((0.4, -0.2), (-2.0, 0.0)):
        share = [max(1 + s_1 * (1 - 2 * s) + s_2 * (1 - 2 * s) ** 2, 0.05) for s in U.soc]
        same(rates("resistance_soc", s_1=s_1, s_2=s_2), balances(heat=column(U.I2 * R_E * share)))


@given(st.floats(-0.7, 2.0))
@settings(deadline=None, max_examples=25)
def test_resistance_asymmetry_of_plain_intervals(a):
    u = drive(N, I_abs=np.abs(U.I), I2=U.I**2)
    own = Physics(model(CELLS, ("resistance_asymmetry", None, {"a": a})))
    heat = U.I**2 * R_E * np.where(U.I < 0, 1 + a, 1.0)
    same(own.rates(X, u, own.numbers(), {}), balances(heat=column(heat)))


def test_resistance_asymmetry_counts_the_charge_that_went_in():
    # 40 A in for a quarter of the interval, 20 A out for the rest
    u = drive(N, I=np.full(N, 5.0), I2=np.full(N, 700.0), I_abs=np.full(N, 25.0))
    own = Physics(model(CELLS, ("resistance_asymmetry", None, {"a": 0.5})))
    heat = np.full(N, 700.0 * R_E * (1 + 0.5 * 10 / 25))
    same(own.rates(X, u, own.numbers(), {}), balances(heat=column(heat)))


@pytest.mark.parametrize(("I_0", "E"), [(2.0, 5000.0), (20.0, 3000.0), (500.0, 0.0)])
def test_charge_transfer_of_a_constant_current(I_0, E):
    u = drive(N, I_abs=np.abs(U.I), I2=U.I**2)
    own = Physics(model(CELLS, ("charge_transfer", None, {"I_0": I_0, "E": E})))
    heat = np.empty((N, CELLS))
    for i in range(N):
        for k in range(CELLS):
            T, amps = T_C[i, k] + 273.15, abs(U.I[i])
            exchange = I_0 * math.exp(-E * (1 / T - 1 / 298.15))
            heat[i, k] = U.I[i] ** 2 * R_E + amps * 2 * 8.314462618 * T / 96485.33212 * math.asinh(
                amps / (2 * exchange)
            )
    same(own.rates(X, u, own.numbers(), {}), balances(heat=heat))


@given(st.floats(0.05, 1.0), st.floats(0.5, 400.0), st.floats(0.5, 200.0))
@settings(deadline=None, max_examples=50)
def test_charge_transfer_of_pulses_within_an_interval(share, amps, I_0):
    on, none = np.full(N, share), np.zeros(N)
    u = drive(N, I=on * amps, I2=on * amps**2, I_abs=on * amps)
    own = Physics(model(CELLS, ("charge_transfer", None, {"I_0": I_0, "E": 0.0})))
    pulse = amps * 2 * 8.314462618 * (T_C + 273.15) / 96485.33212 * math.asinh(amps / (2 * I_0))
    same(
        own.rates(X, u, own.numbers(), {}),
        balances(heat=column(none) + share * (amps**2 * R_E + pulse)),
    )


def test_drifts():
    share = 1 + 0.25 * U.hours
    same(rates("resistance_drift", a=0.25 / 3600), balances(heat=column(U.I2 * R_E * share)))
    same(rates("cooling_drift", a=0.25 / 3600), balances(R_u=column(R_U * share)))


def test_flow_dependent_cooling():
    same(rates("flow_dependent_cooling", n=0.63), balances(R_u=column(R_U * U.flow**-0.63)))


@pytest.mark.parametrize("n", [-0.3, 0.25, 0.8])
def test_natural_convection(n):
    same(rates("natural_convection", n=n), balances(n=n))


def test_second_heat_paths():
    ends = np.array([1.0, 0.0, 0.0, 1.0])
    same(rates("ambient_loss", G=0.3, P=4.0), balances(surface=4.0 - 0.3 * (T_S - 25.0)))
    same(rates("core_loss", G=0.3, P=4.0), balances(heat=column(U.I2 * R_E) + 4.0 - 0.3 * (T_C - 25.0)))
    same(rates("end_plate", G=0.3, P=4.0), balances(surface=(4.0 - 0.3 * (T_S - 25.0)) * ends))
    same(rates("surface_joule", R_s=4e-4), balances(surface=column(U.I2 * 4e-4)))
    same(rates("busbar_joule", R_s=4e-4), balances(surface=column(U.I2 * 4e-4) * ends))
    same(rates("neighbour_heat", 2, P=-1.5), balances(surface=np.array([0.0, -1.5, 0.0, 0.0])))


@pytest.mark.parametrize("cell", [1, 3, 4])
def test_one_cell_differs(cell):
    share = np.ones(CELLS)
    share[cell - 1] = 1.3
    same(rates("cell_resistance", cell, a=0.3), balances(heat=column(U.I2 * R_E) * share))
    same(rates("cell_cooling", cell, a=0.3), balances(R_u=R_U * share * np.ones((N, 1))))
    same(rates("cell_conduction", cell, a=0.3), balances(R_c=R_C * share))


@pytest.mark.parametrize("gap", [1, 2])
def test_coolant_bypass_thins_the_stream_after_the_cell(gap):
    C_f = column(VALUES["C_f"] * U.flow)
    C_f[:, gap:] *= 0.8
    same(rates("coolant_bypass", gap, b=0.2), balances(C_f=C_f))


def test_phase_change():
    bell = 800.0 / (1.5 * math.sqrt(2 * math.pi)) * np.exp(-((T_S - 30.0) ** 2) / (2 * 1.5**2))
    same(rates("phase_change", L=800.0, T_m=30.0, w=1.5), balances(C_s=C_S + bell))


def test_latent_heat_is_what_the_surface_takes_to_pass_the_melting():
    T = np.linspace(20.0, 60.0, 4001)
    z = np.column_stack([T, T])
    u = drive(len(T))
    one = Physics(model(1, ("phase_change", None, {"L": 800.0, "T_m": 41.0, "w": 0.7})))
    bare = Physics(model(1))
    slowed = bare.rates(z, u, bare.numbers(), {})[:, 1] / one.rates(z, u, one.numbers(), {})[:, 1]
    assert np.trapezoid(C_S * slowed, T) - C_S * 40.0 == pytest.approx(800.0, rel=1e-6)


def test_offsets_of_the_inputs():
    same(rates("inlet_offset", b=0.7), balances(T_in=U.T_in - 0.7))
    same(rates("current_offset", b=1.5), balances(heat=column((U.I2 - 3.0 * U.I + 2.25) * R_E)))


def test_an_offset_of_the_current_reaches_every_heat():
    # a constant 30 A read as 31.5: entropic and charge-transfer heat are those of 30 A
    def heats(amps, *more):
        effects = (("entropic_heat", None, values("entropic_heat", dUdT=2e-4)),)
        effects += (("charge_transfer", None, {"I_0": 10.0, "E": 0.0}),)
        effects += (("voltage_heat", None, values("voltage_heat", U=3.4)), *more)
        one = np.full(N, amps)
        u = drive(N, I=one, I2=one * one, I_abs=np.abs(one), IV=one * U.V)
        own = Physics(model(CELLS, *effects))
        return own.rates(X, u, own.numbers(), {})

    for amps in (30.0, -30.0, 1.0, 0.0):
        same(heats(amps + 1.5, ("current_offset", None, {"b": 1.5})), heats(amps))


def test_the_voltages_heat_replaces_the_resistance_and_nothing_else():
    pair = (("entropic_heat", None, values("entropic_heat", dUdT=2e-4)), ("voltage_heat", None, values("voltage_heat")))
    one, other = Physics(model(CELLS, *pair)), Physics(model(CELLS, *pair[::-1]))
    same(one.rates(X, U, one.numbers(), {}), other.rates(X, U, other.numbers(), {}))


def test_readings_of_single_thermocouples():
    T_f, _ = stream(U.T_in)
    expected = T_S.copy()
    expected[:, 2] += 0.8
    same(readings("thermocouple_offset", 3, b=0.8), expected)
    expected = T_S.copy()
    expected[:, 1] = 0.85 * T_S[:, 1] + 0.15 * T_f[:, 1]
    same(readings("thermocouple_contact", 2, g=0.15), expected)
    same(rates("thermocouple_offset", 3, b=0.8), balances())
    same(rates("thermocouple_contact", 2, g=0.15), balances())
