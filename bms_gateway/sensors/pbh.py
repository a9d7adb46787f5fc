r"""The Popov–Belevitch–Hautus test of a string, by polynomials and without rounding.

Sensors fail to determine a string exactly if an eigenvector of A is zero at all of them. If cells have equal C_c, C_s
and R_c, the cores can be eliminated: λ is an eigenvalue of A if and only if μ = C_s λ + λ/(R_c λ + 1/C_c) is an
eigenvalue of the n surfaces' coupling G, with the same surfaces in its vector v; two λ belong to each μ. If neighbours
conduct, the rows of G v = μ v give v_2, v_3, … one after the other from v_1 = 1, as polynomials in μ,

.. math::
    v_{k+1} = v_k + R_{cc} \left( \mu v_k - (t_k - v_k)/R_{u,k} - (v_{k-1} - v_k)/R_{cc} \right), \qquad
    t_{k+1} = (1 - e_k) t_k + e_k v_k,

and the last row gives the characteristic polynomial χ. The roots that χ shares with v_k of every sensor are hidden,
with their multiplicity: twice the degree of a greatest common divisor counts the hidden states. All this is done modulo
the primes of `exact`, but otherwise independently of it: each checks the other. For 1,000 cells it takes a second.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from bms_gateway.sensors.exact import PRIMES, Residues, residue, taken
from bms_gateway.thermal import Floats, StringParameters


def hidden_states(p: StringParameters, sensors: Sequence[int]) -> int | None:
    """Count the states that noise-free readings of some surfaces leave undetermined.

    Parameters
    ----------
    p : StringParameters
        Taken as the rational numbers that the floats are.
    sensors : sequence of int
        1-based cells.

    Returns
    -------
    int or None
        2n − rank of the observability matrix. None if the cells' C_c, C_s, R_c differ, or, without conduction, R_u: the
        test then has no such form.

    References
    ----------
    Lin et al., Eq 20–21, whose rank this computes in another way. M. L. J. Hautus, Controllability and observability
    conditions of linear autonomous systems, Proc. Kon. Ned. Akad. Wet. A 72 (1969).

    Examples
    --------
    >>> p = StringParameters.of(12, C_c=268, C_s=18.8, R_e=3.5e-3, R_c=1.266, R_u=0.79, R_cc=32)
    >>> hidden_states(p, [2, 5, 8, 11]), hidden_states(p, [2, 5, 8, 12])
    (2, 0)
    """
    conducts = bool(np.isfinite(p.R_cc)) and p.cells > 1
    if not all(_alike(x) for x in ((p.C_c, p.C_s, p.R_c) if conducts else (p.C_c, p.C_s, p.R_c, p.R_u))):
        return None
    if not sensors:
        return 2 * p.cells
    if not conducts:
        # Equal cells on one stream: a surface shows all cells that the stream has passed. Without a stream, only its
        # own.
        told = max(sensors) if np.isfinite(p.C_f) else len(set(sensors))
        return 2 * (p.cells - told)
    return 2 * min(_shared_roots(p, sensors, prime) for prime in PRIMES)


def _alike(x: Floats) -> bool:
    return bool((x == x[0]).all())


def _shared_roots(p: StringParameters, sensors: Sequence[int], prime: int) -> int:
    *v, shared = _polynomials(p, prime)
    for k in sorted(set(sensors)):
        shared = _common(shared, v[k - 1], prime)
        if len(shared) == 1:
            break
    return len(shared) - 1


def _polynomials(p: StringParameters, prime: int) -> Iterator[Residues]:
    """Yield v_1 … v_n and a multiple of χ: coefficients from the constant up, without leading zeros."""
    n, R_cc = p.cells, residue(p.R_cc, prime)
    outside, e = taken(p, prime)
    before, v, t = np.zeros(n + 1, np.int64), np.zeros(n + 1, np.int64), np.zeros(n + 1, np.int64)
    v[0] = 1
    for k in range(n):
        yield v[: k + 1]
        raised = np.roll(v, 1)  # μ v; its degree is below n, so nothing wraps around
        film = (t - v) % prime * outside[k] % prime
        neighbour = (before - v) % prime if k else 0
        onward = ((raised - film) % prime * R_cc - neighbour) % prime
        before, t = v, ((1 - e[k]) % prime * t + e[k] * v % prime) % prime
        v = (onward + v) % prime if k < n - 1 else onward
    yield v


def _common(a: Residues, b: Residues, prime: int) -> Residues:
    """Greatest common divisor of two polynomials modulo a prime, by Euclid."""
    while len(b):
        a, b = b, _remainder(a, b, prime)
    return a


def _remainder(a: Residues, b: Residues, prime: int) -> Residues:
    a = a.copy()
    leading = pow(int(b[-1]), -1, prime)
    for top in range(len(a) - 1, len(b) - 2, -1):
        if factor := int(a[top]) * leading % prime:
            at = top - len(b) + 1
            a[at : top + 1] = (a[at : top + 1] - factor * b) % prime
    left = np.flatnonzero(a[: len(b) - 1])
    return a[: left[-1] + 1] if len(left) else a[:0]
