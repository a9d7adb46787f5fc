r"""Heat of a cell from its voltage: q = I (U − V), where U is what the cell would show without current.

Electrical power that does not reach the terminals becomes heat, whatever the mechanism: ohmic, charge transfer,
diffusion, cold or warm. All that is missing is U. It is tracked by recursive least squares with forgetting on

.. math::
    V = U_0 + k\,Q - R_{el} I, \qquad Q = \int I\,dt

where k Q takes up the slope of the open-circuit voltage over the charge moved. The energy balance needs only means over
a tick: mean heat = U·mean(I) − mean(I·V). An error of U enters with the mean current, not with its square, so a
profile that charges and discharges averages it out. Entropic (reversible) heat is not in it.

Current and voltage must belong together: a voltage sampled before a step of the current and multiplied with the current
after it cost 25 % of the heat on a measured cell. Average I·V by the trapezoid over the samples' own stamps, at least.
"""

import math
from dataclasses import dataclass

HORIZON = 600.0
"""s of memory: long against polarisation (tens of seconds), short against a slow warming that changes R_el."""
LEARN = 120.0
"""s of current in both directions before U is believed."""
VOLT_SD = 0.02
"""V: hysteresis and polarisation of a lithium-ion cell that a straight line leaves over."""


@dataclass(frozen=True, slots=True)
class VoltageHeat:
    """What one tick of voltage says.

    Attributes
    ----------
    heat, heat_sd : float
        W; NaN while learning.
    open_circuit, open_circuit_sd : float
        U, V.
    resistance, resistance_sd : float
        R_el, Ω.

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
        Ah; sets how far the open-circuit slope may go. Any order of magnitude will do.
    cells : int
        Cells in series behind the voltage; heat, U and R_el are those of all of them together.
    """

    def __init__(self, capacity: float = 2.5, cells: int = 1) -> None:
        self._slope_sd = 0.5 * cells / capacity  # V/Ah: a cell's whole curve spans half a volt or more
        self._volt_sd = VOLT_SD * cells
        self._cells = cells
        self.reset()

    def reset(self) -> None:
        """Forget: after a gap the charge moved is unknown and hysteresis starts anew."""
        self._theta = (0.0, 0.0, 0.0)
        self._P = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # P_00, P_01, P_02, P_11, P_12, P_22: six numbers need no arrays
        self._Q = 0.0
        self._learnt = 0.0
        self._swing = (0.0, 0.0)

    def update(self, current: float, voltage: float, power: float, dt: float) -> VoltageHeat:
        """Take in the means of one tick.

        Parameters
        ----------
        current, voltage, power : float
            Means of current (discharge positive), voltage and their product: A, V, W. NaN in any: nothing is learnt
            and there is no heat for this tick.
        dt : float
            s; more than a minute counts as a gap.
        """
        if dt > 60.0:
            self.reset()
        if not (math.isfinite(current) and math.isfinite(voltage) and math.isfinite(power)):
            return self._out(math.nan, math.nan)
        moved = current * dt / 3600.0
        self._Q += moved / 2.0  # charge at mid-tick belongs to the means of the tick
        if not any(self._P):
            self._theta = voltage, 0.0, 0.0
            self._P = (0.3 * self._cells) ** 2, 0.0, 0.0, self._slope_sd**2, 0.0, (0.1 * self._cells) ** 2
        self._learn(current, voltage, dt)
        self._learnt += dt
        low, high = self._swing
        self._swing = (min(low, current), max(high, current))
        out = self._out(current, power)
        self._Q += moved / 2.0
        return out

    def _learn(self, current: float, voltage: float, dt: float) -> None:
        U, k, R = self._theta
        P_00, P_01, P_02, P_11, P_12, P_22 = self._P
        # random walks whose sd over the horizon is what the quantities do within it
        share = dt / HORIZON
        P_00 += (self._volt_sd / 2.0) ** 2 * share
        P_11 += (self._slope_sd / 20.0) ** 2 * share
        P_22 += (1e-3 * self._cells) ** 2 * share
        # V = φᵀθ with φ = (1, −Q, −I); h = P φ
        q, i = -self._Q, -current
        h_0 = P_00 + P_01 * q + P_02 * i
        h_1 = P_01 + P_11 * q + P_12 * i
        h_2 = P_02 + P_12 * q + P_22 * i
        noise = self._volt_sd**2 * max(1.0, 20.0 / dt)  # neighbours within ~20 s share their polarisation
        S = h_0 + q * h_1 + i * h_2 + noise
        r = (voltage - (U + q * k + i * R)) / S
        self._theta = U + h_0 * r, k + h_1 * r, R + h_2 * r
        self._P = (
            P_00 - h_0 * h_0 / S,
            P_01 - h_0 * h_1 / S,
            P_02 - h_0 * h_2 / S,
            P_11 - h_1 * h_1 / S,
            P_12 - h_1 * h_2 / S,
            P_22 - h_2 * h_2 / S,
        )

    def _out(self, current: float, power: float) -> VoltageHeat:
        U_0, k, R = self._theta
        P_00, P_01, _, P_11, _, P_22 = self._P
        U, U_sd = U_0 - k * self._Q, math.sqrt(max(0.0, P_00 - 2.0 * self._Q * P_01 + self._Q**2 * P_11))
        R_sd = math.sqrt(max(0.0, P_22))
        ready = self._learnt >= LEARN and self._swing[0] < 0.0 < self._swing[1]
        if not ready or not math.isfinite(current):
            return VoltageHeat(math.nan, math.nan, U if ready else math.nan, U_sd, R if ready else math.nan, R_sd)
        return VoltageHeat(U * current - power, abs(current) * U_sd, U, U_sd, R, R_sd)
