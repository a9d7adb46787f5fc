"""R_e of warm cores: the live band holds that a model file without it may lack how R_e changes with the core."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bms_gateway.errors import StateError
from bms_gateway.observe.adaptive import AdaptiveObserver
from bms_gateway.observe.ahead import CORE, PATH_S
from bms_gateway.observe.estimate import Estimate
from bms_gateway.observe.forecast_start import Coming, Profile
from bms_gateway.observe.outlook import Outlook
from bms_gateway.observe.sensitivity import PARAMETERS, displaced
from bms_gateway.thermal import Prior, StringModel
from bms_gateway.thermal.effects import effect_named
from bms_gateway.thermal.warmth import LEAST_B, MOST_B, WARMTH_SD

C_c, C_s, R_e, R_c, R_u = 268.0, 18.8, 3.5e-3, 1.266, 0.79
AMPS, STEPS = 50.0, 1500


def observer() -> AdaptiveObserver:
    known = {"C_c": C_c, "C_s": C_s, "R_e": R_e, "R_c": R_c, "R_u": R_u}
    o = AdaptiveObserver([StringModel(1, (1,), "single", {k: Prior(v, 0.01) for k, v in known.items()})], 1.0)
    o.consider_warmth(WARMTH_SD)
    return o


def truth(B: float, inlet: float) -> tuple[np.ndarray, np.ndarray]:
    """Core and surface of a cell whose R_e falls by Arrhenius' law, B in kelvin, by scipy."""

    def rates(_: float, T: np.ndarray) -> list[float]:
        q = AMPS**2 * R_e * np.exp(B * (1.0 / (T[0] + 273.15) - 1.0 / 298.15))
        return [(q - (T[0] - T[1]) / R_c) / C_c, ((T[0] - T[1]) / R_c - (T[1] - inlet) / R_u) / C_s]

    at = np.arange(float(STEPS))
    core, surface = solve_ivp(rates, (0.0, at[-1]), [inlet, inlet], t_eval=at, rtol=1e-8, atol=1e-8).y
    return core, surface


def follow(o: AdaptiveObserver, surface: np.ndarray, inlet: float, start: int = 1, stop: int = STEPS) -> list[Estimate]:
    rng = np.random.default_rng(5)
    noise = 0.05 * rng.normal(size=STEPS)
    return [
        o.step(np.full(1, AMPS**2), None, np.full(1, inlet), np.array([[surface[k] + noise[k]]]), np.zeros((1, 1)))
        for k in range(start, stop)
    ]


@pytest.mark.parametrize("B", [-1800.0, 1800.0, 2500.0])
def test_the_core_is_in_its_band_though_its_resistance_changes_with_its_warmth(B: float) -> None:
    core, surface = truth(B, 25.0)
    found = follow(observer(), surface, 25.0)
    late = slice(300, None)
    mean, sd = (np.array([getattr(e, k)[0, 0] for e in found])[late] for k in ("core", "core_sd"))
    assert (np.abs(mean - core[1:][late]) < 2.0 * sd).all()
    assert np.sqrt(np.mean(sd**2)) < 5.0


def test_it_is_known_as_badly_as_the_effect() -> None:
    (B,) = effect_named("resistance_temperature").parameters
    assert B.sd / 1000.0 == WARMTH_SD
    assert (B.lower / 1000.0, B.upper / 1000.0) == (LEAST_B, MOST_B)


def test_at_25_degrees_the_warmth_moves_no_core() -> None:
    o = observer()
    follow(o, truth(0.0, 25.0)[1], 25.0)
    J = o.standing().J[0, 0]
    of_R_e, of_warmth = J[PARAMETERS.index("R_e")], J[PARAMETERS.index("warmth")]
    cold = observer()
    for _ in range(50):
        cold.step(np.full(1, 1.0), None, np.full(1, 25.0), np.array([[25.0]]), np.zeros((1, 1)))
    assert abs(cold.standing().J[0, 0, PARAMETERS.index("warmth")]) < 1e-4
    assert of_R_e > 0.0 > of_warmth


