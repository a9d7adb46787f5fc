r"""Rank of the observability matrix without any rounding.

The entries of [C; CA; CA²; …] span so many decades that double precision loses rank. The parameters of a string are
rational numbers, so the entries are rational too. Arithmetic modulo a prime maps zero to zero, and maps a number that
is not zero to zero with a probability of only one in 2³¹. A rank modulo a prime is therefore never too large, and the
larger of two such ranks is taken as the true one.
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import StringParameters, exchange

PRIMES = (2_147_483_647, 2_147_483_629)
"""The two greatest primes below 2³¹: a product of two residues fits into 64 bits."""

Residues = NDArray[np.int64]


def exact_rank(p: StringParameters, sensors: Sequence[int]) -> int:
    """Compute the rank of (A, C) as in rational arithmetic.

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
    The rows of C are repeatedly multiplied by A and reduced by the rows found before, until no new row is independent.
    This is done with integers modulo two primes; the greater rank is wrong with a probability of about (2n/2³¹)².

    References
    ----------
    Lin et al., Eq 20.

    Examples
    --------
    >>> p = StringParameters.of(30, C_c=268, C_s=18.8, R_e=3.5e-3, R_c=1.266, R_u=0.79, R_cc=32, C_f=11.33)
    >>> exact_rank(p, [1])
    60
    """
    return max(len(_closed(residues(p, prime), sensors, prime)) for prime in PRIMES)


def exact_ranks(p: StringParameters, sets: Sequence[Sequence[int]]) -> NDArray[np.int64]:
    """Exact rank of many sets of sensors of one string.

    Parameters
    ----------
    p : StringParameters
    sets : sequence of sequences of int
        1-based cells.

    Returns
    -------
    ndarray (len(sets),)
        0…2n each, as from `exact_rank`.

    Notes
    -----
    A sensor adds nothing to a set if another sensor of the set determines its reading. Such sensors are left out. Most
    sets then have one sensor, and sets that have become equal are computed once.

    References
    ----------
    Lin et al., Eq 20 and Table 3.
    """
    first, second = (_ranks(residues(p, prime), sets, prime) for prime in PRIMES)
    return np.maximum(first, second)


def residue(value: float, prime: int) -> int:
    """Residue of the rational number that a float is."""
    q = Fraction(value)
    return q.numerator * pow(q.denominator, -1, prime) % prime


def inverse(value: float, prime: int) -> int:
    """Residue of its reciprocal; zero for an infinite value."""
    return pow(residue(value, prime), -1, prime) if np.isfinite(value) else 0


def taken(p: StringParameters, prime: int) -> tuple[list[int], list[int]]:
    """Residues of the film's conductance and of the exchange e of each cell: film = C_f e (`thermal.string.film`)."""
    if p.coolant == "ntu" and np.isfinite(p.C_f):
        e = [residue(x, prime) for x in exchange(p)]
        return [residue(p.C_f, prime) * x % prime for x in e], e
    film, flow = [inverse(x, prime) for x in p.R_u], inverse(p.C_f, prime)
    return film, [x * flow % prime for x in film]


def residues(p: StringParameters, prime: int) -> Residues:
    """Build A (Eq 18, 21, corrected) with each entry as its residue: sums, products, quotients of the parameters.

    Returns
    -------
    ndarray (2n, 2n)
        0…prime − 1.
    """
    n = p.cells
    between = inverse(p.R_cc, prime)
    film, e = taken(p, prime)
    A = [[0] * (2 * n) for _ in range(2 * n)]
    stream = [0] * n  # share of each surface in the coolant at cell k
    for k in range(n):
        c, s = 2 * k, 2 * k + 1
        inside, outside, casing = inverse(p.R_c[k], prime), film[k], inverse(p.C_s[k], prime)
        A[c][s] = inside * inverse(p.C_c[k], prime)
        A[c][c] = -A[c][s]
        A[s][c] = inside * casing
        A[s][s] = -(inside + outside) * casing
        for j in range(k):
            A[s][2 * j + 1] += stream[j] * outside * casing
        for j in (k - 1, k + 1):
            if 0 <= j < n:
                A[s][2 * j + 1] += between * casing
                A[s][s] -= between * casing
        stream = [(1 - e[k]) * share % prime for share in stream]
        stream[k] = e[k]
    return np.array([[x % prime for x in row] for row in A], dtype=np.int64)


def _closed(A: Residues, sensors: Sequence[int], prime: int) -> Residues:
    """Rows that span the smallest space that contains C and is closed under A, each with its own pivot."""
    N = len(A)
    basis = np.zeros((N, N), np.int64)  # reduced: the pivot column of a row is zero in all others
    pivots: list[int] = []
    waiting = [np.eye(N, dtype=np.int64)[2 * k - 1] for k in sensors]
    while waiting and len(pivots) < N:
        row, r = waiting.pop(), len(pivots)
        row = (row - (row[pivots][:, None] * basis[:r] % prime).sum(axis=0)) % prime
        if not row.any():
            continue
        pivot = int(np.flatnonzero(row)[0])
        row = row * pow(int(row[pivot]), -1, prime) % prime
        basis[:r] = (basis[:r] - basis[:r, [pivot]] * row) % prime
        basis[r] = row
        pivots.append(pivot)
        waiting.append((row[:, None] * A % prime).sum(axis=0) % prime)
    return basis[: len(pivots)]


def _ranks(A: Residues, sets: Sequence[Sequence[int]], prime: int) -> NDArray[np.int64]:
    alone = {k: _closed(A, [k], prime) for k in sorted({k for s in sets for k in s})}
    # A sensor adds nothing if another one determines its reading: its unit row is then one of the reduced rows.
    within = {k: {int(j) // 2 + 1 for j in np.flatnonzero(_units(rows)) if j % 2} for k, rows in alone.items()}
    needed = [_independent(s, within) for s in sets]
    ranks = {s: len(_closed(A, s, prime)) for s in set(needed)}
    return np.array([ranks[s] for s in needed], np.int64)


def _units(rows: Residues) -> NDArray[np.bool_]:
    """Return whether each unit row is among reduced rows (r, N): (N,)."""
    there: NDArray[np.bool_] = rows[(rows != 0).sum(axis=1) == 1].any(axis=0)
    return there


def _independent(sensors: Sequence[int], within: Mapping[int, set[int]]) -> tuple[int, ...]:
    """Leave out sensors whose reading another sensor determines; of two that determine each other, the second."""
    kept: list[int] = []
    for k in sorted(sensors, key=lambda k: (-len(within[k]), k)):
        if not any(k in within[j] for j in kept):
            kept.append(k)
    return tuple(sorted(kept))
