"""A measured 26650 cell: surface, ambient and current (and voltage) in, its core thermocouple only to judge.

The core is computed here, by a small Kalman filter of the test's own, for samples of the posterior: what an observer
that takes the posterior at its word would show.
"""

import numpy as np
import pytest

from bms_gateway.identify import VoltageTracker, WindowIdentifier, string_parameters
from bms_gateway.thermal import Prior, StringModel, continuous, discretize
from tests.data import need
from tests.identify.drive import ticks


def load():
    """Per second means by the trapezoid over the raw stamps; the file counts charging as positive."""
    d = np.genfromtxt(need("core_surface", "a123_26650_hev2.csv"), delimiter=",", names=True)
    r = np.genfromtxt(need("core_surface", "a123_26650_hev2_raw_current.csv"), delimiter=",", names=True)
    t, current, voltage = r["t_s"], -r["I_A"], r["V_V"]

    def mean(x):
        total = np.concatenate([[0], np.cumsum((x[1:] + x[:-1]) / 2 * np.diff(t))])
        return np.diff(np.interp(d["t_s"], t, total))

    return d, mean(current), mean(current**2), mean(voltage), mean(current * voltage)


def single(R_c, R_u, R_e=(15e-3, 1.0), C_c=(79.0, 0.15), C_s=(5.5, 0.25)):
    priors = {"C_c": C_c, "C_s": C_s, "R_e": R_e, "R_c": R_c, "R_u": R_u}
    return StringModel(1, (1,), "single", {k: Prior(*v) for k, v in priors.items()})


def core_of(p, square, heat, inlet, y):
    """Core and its sd (K,) by a Kalman filter with parameters `p`."""
    d = discretize(continuous(p), 1.0)
    x, P = np.full(2, y[0]), 0.3 * np.eye(2)
    core, sd = np.empty(len(y)), np.empty(len(y))
    core[0], sd[0] = x[0], np.sqrt(P[0, 0])
    for k in range(len(square)):
        q = heat[k] if np.isfinite(heat[k]) else square[k] * p.R_e[0]
        x = d.step(x, np.array([q]), inlet[k], inlet[k + 1])
        P = d.A @ P @ d.A.T + np.diag([0.05**2, 1e-4])
        gain = P[:, 1] / (P[1, 1] + 0.01)
        x, P = x + gain * (y[k + 1] - x[1]), P - np.outer(gain, P[1])
        core[k + 1], sd[k + 1] = x[0], np.sqrt(P[0, 0])
    return core, sd


def judge(model, voltage=False, samples=16):
    """RMSE of the core and share of samples within two sd, each second judged with what was known then."""
    d, I_mean, square, V_mean, IV = load()
    y, inlet, K = d["T_surf_C"], d["T_amb_C"], len(square)
    heat = np.full(K, np.nan)
    if voltage:
        tracker = VoltageTracker(capacity=2.3)
        heat = np.array([tracker.update(*row, 1.0).heat for row in zip(I_mean, V_mean, IV, strict=True)])
    identifier = WindowIdentifier(model)
    known = [(0, identifier.posterior())]
    for k, tick in enumerate(ticks(square, inlet, y[:, None], heat)):
        job = identifier.add(tick)
        if job is not None:
            identifier.accept(job.run())
            known.append((k, identifier.posterior()))
    rng = np.random.default_rng(0)
    core, sd = np.empty(K + 1), np.empty(K + 1)
    for i, (k, post) in enumerate(known):
        part = slice(k, known[i + 1][0] if i + 1 < len(known) else K + 1)
        centre, own = core_of(string_parameters(model, post.names, post.mean), square, heat, inlet, y)
        draws = rng.multivariate_normal(post.mean, post.cov, samples, method="eigh")
        runs = np.array([core_of(string_parameters(model, post.names, z), square, heat, inlet, y)[0] for z in draws])
        core[part] = centre[part]
        sd[part] = np.sqrt(np.mean((runs - centre) ** 2, axis=0) + own**2)[part]
    error = core - d["T_core_C"]
    surface = np.sqrt(np.mean((y - d["T_core_C"]) ** 2))
    print(f"core RMSE {np.sqrt(np.mean(error**2)):.2f} K, inside {np.mean(np.abs(error) < 2 * sd):.3f}, "
          f"sd {sd.mean():.1f} K; core = surface {surface:.1f} K")  # fmt: skip
    return np.sqrt(np.mean(error**2)), np.mean(np.abs(error) < 2 * sd)


@pytest.mark.slow
@pytest.mark.parametrize(("R_c", "R_u"), [((2.0, 0.8), (3.0, 0.8)), ((1.0, 0.6), (2.0, 0.6)), ((4.0, 0.8), (6.0, 0.8))])
def test_wide_priors_keep_a_band_that_holds(R_c, R_u):
    _, inside = judge(single(R_c, R_u))
    assert inside >= 0.9


@pytest.mark.slow
def test_the_authors_figures_as_priors_halve_the_error():
    rmse, inside = judge(single((3.0, 0.2), (4.8, 0.6)))
    assert rmse <= 2.2
    assert inside >= 0.9


def test_heat_from_voltage_finds_the_core():
    rmse, inside = judge(single((3.0, 0.2), (4.8, 0.6)), voltage=True)
    assert rmse <= 0.7
    assert inside >= 0.9