def test_what_was_identified_in_a_warm_cell_holds_at_that_warmth() -> None:
    """Oracle: the cell itself, with R_e known at the warmth at which it runs, whatever B is."""
    o, surface = observer(), truth(0.0, 45.0)[1]
    follow(o, surface, 45.0, stop=1200)
    at = PARAMETERS.index("warmth")
    before = np.array(o.snapshot()["own"]["J"])[0, 0]  # with the steps that wait
    o.set_parameters(0, {"R_e": R_e}, ["R_e"], np.array([[0.01**2]]))
    s = o.standing()
    assert abs(s.J[0, 0, at]) < 0.05 * abs(before[at])  # the core has not moved since its heat was identified
    core = truth(0.0, 45.0)[0]
    u = 1000.0 * (1.0 / (core[600:1200] + 273.15) - 1.0 / 298.15)
    assert u.min() <= s.u_0[0] <= u.max()
    assert s.J[0, 0, at] == pytest.approx(before[at] - s.u_0[0] * before[PARAMETERS.index("R_e")], rel=1e-9)
    wide = o.estimate().core_sd[0, 0]
    follow(o, surface, 45.0, 1200, 1450)
    assert o.estimate().core_sd[0, 0] < 1.2 * wide  # and goes on to hold there


def test_a_number_that_is_no_resistance_leaves_the_warmth_at_which_it_is_known() -> None:
    o = observer()
    follow(o, truth(0.0, 45.0)[1], 45.0, stop=300)
    o.set_parameters(0, {"R_c": R_c}, ["R_c"], np.array([[0.01**2]]))
    assert o.standing().u_0[0] == 0.0


def test_where_no_heat_is_felt_a_resistance_stays_known_where_it_was() -> None:
    o = observer()
    for _ in range(50):
        o.step(np.zeros(1), None, np.full(1, 45.0), np.array([[45.0]]), np.zeros((1, 1)))
    o.set_parameters(0, {"R_e": R_e}, ["R_e"], np.array([[0.01**2]]))
    assert o.standing().u_0[0] == 0.0


def test_a_state_of_a_version_without_it_is_taken_up_with_the_prior() -> None:
    surface = truth(1800.0, 25.0)[1]
    a, b = observer(), observer()
    follow(a, surface, 25.0, stop=200)
    stored = json.loads(json.dumps(a.snapshot()))
    k = len(PARAMETERS) - 1
    del stored["own"]["u_0"]
    stored["own"]["cov"] = np.array(stored["own"]["cov"])[:, :k, :k].tolist()
    for part in (stored["own"], stored["block"]):
        part["J"] = np.array(part["J"])[:, :, :k].tolist()
    b.restore(stored)
    assert b.estimate().core[0, 0] == a.estimate().core[0, 0]
    x, y = follow(a, surface, 25.0, 200)[-1], follow(b, surface, 25.0, 200)[-1]
    assert x.core[0, 0] == y.core[0, 0]
    assert y.core_sd[0, 0] == pytest.approx(x.core_sd[0, 0], rel=0.02)


def test_a_state_with_numbers_that_no_version_had_is_refused() -> None:
    o = observer()
    stored = json.loads(json.dumps(o.snapshot()))
    k = len(PARAMETERS) - 2
    stored["own"]["cov"] = np.array(stored["own"]["cov"])[:, :k, :k].tolist()
    with pytest.raises(StateError):
        observer().restore(stored)


def test_a_state_whose_warmth_is_no_number_is_refused() -> None:
    stored = json.loads(json.dumps(observer().snapshot()))
    stored["own"]["u_0"] = [None]
    with pytest.raises(StateError):
        observer().restore(stored)


