r"""A string with effects and its disturbances as a linear system about one point.

With z = [X, b_f, b_q] the state of the string, the inlet's offset and the common heat offset (as in `model`),

.. math::
    \dot z = f(z, u), \qquad \dot b = -b/\tau, \qquad A = \partial f/\partial z, \qquad
    \Phi = e^{A \Delta t}, \quad \Gamma = \int_0^{\Delta t} e^{A s} ds

one step is z⁺ = z + Γ f(z, ū): exact for a linear string, of second order with the present Jacobian, and exact at rest
with any (M. Hochbruck, A. Ostermann, Exponential integrators, Acta Numerica 2010, the Rosenbrock–Euler method).
"""

from dataclasses import dataclass, field, replace

import numpy as np

from bms_gateway.observe.model import OFFSETS
from bms_gateway.thermal import Disturbance, Floats, gathered_noise
from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.exponential import exponential
from bms_gateway.thermal.physics import Numbers
from bms_gateway.thermal.system import System

PROBE = 0.05
"""K and W: well above rounding, well below the curvature of any effect."""
ROW = ("I", "I2", "I_abs", "T_in", "flow", "soc", "V", "IV", "hours")
"""Columns of inputs kept as one array."""


def drive_of(rows: Floats, dt: float) -> Drive:
    """Name the columns of N intervals (N, 9), in the order of `ROW`."""
    I, I2, I_abs, T_in, flow, soc, V, IV, hours = rows.T  # noqa: E741
    return Drive(dt, I, I2, I_abs, T_in, flow, soc, V, IV, hours, frozenset())


def disturbed(v: Numbers, b: Floats) -> Numbers:
    """Numbers with the offsets `b` (…, 2) of inlet and heat in force."""
    return replace(v, inlet_offset=-b[..., :1], core_heat=b[..., 1:])


@dataclass(frozen=True, slots=True)
class Jacobian:
    """Slopes of the balances and of the readings.

    Attributes
    ----------
    A : ndarray (D + 2, D + 2), 1/s
        Of the rates of z by z.
    B_q : ndarray (D + 2, n), K/J
        Of the rates by the heat of each core.
    H : ndarray (n, D + 2)
        Of the readings by z.
    """

    A: Floats
    B_q: Floats
    H: Floats


def jacobian(system: System, z: Floats, correlation: float) -> Jacobian:
    """Differentiate at the state `z` (D + 2,) under the one interval of the system: one call each.

    Parameters
    ----------
    correlation : float, s
        Time constant of the offsets.
    """
    D, n = system.physics.states, system.physics.cells
    X, b = z[:-OFFSETS], z[-OFFSETS:]
    k = D + 1 + n
    nudge = np.zeros((k, k))
    np.fill_diagonal(nudge, PROBE)
    nudge = np.concatenate([nudge, -nudge])
    at = X + nudge[:, :D]
    w = replace(system.v, inlet_offset=-(b[0] + nudge[:, D : D + 1]), core_heat=b[1] + nudge[:, D + 1 :])
    moved = replace(system, v=w)
    f, r = moved.rates(at), moved.readings(at)
    slope, seen = ((x[:k] - x[k:]).T / (2.0 * PROBE) for x in (f, r))
    A, B_q, H = np.zeros((D + OFFSETS, D + OFFSETS)), np.zeros((D + OFFSETS, n)), np.zeros((n, D + OFFSETS))
    A[:D, : D + 1], A[:D, D + 1], B_q[:D] = slope[:, : D + 1], slope[:, D + 1 :].sum(axis=1), slope[:, D + 1 :]
    A[D, D] = A[D + 1, D + 1] = -1.0 / correlation
    H[:, : D + 1] = seen[:, : D + 1]
    # an effect that lacks an input has no slope
    return Jacobian(*(np.nan_to_num(x, posinf=0.0, neginf=0.0) for x in (A, B_q, H)))


def heated(j: Jacobian, system: System, z: Floats) -> Jacobian:
    """Let the offset of heat act like the heat of a current: more where resistance is higher in the model.

    If the model computes the heat from the voltage and not from the current, the offset acts on all cores alike.
    """
    X, one = z[None, :-OFFSETS], np.full(1, 1.0 / float(np.mean(system.v.string.R_e)))
    now = replace(system, v=disturbed(system.v, z[-OFFSETS:]))
    slope = (replace(now, u=replace(now.u, I2=now.u.I2 + one)).rates(X) - now.rates(X))[0]
    if not np.isfinite(slope).all() or not slope.any():
        return j
    A = j.A.copy()
    A[: len(slope), -1] = slope
    return replace(j, A=A)


@dataclass(frozen=True, slots=True)
class Tangent:
    """One step of `dt` seconds of the linear system.

    Attributes
    ----------
    Phi, Gamma : ndarray (D + 2, D + 2)
    jacobian : Jacobian
    disturbance : Disturbance
    dt : float, s
    made : dict
        Noise integrated over the step, by which inputs were measured in it; computed when first needed.
    """

    Phi: Floats
    Gamma: Floats
    jacobian: Jacobian
    disturbance: Disturbance
    dt: float
    made: dict[tuple[bool, bool], Floats] = field(default_factory=dict, compare=False, repr=False)

    @classmethod
    def of(cls, j: Jacobian, dt: float, disturbance: Disturbance) -> "Tangent":
        """Discretise the Jacobian."""
        M = len(j.A)
        F = np.zeros((2 * M, 2 * M))
        F[:M, :M], F[:M, M:] = j.A * dt, np.eye(M) * dt
        E = exponential(F)
        return cls(E[:M, :M].copy(), E[:M, M:].copy(), j, disturbance, dt)

    @property
    def H(self) -> Floats:
        """Slopes (n, D + 2) of the readings."""
        return self.jacobian.H

    def noise(self, inlet_known: bool, current_known: bool) -> Floats:
        """Covariance (D + 2, D + 2) of the noise of a step in which inlet and current were, or were not, measured."""
        which = inlet_known, current_known
        if which not in self.made:
            W = self.intensity(inlet_known=inlet_known, current_known=current_known)
            self.made[which] = gathered_noise(self.jacobian.A, W, self.dt)[1]
        return self.made[which]

    def intensity(self, *, inlet_known: bool, current_known: bool) -> Floats:
        """Intensity (D + 2, D + 2) of the white noise behind that covariance."""
        d, j = self.disturbance, self.jacobian
        W = 2.0 * d.correlation * d.heat_cell**2 * (j.B_q @ j.B_q.T)
        inlet = d.inlet if inlet_known else max(d.inlet, d.inlet_unknown)
        heat = d.heat_common if current_known else max(d.heat_common, d.heat_unknown)
        W[-2, -2], W[-1, -1] = 2.0 * inlet**2 / d.correlation, 2.0 * heat**2 / d.correlation
        return np.asarray(W, dtype=np.float64)
