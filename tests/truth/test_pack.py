"""The truth of the hidden effects: checked against LSODA on balances written out anew, cell by cell.

Nothing here uses the terms or the right-hand side of `pack.py`: what the two share is the table of equations.
"""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.truth import hidden
from tests.truth.cycle import repeated
from tests.truth.drives import CYCLES, FLOWS, INLETS, make_drive
from tests.truth.effects import CATALOGUE, KNOTS, SENSING, lagged, sense
from tests.truth.hidden import Scenario, make_log, make_logs, new_drive
from tests.truth.pack import CAPACITY_AH, NOMINAL, integrate, shells, terms
from tests.truth.sizes import SIZES
from tests.truth.strange import STRANGE, UNKNOWN
from tests.truth.string import TruthString, rk4, wavy_inlet

IDS = """entropic_heat voltage_heat resistance_temperature resistance_soc resistance_asymmetry charge_transfer
hysteresis polarization radial_gradient resistance_drift cooling_drift flow_dependent_cooling natural_convection
ambient_loss core_loss surface_joule busbar_joule end_plate coolant_delay coolant_bypass cell_resistance cell_cooling
cell_conduction neighbour_heat phase_change thermocouple_lag thermocouple_offset thermocouple_contact
inlet_offset current_offset"""

N, K, SOC_0 = 3, 150, 0.6


def short_drive():
    """A charge, a rest and discharges of 10 s, an inlet that moves and a flow that steps."""
    current = np.repeat(
        [-60.0, 0.0, 90.0, 30.0, -110.0, -20.0, 0.0, 140.0, 10.0, -80.0, 70.0, 0.0, -40.0, 100.0, 50.0], 10
    )
    return current, wavy_inlet(K, amplitude=6.0, period=90.0), np.repeat([1.0, 0.7, 1.3], 50)