def test_a_resistance_that_is_told_to_follow_its_core_does_so() -> None:
    """Oracle: scipy. A warm inlet after minute ten moves the core to where R_e is another."""
    o, B, u_1 = observer(), 3.0, -0.1
    core, surface = truth(1000.0 * B, 25.0)
    told = {"R_e": R_e * np.exp(B * u_1), "warmth": B, "u_0": u_1}
    o.set_parameters(0, told, ["R_e", "warmth"], np.diag([0.01**2, 0.2**2]))
    found = follow(o, surface, 25.0)
    mean, sd = (np.array([getattr(e, k)[0, 0] for e in found])[300:] for k in ("core", "core_sd"))
    assert np.abs(mean - core[301:]).max() < 0.5
    assert sd.max() < 2.0
    s = o.standing()
    assert (s.B[0], s.u_0[0]) == (B, u_1)
    u = 1000.0 * (1.0 / (core[-1] + 273.15) - 1.0 / 298.15)
    assert o.by_warmth()[0] == pytest.approx(np.exp(B * (u - u_1)), rel=0.02)
    again = observer()
    again.restore(json.loads(json.dumps(o.snapshot())))
    assert again.standing().B[0] == B


def test_another_resistance_moves_the_state_to_where_it_would_be() -> None:
    """Oracle: the observer that had it from the start; without readings, the state is linear in the heat."""
    o, other = observer(), observer()
    other.set_parameters(0, {"R_e": 0.4 * R_e}, ["R_e"], np.array([[0.01**2]]))
    nothing = np.array([[np.nan]])
    for x in (o, other):
        for _ in range(700):
            x.step(np.full(1, AMPS**2), None, np.full(1, 25.0), nothing, np.zeros((1, 1)))
    o.set_parameters(0, {"R_e": 0.4 * R_e}, ["R_e"], np.array([[0.01**2]]))
    a, b = o.estimate(), other.estimate()
    assert a.core[0, 0] == pytest.approx(b.core[0, 0], abs=0.03)
    assert a.surface[0, 0] == pytest.approx(b.surface[0, 0], abs=0.03)


def test_a_B_that_is_found_moves_the_core_by_the_heat_that_it_has_had() -> None:
    """Oracle: a core that has long been at 45 °C; with B its heat has been exp(B u) times as large."""
    B, u = 2.0, 1000.0 * (1.0 / (45.0 + 273.15) - 1.0 / 298.15)
    J, moved = np.zeros((4, len(PARAMETERS))), np.zeros(len(PARAMETERS))
    by_R_e = np.array([20.0, 8.0, 0.0, 0.0])
    J[:, PARAMETERS.index("R_e")], J[:, PARAMETERS.index("warmth")] = by_R_e, u * by_R_e
    J[2, PARAMETERS.index("warmth")] = 1e-5
    moved[PARAMETERS.index("warmth")], moved[PARAMETERS.index("R_c")] = B, 0.1
    J[0, PARAMETERS.index("R_c")] = 12.0
    assert displaced(J, moved) == pytest.approx(by_R_e * np.expm1(B * u) + np.array([1.2, 0.0, 2e-5, 0.0]))


def test_a_forecast_follows_the_resistance_of_its_cores() -> None:
    """Oracle: the cell itself, which warms by six kelvin in these ten minutes while its R_e falls by a fifth."""
    B, now = 3.0, 150
    o, (core, surface) = observer(), truth(1000.0 * B, 25.0)
    o.set_parameters(0, {"R_e": R_e, "warmth": B, "u_0": 0.0}, ["R_e", "warmth"], np.diag([0.01**2, 0.2**2]))
    follow(o, surface, 25.0, stop=now)
    none, s = np.zeros((1, 1)), o.standing()
    plain = Coming(np.full(1, np.nan), np.zeros((4, 1)), none, none, none, none, none, np.full(1, AMPS))
    held = np.full((60, 1), AMPS)
    profile = Profile(held, held**2, np.full((60, 1), 25.0))
    T = Outlook().under(s, plain, profile).under(np.zeros(1))[CORE][:, 0, 0]
    true = core[now - 1 + PATH_S.astype(int)]
    at_first = s.x[0, 0]
    assert true[-1] - at_first > 6.0
    assert np.abs(T - true).max() < 0.5
    constant = Outlook().under(replace(s, B=np.zeros(1)), plain, profile).under(np.zeros(1))
    assert constant[CORE][-1, 0, 0] > true[-1] + 1.0
    # a load that is held has the R_e of now: the forecast is too warm, never too cold
    ahead = Outlook().ahead(s, plain).under(np.array([AMPS**2]))[CORE][:, 0, 0]
    assert true[-1] - 0.5 < ahead[-1] < true[-1] + 4.0
