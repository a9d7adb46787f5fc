"""Unknown inputs of a string as noise, and the covariance that this noise leaves after a step."""

from dataclasses import dataclass

import numpy as np

from bms_gateway.thermal.exponential import exponential
from bms_gateway.thermal.parameters import Floats

HEAT_GAIN_SD = 0.25
"""Least relative sd of heat that is computed from the voltage. The timing of voltage against current alone changes it
by 8 to 17 %, and cells that were measured in a calorimeter make 0.5 to 0.9 of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """Standard deviations of the unknown inputs of a model.

    Attributes
    ----------
    heat_common : float, W
        Heat error shared by the cells of a string.
    heat_cell : float, W
        Heat error of each cell on its own.
    inlet : float, K
        Measured inlet against the coolant at the first cell.
    inlet_unknown : float, K
        The same while no inlet is measured and the last value is held: the daily change of the air.
    heat_unknown : float, W
        Common heat error while no current is measured and the usual heat is assumed: a cell at work against at rest.
    correlation : float, s
        Duration of such errors: the time constant of a drive's phases.
    sensor : float, K
        White noise of a thermocouple reading.
    cooling_cell : float, W
        Heat that stays in the surface of each cell because it is cooled worse than in the model. With 0, cells have no
        such offset.

    References
    ----------
    Not in the paper; the difference between Lin et al., Eq 18 and a real string.
    """

    heat_common: float = 0.5
    heat_cell: float = 0.15
    inlet: float = 0.5
    inlet_unknown: float = 5.0
    heat_unknown: float = 10.0
    correlation: float = 600.0
    sensor: float = 0.1
    cooling_cell: float = 0.0


@dataclass(frozen=True, slots=True)
class Start:
    """Standard deviations of the temperatures of a string at its first reading, K.

    Attributes
    ----------
    level : float
        All temperatures together, about the first reading (or the inlet without a surface reading).
    gap : float
        Cores over surfaces, all cells together: 6.4 K ten minutes after a hot stop, more at once.
    slope : float
        Last cell over the middle one: the stream warms up by as much along a loaded string.
    cell : float
        Each cell on its own.
    cell_gap : float
        Core over surface of each cell on its own.

    References
    ----------
    Lin et al., Fig 8 for the size of `gap`.
    """

    level: float = 20.0
    gap: float = 8.0
    slope: float = 5.0
    cell: float = 1.0
    cell_gap: float = 0.5


def start_spread(cells: int, start: Start) -> Floats:
    """Covariance of the temperatures [T_c1, T_s1, …] before the first reading; most of it is common to the cells.

    Returns
    -------
    ndarray (2n, 2n), K²
        Symmetric, positive definite.
    """
    core = np.tile([1.0, 0.0], cells)
    along = np.repeat(np.linspace(-1.0, 1.0, cells) if cells > 1 else np.zeros(1), 2)
    P = start.level**2 + start.gap**2 * np.outer(core, core) + start.slope**2 * np.outer(along, along)
    P += start.cell**2 * np.kron(np.eye(cells), np.ones((2, 2))) + start.cell_gap**2 * np.diag(core)
    return np.asarray(P, dtype=np.float64)


def gathered_noise(A: Floats, W: Floats, dt: float) -> tuple[Floats, Floats]:
    """Transition and covariance that white noise of intensity `W` leaves after `dt` seconds, exactly.

    Van Loan's exponential contains exp(−A t), which overflows over a parked night. It is therefore computed for
    dt/2^k, which is short against the fastest time constant, and doubled k times: Q(2t) = Q(t) + Φ(t) Q(t) Φ(t)ᵀ.

    Parameters
    ----------
    A, W : ndarray (M, M)
        1/s and K²/s.
    dt : float, s

    Returns
    -------
    Phi, Q : ndarray (M, M)
        `Q` is symmetric.

    References
    ----------
    C. F. Van Loan, Computing integrals involving the matrix exponential, IEEE TAC 23 (1978).
    """
    M = len(A)
    norm = float(np.abs(A).sum(axis=0).max()) * dt
    doublings = max(0, int(np.ceil(np.log2(max(norm, 1.0)))))
    F = np.zeros((2 * M, 2 * M))
    F[:M, :M], F[:M, M:], F[M:, M:] = -A, W, A.T
    E = exponential(F * (dt / 2**doublings))
    Phi = E[M:, M:].T
    Q = Phi @ E[:M, M:]
    for _ in range(doublings):
        Q = Q + Phi @ Q @ Phi.T
        Phi = Phi @ Phi
    return Phi, (Q + Q.T) / 2.0
