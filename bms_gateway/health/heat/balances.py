"""The string's heat balances over one step of the heat filter, and how they move with what is not known.

Lin et al., Eq 1 and 16–18, sampled; heat at the casings is one more input, by which a change of R_u acts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from bms_gateway.health.heat.layout import Layout
from bms_gateway.observe.model import usable
from bms_gateway.thermal import ContinuousString, Floats, StringParameters, continuous, discretize
from bms_gateway.thermal.string import coolant_path

KELVIN = 273.15
LEAST_LOSS, MOST_LOSS = -1.5, 0.95
"""Share of the film's conductance that is lost: it acts on the gap at the start of a step, which is stable so far."""


@dataclass(frozen=True, slots=True)
class Balances:
    """Discrete balances of S strings of n cells.

    Attributes
    ----------
    Phi : ndarray (S, 2n, 2n)
    core, casing : ndarray (S, 2n, n), K/W
        What mean heat in the cores and at the casings does in a step.
    inlet0, inlet1 : ndarray (S, 2n)
        The inlet at the start and at the end of a step.
    M, m : ndarray (S, n, n), (S, n)
        Coolant at each cell, M T_s + m T_in.
    R_e, R_u, C : ndarray (S, n)
        Ω, K/W, and heat capacity of a whole cell, J/K.
    """

    Phi: Floats
    core: Floats
    casing: Floats
    inlet0: Floats
    inlet1: Floats
    M: Floats
    m: Floats
    R_e: Floats
    R_u: Floats
    C: Floats

    @classmethod
    def of(cls, strings: Sequence[StringParameters], dt: float) -> "Balances":
        """Discretise; equal strings share the work."""
        done: dict[bytes, Balances] = {}
        parts = []
        for p in map(usable, strings):
            key = b"".join(np.asarray(x).tobytes() for x in (p.C_c, p.C_s, p.R_e, p.R_c, p.R_u, p.R_cc, p.C_f))
            if key not in done:
                done[key] = _balances(p, dt)
            parts.append(done[key])
        return cls(**{f.name: np.stack([getattr(b, f.name) for b in parts]) for f in fields(cls)})

    def coolant(self, T_s: Floats, inlet: Floats) -> Floats:
        """Coolant (S, n) at each cell, °C."""
        return np.asarray(np.matmul(self.M, T_s[:, :, None])[:, :, 0] + self.m * inlet[:, None], dtype=np.float64)


def _balances(p: StringParameters, dt: float) -> Balances:
    """Balances of one string, without the axis of the strings."""
    s, n = continuous(p), p.cells
    B_s = np.zeros((2 * n, n))
    B_s[np.arange(1, 2 * n, 2), np.arange(n)] = 1.0 / p.C_s
    d = discretize(ContinuousString(s.A, np.hstack((s.B_q, B_s)), s.B_f), dt)
    M, m = coolant_path(p)
    return Balances(
        Phi=d.A,
        core=d.B_q[:, :n],
        casing=d.B_q[:, n:],
        inlet0=d.B_f0,
        inlet1=d.B_f1,
        M=M,
        m=m,
        R_e=p.R_e,
        R_u=p.R_u,
        C=p.C_c + p.C_s,
    )


def coupling(b: Balances, at: Layout, z: Floats, q: Floats, flux: Floats, current: Floats) -> tuple[Floats, Floats]:
    """How the numbers behind the temperatures act on these in one step.

    Parameters
    ----------
    b : Balances
    at : Layout
    z : ndarray (S, N)
    q, flux : ndarray (S, n), W
        Heat by the current, and heat from casing to coolant with R_u as identified.
    current : ndarray (S,), A
        Its mean; 0 where not known.

    Returns
    -------
    X : ndarray (S, 2n, N − 2n)
    moved : ndarray (S, 2n), K
        What they do now.
    """
    S, n = at.strings, at.cells
    lost = np.clip(z[:, at.flow], LEAST_LOSS, MOST_LOSS)
    warm = z[:, 0 : 2 * n : 2] + KELVIN
    X = np.zeros((S, 2 * n, at.states - at.nodes))
    o = at.nodes
    X[:, :, at.load - o] = np.matmul(b.core, q[:, :, None])[:, :, 0]
    X[:, :, at.brisk - o] = X[:, :, at.load - o]
    X[:, :, at.flow - o] = np.matmul(b.casing, flux[:, :, None])[:, :, 0]
    X[:, :, at.inlet - o] = b.inlet0 + b.inlet1
    X[:, :, at.entropy - o] = np.matmul(b.core, (-current[:, None] * warm)[:, :, None])[:, :, 0]
    row = np.arange(S)[:, None]
    core, casing = b.core.transpose(0, 2, 1)[row, at.told], b.casing.transpose(0, 2, 1)[row, at.told]  # (S, a, 2n)
    seen = at.seen[:, :, None]
    core, casing = np.where(seen, core, 0.0), np.where(seen, casing, 0.0)
    X[:, :, at.heat.start - o : at.heat.stop - o] = core.transpose(0, 2, 1)
    X[:, :, at.own_load.start - o : at.own_load.stop - o] = (core * q[row, at.told][:, :, None]).transpose(0, 2, 1)
    X[:, :, at.own_flow.start - o : at.own_flow.stop - o] = (casing * flux[row, at.told][:, :, None]).transpose(0, 2, 1)
    rest = z[:, o:].copy()
    rest[:, at.flow - o] = lost
    return X, np.asarray(np.matmul(X, rest[:, :, None])[:, :, 0], dtype=np.float64)
