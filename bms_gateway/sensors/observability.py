r"""What surface sensors can tell of the cores of a string.

Three answers, because they differ. The *exact rank* of the observability matrix is what noise-free readings would
determine; it is found without any rounding. The *paper's rank* is that of the same matrix in double precision: its
entries span so many decades that rounding alone loses rank, but the published tables rest on it, so it is reproduced
under its own name. The *steady standard deviation* of each core is what a user can use.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from bms_gateway.sensors.exact import exact_rank
from bms_gateway.sensors.paper import paper_rank
from bms_gateway.thermal import Disturbance, Floats, StringParameters, continuous, gathered_noise


@dataclass(frozen=True, slots=True)
class Observability:
    """The three answers for one set of sensors.

    Attributes
    ----------
    states : int
        2n.
    exact_rank, paper_rank : int
    core_sd : ndarray (n,), K
    """

    states: int
    exact_rank: int
    paper_rank: int
    core_sd: Floats

    @property
    def observable(self) -> bool:
        """Whether noise-free readings determine every temperature."""
        return self.exact_rank == self.states

    @property
    def worst_cell(self) -> int:
        """Cell (1-based) with the least certain core."""
        return int(np.argmax(self.core_sd)) + 1


def observability(
    p: StringParameters, sensors: Sequence[int], disturbance: Disturbance | None = None, *, dt: float = 1.0
) -> Observability:
    """Give the three answers for surface sensors at the cells `sensors` (1-based).

    Examples
    --------
    >>> p = StringParameters.of(5, C_c=268, C_s=18.8, R_e=3.5e-3, R_c=1.266, R_u=0.79, R_cc=4, C_f=11.33)
    >>> o = observability(p, (1, 5))
    >>> o.exact_rank, o.observable, np.round(o.core_sd, 2)
    (10, True, array([0.69, 0.64, 0.63, 0.63, 0.48]))
    """
    return Observability(
        2 * p.cells, exact_rank(p, sensors), paper_rank(p, sensors), steady_core_sd(p, sensors, disturbance, dt=dt)
    )


def steady_core_sd(
    p: StringParameters, sensors: Sequence[int], disturbance: Disturbance | None = None, *, dt: float = 1.0
) -> Floats:
    """Tell the standard deviation at which each core's estimate settles, parameters taken for true.

    Parameters
    ----------
    p : StringParameters
    sensors : sequence of int
        1-based cells read every step.
    disturbance : Disturbance, optional
    dt : float, s

    Returns
    -------
    ndarray (n,), K

    Notes
    -----
    Every disturbance is white here, with the low-frequency intensity 2τσ² of the lasting one it stands for. That ranks
    placements by one Riccati equation of 2n states and errs to the safe side: an observer that follows the lasting
    errors as states of their own does better, by a sixth (two sensors on twelve cells) to a half (one cell).
    """
    d = disturbance or Disturbance()
    s = continuous(p)
    common = s.B_q.sum(axis=1)
    W = d.heat_common**2 * np.outer(common, common) + d.heat_cell**2 * (s.B_q @ s.B_q.T)
    W = 2.0 * d.correlation * (W + d.inlet**2 * np.outer(s.B_f, s.B_f))
    Phi, Q = gathered_noise(s.A, W, dt)
    if len(sensors):
        C = np.eye(len(Phi))[[2 * k - 1 for k in sensors]]
        R = d.sensor**2 * np.eye(len(sensors))
        P = scipy.linalg.solve_discrete_are(Phi.T, C.T, Q, R)
        PC = P @ C.T
        P = P - PC @ np.linalg.solve(C @ PC + R, PC.T)
    else:
        P = scipy.linalg.solve_discrete_lyapunov(Phi, Q)
    return np.sqrt(np.diag(P)[0::2])
