"""Eq 15: whether a drive excites all coefficients, by the paper's eigenvalues and by the resulting uncertainty."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bms_gateway.identify import Settings, WindowIdentifier
from bms_gateway.identify.excitation import excitation
from bms_gateway.identify.least_squares import rows as filtered_rows
from bms_gateway.identify.regression import SCALE
from bms_gateway.reproduce.result import Row, Section, Verdict, kept
from bms_gateway.reproduce.setting import INLET, Size, cell, drive, identify, run, start_model, ticks
from bms_gateway.thermal import Floats

WARM_S = 1332
"""Time driven before the window, s, so that the window does not contain the warm-up, which every current causes."""
WINDOW_S = 1200
NOISE = 0.1
SEED = 0
STEADY_A = 62.2
"""A: the same heat as the urban assault cycle, without its pulses."""
CASES = {
    "urban-assault": "urban assault",
    "us06": "US06-like",
    "udds": "UDDS-like",
    "steady": "steady 62.2 A",
    "parked": "parked",
}

TEXT = (
    "Coefficients can be told apart only where the drive moves all three regressors φ in three different ways: the "
    "mean of φφᵀ over a window must have no small eigenvalue (Eq 15, persistent excitation). The paper gives 0.3 and "
    "0.005 without the scaling of φ, on which they depend entirely; ours are in units of (60 A)² for I², 10 K for "
    "T_f − T_s and 0.1 K/s for sT_s, filtered by λ²/(s + λ)², which has no gain of its own at rest.",
    "What a user wants to know is how well R_e is known after the window. The right column has that: the sd of ln R_e "
    "that the production method states after one window of 20 min from Eq 14's start at 0.1 K (before: 100 %). Excited "
    "enough means: it has fallen below 15 %, where the method says 'identified'.",
)


@dataclass(frozen=True, slots=True)
class Excited:
    """Extreme eigenvalues of the mean of φφᵀ, and sd of ln R_e afterwards, infinite if the window is skipped."""

    least: float
    greatest: float
    sd: float
    status: str


def section(size: Size) -> Section:  # noqa: ARG001 — one drive of each kind tells it
    """Rank drives by the information that they give.

    References
    ----------
    Lin et al., Eq 15; its α₀ = 0.005 and α₁ = 0.3 are printed the wrong way round.
    """
    found = {name: excited(name) for name in CASES}
    first = found["urban-assault"]
    rows = [
        Row(
            "eq15.scaling",
            "scaling of φ = (I², T_f − T_s, sT_s)",
            "not stated",
            f"{SCALE[0]:g} A², {SCALE[1]:g} K, {SCALE[2]:g} K/s",
            "assumed",
            "unscaled, I² outweighs all others by its unit alone, and so does its eigenvalue",
        )
    ]
    for name, label in CASES.items():
        e = found[name]
        sd = "passed over, nothing learnt" if np.isinf(e.sd) else f"sd of R_e {100 * e.sd:.0f} %, {e.status}"
        verdict: Verdict
        if name == "urban-assault":
            verdict, paper = "paper wrong", "0.3 and 0.005"
        else:
            verdict, paper = _verdict(name, e, first), "–"
        rows.append(
            Row(
                f"eq15.{name}",
                f"{label}: greatest and least eigenvalue; R_e after the window",
                paper,
                f"{e.greatest:.3g} and {e.least:.2g}; {sd}",
                verdict,
                _note(name, found),
                {"greatest": e.greatest, "least": e.least, "sd_R_e": e.sd},
            )
        )
    return Section("excitation", "Excited enough? (Eq 15)", TEXT, tuple(rows))


_NOTES = {
    "urban-assault": "α₀ is the lower bound and α₁ the upper one: they are swapped after Eq 15. Our numbers belong "
    "to our scaling and are not to be compared with the paper's",
    "us06": "one window is not enough; the window after it goes on from what this one left",
    "steady": "all the heat, none of the information: the least eigenvalue is smaller by orders of magnitude",
    "parked": "the recursion freezes at |φ|²/m² < 1e-3 and the window is left out: plain forgetting would forget all",
}


def _note(name: str, found: Mapping[str, Excited]) -> str:
    town, motorway = found["udds"], found["us06"]
    if name == "udds" and town.least < motorway.least and town.sd < motorway.sd:
        return "a least eigenvalue far below that of US06, and R_e better known: the eigenvalues do not rank the drives"
    return _NOTES.get(name, "")


def _verdict(name: str, e: Excited, urban: Excited) -> Verdict:
    if name == "parked":
        return kept(np.isinf(e.sd))
    if name == "steady":
        return kept(e.least < 0.1 * urban.least and e.status != "identified")
    return kept(e.sd < 0.6)


def excited(name: str) -> Excited:
    """Drive one window of `name` after a warm-up; return the eigenvalues and the sd of R_e."""
    current = _current(name)
    x = run(cell(), current, np.full(2, INLET))
    y = x[:, 1] + NOISE * np.random.default_rng([SEED, 15]).standard_normal(len(x))
    last = slice(WARM_S, WARM_S + WINDOW_S)
    _, Phi = filtered_rows(current**2, x[:, 1], np.full(len(x), INLET), 1.0, [0, 1, 2])
    least, greatest = excitation(Phi[last], WINDOW_S)[0]
    identifier = WindowIdentifier(start_model(), Settings(root="smaller", carried=0.0))
    identify(identifier, ticks(current[last], y[WARM_S : WARM_S + WINDOW_S + 1]))
    R_e = {e.name: e for e in identifier.estimates()}["R_e"]
    sd = R_e.sd / R_e.value if R_e.status != "learning" else np.inf
    return Excited(float(least), float(greatest), float(sd), R_e.status)


def _current(name: str) -> Floats:
    seconds = WARM_S + WINDOW_S
    if name == "steady":
        return np.full(seconds, STEADY_A)
    if name == "parked":
        current = drive("urban-assault", SEED, seconds)
        current[WARM_S:] = 0.0
        return current
    return drive(name, SEED, seconds)
