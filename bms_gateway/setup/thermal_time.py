"""Thermal time constant that a log shows, held against that of the named cell."""

import math
from typing import Final

import numpy as np

from bms_gateway.setup.proposal import Proposal, Proposed
from bms_gateway.thermal import Floats, StringModel

TIMES_S: Final = np.geomspace(10.0, 30_000.0, 81)
"""Time constants that are tried: from a bare small cell on liquid to a large one in still air."""
MOST_POINTS: Final = 1500
LEAST_STEPS: Final = 10.0
"""Least movement of the reading, in its own steps."""
EXPLAINED: Final = 0.95
"""Least share of the reading's variance that one time constant explains."""
WORSE: Final = 1.5
"""Mean squared error over the least one up to which a time constant is possible: errors of neighbours are alike."""
LENGTHS: Final = 0.5
"""Greatest time constant that a log shows, over its length."""
MOST_SD: Final = 3.0


def time_shown(t: Floats, squares: Floats, surface: Floats, inlet: Floats, step: float) -> tuple[float, float] | None:
    """Give the least and the greatest time constant, s, by which a surface follows heat and coolant; None if unknown.

    Parameters
    ----------
    t : ndarray (n,)
        s, evenly spaced.
    squares, surface, inlet : ndarray (n,)
        Squared current, A²; °C. A coolant that nobody measures stands still.
    step : float
        Resolution of the reading, K.
    """
    if np.ptp(surface) < LEAST_STEPS * step or not squares.any():
        return None
    errors = np.array([_error(t, squares, surface, inlet, tau) for tau in TIMES_S])
    best = float(errors.min())
    if not best <= (1.0 - EXPLAINED) * float(surface.var()):
        return None
    possible = TIMES_S[errors <= WORSE * best + step**2 / 12.0]
    low, high = float(possible[0]), float(possible[-1])
    return None if low <= TIMES_S[0] or high > LENGTHS * float(t[-1] - t[0]) else (low, high)


def _error(t: Floats, squares: Floats, surface: Floats, inlet: Floats, tau: float) -> float:
    """Mean squared error of a surface that follows heat and coolant by one time constant; the heat only warms."""
    left = np.exp(-(t - t[0]) / tau)
    columns = np.stack([np.ones(len(t)), left, _follows(t, squares / squares.max(), tau)], axis=1)
    around = _follows(t, inlet - inlet[0], tau)
    gain, *_ = np.linalg.lstsq(columns, surface - around, rcond=None)
    if gain[2] <= 0.0:
        return math.inf
    return float(np.mean((surface - around - columns @ gain) ** 2))


def _follows(t: Floats, x: Floats, tau: float) -> Floats:
    """First-order answer to values that hold from stamp to stamp, from zero."""
    out, y, kept = np.zeros(len(x)), 0.0, math.exp(-float(t[1] - t[0]) / tau)
    for k in range(1, len(x)):
        y = kept * y + (1.0 - kept) * float(x[k - 1])
        out[k] = y
    return out


def time_named(model: StringModel) -> tuple[float, float]:
    """Slow time constant of a cell by its priors, s, and its sd as a share."""
    mean = {name: float(np.mean(p.value)) for name, p in model.priors.items()}
    share = {name: p.rel_sd for name, p in model.priors.items()}
    tau = _slow(mean)
    moves = [math.log(_slow({**mean, s: 1.01 * mean[s]}) / tau) / 0.01 * share[s] for s in ("C_c", "C_s", "R_c", "R_u")]
    return tau, math.hypot(*moves)


def _slow(p: dict[str, float]) -> float:
    inner, outer = 1.0 / p["R_c"], 1.0 / p["R_u"]
    rates = [[-inner / p["C_c"], inner / p["C_c"]], [inner / p["C_s"], -(inner + outer) / p["C_s"]]]
    return float(-1.0 / np.linalg.eigvals(np.array(rates)).real.max())


def time_contradiction(proposal: Proposal, string: int, model: StringModel, name: str) -> str | None:
    """Say where the thermal time constant of a log is not that of the named cell; None where it may be."""
    shown = _shown(proposal, string)
    if shown is None:
        return None
    low, high = shown
    named, sd = time_named(model)
    if named * math.exp(-MOST_SD * sd) <= high and low <= named * math.exp(MOST_SD * sd):
        return None
    return (
        f"the thermocouples of string_{string} follow heat and coolant in {low:.3g} to {high:.3g} s, and '{name}' "
        f"would in {named:.3g} s (± {100 * sd:.0f} %): check the cell, its cooling (still, forced, plate, liquid), how "
        "many are in parallel (2p), and whether the thermocouples touch the cells"
    )


def _shown(proposal: Proposal, string: int) -> tuple[float, float] | None:
    """Median of what the thermocouples of a string show; None where most of them show nothing."""
    current = next(proposal.of("current", string), None)
    cells = [p for p in proposal.of("surface") if p.string == string]
    if current is None or not cells or current.against:
        return None
    inlet = next(proposal.of("coolant_inlet", string), None)
    t, amps = current.series.t, current.factor * current.series.x + current.shift
    grid = np.linspace(t[0], t[-1], min(MOST_POINTS, max(int(t[-1] - t[0]), 2)))
    moved = np.interp(grid, t, np.concatenate([[0.0], np.cumsum(amps[:-1] ** 2 * np.diff(t))]))
    squares = np.append(np.diff(moved) / np.diff(grid), 0.0)
    around = np.zeros(len(grid)) if inlet is None else _read(inlet, grid)
    chosen = cells[:: max(len(cells) // 6, 1)]
    shown = [time_shown(grid, squares, _read(p, grid), around, p.resolution) for p in chosen]
    found = [s for s in shown if s is not None]
    if 2 * len(found) <= len(chosen):
        return None
    return float(np.median([low for low, _ in found])), float(np.median([high for _, high in found]))


def _read(p: Proposed, grid: Floats) -> Floats:
    return np.asarray(np.interp(grid, p.series.t, p.factor * p.series.x + p.shift))
