"""The truth that tests measure against: its own right-hand side, its own integrators, nothing of the package.

A string of n cells is written out here cell by cell, straight from the heat balances, and integrated by LSODA with
tight tolerances (`lsoda`) or, many times faster and for a whole batch of strings at once, by sub-stepped RK4 (`rk4`;
where R_e does not depend on temperature, a step is a sum of steps that are worked out once). The two are checked
against each other in `test_truth.py`. All batches share the current and the inlet unless these carry a batch axis
themselves.

Current is constant within a step (mean of the square = square of the mean), so it is free of aliasing by construction.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.integrate import solve_ivp

TABLE_1 = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79}
"""Lin et al., Table 1: A123 32157."""
C_F = 1.184 * 1007 * 9.5e-3
"""W/K: air at 25 °C, 9.5 L/s (the paper's flow)."""


@dataclass(frozen=True)
class TruthString:
    """Parameters (…, n); `B` [K] lets R_e fall as exp(B(1/T_c − 1/298.15)); `coolant` is bulk or ntu."""

    C_c: np.ndarray
    C_s: np.ndarray
    R_e: np.ndarray
    R_c: np.ndarray
    R_u: np.ndarray
    R_cc: float = np.inf
    C_f: float = np.inf
    coolant: str = "bulk"
    B: float = 0.0
    _batch: tuple = field(default=(), repr=False)

    @classmethod
    def of(cls, cells=1, *, batch=(), R_cc=np.inf, C_f=np.inf, coolant="bulk", B=0.0, **values):
        """Table 1 spread over the cells, with `values` (anything that broadcasts to batch + (n,)) in its place."""
        v = {k: np.array(np.broadcast_to(values.get(k, x), (*batch, cells)), float) for k, x in TABLE_1.items()}
        return cls(**v, R_cc=R_cc, C_f=C_f, coolant=coolant, B=B, _batch=tuple(batch))

    @property
    def cells(self):
        return self.C_c.shape[-1]

    @cached_property
    def _film(self):
        """R_u of each cell and, where the stream is ntu, the share of the gap that it takes up."""
        shares = [None] * self.cells
        if self.coolant == "ntu":  # the stream leaves as near to the casing as exp(−1/(R_u C_f)) of the gap
            shares = [1 - np.exp(-1 / (self.R_u[..., k] * self.C_f)) for k in range(self.cells)]
        return list(zip(_by_cell(self.R_u), shares, strict=True))

    def to_coolant(self, T_s, T_in):
        """W from each casing to the stream, which warms from cell to cell; without bound on C_f it does not."""
        if not np.isfinite(self.C_f):
            return (T_s - np.asarray(T_in)[..., None]) / self.R_u
        taken, stream = [], T_in if T_s.ndim > 1 else float(T_in)
        for T, (R_u, share) in zip(_by_cell(T_s), self._film, strict=True):
            gap = T - stream
            taken.append(gap / R_u if share is None else self.C_f * gap * share)
            stream = stream + taken[-1] / self.C_f
        return np.stack(taken, axis=-1) if T_s.ndim > 1 else np.array(taken)

    def rates(self, T_c, T_s, T_in, I2, heat=None):
        """dT_c/dt and dT_s/dt; `I2` A² (…,), or `heat` W (…, n) in place of I²R_e."""
        if heat is None:
            R_e = self.R_e * np.exp(self.B * (1 / (T_c + 273.15) - 1 / 298.15)) if self.B else self.R_e
            heat = np.asarray(I2)[..., None] * R_e
        outward = (T_c - T_s) / self.R_c
        to_coolant = self.to_coolant(T_s, T_in)
        between = np.zeros_like(T_s)
        if self.cells > 1 and np.isfinite(self.R_cc):
            flux = (T_s[..., 1:] - T_s[..., :-1]) / self.R_cc  # from cell k+1 into cell k
            between[..., :-1] += flux
            between[..., 1:] -= flux
        return (heat - outward) / self.C_c, (outward - to_coolant + between) / self.C_s


def _by_cell(x):
    """Along the last axis: numbers of Python where there is no batch, which are many times faster one by one."""
    return x.tolist() if x.ndim == 1 else [x[..., k] for k in range(x.shape[-1])]


def rk4(truth, current, inlet, T_0, *, dt=1.0, substeps=2, heat=None):
    """Integrate over K steps of `dt`.

    current : (K, …) A, constant in each step. inlet : (K + 1, …) °C, straight lines between instants.
    T_0 : °C, scalar, or (core, surface) each broadcastable to (…, n). heat : (K, …, n) W in place of I²R_e, or None.
    Returns core and surface (K + 1, …, n).
    """
    current, inlet = np.asarray(current, float), np.asarray(inlet, float)
    T_c0, T_s0 = T_0 if isinstance(T_0, tuple) else (T_0, T_0)
    x = np.stack([np.broadcast_to(T, truth.C_c.shape) for T in (T_c0, T_s0)]).astype(float)
    how = truth, x, current**2, inlet, heat, dt / substeps, substeps
    states = by_superposition(*how) if truth.B == 0.0 else step_by_step(*how)
    return np.ascontiguousarray(states[:, 0]), np.ascontiguousarray(states[:, 1])


def _step(truth, x, inlet, I2, q, h, substeps):
    """One step from x (2, …, n), core and casing; `inlet` at its begin and at its end."""

    def f(x, T_in):
        return np.stack(truth.rates(x[0], x[1], T_in, I2, q))

    a, b = inlet
    for j in range(substeps):
        T0, Tm, T1 = (a + (b - a) * (j + s) / substeps for s in (0, 0.5, 1))
        k1 = f(x, T0)
        k2 = f(x + h / 2 * k1, Tm)
        k3 = f(x + h / 2 * k2, Tm)
        k4 = f(x + h * k3, T1)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def step_by_step(truth, x, I2, inlet, heat, h, substeps):
    states = np.empty((len(I2) + 1, *x.shape))
    states[0] = x
    for k in range(len(I2)):
        q = None if heat is None else heat[k]
        states[k + 1] = x = _step(truth, x, inlet[k : k + 2], I2[k], q, h, substeps)
    return states


AT_ONCE = 256
"""Steps whose inputs are prepared together."""


def by_superposition(truth, x, I2, inlet, heat, h, substeps):
    """The same where the balances are linear: a step is the sum of the steps of each state and input alone."""
    shape, n = truth.C_c.shape, truth.cells
    batch = shape[:-1]
    K, alone = len(I2), 3 * n + 2
    unit_x, unit_q, unit_T = np.zeros((2, alone, *shape)), np.zeros((alone, *shape)), np.zeros((2, alone, *batch))
    for i in range(n):
        unit_x[0, i, ..., i] = unit_x[1, n + i, ..., i] = unit_q[2 * n + i, ..., i] = 1.0
    unit_T[0, -2] = unit_T[1, -1] = 1.0
    moved = np.concatenate(_step(truth, unit_x, unit_T, 0.0, unit_q, h, substeps), axis=-1)
    by_x, by_q, (by_begin, by_end) = moved[: 2 * n], moved[2 * n : 3 * n], moved[-2:]
    by_x = np.moveaxis(by_x, 0, -1)

    def of_batch(x):
        """(K, …) with as many axes as (K, *batch, 1)."""
        return x.reshape(len(x), *(1,) * (len(batch) + 1 - x.ndim), *x.shape[1:], 1)

    inlet = of_batch(inlet)
    heat = of_batch(I2) * truth.R_e if heat is None else np.asarray(heat)
    core_and_casing = np.empty((K + 1, *batch, 2 * n))
    core_and_casing[0] = z = np.concatenate(x, axis=-1)
    for first in range(0, K, AT_ONCE):
        part = slice(first, min(first + AT_ONCE, K))
        q = np.broadcast_to(heat[part], (part.stop - first, *shape))
        into = np.einsum("k...i,i...j->k...j", q, by_q)
        into += inlet[part] * by_begin + inlet[first + 1 : part.stop + 1] * by_end
        for k, more in enumerate(into, first + 1):
            core_and_casing[k] = z = (by_x @ z[..., None])[..., 0] + more
    return np.moveaxis(core_and_casing.reshape(K + 1, *batch, 2, n), -2, 1)


def lsoda(truth, current, inlet, T_0, *, dt=1.0):
    """The same for one string, by LSODA restarted at every change of the current; `inlet` may be a function of time."""
    n = truth.cells
    T_c0, T_s0 = T_0 if isinstance(T_0, tuple) else (T_0, T_0)
    x = np.concatenate([np.broadcast_to(T_c0, (n,)), np.broadcast_to(T_s0, (n,))]).astype(float)
    K = len(current)
    instants = np.arange(K + 1) * dt
    if isinstance(inlet, Callable):
        T_in = inlet
    else:

        def T_in(t):
            return np.interp(t, instants, inlet)

    out = np.empty((K + 1, 2 * n))
    out[0] = x
    for k in range(K):

        def f(t, x, k=k):
            return np.concatenate(truth.rates(x[:n], x[n:], T_in(t), np.float64(current[k]) ** 2))

        got = solve_ivp(f, instants[k : k + 2], out[k], method="LSODA", rtol=1e-10, atol=1e-10)
        out[k + 1] = got.y[:, -1]
    return out[:, :n], out[:, n:]


def wavy_inlet(seconds, *, mean=25.0, amplitude=3.0, period=300.0, dt=1.0, phase=0.0):
    """An inlet that moves by ± `amplitude` K, not a pure sine: (K + 1,) °C."""
    t = np.arange(0, seconds + dt / 2, dt)
    w = 2 * np.pi / period
    return mean + amplitude * (0.8 * np.sin(w * t + phase) + 0.2 * np.sin(2.7 * w * t + 1.0))
