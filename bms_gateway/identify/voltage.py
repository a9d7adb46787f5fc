r"""Heat of a cell from its voltage: q = I (U − V), where U is the cell's voltage without current.

Electrical power that does not reach the terminals becomes heat by any mechanism: ohmic, charge transfer, diffusion,
cold or warm. Only U is unknown. It is tracked by recursive least squares with forgetting on

.. math::
    V = U_0 + k\,Q - R_0 I - R_1 \bar I, \qquad Q = \int I\,dt, \quad \tau \dot{\bar I} = I - \bar I

where k Q describes the slope of the open-circuit voltage over the moved charge, and R_1 Ī the polarisation that builds
up in half a minute. Without it, U would follow the polarisation of a drive's mean current, and this heat would be
missing.

The energy balance needs only means over a tick: mean heat = U·mean(I) − mean(I·V). An error of U is multiplied by the
mean current, not by its square, so it cancels in a profile that charges and discharges. Entropic (reversible) heat is
not included.

Current and voltage must be sampled at the same time: a voltage sampled before a step of the current and multiplied with
the current after it lost 25 % of the heat on a measured cell. At least, average I·V by the trapezoid over the stamps.
"""

import math
from dataclasses import dataclass
from operator import mul

HORIZON = 600.0
"""s of memory: long against polarisation (tens of seconds), short against a slow warming that changes R_0."""
LEARN = 120.0
"""s of current in both directions before U is used."""
VOLT_SD = 0.02
"""V: hysteresis and polarisation of a lithium-ion cell that the equation does not describe …"""
ALIKE_S = 5.0
"""… with this correlation time, s."""
POLARISES_S = 25.0
"""τ, s: between charge transfer (seconds) and diffusion (minutes)."""
OHM_SD, OHM_WALK = 0.1, 1e-3
"""Ω per cell: size of R_0 and R_1, and their change within `HORIZON`."""


@dataclass(frozen=True, slots=True)
class VoltageHeat:
    """Results of one tick of voltage.

    Attributes
    ----------
    heat, heat_sd : float
        W; NaN while learning.
    open_circuit, open_circuit_sd : float
        U, V.
    resistance, resistance_sd : float
        R_0 + R_1, Ω: resistance to a lasting current.

    References
    ----------
    In place of I²R_e in Lin et al., Eq 1.
    """

    heat: float
    heat_sd: float
    open_circuit: float
    open_circuit_sd: float
    resistance: float
    resistance_sd: float


class VoltageTracker:
    """Open-circuit voltage and electrical resistance of one cell (or of a string, per cell or in all), online.

    Parameters
    ----------
    capacity : float
        Ah; limits the open-circuit slope. The order of magnitude is enough.
    cells : int
        Cells in series behind the voltage; heat, U and resistance are totals of all of them.
    """

    def __init__(self, capacity: float = 2.5, cells: int = 1) -> None:
        self._slope_sd = 0.5 * cells / capacity  # V/Ah: a cell's whole curve spans half a volt or more
        self._volt_sd = VOLT_SD * cells
        self._cells = cells
        self.reset()

    def reset(self) -> None:
        """Reset: after a gap the moved charge is unknown and hysteresis starts anew."""
        self._theta = [0.0] * 4  # U_0, k, R_0, R_1
        self._P: list[list[float]] = []
        self._Q = self._lagged = 0.0
        self._learnt = 0.0
        self._swing = (0.0, 0.0)

    def update(self, current: float, voltage: float, power: float, dt: float) -> VoltageHeat:
        """Include the means of one tick.

        Parameters
        ----------
        current, voltage, power : float
            Means of current (discharge positive), voltage and their product: A, V, W. With a NaN, nothing is learnt and
            this tick has no heat.
        dt : float
            s; more than a minute counts as a gap.
        """
        if dt > 60.0:
            self.reset()
        if not (math.isfinite(current) and math.isfinite(voltage) and math.isfinite(power)):
            return self._out(math.nan, math.nan)
        moved = current * dt / 3600.0
        self._Q += moved / 2.0  # charge at mid-tick belongs to the means of the tick
        if not self._P:
            self._theta[0] = voltage
            sds = 0.3 * self._cells, self._slope_sd, OHM_SD * self._cells, OHM_SD * self._cells
            self._P = [[sd**2 if i == j else 0.0 for j in range(4)] for i, sd in enumerate(sds)]
        apart, kept = self._lagged - current, math.exp(-dt / POLARISES_S)
        self._learn((1.0, -self._Q, -current, -current - apart * (1.0 - kept) * POLARISES_S / dt), voltage, dt)
        self._lagged = current + apart * kept
        self._learnt += dt
        low, high = self._swing
        self._swing = (min(low, current), max(high, current))
        out = self._out(current, power)
        self._Q += moved / 2.0
        return out

    def _learn(self, phi: tuple[float, ...], voltage: float, dt: float) -> None:
        """Learn from V = φᵀθ."""
        P, theta, share = self._P, self._theta, dt / HORIZON
        # random walks whose sd over the horizon is the change of the quantities within it
        walks = self._volt_sd / 2.0, self._slope_sd / 20.0, OHM_WALK * self._cells, OHM_WALK * self._cells
        for i, walk in enumerate(walks):
            P[i][i] += walk**2 * share
        h = [sum(map(mul, row, phi)) for row in P]
        S = sum(map(mul, h, phi)) + self._volt_sd**2 * max(1.0, ALIKE_S / dt)
        r = (voltage - sum(map(mul, theta, phi))) / S
        self._theta = [x + a * r for x, a in zip(theta, h, strict=True)]
        self._P = [[x - a * b / S for x, b in zip(row, h, strict=True)] for row, a in zip(P, h, strict=True)]

    def _out(self, current: float, power: float) -> VoltageHeat:
        ready = self._learnt >= LEARN and self._swing[0] < 0.0 < self._swing[1]
        if not self._P:
            return VoltageHeat(math.nan, math.nan, math.nan, 0.0, math.nan, 0.0)
        (U_0, k, R_0, R_1), P, Q = self._theta, self._P, self._Q
        U, U_sd = U_0 - k * Q, math.sqrt(max(0.0, P[0][0] - 2.0 * Q * P[0][1] + Q**2 * P[1][1]))
        R, R_sd = R_0 + R_1, math.sqrt(max(0.0, P[2][2] + 2.0 * P[2][3] + P[3][3]))
        if not ready or not math.isfinite(current):
            return VoltageHeat(math.nan, math.nan, U if ready else math.nan, U_sd, R if ready else math.nan, R_sd)
        return VoltageHeat(U * current - power, abs(current) * U_sd, U, U_sd, R, R_sd)