class Written:
    """The balances of three cells as the table of effects states them, with all states in one vector."""

    def __init__(self, p):
        self.p, (self.current, self.inlet, self.flow) = p, short_drive()
        self.rings = 64 if "phi" in p else 1
        moved = np.concatenate([[0.0], np.cumsum(self.current)]) / 3600 / CAPACITY_AH
        self.soc = SOC_0 - moved

    def factor(self, k, t):
        p, soc, h = self.p, np.interp(t, np.arange(K + 1.0), self.soc), t / 3600
        u = 1 - 2 * soc
        f = (1 + p.get("s1", 0) * u + p.get("s2", 0) * u * u) * (1 + p.get("r_drift", 0) * h)
        if "swing" in p:
            s = sum(math.sin(2 * math.pi * t / P + a) for P, a in zip(p["periods"], p["phases"], strict=True))
            f *= math.exp(p["swing"] * s / math.sqrt(len(p["periods"]) / 2))
        if self.current[k] < 0:
            f *= 1 + p.get("asymmetry", 0)
        return f

    def heat(self, k, t, T_c, V_1, q, cell):
        p, I = self.p, self.current[k]  # noqa: E741
        T = T_c + 273.15
        R = NOMINAL["R_e"] * self.factor(k, t) * math.exp(p.get("B", 0) * (1 / T - 1 / 298.15))
        R *= 1 + p.get("r_cell", {}).get(cell, 0)
        Q = I * I * R
        if "dU_dT" in p:
            soc = np.interp(t, np.arange(K + 1.0), self.soc)
            Q -= I * T * 1e-3 * (np.interp(soc, KNOTS, p["dU_dT"]) if np.size(p["dU_dT"]) > 1 else p["dU_dT"])
        if "I_0" in p:
            I_0 = p["I_0"] * math.exp(-p["E"] * (1 / T - 1 / 298.15))
            Q += abs(I) * 2 * 8.314462618 * T / 96485.33212 * math.asinh(abs(I) / (2 * I_0))
        if "hysteresis" in p:
            Q += abs(I) * p["hysteresis"] * (1 - math.exp(-q / p["Ah"]))
        if "R_1" in p:
            Q += V_1**2 / p["R_1"]
        Q += p.get("core_P", {}).get(cell, 0) - p.get("core_G", {}).get(cell, 0) * (T_c - 25.0)
        return Q

    def rates(self, t, x, k):
        p, I, r = self.p, self.current[k], self.rings  # noqa: E741
        V_1, q = x[0], x[1]
        T = x[2 : 2 + N * r].reshape(N, r)
        T_s = x[2 + N * r :]
        dT, dT_s = np.zeros((N, r)), np.zeros(N)
        stream = np.interp(t - p.get("delay", 0.0), np.arange(K + 1.0), self.inlet)
        flow, h = self.flow[k], t / 3600
        for c in range(N):
            R_c = NOMINAL["R_c"] * (1 + p.get("c_cell", {}).get(c, 0))
            if r == 1:
                out = (T[c, 0] - T_s[c]) / R_c
                dT[c, 0] = (self.heat(k, t, T[c, 0], V_1, q, c) - out) / NOMINAL["C_c"]
            else:
                out = self.shells(T[c], dT[c], T_s[c], R_c, self.heat(k, t, T[c] @ self.volumes(), V_1, q, c))
            R_u = NOMINAL["R_u"] * (1 + p.get("u_cell", {}).get(c, 0)) * (1 + p.get("u_drift", 0) * h)
            R_u *= flow ** -p.get("flow_n", 0)
            gap = T_s[c] - stream
            film = gap / R_u * abs(gap / 5) ** p.get("film_n", 0) if gap else 0.0
            net = out - film + p.get("casing", {}).get(c, 0) + p.get("R_s", {}).get(c, 0) * I * I
            net -= p.get("G", {}).get(c, 0) * (T_s[c] - 25.0)
            net += sum((T_s[j] - T_s[c]) / NOMINAL["R_cc"] for j in (c - 1, c + 1) if 0 <= j < N)
            C_s = NOMINAL["C_s"]
            if "L" in p:
                C_s += p["L"] * math.exp(-0.5 * ((T_s[c] - p["T_m"]) / p["w"]) ** 2) / (p["w"] * math.sqrt(2 * math.pi))
            dT_s[c] = net / C_s
            left = 1 - p.get("bypass", 0) * (c >= p.get("after", N))
            stream += film / (NOMINAL["C_f"] * flow * left)
        dV = (I * p["R_1"] - V_1) / p["tau"] if "R_1" in p else 0.0
        return np.concatenate([[dV, abs(I) / 3600], dT.ravel(), dT_s])

    def volumes(self):
        e = np.arange(self.rings + 1) / self.rings
        return e[1:] ** 2 - e[:-1] ** 2

    def shells(self, T, dT, T_s, R_c, Q):
        """Heat through a cylinder shell by shell; a gap between middles a, b conducts 2 π k L / ln(b/a)."""
        r, phi = self.rings, self.p["phi"]
        k = 1 / (4 * phi * R_c)  # 2 π k L, from mean-to-edge 1/(8 π k L) = φ R_c
        flows = [k / math.log((i + 1.5) / (i + 0.5)) * (T[i] - T[i + 1]) for i in range(r - 1)]
        flows.append((T[-1] - T_s) / (math.log(r / (r - 0.5)) / k + (1 - phi) * R_c))
        v = self.volumes()
        for i in range(r):
            into = flows[i - 1] if i else 0.0
            dT[i] = (Q * v[i] + into - flows[i]) / (NOMINAL["C_c"] * v[i])
        return flows[-1]

    def solve(self):
        """Core and surface at the instants (K + 1, N); restarted at every second, where current and flow may jump."""
        r = self.rings
        x = np.concatenate([[0.0, 0.0], np.full(N * r + N, self.inlet[0])])
        direction, core, surface = 0.0, [], []
        for k in range(K + 1):
            core.append([x[2 + c * r : 2 + (c + 1) * r] @ self.volumes() for c in range(N)])
            surface.append(x[2 + N * r :])
            if k == K:
                break
            if self.current[k] * direction < 0:
                x[1] = 0.0
            direction = np.sign(self.current[k]) or direction
            x = solve_ivp(self.rates, (k, k + 1), x, "LSODA", args=(k,), rtol=1e-7, atol=1e-8).y[:, -1]
        return np.array(core), np.array(surface)


PERIODS, PHASES = np.array([60.0, 95.0]), np.array([0.3, 2.0])


def each(value):
    """The same at all cells."""
    return dict.fromkeys(range(N), value)


