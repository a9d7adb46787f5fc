"""Table 1, Eq 7 to 14, Figures 3 and 4: one cell, and the identification of its resistances during a drive."""

import numpy as np

from bms_gateway.identify.identifiable import alias
from bms_gateway.identify.least_squares import solve
from bms_gateway.identify.recursive import RecursiveIdentifier
from bms_gateway.identify.regression import roots
from bms_gateway.reproduce.result import Curve, Figure, Panel, Row, Section, agreeing, disproved, kept, several, span
from bms_gateway.reproduce.setting import (
    EQ_14,
    INLET,
    RESISTANCES,
    Size,
    cell,
    drive,
    run,
    settled,
    start_model,
    ticks,
)
from bms_gateway.sensors.paper import TABLE_1
from bms_gateway.thermal import Floats, continuous, steady_state
from bms_gateway.thermal.cycles import CYCLES

DRIVE_S = 2700
RUNS = 5  # drives per cycle: each seed has its own wave form, and the first minutes decide the result
LIMIT = 0.05

NAMES = {"urban-assault": "urban assault", "us06": "US06", "udds": "UDDS"}

TEXT = (
    "A cell is two lumps: a core (the jelly roll) that is heated by I²R_e and has no sensor, and a surface (the can) "
    "that has one. Heat flows core – surface – coolant:",
    "  C_c dT_c/dt = I²R_e + (T_s − T_c)/R_c                     (Eq 1)",
    "  C_s dT_s/dt = (T_f − T_s)/R_u − (T_s − T_c)/R_c",
    "Eliminating the core that nobody measures leaves a second-order equation for T_s. Passed through a filter "
    "1/((s + λ)²), so that nothing needs to be differentiated, it is linear in three unknown coefficients (Eq 7–8):",
    "  s²T_s = α I² + β (T_f − T_s) + γ sT_s",
    "  α = R_e/(C_c C_s R_c),  β = 1/(C_c C_s R_c R_u),  −γ = (C_c + C_s)/(C_c C_s R_c) + 1/(C_s R_u)",
    "Least squares finds α, β, γ while driving, all data at once (Eq 3–4) or second by second (Eq 5). With the heat "
    "capacities presumed known, R_u follows from a quadratic (Eq 9), then R_c and R_e. The quadratic has TWO positive "
    "roots: two different cells show the same surface under any current, as long as the coolant does not change its "
    "temperature. Which is meant must be known: the smaller R_u where air is forced past the cell (so here), the "
    "larger in still air.",
    "The cycle of the paper has not been published; ours are drawn at random, with its length, limits and heat.",
)


def section(size: Size) -> Section:
    """Reproduce Table 1, Eq 9, Eq 14 and Fig 3 and 4.

    References
    ----------
    Lin et al., Eq 1–14, Table 1, Fig 3–4.
    """
    runs = min(RUNS, max(2, size.seeds))
    fast = {name: _times(name, runs, paper=False) for name in CYCLES}
    slow = {name: _times(name, runs, paper=True) for name in CYCLES}
    rows = [_table_1(), _poles(), _cycle(), _start(), _two_roots(), _batch()]
    rows += _time_rows(slow["urban-assault"], fast["urban-assault"])
    rows += [_other_cycle(name, slow[name], fast[name]) for name in CYCLES if name != "urban-assault"]
    return Section(
        "identification",
        "One cell, identified while driving (Table 1, Eq 1–14, Fig 3–4)",
        TEXT,
        tuple(rows),
        _figures(),
    )


def trajectory(name: str, seed: int, *, paper: bool, seconds: int = DRIVE_S) -> Floats:
    """Relative errors of R_e, R_c, R_u, second by second from Eq 14's start, noise-free: (seconds + 1, 3)."""
    current = drive(name, seed, seconds)
    surface = run(cell(), current, np.full(2, INLET))[:, 1]
    tuning = {"P": 100.0, "pole": 0.1, "normalised": True} if paper else {}
    identifier = RecursiveIdentifier(start_model(), root="smaller", **tuning)  # type: ignore[arg-type]
    out = np.full((seconds + 1, 3), np.nan)
    for k, tick in enumerate(ticks(current, surface)):
        identifier.add(tick)
        found = identifier.cell()
        if found is not None:
            out[k] = found.R_e / TABLE_1["R_e"] - 1, found.R_c / TABLE_1["R_c"] - 1, found.R_u / TABLE_1["R_u"] - 1
    return out


