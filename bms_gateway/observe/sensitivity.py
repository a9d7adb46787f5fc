r"""Sensitivity of the estimate to its parameters, J = ∂x̂/∂ ln θ, advanced along with the observer.

Differentiating predict and update with the gain held,

.. math::
    J^- = A\,(J + \tfrac{\Delta t}{2} F) + \tfrac{\Delta t}{2} F, \quad F = \partial f/\partial \ln\theta, \qquad
    J^+ = J^- - K\,[(1-w) C J^- + w C J]

with f the rate of change in the middle of the step; the trapezium has an error of (Δt·pole)²/12, 0.1 % here. Each
column of F is a heat flow that the model already knows: scaling R_c by 1 + ε changes the flow through it by −ε times
itself. Nothing is re-discretised, and a new covariance Σ of ln θ needs no new run: the parameters' part of the band is
J Σ Jᵀ.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from bms_gateway.observe.model import OFFSETS, Ints, StackedModel, scaled, usable
from bms_gateway.observe.reversible import per_ampere, reversible
from bms_gateway.thermal import Floats, StringParameters, coolant_path, exchange, film
from bms_gateway.thermal.entropy import ENTROPIC
from bms_gateway.thermal.warmth import WARMTH, warmth

SYMBOLS = ("C_c", "C_s", "R_e", "R_c", "R_u", "R_cc", "C_f")
PARAMETERS = (*SYMBOLS, "heat", *ENTROPIC, WARMTH)
"""Columns of J, each common to the cells of a string. `heat` scales measured heat, which was not computed as I²R_e. The
last three are no logarithms (`reversible`, `thermal.warmth`)."""
LOGARITHMS = len(SYMBOLS) + 1
"""Number of columns that belong to logarithms; they come first."""
R_E_AT, HEAT_AT, WARMTH_AT = SYMBOLS.index("R_e"), LOGARITHMS - 1, len(PARAMETERS) - 1
ENTROPIC_AT = slice(LOGARITHMS, WARMTH_AT)

FELT = 1e-6
"""K²: squared sensitivity of a state to ln R_e below which no heat is felt."""
LEAST_FELT, MOST_LN = 1e-3, 3.0
"""K: sensitivity of a state to ln R_e below which no mean warmth is computed; and limit of the logarithm of a factor on
its heat, beyond which J describes nothing."""
PROBE = 1e-4
"""Relative step of the finite differences over a gap: far above rounding, far below curvature."""


@dataclass(frozen=True, slots=True)
class Flows:
    """The numbers of S strings that the derivatives need.

    Attributes
    ----------
    C_c, C_s, R_c : ndarray (S, n)
    film : ndarray (S, n), W/K
        From each surface to the coolant at its cell.
    g_cc : ndarray (S,), W/K
        1/R_cc.
    M, m : ndarray (S, n, n), (S, n)
        Coolant path T_f = M T_s + m T_f_in.
    de : ndarray (S, n)
        (∂e/∂ ln R_u)/e of the exchange; the same for ln C_f. 0 if the stream does not warm up.
    by_R_u, by_C_f : ndarray (S, n)
        Relative slope of `film` by ln R_u and by ln C_f: −1 and 0 for the bulk node.
    entropic : ndarray (S, 2), mV/K
        Coefficients of reversible heat (`reversible`).
    u_0 : ndarray (S,)
        Warmth at which R_e is known (`thermal.warmth`).

    References
    ----------
    Derivatives of Lin et al., Eq 1 and 16–18.
    """

    C_c: Floats
    C_s: Floats
    R_c: Floats
    film: Floats
    g_cc: Floats
    M: Floats
    m: Floats
    de: Floats
    by_R_u: Floats
    by_C_f: Floats
    entropic: Floats
    u_0: Floats

    @classmethod
    def of(
        cls, parameters: Sequence[StringParameters], entropic: Floats | None = None, u_0: Floats | None = None
    ) -> "Flows":
        """Gather from strings of equal length; without coefficients, their mean reversible heat is zero."""
        path = [coolant_path(p) for p in parameters]
        de = np.stack([_relative_slope(p) for p in parameters])
        warms = np.array([[bool(np.isfinite(p.C_f))] for p in parameters])
        return cls(
            np.stack([p.C_c for p in parameters]),
            np.stack([p.C_s for p in parameters]),
            np.stack([p.R_c for p in parameters]),
            np.stack([film(p) for p in parameters]),
            np.array([1.0 / p.R_cc for p in parameters]),
            np.stack([M for M, _ in path]),
            np.stack([m for _, m in path]),
            de,
            np.where(warms, de, -1.0),
            np.where(warms, 1.0 + de, 0.0),
            np.zeros((len(parameters), len(ENTROPIC))) if entropic is None else entropic,
            np.zeros(len(parameters)) if u_0 is None else u_0,
        )

    def coolant(self, x: Floats, inlet: Floats) -> Floats:
        """Coolant at each cell (S, n), °C, for states `x` (S, M) and the measured `inlet` (S,)."""
        T_s, T_in = x[:, 1 : 2 * self.C_c.shape[1] : 2], inlet + x[:, -2]
        return np.asarray(np.matmul(self.M, T_s[:, :, None])[:, :, 0] + self.m * T_in[:, None], dtype=np.float64)

    def forcing(self, x: Floats, electric: Floats, given: Floats, inlet: Floats, amps: Floats | None = None) -> Floats:
        """Rates of change by ln θ, by the coefficients of reversible heat, and by the warmth's B.

        Parameters
        ----------
        x : ndarray (S, M)
            State with offsets, °C.
        electric : ndarray (S, n), W
            Heat made from I²R_e.
        given : ndarray (S, n), W
            Measured heat; 0 where heat is computed as I²R_e.
        inlet : ndarray (S,), °C
        amps : ndarray (S, 2), A, optional
            As of `Reversible.pass_step`; None: no reversible heat.

        Returns
        -------
        ndarray (S, M, p), K/s
        """
        N = 2 * self.C_c.shape[1]
        T_c, T_s = x[:, 0:N:2], x[:, 1:N:2]
        out = (T_c - T_s) / self.R_c
        T_f = self.coolant(x, inlet)
        over = T_s - T_f
        cooled = over * self.film
        step = (T_s[:, 1:] - T_s[:, :-1]) * self.g_cc[:, None]
        conducted = np.zeros_like(T_s)
        conducted[:, :-1] += step
        conducted[:, 1:] -= step
        warmed = np.matmul(self.M, (self.de * over)[:, :, None])[:, :, 0] * self.film
        heat = electric + given + x[:, -1:]
        F = np.zeros((*x.shape, len(PARAMETERS)))
        core, surface = F[:, 0:N:2], F[:, 1:N:2]
        if amps is not None:
            heat = heat + reversible(self.entropic, amps, T_c)
            core[:, :, ENTROPIC_AT] = (per_ampere(T_c) / self.C_c)[:, :, None] * amps[:, None]
        core[:, :, 0] = (out - heat) / self.C_c
        surface[:, :, 1] = (cooled - out - conducted) / self.C_s
        if x.shape[1] > N + OFFSETS:
            surface[:, :, 1] -= x[:, N:-OFFSETS] / self.C_s
        core[:, :, 2] = electric / self.C_c
        core[:, :, WARMTH_AT] = core[:, :, 2] * (warmth(T_c) - self.u_0[:, None])
        core[:, :, 3] = out / self.C_c
        surface[:, :, 3] = -out / self.C_s
        surface[:, :, 4] = (warmed - self.by_R_u * cooled) / self.C_s
        surface[:, :, 5] = -conducted / self.C_s
        surface[:, :, 6] = (warmed - self.by_C_f * cooled) / self.C_s
        core[:, :, HEAT_AT] = given / self.C_c
        return F

    def of_strings(self, at: Ints) -> "Flows":
        """Take the strings `at`, ascending and each once."""
        if len(at) == len(self.g_cc):
            return self
        return Flows(*(getattr(self, f.name)[at] for f in fields(self)))

    def exchanged(self, at: Ints, part: "Flows") -> "Flows":
        """Replace the strings `at` by those of `part`."""

        def mixed(mine: Floats, new: Floats) -> Floats:
            changed = mine.copy()
            changed[at] = new
            return changed

        return Flows(*(mixed(getattr(self, f.name), getattr(part, f.name)) for f in fields(self)))


def _relative_slope(p: StringParameters) -> Floats:
    e = exchange(p)
    ntu = 1.0 / (p.R_u * p.C_f)
    slope = -ntu if p.coolant == "bulk" else -ntu * np.exp(-ntu)
    return np.divide(slope, e, out=np.zeros_like(e), where=e > 0.0)


def felt_at(J: Floats) -> float:
    """Find the warmth, over that at which R_e is known, which the sensitivities `J` (M, p) of a string have seen.

    As R_e exp(B (u - u_0)) = R_e' exp(B (u - u_1)), a number R_e' that was identified at u_1 depends on B no more: with
    R_e' fixed, the state moves with B by the column of warmth less (u_1 - u_0) times that of R_e. The u_1 that leaves
    least of the former is the mean over the heat that the state still feels.

    Returns
    -------
    float
        u_1 - u_0; 0 where no heat is felt.
    """
    by_R_e, by_warmth = J[:, R_E_AT], J[:, WARMTH_AT]
    felt = float(by_R_e @ by_R_e)
    return float(by_R_e @ by_warmth) / felt if felt > FELT else 0.0


def displaced(J: Floats, moved: Floats) -> Floats:
    """Change (M,) of the state of a string by changes `moved` (p,) of its numbers, J (M, p) their sensitivities.

    The state is linear in the heat by R_e, and not in the logarithm of R_e: a factor f on this heat moves the state by
    (f - 1) times its sensitivity. B makes a factor for each state, by the mean warmth of the heat that the state feels.
    """
    by_R_e = J[:, R_E_AT]
    felt = np.abs(by_R_e) > LEAST_FELT
    ln = np.where(felt, moved[R_E_AT] + moved[WARMTH_AT] * J[:, WARMTH_AT] / np.where(felt, by_R_e, 1.0), 0.0)
    rest = np.where(felt, 0.0, by_R_e * moved[R_E_AT] + J[:, WARMTH_AT] * moved[WARMTH_AT])
    others = moved.copy()
    others[[R_E_AT, WARMTH_AT]] = 0.0
    return np.asarray(J @ others + rest + by_R_e * np.expm1(np.clip(ln, -MOST_LN, MOST_LN)), dtype=np.float64)


def carried(J: Floats, A: Floats, forcing: Floats, dt: float) -> Floats:
    """Carry `J` (S, M, p) over one step of `dt` seconds.

    References
    ----------
    Derivatives of Lin et al., Eq 1 and 16–18.
    """
    half = (dt / 2.0) * forcing
    return np.asarray(np.matmul(A, J + half) + half, dtype=np.float64)


def bridged(
    J: Floats,
    x: Floats,
    parameters: Sequence[StringParameters],
    over: Callable[[Sequence[StringParameters]], StackedModel],
    inlet0: Floats,
    inlet1: Floats,
) -> Floats:
    """Carry `J` (S, M, p) over a gap in one step, with no heat but the state's own.

    Parameters
    ----------
    J : ndarray (S, M, p)
    x : ndarray (S, M)
        State before the gap.
    parameters : sequence of StringParameters
    over : callable
        Discretises strings with the length of the gap.
    inlet0, inlet1 : ndarray (S,), °C

    Returns
    -------
    ndarray (S, M, p)
        By central differences of the whole step, because so long a step has no middle that represents it.
    """
    J = np.matmul(over(parameters).A, J)
    still = np.zeros((len(x), len(parameters[0].R_e)))
    for j, name in enumerate(SYMBOLS):
        up, down = (
            over([usable(scaled(p, name, f)) for p in parameters]).advance(x, still, inlet0, inlet1)
            for f in (np.exp(PROBE), np.exp(-PROBE))
        )
        J[:, :, j] += (up - down) / (2.0 * PROBE)
    return J


def corrected(J: Floats, J_before: Floats, K: Floats, sensors: Ints, lag: Floats) -> tuple[Floats, Floats]:
    """Correct `J` as the update with gain `K` (S, M, m) corrected the state.

    Parameters
    ----------
    J, J_before : ndarray (S, M, p)
        Carried to now, and as it was one step ago.
    K : ndarray (S, M, m)
        Zero columns where there was no reading.
    sensors, lag : ndarray (S, m)

    Returns
    -------
    J : ndarray (S, M, p)
    seen : ndarray (S, m, p)
        Sensitivities of the predicted readings.

    References
    ----------
    Derivative of the filter's update; not in the paper.
    """
    row = np.arange(len(J))[:, None]
    at = 2 * sensors + 1
    now = J[row, at]
    seen = now + lag[:, :, None] * (J_before[row, at] - now)
    return J - np.matmul(K, seen), seen