CASES = {
    "entropic_heat": ({"dUdT": [-0.4, 0.9, 0.3, -0.2]}, {"dU_dT": [-0.4, 0.9, 0.3, -0.2]}),
    "voltage_heat": (
        {"swing": 0.5, "periods": PERIODS, "phases": PHASES},
        {"swing": 0.5, "periods": PERIODS, "phases": PHASES},
    ),
    "resistance_temperature": ({"B": 4000.0}, {"B": 4000.0}),
    "resistance_soc": ({"s_1": 0.8, "s_2": 0.4}, {"s1": 0.8, "s2": 0.4}),
    "resistance_asymmetry": ({"a": 0.7}, {"asymmetry": 0.7}),
    "charge_transfer": ({"I_0": 8.0, "E": 6000.0}, {"I_0": 8.0, "E": 6000.0}),
    "hysteresis": ({"V": 0.08, "Q": 0.15}, {"hysteresis": 0.08, "Ah": 0.15}),
    "polarization": ({"R_1": 3e-3, "tau": 25.0}, {"R_1": 3e-3, "tau": 25.0}),
    "radial_gradient": ({"phi": 0.7}, {"phi": 0.7}),
    "resistance_drift": ({"a": 5.0}, {"r_drift": 5.0}),
    "cooling_drift": ({"a": 5.0}, {"u_drift": 5.0}),
    "flow_dependent_cooling": ({"n": 0.7}, {"flow_n": 0.7}),
    "natural_convection": ({"n": 0.3}, {"film_n": 0.3}),
    "ambient_loss": ({"G": 0.5, "P": 2.0}, {"G": each(0.5), "casing": each(2.0)}),
    "core_loss": ({"G": 0.5, "P": 2.0}, {"core_G": each(0.5), "core_P": each(2.0)}),
    "surface_joule": ({"R_s": 6e-4}, {"R_s": each(6e-4)}),
    "busbar_joule": ({"R_s": 9e-4}, {"R_s": {0: 9e-4, 2: 9e-4}}),
    "end_plate": ({"G": 0.5, "P": -2.0}, {"G": {0: 0.5, 2: 0.5}, "casing": {0: -2.0, 2: -2.0}}),
    "coolant_bypass": ({"b": 0.5, "cell": 1}, {"bypass": 0.5, "after": 1}),
    "cell_resistance": ({"a": 0.6, "cell": 2}, {"r_cell": {1: 0.6}}),
    "cell_cooling": ({"a": 0.6, "cell": 3}, {"u_cell": {2: 0.6}}),
    "cell_conduction": ({"a": 1.5, "cell": 1}, {"c_cell": {0: 1.5}}),
    "neighbour_heat": ({"P": 2.5, "cell": 2}, {"casing": {1: 2.5}}),
    "phase_change": ({"L": 900.0, "T_m": 27.0, "w": 0.7}, {"L": 900.0, "T_m": 27.0, "w": 0.7}),
}
"""Effect: as `effects.py` takes it, as the balances above take it."""


def traced(name=None, parameters=None, **more):
    current, inlet, flow = short_drive()
    t = terms(N, current, inlet, flow, SOC_0, **more)
    if name:
        CATALOGUE[name](t, **parameters)
    return integrate([t])[0]


@pytest.mark.parametrize("name", CASES)
def test_each_effect_agrees_with_lsoda_on_balances_written_out_anew(name):
    ours, written = CASES[name]
    got, plain = traced(name, ours), traced()
    core, surface = Written(written).solve()
    felt = max(np.abs(got.core - plain.core).max(), np.abs(got.surface - plain.surface).max())
    assert felt > 0.05  # the effect does something here, so that agreement means something
    assert np.abs(got.core - core).max() < 0.01
    assert np.abs(got.surface - surface).max() < 0.01


def test_a_delayed_inlet_is_a_plug_and_a_lag_with_that_mean_delay():
    current, _, flow = short_drive()
    step = np.where(np.arange(K + 1) < 20, 20.0, 30.0)
    t = terms(N, current, step, flow, SOC_0)
    CATALOGUE["coolant_delay"](t, tau=15.0)
    assert t.inlet[:29] == pytest.approx(20.0)  # nothing before the plug of 9.75 s has passed
    assert t.inlet[-1] == pytest.approx(30.0)
    assert np.sum(step - t.inlet) / 10.0 == pytest.approx(15.0, abs=0.1)


def test_a_lagged_reading_solves_its_equation():
    x = np.cumsum(np.random.default_rng(0).normal(size=(120, 2)), axis=0)
    y = lagged(x, 7.0)
    for c in range(2):
        fine = solve_ivp(
            lambda t, z, c=c: (np.interp(t, np.arange(120), x[:, c]) - z) / 7.0,
            (0, 119), x[0, c : c + 1], t_eval=np.arange(120.0), max_step=0.25, rtol=1e-8, atol=1e-9,
        )  # fmt: skip
        assert np.abs(fine.y[0] - y[:, c]).max() < 1e-3