def _times(name: str, runs: int, *, paper: bool) -> Floats:
    """Minutes until all three stay within 5 %, per run."""
    return np.array([np.max(settled(trajectory(name, s, paper=paper), LIMIT)) for s in range(runs)])


def _time_rows(slow: Floats, fast: Floats) -> list[Row]:
    what = "minutes to ± 5 % of R_e, R_c and R_u, urban assault, noise-free"
    middle = float(np.median(slow))
    return [
        Row(
            "fig4.paper",
            f"{what}, paper-like tuning",
            "about 10",
            span(slow),
            agreeing(5.0 <= middle <= 15.0),
            f"λ = 0.1 1/s, P0 = 100, rows divided by m (Eq 4). Median and range of {len(slow)} drives: how calm the "
            "first minutes are decides",
            _spread(slow),
        ),
        Row(
            "fig4.ours",
            f"{what}, our tuning",
            "–",
            span(fast),
            kept(float(np.median(fast)) <= 3.5),
            "λ = 0.05 1/s, P0 = 1e4: the same data and equations",
            _spread(fast),
        ),
    ]


def _other_cycle(name: str, slow: Floats, fast: Floats) -> Row:
    return Row(
        f"fig4.{name}",
        f"the same, {NAMES[name]}-like: paper-like tuning; ours",
        "–",
        f"{span(slow)}; {span(fast)}",
        kept(float(np.median(fast)) <= 5.0),
        "town traffic makes a quarter of the heat, and P0 = 100 then believes the start for long"
        if name == "udds"
        else "",
        {"paper_like": float(np.median(slow)), "ours": float(np.median(fast))},
    )


def _spread(minutes: Floats) -> dict[str, float]:
    return {"minutes": float(np.median(minutes)), "least": float(minutes.min()), "most": float(minutes.max())}


def _table_1() -> Row:
    rise = steady_state(cell(), np.array([62.2**2 * TABLE_1["R_e"]]), 0.0)
    return Row(
        "table1",
        "the cell, A123 32157: C_c, C_s J/K; R_e mΩ; R_c, R_u K/W",
        "268  18.8  3.5  1.266  0.79",
        several([TABLE_1[s] * f for s, f in zip(TABLE_1, (1, 1, 1e3, 1, 1), strict=True)], "g"),
        "agrees",
        f"taken over. At 62.2 A rms its surface is {rise[1]:.1f} K above the air and its core {rise[0] - rise[1]:.1f} "
        "K above that: what a surface sensor alone does not show",
        {"surface_rise_K": float(rise[1]), "core_over_surface_K": float(rise[0] - rise[1])},
    )


def _poles() -> Row:
    fast, slow = np.sort(np.linalg.eigvals(continuous(cell()).A).real)
    return Row(
        "eq1.poles",
        "time constants of Eq 1",
        "–",
        f"{-1 / fast:.2f} s and {-1 / slow:.1f} s",
        "beyond",
        "everything below follows from these two: the surface reacts in seconds, the core forgets in half an hour",
        {"fast_s": -1 / fast, "slow_s": -1 / slow},
    )


def _cycle() -> Row:
    current = CYCLES["urban-assault"](np.random.default_rng([0, 3]), 8.0)
    rms = float(np.sqrt(np.mean(current**2)))
    return Row(
        "fig3.cycle",
        "urban assault cycle",
        "1332 s, +160/−96 A",
        f"{len(current)} s, {current.max():+.0f}/{current.min():.0f} A, {rms:.1f} A rms".replace("-", "−"),
        "assumed",
        "a synthetic one from a seed: the original is not public. 62.2 A rms is what Fig 7 asks for",
        {"seconds": len(current), "high_A": float(current.max()), "low_A": float(current.min()), "rms_A": rms},
    )


def _start() -> Row:
    return Row(
        "eq14",
        "start of the identification: R_e mΩ, R_c, R_u K/W",
        "not in what we have",
        several([EQ_14["R_e"] * 1e3, EQ_14["R_c"], EQ_14["R_u"]], "g"),
        "assumed",
        "Eq 14's numbers are printed nowhere in our sources. These are 2.9, 0.4 and 1.9 times the truth, and on the "
        "wrong side of the fold",
        dict(EQ_14),
    )


