"""Priors of `cells` against more measured cells: resistances by their voltages, time constants by their rests.

Only what the records show without a model of the heat is taken: a fit of one node to a surface finds a heat capacity
that depends on what is assumed of the heat. Resistances are those over minutes: by regression of the voltage over means
of half a minute, by two discharges at different rates, or by pulses of some seconds where there is nothing longer.
"""

import numpy as np
import pytest
from numpy.polynomial import legendre
from scipy.optimize import curve_fit

from bms_gateway.thermal.cells import cell_of
from tests.data import need
from tests.thermal.prior_errors import known_errors, off


def columns(folder: str, file: str) -> dict[str, np.ndarray]:
    """Columns of a record; time, current and voltage as `t`, `I`, `V`, discharge positive and time going forward."""
    path = need(folder, file)
    d = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    t, current, voltage = d.dtype.names[:3]
    keep = np.diff(d[t], prepend=d[t][0] - 1.0) > 0 if "seq" not in d.dtype.names else np.ones(len(d), bool)
    sign = 1.0 if folder == "bench" or file.startswith("dmegc") else -1.0
    found = {"t": d[t][keep], "I": sign * d[current][keep], "V": d[voltage][keep]}
    return found | {name: d[name][keep] for name in d.dtype.names[3:]}


def by_regression(t, I, V) -> float:  # noqa: E741
    """Resistance over half a minute, Ω: means of the voltage on the charge drawn, as a curve, and on the current."""
    charge = np.cumsum(I * np.clip(np.diff(t, prepend=t[0]), 0, 120)) / 3600
    _, which = np.unique((t // 30).astype(int), return_inverse=True)
    V, I, charge = (np.bincount(which, x) / np.bincount(which) for x in (V, I, charge))  # noqa: E741
    s = 2 * (charge - charge.min()) / np.ptp(charge) - 1
    ok = (s > -0.98) & (s < 0.8)  # its open-circuit voltage falls off a cliff at the end
    A = np.column_stack([legendre.legvander(s, 6), -I])[ok]
    return float(np.linalg.lstsq(A, V[ok], rcond=None)[0][-1])


def by_two_rates(one: tuple[str, str], other: tuple[str, str], series: int = 1) -> float:
    """Resistance over a discharge, Ω: the voltages of the first discharges of two records at the same charge drawn."""
    curves = []
    for record in (one, other):
        d = columns(*record)
        on = d["I"] > 0.5 * d["I"].max()
        on &= np.cumsum(np.diff(on.astype(int), prepend=0) == 1) == 1
        charge = np.cumsum(np.where(on, d["I"] * np.diff(d["t"], prepend=d["t"][0]), 0.0))
        curves.append((charge[on], d["V"][on] / series, np.median(d["I"][on])))
    (q1, V1, I1), (q2, V2, I2) = curves
    at = np.linspace(0.15, 1.0, 50) * 0.85 * min(q1.max(), q2.max())
    return float(np.median(np.interp(at, q1, V1) - np.interp(at, q2, V2)) / (I2 - I1))


def by_pulses(t, I, V, seconds: float = 9.0) -> float:  # noqa: E741
    """Resistance of pulses that last that long, Ω."""
    on = np.abs(I) > 0.5 * np.abs(I).max()
    found = []
    for begin in np.flatnonzero(np.diff(on.astype(int)) == 1) + 1:
        end = int(np.searchsorted(t, t[begin] + seconds))
        if end < len(t) and on[begin:end].all():
            found.append((V[begin - 1] - V[end - 1]) / (I[end - 1] - I[begin - 1]))
    return float(np.median(found))


def fall(t, T, at_s: float = 60.0) -> float:
    """Time constant with which a temperature falls to a level of its own, s."""
    keep = (t > at_s) & (t < 5400)
    t, T = t[keep], T[keep]
    return float(curve_fit(lambda u, a, b, tau: a + b * np.exp(-u / tau), t, T, p0=[T[-1], T[0] - T[-1], 800.0])[0][2])


def fall_to(t, T, level: float) -> float:
    """Time constant with which it falls to a known level, s: the rest is too short to show it."""
    keep = t > 60.0
    return float(curve_fit(lambda u, b, tau: level + b * np.exp(-u / tau), t[keep], T[keep], p0=[5.0, 800.0])[0][1])


def resistances() -> dict[str, tuple[str, dict[str, float]]]:
    found = {}
    for run in ("10C_us06", "25C_us06", "25C_la92"):
        d = columns("surface_cells", f"pan18650pf_{run}.csv")
        found[f"18650PF {run}"] = "panasonic_18650pf", {"R_e": by_regression(d["t"], d["I"], d["V"])}
    d = columns("surface_cells", "dmegc_18650_randomwalk_R1.csv")
    runs = [d["seq"] == s for s in np.unique(d["seq"]) if (d["seq"] == s).sum() > 60]
    walk = [by_regression(d["t"][run], d["I"][run], d["V"][run]) for run in runs]
    found["DMEGC random walk"] = "18650 2.6Ah", {"R_e": float(np.median(walk))}
    for what, cell, folder, one, other, series in (
        ("30Q", "samsung_30q", "surface_cells", "s30q_18650_S001_1C.csv", "s30q_18650_S001_4C.csv", 1),
        (
            "40T",
            "samsung_40t",
            "surface_cells",
            "s40t_21700_liquidcooled_1C.csv",
            "s40t_21700_liquidcooled_1.5C.csv",
            1,
        ),
        ("M50", "lg_m50", "bench", "lgm50_rate_1C_T25.csv.gz", "lgm50_rate_2C_T25.csv.gz", 1),
        (
            "Leaf modules",
            "leaf_pouch 2p",
            "bench",
            "leaf_pack_3modules_0_3c.csv.gz",
            "leaf_pack_3modules_2_0c.csv.gz",
            6,
        ),
    ):
        found[what] = cell, {"R_e": by_two_rates((folder, one), (folder, other), series)}
    for what, cell, record in (
        ("K2 pulses", "k2_26650", ("surface_cells", "k2_26650_hppc_20C.csv")),
        ("21700 of 4.5 Ah", "21700 4.5Ah", ("bench", "21700_hppc_heatflux.csv.gz")),
    ):
        d = columns(*record)
        found[what] = cell, {"R_e": by_pulses(d["t"], d["I"], d["V"])}
    return found


def rests() -> dict[str, tuple[str, dict[str, float]]]:
    found = {}
    for run in ("25C_us06", "25C_la92"):
        d = columns("surface_cells", f"pan18650pf_{run}.csv")
        last = np.flatnonzero(np.abs(d["I"]) > 0.1)[-1] + 1
        tau = fall_to(d["t"][last:] - d["t"][last], d["T_surf_C"][last:], 25.0)
        found[f"18650PF {run}"] = "panasonic_18650pf forced", {"tau": tau}
    for run in ("1C", "1.5C"):
        d = columns("surface_cells", f"s40t_21700_liquidcooled_{run}.csv")
        last = np.flatnonzero(np.abs(d["I"]) > 0.1)[-1] + 1
        found[f"40T {run}"] = "samsung_40t liquid", {"tau": fall(d["t"][last:] - d["t"][last], d["T2_C"][last:])}
    d = columns("surface_cells", "k2_26650_hppc_20C.csv")
    still = np.flatnonzero(np.diff(np.concatenate([[0], np.abs(d["I"]) < 0.1, [0]]).astype(int)))
    long = [(a, b) for a, b in zip(still[::2], still[1::2], strict=True) if d["t"][b - 1] - d["t"][a] > 3000]
    above = d["T_surf_C"] - d["T_amb_C"]
    taus = [fall(d["t"][a:b] - d["t"][a], above[a:b]) for a, b in long]
    found["K2 rests"] = "k2_26650 still", {"tau": float(np.median(taus))}
    return found


def test_priors_hold_the_resistances_and_time_constants_of_more_measured_cells() -> None:
    errors = {}
    for kind in (resistances(), rests()):
        for what, (cell, values) in kind.items():
            errors |= {f"{what}: {name}": e for name, e in off(cell_of(cell), values).items()}
    print("\n".join(f"{what}: {e:+.2f} sd" for what, e in errors.items()))
    assert len(errors) == 15
    every = [*errors.values(), *known_errors().values()]
    assert np.mean(np.abs(every) <= 2.0) >= 0.95
    assert np.max(np.abs(every)) < 3.0
    assert np.sqrt(np.mean(np.square(list(errors.values())))) > 0.5  # not merely wide


def test_the_ways_to_find_a_resistance_and_a_time_constant_find_them() -> None:
    t = np.arange(0.0, 3000.0)
    I = np.where(t // 200 % 2 == 0, 5.0, 1.0)  # noqa: E741
    V = 4.0 - 1e-5 * np.cumsum(I) - 0.03 * I
    assert by_regression(t, I, V) == pytest.approx(0.03, rel=0.05)
    on = np.where(t % 200 < 30, 5.0, 0.0)
    assert by_pulses(t, on, 4.0 - 0.02 * on) == pytest.approx(0.02)
    assert fall(t, 20.0 + 9.0 * np.exp(-t / 700.0)) == pytest.approx(700.0, rel=1e-3)
    assert fall_to(t[:300], 20.0 + 9.0 * np.exp(-t[:300] / 700.0), 20.0) == pytest.approx(700.0, rel=1e-3)