def test_wrong_readings_are_wrong_as_said():
    current, inlet, _ = short_drive()
    t = traced()

    def read(**effects):
        return sense(t.surface, t.coolant, inlet, current, effects)

    y, T_in, amps = read(thermocouple_offset={"b": 0.7, "cell": 2}, inlet_offset={"b": -1.0}, current_offset={"b": 2.0})
    assert np.allclose(y - t.surface, [0.0, 0.7, 0.0])
    assert np.allclose(T_in - inlet, -1.0)
    assert np.allclose(amps - current, 2.0)
    y = read(thermocouple_contact={"g": 0.25, "cell": 3})[0]
    assert np.allclose(y[:, 2], 0.75 * t.surface[:, 2] + 0.25 * t.coolant[:, 2])
    assert np.array_equal(y[:, :2], t.surface[:, :2])


def test_without_effects_it_is_the_string_of_the_other_truth():
    current, inlet = repeated(20), wavy_inlet(1200)
    for coolant in ("bulk", "ntu"):
        t = terms(5, current, inlet, np.ones(1200), SOC_0, coolant=coolant)
        other = TruthString.of(5, R_cc=NOMINAL["R_cc"], C_f=NOMINAL["C_f"], coolant=coolant)
        got, (core, surface) = integrate([t])[0], rk4(other, current, inlet, inlet[0])
        assert np.abs(got.core - core).max() < 1e-3
        assert np.abs(got.surface - surface).max() < 5e-3


def test_all_heat_is_stored_or_leaves_with_the_stream():
    current, inlet, flow = short_drive()
    for rings in (1, 24):
        t = terms(4, current, inlet, flow, SOC_0)
        t.rings, t.share = rings, 0.6
        got = integrate([t])[0]
        made = 4 * NOMINAL["R_e"] * np.sum(current**2)
        stored = 268.0 * (got.core[-1] - got.core[0]).sum() + 18.8 * (got.surface[-1] - got.surface[0]).sum()
        film = (got.surface - got.coolant) / NOMINAL["R_u"]
        assert made == pytest.approx(stored + film.sum(axis=1)[1:-1].sum() + film[[0, -1]].sum() / 2, rel=2e-3)


def test_the_cylinder_has_the_profile_of_the_textbook():
    # Uniform heat q in a solid cylinder: T(r) − T(edge) = q/(4 π k L) (1 − r²), mean half of the centre's.
    share, q, R_c = 0.7, 20.0, NOMINAL["R_c"]
    t = terms(1, np.full(3600, np.sqrt(q / NOMINAL["R_e"])), np.full(3601, 20.0), np.ones(3600), SOC_0)
    t.rings, t.share = 24, share
    got = integrate([t])[0]
    assert got.surface[-1, 0] == pytest.approx(20.0 + q * NOMINAL["R_u"], abs=0.1)
    assert got.core[-1, 0] - got.surface[-1, 0] == pytest.approx(q * R_c, rel=5e-3)
    w, inner, outer = shells(24, share)
    profile = np.concatenate([np.cumsum((np.cumsum(w)[:-1] / inner)[::-1])[::-1], [0.0]]) + 1 / outer
    middle = (np.arange(24) + 0.5) / 24
    assert np.allclose(profile, 2 * share * (1 - middle**2) + 1 - share, atol=1e-9)


def test_every_id_of_the_catalogue_can_be_hidden():
    assert sorted(IDS.split()) == sorted([*CATALOGUE, *SENSING]) == sorted(SIZES)
    assert set(CASES) | {"coolant_delay"} == set(CATALOGUE)
    assert len(UNKNOWN) >= 8
    assert not set(UNKNOWN) & set(SIZES)
    for scenarios in ([Scenario({i: ("strong", None)}, seconds=120, seed=3) for i in (*IDS.split(), *UNKNOWN)],):
        for log in make_logs(scenarios):
            (name,) = log.scenario.effects
            assert name in UNKNOWN or log.parameters[name]
            assert all(np.isfinite(x).all() for x in log.table.values()), name


@pytest.mark.parametrize("name", STRANGE)
def test_effects_in_no_catalogue_are_felt(name):
    plain, strange = make_logs([Scenario(cells=4, sensors=(1, 4)), Scenario({name: ("strong", None)}, 4, (1, 4))])
    assert np.sqrt(np.mean((plain.surface - strange.surface) ** 2)) > 0.1


