"""Windows of strings whose R_e changes with the temperature of each core; truth: `tests.truth.pack`."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.identify import Tick, WindowIdentifier
from bms_gateway.identify.carried import Course
from bms_gateway.identify.response import Inputs, Warmth, respond
from bms_gateway.identify.window_means import Means
from bms_gateway.identify.window_warmth import MOST_RATIO, CoresOfRoots, at_readings_of, warmth_of
from bms_gateway.thermal import StringModel, StringParameters, continuous, discretize
from tests.identify.drive import model
from tests.truth.effects import resistance_temperature
from tests.truth.pack import NOMINAL, integrate, terms
from tests.truth.string import C_F, TABLE_1

CELLS, SENSORS, MINUTES = 5, (1, 3, 5), 40
NAMES = ("C_c", "C_s", "R_e", "R_c", "R_u", "R_cc", "C_f")


def made() -> StringModel:
    known = model(CELLS, SENSORS, **{k: NOMINAL[k] for k in NAMES})
    return replace(known, priors={k: replace(p, rel_sd=min(p.rel_sd, 0.1)) for k, p in known.priors.items()})


def learnt(B: float, seed: int) -> tuple[WindowIdentifier, np.ndarray, np.ndarray]:
    """Identifier after windows of a cold start, the currents and the true cores."""
    rng = np.random.default_rng([seed, 4])
    K = 60 * MINUTES
    amps = np.repeat(rng.uniform(-40.0, 70.0, K // 30), 30) * np.repeat(rng.uniform(0.3, 1.3, K // 300), 300)
    inlet = 12.0 + np.interp(np.arange(K + 1), [0, 500, 900, 1500, 2000, K], [0, 0, 14, 14, 4, 4])
    t = terms(CELLS, amps, inlet, np.ones(K), 0.5)
    resistance_temperature(t, B=B)
    trace = integrate([t])[0]
    y = np.full((K + 1, CELLS), np.nan)
    at = [k - 1 for k in SENSORS]
    y[:, at] = trace.surface[:, at] + 0.05 * rng.normal(size=(K + 1, len(at)))
    identifier = WindowIdentifier(made())
    for k in range(K):
        now = Tick(int((k + 1) * 1e9), 1.0, amps[k] ** 2, np.nan, inlet[k + 1], y[k + 1], np.zeros(CELLS), amps[k])
        if (job := identifier.add(now)) is not None:
            identifier.accept(job.run())
    if (job := identifier.finish()) is not None:
        identifier.accept(job.run())
    return identifier, amps, trace.core


@pytest.mark.parametrize(("B", "seed"), [(3500.0, 1), (3500.0, 2), (1500.0, 3), (0.0, 4)])
def test_windows_find_how_resistance_follows_the_core(B, seed):
    identifier, amps, core = learnt(B, seed)
    p = identifier.posterior()
    at, R_e = p.apart.names.index("warmth"), p.apart.names.index("R_e")
    assert abs(p.apart.mean[at] - B / 1000.0) < 0.7  # half the sd of what was known; it draws towards 0
    assert abs(p.apart.mean[at] - B / 1000.0) < 2.0 * np.sqrt(p.apart.cov[at, at])
    # R_e is that of the mean heat of the last window
    u = 1000.0 * (1.0 / (core[-1200:] + 273.15) - 1.0 / 298.15)
    factor = np.exp(B / 1000.0 * u)
    heat = (amps[-1200:] ** 2)[:, None] * np.ones(CELLS)
    true = np.log(NOMINAL["R_e"] * np.sum(heat * factor) / np.sum(heat))
    assert p.apart.warmth == pytest.approx(np.sum(heat * u) / np.sum(heat), abs=0.02)
    assert abs(p.apart.mean[R_e] - true) < 2.5 * np.sqrt(p.apart.cov[R_e, R_e]) + 0.02
    assert p.apart.mean[R_e] == pytest.approx(p.mean[p.names.index("R_e")], abs=0.1)  # but for reversible heat
    constant, at = p.as_constants([(p.apart.warmth, 0.05), (p.apart.warmth + 0.1, 0.0)]), p.names.index("R_e")
    B_2 = p.apart.mean[p.apart.names.index("warmth")] ** 2 + p.apart.cov[-1, -1]
    assert constant.cov[at, at] - p.cov[at, at] == pytest.approx(B_2 * (0.05**2 + 0.1**2) / 2)
    assert not identifier.doubts()


def test_an_identifier_of_a_version_without_it_goes_on_with_what_it_knew():
    identifier, _, _ = learnt(0.0, 4)
    state = identifier.snapshot()
    at = len(state["names"]) - 1
    older = {**state, "names": state["names"][:-1]}
    older["info"] = np.delete(np.delete(np.array(state["info"]), at, 0), at, 1).tolist()
    older["grad"] = np.delete(np.array(state["grad"]), at).tolist()
    k = len(state["entropy"]["mean"]) - 1
    older["entropy"] = {
        "at": state["entropy"]["at"],
        "mean": state["entropy"]["mean"][:k],
        "cov": np.array(state["entropy"]["cov"])[:k, :k].tolist(),
    }
    again = WindowIdentifier(made())
    again.restore(older)
    assert again.windows == identifier.windows
    assert again.posterior().mean.tolist() == identifier.posterior().mean.tolist()
    assert again.posterior().apart is None  # until the next window
    assert again.snapshot()["names"] == state["names"]


def test_the_warmth_of_a_window_is_an_input_of_each_cell():
    """Oracle: step by step, with the R_e of each cell as the warmth says."""
    p, K, B = StringParameters.of(3, **TABLE_1, R_cc=4.0, C_f=C_F), 75, 3.0
    rng = np.random.default_rng(6)
    square, inlet = rng.uniform(0.0, 4e3, K), np.full(K + 1, 25.0)
    w = Warmth(np.linspace(0.1, -0.1, K), np.linspace(0.0, 0.03, K), np.array([-0.7, 0.0, 0.7]))
    u = Inputs(square, np.zeros(K), inlet, 1.0, np.zeros((K, 0)), np.zeros(0), warmth=w, B=B)
    x, d = np.full(6, 25.0), discretize(continuous(p), 1.0)
    seen = [x[1::2]]
    for k in range(K):
        x = d.step(x, square[k] * p.R_e * np.exp(B * (w.mean[k] + w.course[k] * w.profile)), 25.0, 25.0)
        seen.append(x[1::2])
    R = respond([p], u, np.full((1, 6), 25.0), [0, 1, 2], 0.0, B)
    rise = np.array(seen) - 25.0
    assert np.abs(R.surface[0] - 25.0 - rise).max() < 0.003 * rise.max()


@pytest.mark.parametrize("cells", [1, 3])
def test_the_slope_by_B_is_that_of_the_response(cells):
    p, K = StringParameters.of(cells, **TABLE_1, R_cc=4.0, C_f=C_F), 100
    square = np.random.default_rng(7).uniform(0.0, 4e3, K)
    w = Warmth(np.linspace(0.1, -0.2, K), np.linspace(0.0, 0.05, K), np.linspace(-1.0, 1.0, cells))
    u = Inputs(square, np.zeros(K), np.full(K + 1, 25.0), 1.0, np.ones((K, 1)), np.full(1, 0.1), warmth=w, B=2.0)

    def at(B: float, own: float) -> np.ndarray:
        return respond([p], replace(u, B=B), np.full((1, 2 * cells), 25.0), [0], 0.0, own).surface[0]

    by_mean = (at(2.0 + 1e-5, 2.0) - at(2.0 - 1e-5, 2.0)) / 2e-5
    R = respond([p], u, np.full((1, 2 * cells), 25.0), [0], 0.0, 2.0)
    assert np.allclose(R.surface_by_input[:, :, -1], by_mean, atol=1e-6)
    assert np.abs(by_mean).max() > 0.01


def test_cores_follow_the_readings():
    """Oracle: two cells at rest with another heat; surfaces and cores rise by q R_u and q (R_c + R_u)."""
    p = StringParameters.of(2, C_c=268.0, C_s=18.8, R_e=3.5e-3, R_c=1.2, R_u=0.8)
    K, q, other = 80, 10.0, 7.0
    y = np.full((K, 2), np.nan)
    y[:, 0] = 25.0 + q * 0.8
    y[10:30, 0] = np.nan
    means = Means.of(y, np.zeros((K, 2)), [0], 1.0)
    simulated = np.full((len(means.y), 1), 25.0 + other * 0.8)
    core = at_readings_of(means, simulated, np.full((10, 2), 25.0 + other * 2.0), p, 8.0)
    assert np.allclose(core, 25.0 + q * 2.0)
    nothing = Means.of(np.full((K, 2), np.nan), np.zeros((K, 2)), [0], 1.0)
    assert at_readings_of(nothing, simulated, core, p, 8.0) is core


def test_cells_that_warm_along_the_coolant_are_one_pattern():
    K = 160
    course = Course.of(np.full(K, 900.0), np.zeros(K), np.full(K, 30.0), np.full(K + 1, 20.0), 1.0, 8.0)
    core = (
        25.0 + np.outer(np.linspace(0.0, 20.0, K // 8), np.ones(6)) + np.outer(np.linspace(0.0, 1.0, K // 8), range(6))
    )
    w, mean, swing = warmth_of(core, course)
    u = 1000.0 * (1.0 / (core + 273.15) - 1.0 / 298.15)
    told = (w.mean[:, None] + np.outer(w.course, w.profile))[::8]
    assert np.abs(told - u).max() < 1e-3
    assert (mean, swing) == pytest.approx((u.mean(), u.mean(axis=1).std()))
    rest = Course.of(np.zeros(K), np.zeros(K), np.zeros(K), np.full(K + 1, 20.0), 1.0, 8.0)
    assert warmth_of(core, rest)[1:] == (0.0, 0.0)
    cooled = replace(course, square=np.where(np.arange(K // 8) < 4, -50.0, course.square))  # by effects of its model
    assert warmth_of(core, cooled)[1] == pytest.approx(u[4:].mean())


def test_the_other_root_has_its_own_cores():
    """What evidence says of R_e and B holds at the cores of the better root, and nothing where cores stand still."""
    cores = CoresOfRoots(mean=-0.1, swing=0.04)
    assert cores.known() == (0.0, 1.0)
    cores.seek_other()
    cores.mean, cores.swing = -0.25, 0.08
    assert cores.known() == pytest.approx((-0.15, 2.0))
    cores.keep(other=False)
    assert cores.known() == (0.0, 1.0)
    cores.mean, cores.swing = -0.1, 0.04
    cores.seek_other()
    cores.mean, cores.swing = -0.25, 0.08
    cores.keep(other=True)
    assert cores.known() == pytest.approx((-0.15, 2.0))
    cores.swing = 1e-9
    cores.seek_other()
    cores.swing = 0.05
    assert cores.known()[1] == MOST_RATIO
