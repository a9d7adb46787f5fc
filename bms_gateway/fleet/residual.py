"""Readings of a string's surfaces against the predictions of its observer, cell by cell and regime by regime.

The regimes are few and fixed, so that vehicles can be compared; they overlap. The strength of a current is measured by
its heat: by the steady rise of the core above the coolant that the model file predicts for this current.

In a slow system, neighbouring errors are nearly equal. The standard deviation of a mean is therefore computed from
the scatter of the means of whole stretches of time (cluster-robust variance), as in the comparison of a single
record. Only the current stretch is kept in memory, so a day takes no more memory than two minutes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp, sqrt
from typing import Final

import numpy as np

from bms_gateway.engine import Judgement
from bms_gateway.health.mismatch import GRACE_S
from bms_gateway.thermal import Floats, StringModel

REGIMES: Mapping[str, str] = {
    "all": "at any time",
    "rest": "at rest",
    "high_current": "at high current",
    "charging": "while charging",
    "cold": "with the coolant below 10 °C",
    "hot": "with the coolant above 35 °C",
    "low_flow": "at low coolant flow",
}
"""Names of the regimes, and the words for a sentence."""
LEVEL: Final = "level"
PLACES: Mapping[str, str] = {**REGIMES, LEVEL: "all along, by its windows"}
"""Also the constant error that windows find of a thermocouple: an observer takes up most of it, and predicts it."""
LEVEL_SD_K = 0.05
"""How well a window tells it; between windows of a healthy string it changes by as much."""
REST_K = 0.5
"""Rise of the core below which a string counts as resting: little more than a thermocouple can resolve."""
HIGH_K = 10.0
"""Rise of the core above which the current counts as high."""
RECENT_S = 60.0
"""Time over which the current is averaged: surfaces follow the heat within it."""
COLD_C, HOT_C = 10.0, 35.0
LOW_FLOW = 0.7
STRETCH_S = 120
"""Longer than the correlation time of the errors of an observer that is corrected each second."""
FEWEST = 5
"""Least number of stretches for which the sd of a mean is given."""


@dataclass(frozen=True, slots=True)
class CellResidual:
    """Reading less prediction of one cell in one regime.

    Attributes
    ----------
    regime : str
        Of `PLACES`.
    cell : int
        1-based.
    readings : int
    mean_K, sd_K : float
        Mean and its standard deviation; NaN if there are too few stretches.
    rms_K : float
    normalised : float
        Root mean square of error over expected error; 1 if the model is right.
    """

    regime: str
    cell: int
    readings: int
    mean_K: float
    sd_K: float
    rms_K: float
    normalised: float


class Residuals:
    """Collects the errors of one string, tick by tick.

    Attributes
    ----------
    seconds : ndarray (regimes,)
        How long each regime lasted.
    """

    def __init__(self, model: StringModel) -> None:
        p = {k: float(np.mean(v.value)) for k, v in model.priors.items()}
        self._rise = p["R_e"] * (p["R_c"] + p["R_u"])
        self._cells = np.array(model.sensors, np.intp) - 1
        self._recent = 0.0
        self._quiet_s = GRACE_S
        self._last_ns: int | None = None
        self._begin()

    def _begin(self) -> None:
        shape = (len(REGIMES), len(self._cells))
        self._n, self._e, self._ee, self._zz, self._white = (np.zeros(shape) for _ in range(5))
        self._stretches, self._SS, self._Sn, self._nn = (np.zeros(shape) for _ in range(4))
        self.seconds = np.zeros(len(REGIMES))
        self._stretch = -1
        self._open: list[tuple[tuple[bool, ...], Floats, Floats]] = []

    def add(self, time_ns: int, j: Judgement) -> None:
        """Take in one tick."""
        dt = 1.0 if self._last_ns is None else (time_ns - self._last_ns) * 1e-9
        if self._last_ns is None or dt > GRACE_S:
            self._quiet_s, dt = GRACE_S, 1.0
        self._last_ns = time_ns
        if j.square == j.square:
            self._recent += (j.square - self._recent) * (1.0 - exp(-dt / RECENT_S))
        if self._quiet_s > 0.0:  # until the observer has converged, its innovations say nothing about the model
            self._quiet_s -= dt
            return
        stretch = time_ns // (STRETCH_S * 1_000_000_000)
        if stretch != self._stretch:
            self._close_stretch()
            self._stretch = stretch
        inside = self._regimes(j)
        self.seconds += dt * np.array(inside)
        self._open.append((inside, j.innovation, j.innovation_sd))

    def _regimes(self, j: Judgement) -> tuple[bool, ...]:
        rise = self._rise * self._recent
        moving = self._rise * j.square > REST_K
        return (
            True,
            rise < REST_K and not moving and j.square == j.square,
            rise > HIGH_K,
            moving and j.current < 0.0,
            j.inlet < COLD_C,
            j.inlet > HOT_C,
            j.flow < LOW_FLOW,
        )

    def _close_stretch(self) -> None:
        if not self._open:
            return
        inside = np.array([o[0] for o in self._open], float).T
        e, sd = (np.stack([o[k] for o in self._open])[:, self._cells] for k in (1, 2))
        self._open = []
        there = np.isfinite(e) & (sd > 0.0)
        e, sd = np.where(there, e, 0.0), np.where(there, sd, 1.0)
        n, S = inside @ there, inside @ e
        self._n += n
        self._e += S
        self._ee += inside @ e**2
        self._zz += inside @ (e / sd) ** 2
        self._white += inside @ np.where(there, sd**2, 0.0)
        self._stretches += n > 0
        self._SS += S**2
        self._Sn += S * n
        self._nn += n**2

    def take(self, constant: Floats | None = None) -> tuple[tuple[CellResidual, ...], Floats]:
        """Close a day: its residuals by regime and cell, those with readings, and the seconds of each regime.

        `constant` (n,), K, are the constant errors of the cells' thermocouples by the newest window.
        """
        self._close_stretch()
        found = []
        for r, regime in enumerate(REGIMES):
            for c, cell in enumerate(self._cells.tolist()):
                n = self._n[r, c]
                if n == 0:
                    continue
                mean = self._e[r, c] / n
                rms, normalised = sqrt(self._ee[r, c] / n), sqrt(self._zz[r, c] / n)
                sd = self._sd(r, c, mean)
                found.append(CellResidual(regime, cell + 1, int(n), float(mean), sd, rms, normalised))
        for cell, n in zip(self._cells.tolist(), self._n[0].tolist(), strict=True):
            if constant is not None and n:
                mean = float(constant[cell])
                found.append(CellResidual(LEVEL, cell + 1, int(n), mean, LEVEL_SD_K, abs(mean), abs(mean) / LEVEL_SD_K))
        seconds = self.seconds
        self._begin()
        return tuple(found), seconds

    def _sd(self, r: int, c: int, mean: float) -> float:
        C, n = self._stretches[r, c], self._n[r, c]
        if C < FEWEST:
            return float("nan")
        spread = (self._SS[r, c] - 2.0 * mean * self._Sn[r, c] + mean**2 * self._nn[r, c]) / n**2 * C / (C - 1.0)
        # the scatter of few stretches is itself uncertain: the variance of Student's t
        variance = max(spread * (C + 1.0) / (C - 1.0), self._white[r, c] / n**2)
        return sqrt(variance)