def test_a_log_is_the_same_in_any_company_and_again():
    one = Scenario({"charge_transfer": ("medium", None)}, seconds=200, jitter=0.3, missing=0.1, step=0.5, noise=0.3)
    alone = make_log(one)
    others = [Scenario({i: ("medium", None)}, seconds=200, seed=9) for i in CATALOGUE if i != "radial_gradient"]
    for again in (make_log(one), make_logs([*others[:5], one, *others[5:]])[5]):
        assert all(np.array_equal(alone.table[c], again.table[c], equal_nan=True) for c in alone.table)
        assert np.array_equal(alone.core, again.core)
    assert not np.array_equal(make_log(Scenario(seconds=60, seed=1)).core, make_log(Scenario(seconds=60, seed=2)).core)


def test_a_new_drive_is_of_the_same_pack():
    first = Scenario({"cell_cooling": ("strong", None)}, seconds=300)
    a, b = make_logs([first, new_drive(first, cycle="us06")])
    assert a.parameters == b.parameters
    assert a.cells == b.cells
    assert all(np.array_equal(a.pack[k], b.pack[k]) for k in a.pack)
    assert not np.array_equal(a.table["current_A"], b.table["current_A"])
    assert not np.array_equal(a.table["coolant_inlet_C"], b.table["coolant_inlet_C"])


@pytest.mark.parametrize("cycle", CYCLES)
def test_drives_keep_the_charge_and_the_current_within_limits(cycle):
    for seed in range(6):
        d = make_drive(cycle, INLETS[seed % 4], FLOWS[seed % 2], seed=seed)
        soc = d.soc_0 - np.concatenate([[0.0], np.cumsum(d.current)]) / 3600 / CAPACITY_AH
        assert soc.min() > 0.1
        assert soc.max() < 0.95
        assert np.abs(d.current).max() < 175
        assert 30 < np.sqrt(np.mean(d.current**2)) < 70
        assert len(d.inlet) == len(d.current) + 1 == len(d.flow) + 1
        assert 5 < d.inlet.min() < d.inlet.max() + 1e-9 < 40
        assert 0.55 < d.flow.min() <= d.flow.max() < 1.45


def test_jittered_stamps_carry_the_same_charge_and_heat():
    log = make_log(Scenario(seconds=600, jitter=0.3, cycle="us06"))
    stamps = log.table["time_s"]
    assert 0.05 < np.abs(stamps - np.round(stamps)).mean() < 0.3
    assert (np.diff(stamps) > 0.35).all()
    rows = make_drive("us06", seconds=600).current
    mean = hidden.means_between(stamps, rows)[1]
    held = np.diff(np.append(stamps, 600.0))
    assert mean.sum() == pytest.approx(np.sum(rows**2 * held), rel=1e-12)


def test_voltage_energy_is_the_irreversible_heat():
    # I (U − V) summed is the Joule heat plus what the RC pair stores; entropic heat is not in it.
    for name, value in (("resistance_temperature", {"B": 3000.0}), ("resistance_asymmetry", {"a": 0.5})):
        current, inlet, flow = short_drive()
        t = terms(N, current, inlet, flow, SOC_0)
        CATALOGUE[name](t, **value)
        got = integrate([t])[0]
        stored = 268.0 * (got.core[-1] - got.core[0])
        made = stored + np.sum((got.core[1:] + got.core[:-1] - got.surface[1:] - got.surface[:-1]) / 2, axis=0) / 1.266
        assert np.mean(made) == pytest.approx(np.sum(current * got.overpotential), rel=5e-3)


def test_a_file_has_the_contracts_columns(tmp_path):
    log = make_log(Scenario(seconds=90, missing=0.2, step=0.1, columns=("flow", "soc", "voltage")))
    head, *rows = log.write_csv(tmp_path / "log.csv").read_text().splitlines()
    names = "time_s,current_A,coolant_inlet_C,voltage_V,soc,coolant_flow_m3_s,surface_1_C,surface_3_C,surface_5_C"
    assert head == names
    assert len(rows) == 90
    blanks = sum(row.split(",")[2:].count("") for row in rows)
    assert 0.1 < blanks / (90 * 7) < 0.3
    assert all(row.split(",")[1] for row in rows)
    assert "sensors = [1, 3, 5]" in log.model