def _two_roots() -> Row:
    p = TABLE_1
    alpha, beta, gamma = _coefficients()
    both = roots(alpha, beta, gamma, p["C_c"], p["C_s"])
    smaller, larger = both.smaller, both.larger
    if smaller is None or larger is None:  # the nominal cell is 33 % away from the fold
        raise ArithmeticError("Table 1 has no two roots")
    other = np.exp(alias(np.log([p[s] for s in ("C_c", "C_s", *RESISTANCES)])))[2:]
    rise = larger.R_e * (larger.R_c + larger.R_u) / (smaller.R_e * (smaller.R_c + smaller.R_u))
    inside = larger.R_e * larger.R_c / (smaller.R_e * smaller.R_c)
    shown = [
        run(cell(R_e=c.R_e, R_c=c.R_c, R_u=c.R_u), drive("urban-assault", 0, 1332), np.full(2, INLET))[:, 1]
        for c in (smaller, larger)
    ]
    apart = float(np.abs(shown[0] - shown[1]).max())
    return Row(
        "eq9.roots",
        "cells with the same surface under any current: R_e mΩ, R_c, R_u",
        "3.5  1.266  0.79",
        "  and  ".join(f"{c.R_e * 1e3:.4g}  {c.R_c:.4g}  {c.R_u:.4g}" for c in (smaller, larger)),
        disproved(apart < 1e-6),
        "the paper picks the root by a rough estimate; the rule is R_u < C_c R_c/(C_c + C_s) in forced air. The other "
        f"cell has the same surface and a core {100 * inside:.0f} % as far above it ({100 * rise:.0f} % of the whole "
        "rise)",
        {
            "R_e": float(other[0]),
            "R_c": float(other[1]),
            "R_u": float(other[2]),
            "core_over_surface": inside,
            "apart_K": apart,
        },
    )


def _coefficients() -> tuple[float, float, float]:
    p = TABLE_1
    inner = p["C_c"] * p["C_s"] * p["R_c"]
    return p["R_e"] / inner, 1 / (inner * p["R_u"]), -(p["C_c"] + p["C_s"]) / inner - 1 / (p["C_s"] * p["R_u"])


def _batch() -> Row:
    current = drive("urban-assault", 0, 1332)
    surface = run(cell(), current, np.full(2, INLET))[:, 1]
    theta, _ = solve(current**2, surface, np.full(len(surface), INLET))
    alpha, beta, gamma = theta.tolist()
    found = roots(alpha, beta, gamma, TABLE_1["C_c"], TABLE_1["C_s"]).smaller
    error = np.inf if found is None else max(abs(getattr(found, s) / TABLE_1[s] - 1) for s in RESISTANCES)
    return Row(
        "eq3.batch",
        "largest error of R_e, R_c, R_u after one cycle, all data at once, noise-free",
        "–",
        f"{100 * error:.3f} %",
        kept(error < 1e-3),
        "with the mean of I² held over each second and temperatures joined by straight lines; holding everything costs "
        "8 %, the bilinear rule 20 %",
        {"error": error},
    )


def _figures() -> tuple[Figure, ...]:
    seed, seconds = 0, 1332
    current = drive("urban-assault", seed, seconds)
    x = run(cell(), current, np.full(2, INLET))
    t = np.arange(seconds + 1) / 60.0
    fig3 = Figure(
        "fig03_cycle",
        "Fig 3: the drive (synthetic)",
        (
            Panel("", "min", "current, A", (Curve("urban assault, seed 0", t[:-1], current),)),
            Panel("", "min", "°C", (Curve("core (not measured)", t, x[:, 0]), Curve("surface", t, x[:, 1]))),
        ),
    )
    panels = []
    both = {
        "paper-like": trajectory("urban-assault", seed, paper=True, seconds=seconds),
        "ours": trajectory("urban-assault", seed, paper=False, seconds=seconds),
    }
    for i, name in enumerate(RESISTANCES):
        curves = tuple(Curve(label, t, 100 * e[:, i], "-" if label == "ours" else "--") for label, e in both.items())
        panels.append(Panel("", "min", f"{name}, error %", curves, limits=(-50.0, 50.0), level=0.0))
    return fig3, Figure("fig04_identification", "Fig 4: from Eq 14's start, noise-free", tuple(panels))
