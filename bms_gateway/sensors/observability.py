r"""What surface sensors can tell of the cores of a string.

Three answers, because they differ. The *exact rank* of the observability matrix is what noise-free readings would
determine; it is found without any rounding. The *paper's rank* is that of the same matrix in double precision: its
entries span so many decades that rounding alone loses rank, but the published tables rest on it, so it is reproduced
under its own name. The *steady standard deviation* of each core is what a user can use.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from bms_gateway.thermal import Disturbance, Floats, StringParameters, continuous, exchange, gathered_noise

PRIMES = (2_147_483_647, 2_147_483_629)
"""The two greatest below 2³¹: a product of residues fits into 64 bits."""


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


def exact_rank(p: StringParameters, sensors: Sequence[int]) -> int:
    """Rank of (A, C) as if computed with rational numbers.

    Parameters
    ----------
    p : StringParameters
        Taken as the rational numbers that the floats are; so is the exchange of an NTU coolant node.
    sensors : sequence of int
        1-based cells.

    Returns
    -------
    int
        0…2n.

    Notes
    -----
    The rows of C are multiplied by A and reduced against what is there until nothing new comes, in the integers modulo
    a prime. Modulo a prime the rank is never too great, and too small with a chance of about 2n/2³¹; two primes and
    the greater of their ranks leave 1e-14. About 10 ms for 40 cells.
    """
    return max(_krylov_rank(_residues(p, prime), [2 * k - 1 for k in sensors], prime) for prime in PRIMES)


def paper_rank(p: StringParameters, sensors: Sequence[int]) -> int:
    """Rank of the observability matrix in double precision, with A in 1/s.

    Singular values below max(size)·ε·(the greatest) count as zero.

    References
    ----------
    Lin et al., Tables 2 and 3, Fig 12 and 13, which are artefacts of this rounding.
    """
    A = continuous(p).A
    rows = [np.eye(len(A))[[2 * k - 1 for k in sensors]]]
    for _ in range(len(A) - 1):
        rows.append(rows[-1] @ A)
    return int(np.linalg.matrix_rank(np.vstack(rows))) if len(sensors) else 0


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


def _residues(p: StringParameters, prime: int) -> NDArray[np.int64]:
    """Build A with each entry as its residue: sums, products and quotients of rational parameters."""

    def residue(value: float) -> int:
        q = Fraction(value)
        return q.numerator * pow(q.denominator, -1, prime) % prime

    def inverse(value: float) -> int:
        return pow(residue(value), -1, prime) if np.isfinite(value) else 0

    n = p.cells
    e = [residue(x) for x in exchange(p)] if p.coolant == "ntu" else [inverse(x) * inverse(p.C_f) for x in p.R_u]
    A = [[0] * (2 * n) for _ in range(2 * n)]
    stream = [0] * n  # share of each surface in the coolant that meets cell k
    for k in range(n):
        c, s = 2 * k, 2 * k + 1
        inside, outside, casing = inverse(p.R_c[k]), inverse(p.R_u[k]), inverse(p.C_s[k])
        A[c][s] = inside * inverse(p.C_c[k])
        A[c][c] = -A[c][s]
        A[s][c] = inside * casing
        A[s][s] = -(inside + outside) * casing
        for j in range(k):
            A[s][2 * j + 1] += stream[j] * outside * casing
        for j in (k - 1, k + 1):
            if 0 <= j < n:
                A[s][2 * j + 1] += inverse(p.R_cc) * casing
                A[s][s] -= inverse(p.R_cc) * casing
        stream = [(1 - e[k]) * share % prime for share in stream]
        stream[k] = e[k]
    return np.array([[x % prime for x in row] for row in A], dtype=np.int64)


def _krylov_rank(A: NDArray[np.int64], start: Sequence[int], prime: int) -> int:
    """Dimension of the smallest space of rows that holds the unit rows `start` and is closed under A."""
    N = len(A)
    basis = np.zeros((0, N), np.int64)  # reduced: the pivot column of a row is zero in all others
    pivots: list[int] = []
    waiting = [np.eye(N, dtype=np.int64)[k] for k in start]
    while waiting and len(pivots) < N:
        row = waiting.pop()
        row = (row - (row[pivots][:, None] * basis % prime).sum(axis=0)) % prime
        if not row.any():
            continue
        pivot = int(np.flatnonzero(row)[0])
        row = row * pow(int(row[pivot]), -1, prime) % prime
        basis = np.vstack(((basis - basis[:, [pivot]] * row) % prime, row))
        pivots.append(pivot)
        waiting.append((row[:, None] * A % prime).sum(axis=0) % prime)
    return len(pivots)
