r"""Effects that every real cell may have; every window's fit carries them, whether or not the model file names them.

A window's model has two nodes per cell, I²R_e and a coolant. A real cell also loses heat from its ends, cools a little
by its entropy and distributes its heat over its radius, its R_e falls as it warms, and its thermocouple is influenced
by the air. Without these effects, a fit would change R_c, R_u and the capacities instead, with full confidence. So each
effect below has a coefficient v with the prior N(0, 1), in units of its usual size in cells of vehicles. The surfaces
are linear in v as long as the effects are small:

.. math::
    y = f(\varphi, \xi) + \sum_j v_j \, c_j(t)
with c_j the response of the string along the undisturbed trajectory: to the effect's heat, to its flow into the casing,
or to its error of the reading. The responses are slow against the steps of the bus, so they are simulated in steps of
about `STEP_S`.

Beyond Lin et al., Eq 1 and 18.
"""

import math
from dataclasses import dataclass

import numpy as np

from bms_gateway.thermal import (
    HEAT_GAIN_SD,
    ContinuousString,
    Floats,
    StringParameters,
    continuous,
    coolant_path,
    discretize,
    film,
)
from bms_gateway.thermal.entropy import ENTROPIC_SD, ENTROPIC_SLOPE_SD, KELVIN
from bms_gateway.thermal.warmth import WARMTH, resistance_factor

STEP_S = 8.0
LEAST_SHARE, MOST_SHARE = 0.03, 0.95
"""Limits of the roll's share of R_c: a smaller share is one node, a larger one leaves no resistance to the casing."""
ROLL_MEDIAN, ROLL_SPREAD = 2.0, 1.5
"""Logistic prior of the share: 0.14 in the middle, 0.04 to 0.70 within 2 sd."""
LEAST_W = 0.05
"""Mean heat of a cell below which the shares of heat are not computed."""

NAMES = (
    "heat_gain",  # of heat from voltage, by `HEAT_GAIN_SD`
    "entropic",  # W: level ±0.25 mV/K of heat that changes sign with the current; an offset of the current looks alike
    "entropic_slope",  # ±0.5 mV/K more at one end of the charge than in the middle
    "charge_transfer",  # 30 % of the loss grows with |I| instead of I²
    "asymmetry",  # charging resistance ±15 % off the discharging one
    "end_loss",  # 10 % of the heat leaves the core by the ends
    "sink",  # surroundings 0.4 K off the coolant
    "ambient_loss",  # 6 % more or less leaves the casing than by R_u, to where the window began
    "convection",  # film grows with the gap to the power 0.1
    "contact",  # thermocouple reads 3 % of the coolant
    "lag",  # thermocouple lags by 1.5 s
    "roll",  # heat of the roll is spread over its radius
    WARMTH,  # R_e follows the temperature of its core
)
ROLL_AT, WARMTH_AT = NAMES.index("roll"), NAMES.index(WARMTH)
"""These two are no responses to be added, because they are not linear: the roll is a state of each cell
(`thermal.roll`), and the warmth of a core changes the R_e that makes its heat (`thermal.warmth`)."""


def roll_share(v: float) -> float:
    """Share of R_c within the jelly roll, from its coefficient v; the rest is contact to the casing."""
    return LEAST_SHARE + (MOST_SHARE - LEAST_SHARE) / (1.0 + math.exp(ROLL_MEDIAN - ROLL_SPREAD * v))


def roll_bend(v: float) -> float:
    """Second over first derivative of `roll_share`: the curvature of the response to v.

    Examples
    --------
    >>> h = 1e-4
    >>> first = (roll_share(-1.0 + h) - roll_share(-1.0 - h)) / (2.0 * h)
    >>> second = (roll_share(-1.0 + h) - 2.0 * roll_share(-1.0) + roll_share(-1.0 - h)) / h**2
    >>> abs(second / first / roll_bend(-1.0) - 1.0) < 1e-5
    True
    """
    return ROLL_SPREAD * math.tanh((ROLL_MEDIAN - ROLL_SPREAD * v) / 2.0)


