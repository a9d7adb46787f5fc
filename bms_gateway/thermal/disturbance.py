"""What drives a string beside its known inputs, and how it gathers over a step."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from bms_gateway.thermal.parameters import Floats


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What the model does not know while it runs, as standard deviations.

    Attributes
    ----------
    heat_common : float, W
        Heat error shared by the cells of a string.
    heat_cell : float, W
        Heat error of each cell on its own.
    inlet : float, K
        Measured inlet against the coolant that meets the first cell.
    inlet_unknown : float, K
        The same while no inlet is measured and the last one is held: a day's swing of the air.
    heat_unknown : float, W
        Common heat error while no current is measured and the usual heat is assumed: a cell at work against at rest.
    correlation : float, s
        How long such errors last: the time constant of a drive's phases.
    sensor : float, K
        White noise of a thermocouple reading.

    References
    ----------
    Not in the paper; what stands between Lin et al., Eq 18 and a real string.
    """

    heat_common: float = 0.5
    heat_cell: float = 0.15
    inlet: float = 0.5
    inlet_unknown: float = 5.0
    heat_unknown: float = 10.0
    correlation: float = 600.0
    sensor: float = 0.1


def gathered_noise(A: Floats, W: Floats, dt: float) -> tuple[Floats, Floats]:
    """Transition and covariance that white noise of intensity `W` leaves after `dt` seconds, exactly.

    Van Loan's exponential holds exp(−A t), which overflows over a parked night; it is therefore taken for a fraction
    dt/2^k short against the fastest pole and doubled k times: Q(2t) = Q(t) + Φ(t) Q(t) Φ(t)ᵀ.

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
    E = scipy.linalg.expm(F * (dt / 2**doublings))
    Phi = E[M:, M:].T
    Q = Phi @ E[:M, M:]
    for _ in range(doublings):
        Q = Q + Phi @ Q @ Phi.T
        Phi = Phi @ Phi
    return Phi, (Q + Q.T) / 2.0