@dataclass(frozen=True, slots=True)
class Course:
    """Inputs of the carried effects in a window of K ticks, in C coarse steps of `per` ticks.

    Attributes
    ----------
    square, heat, current, magnitude, charging : ndarray (C,)
        Means of I², of the heat from voltage (W), of I, of |I|, and of I² while charging.
    charge : ndarray (C,)
        Charge moved until the middle of each step, over the capacity, about the mean of these values.
    inlet : ndarray (C + 1,), °C
    dt : float, s
        Of a coarse step.
    per, ticks : int
    """

    square: Floats
    heat: Floats
    current: Floats
    magnitude: Floats
    charging: Floats
    charge: Floats
    inlet: Floats
    dt: float
    per: int
    ticks: int

    @classmethod
    def of(cls, square: Floats, heat: Floats, current: Floats, inlet: Floats, dt: float, capacity: float) -> "Course":
        """Take means over the coarse steps; the last step may hold fewer ticks and counts as a whole one."""
        K = len(square)
        per = max(1, min(round(STEP_S / dt), K))
        first = np.arange(0, K, per)
        count = np.diff(np.append(first, K))

        def mean(x: Floats) -> Floats:
            return np.asarray(np.add.reduceat(x, first) / count, dtype=np.float64)

        step = mean(current) * per * dt / 3600.0 / capacity
        moved = np.cumsum(step) - step / 2.0  # to the middle of each step: at its end, it would correlate with I²
        return cls(
            mean(square), mean(heat), mean(current), mean(np.abs(current)), mean(square * (current < 0.0)),
            moved - moved.mean(), inlet[np.minimum(np.append(first, first[-1] + per), K)], per * dt, per, K,
        )  # fmt: skip

    def at_ticks(self, coarse: Floats) -> Floats:
        """Values (K + 1, …) at the ticks' instants, interpolated between those (C + 1, …) at the coarse steps."""
        at = np.arange(self.ticks + 1) / self.per
        k = np.minimum(at.astype(np.intp), len(coarse) - 2)
        share = (at - k).reshape(-1, *(1,) * (coarse.ndim - 1))
        return np.asarray((1.0 - share) * coarse[k] + share * coarse[k + 1], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Carried:
    """Result of one unit of each carried effect in a window, in the order of `NAMES`.

    Attributes
    ----------
    readings : ndarray (K + 1, m, v), K
        At the ticks' instants.
    shares : ndarray (2, v)
        Mean heat into the cores over the window's mean heat, and mean flow into the casings over the flow to the
        coolant. An observer without the effects has R_e (or the gain of heat from voltage) and R_u changed by these.
    last : ndarray (2n, v), K
        Cores and casings at the end, without errors of the thermocouples.
    core : ndarray (C, n), °C
        Undisturbed, in the middle of the coarse steps.
    """

    readings: Floats
    shares: Floats
    last: Floats
    core: Floats

    def times(self, size: float) -> "Carried":
        """Effects of `size` units."""
        return Carried(size * self.readings, size * self.shares, size * self.last, self.core)


def columns(
    p: StringParameters,
    course: Course,
    x0: Floats,
    surface: Floats,
    sensed: list[int],
    B: float = 0.0,
) -> "Carried":
    """Compute the addition of one unit of each carried effect to the readings.

    Parameters
    ----------
    p : StringParameters
        String of n cells.
    course : Course
        Of K ticks.
    x0 : ndarray (2n,), °C
        Temperatures at the beginning of the window.
    surface : ndarray (K + 1, m), °C
        Undisturbed surfaces of the sensed cells at the ticks' instants.
    sensed : list of int
        0-based, m of them.
    B : float, 1000 K
        With which R_e follows the warmth of each core.

    References
    ----------
    Not in the paper; a linear response about Lin et al., Eq 18.
    """
    n = p.cells
    s = continuous(p)
    casing = np.zeros((2 * n, n))
    casing[np.arange(1, 2 * n, 2), np.arange(n)] = 1.0 / p.C_s
    step = discretize(ContinuousString(s.A, np.hstack((s.B_q, casing)), s.B_f), course.dt)
    given = np.outer(course.heat, p.R_e / np.mean(p.R_e))
    X, R_e = np.empty((len(given) + 1, 2 * n)), np.empty_like(given)
    X[0] = x0
    known = given @ step.B_q[:, :n].T + np.outer(course.inlet[:-1], step.B_f0) + np.outer(course.inlet[1:], step.B_f1)
    for k, forced in enumerate(known):
        R_e[k] = p.R_e * resistance_factor(B, X[k, 0::2])
        X[k + 1] = step.A @ X[k] + step.B_q[:, :n] @ (course.square[k] * R_e[k]) + forced
    made = given + course.square[:, None] * R_e
    M, m = coolant_path(p)
    T_c, T_s = X[:, 0::2], X[:, 1::2]
    T_f = T_s @ M.T + np.outer(course.inlet, m)
    middle = [(T[1:] + T[:-1]) / 2.0 for T in (T_c, T_s, T_f)]
    into = _forcing(p, course, R_e, *middle)
    out = np.zeros((len(X), len(sensed), len(NAMES)))
    x = np.zeros((2 * n, len(NAMES)))
    at = [2 * k + 1 for k in sensed]
    for k, forced in enumerate(np.matmul(step.B_q, into)):
        x = step.A @ x + forced
        out[k + 1] = x[at]
    fine = course.at_ticks(out)
    fine[:, :, NAMES.index("contact")] += 0.03 * (course.at_ticks(T_f[:, sensed]) - surface)
    fine[:, :, NAMES.index("lag")] -= (
        1.5 * np.gradient(surface, course.dt / course.per, axis=0) if len(surface) > 1 else 0.0
    )
    heat, cooled = (max(float(abs(np.mean(w))), LEAST_W) for w in (made, (T_s - T_f) * film(p)))
    shares = np.stack([into[:, :n].mean(axis=(0, 1)) / heat, into[:, n:].mean(axis=(0, 1)) / cooled])
    return Carried(fine, shares, x, middle[0])


def _forcing(p: StringParameters, u: Course, R_e: Floats, T_c: Floats, T_s: Floats, T_f: Floats) -> Floats:
    """Heat into cores and flow into casings (C, 2n, v), W, for one unit of each effect.

    `R_e` (C, n) is that of the cores at their temperatures.
    """
    n, C = p.cells, len(u.square)
    out = np.zeros((C, 2 * n, len(NAMES)))
    core, casing = out[:, :n], out[:, n:]
    square, heat = u.square[:, None], u.heat[:, None]
    rms = float(np.sqrt(np.mean(u.square)))
    ohmic = square > 0.0  # otherwise the heat comes from the voltage, which includes these losses
    reversible = u.current[:, None] * (T_c + KELVIN)
    over, cooled = T_s - T_f, film(p)
    core[:, :, 0] = HEAT_GAIN_SD * heat * (p.R_e / np.mean(p.R_e))
    core[:, :, 1] = -ENTROPIC_SD * reversible
    core[:, :, 2] = -ENTROPIC_SLOPE_SD * u.charge[:, None] * reversible
    core[:, :, 3] = 0.3 * ohmic * R_e * (rms * u.magnitude[:, None] - square)
    core[:, :, 4] = 0.15 * R_e * u.charging[:, None]
    core[:, :, 5] = -0.1 * (T_c - T_f) / (p.R_c + p.R_u)
    casing[:, :, 6] = 0.4 * cooled
    casing[:, :, 7] = -0.06 * (T_s - u.inlet[0]) * cooled
    casing[:, :, 8] = -0.1 * np.log(np.abs(over) / 5.0 + 0.05) * over * cooled
    return out
