"""The string's heat balances over one step of the heat filter, and their derivatives by the unknown numbers.

Lin et al., Eq 1 and 16–18, sampled at the ends of the ticks of a step. Heat changes from tick to tick, and
thermocouples are read in between, so a reading follows neither from the mean heat nor from the end of the step alone.
Heat at the casings is one more input; a change of R_u acts through it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from bms_gateway.health.heat.layout import Ints, Layout
from bms_gateway.health.heat.usual import REFERENCE
from bms_gateway.observe.model import usable
from bms_gateway.thermal import ContinuousString, Floats, StringParameters, continuous, discretize
from bms_gateway.thermal.string import coolant_path

KELVIN = 273.15
LEAST_LOSS, MOST_LOSS = -1.5, 0.95
"""Limits of the lost share of the film's conductance."""
MOST_WHOLE = 0.5
"""Greatest common loss, as a share of the films' usual conductance, at which a cell's own share counts in full. The
common loss is known to some tenths only, and a wrong value makes the film of each cell wrong through its own share. A
greater loss reduces the own share as well; otherwise a pump that stops would leave cells that seem to differ by more
than they do."""


@dataclass(frozen=True, slots=True)
class Response:
    """How temperatures r of S strings of n cells depend on the state before a step and on the inputs within it.

    Attributes
    ----------
    of : ndarray (S, …, r, 4n + 2)
        By the 2n temperatures before the step, by 1 W of constant heat in each of the n cores, by the same at each of
        the n casings, and by the inlet at the start and at the end of the step; the inlet is linear in between.
    """

    of: Floats

    @property
    def Phi(self) -> Floats:
        """By the temperatures before the step (S, …, r, 2n)."""
        return self.of[..., : (self.of.shape[-1] - 2) // 2]

    @property
    def core(self) -> Floats:
        """By mean heat in the cores (S, …, r, n), K/W."""
        n = (self.of.shape[-1] - 2) // 4
        return self.of[..., 2 * n : 3 * n]

    @property
    def casing(self) -> Floats:
        """By mean heat at the casings (S, …, r, n), K/W."""
        n = (self.of.shape[-1] - 2) // 4
        return self.of[..., 3 * n : 4 * n]

    @property
    def inlet(self) -> Floats:
        """By the inlet at the start and at the end of the step (S, …, r, 2)."""
        return self.of[..., -2:]

    def free(self, T: Floats, inlet0: Floats, inlet1: Floats) -> Floats:
        """Temperatures (S, r), °C, without heat: from those before the step (S, 2n) and the inlet (S,)."""
        inlet = np.stack((inlet0, inlet1), axis=1)[:, :, None]
        return np.asarray(np.matmul(self.Phi, T[:, :, None])[:, :, 0] + np.matmul(self.inlet, inlet)[:, :, 0])


@dataclass(frozen=True, slots=True)
class Balances:
    """Discrete balances of S strings of n cells over a step of L ticks.

    Attributes
    ----------
    end : Response
        Temperatures after the step, r = 2n.
    mean : Response
        Means of the casings over the step, r = n.
    at : Response
        Casings at the start of the step and after each of its ticks, (S, n, L + 1, 4n + 2).
    tick, tick_core : ndarray (S, 2n, 2n), (S, 2n, n)
        Temperatures after a tick, by those before it and by the heat in the cores, K/W.
    M, m : ndarray (S, n, n), (S, n)
        Coolant at each cell, M T_s + m T_in.
    R_e, R_u, C : ndarray (S, n)
        Ω, K/W, and heat capacity of a whole cell, J/K.
    """

    end: Response
    mean: Response
    at: Response
    tick: Floats
    tick_core: Floats
    M: Floats
    m: Floats
    R_e: Floats
    R_u: Floats
    C: Floats

    @classmethod
    def of(cls, strings: Sequence[StringParameters], dt: float, ticks: int, sensors: Ints) -> "Balances":
        """Discretise steps of `dt` seconds, for sensors on the cells (S, m); equal strings share the work."""
        done: dict[bytes, dict[str, Floats]] = {}
        parts = []
        for p, cells in zip(map(usable, strings), sensors, strict=True):
            numbers = p.C_c, p.C_s, p.R_e, p.R_c, p.R_u, p.R_cc, p.C_f, cells
            key = p.coolant.encode() + b"".join(np.asarray(x).tobytes() for x in numbers)
            if key not in done:
                done[key] = _balances(p, dt, ticks, cells)
            parts.append(done[key])
        made: dict[str, Any] = {k: np.stack([part[k] for part in parts]) for k in parts[0]}
        return cls(**made | {k: Response(made[k]) for k in ("end", "mean", "at")})

    def with_string(self, s: int, one: "Balances") -> "Balances":
        """Return the balances with string `s` replaced by `one`."""
        changed: dict[str, Any] = {}
        for f in fields(self):
            old, new = getattr(self, f.name), getattr(one, f.name)
            wrapped = isinstance(old, Response)
            array = (old.of if wrapped else old).copy()
            array[s] = (new.of if wrapped else new)[0]
            changed[f.name] = Response(array) if wrapped else array
        return Balances(**changed)

    @property
    def ticks(self) -> int:
        """Number of ticks of a step, L."""
        return int(self.at.of.shape[2]) - 1

    def coolant(self, T_s: Floats, inlet: Floats) -> Floats:
        """Coolant (S, n) at each cell, °C."""
        return np.asarray(np.matmul(self.M, T_s[:, :, None])[:, :, 0] + self.m * inlet[:, None], dtype=np.float64)

    def heated(self, heat: Floats) -> Floats:
        """Response (L + 1, S, 2n), K, of the temperatures at the ticks' ends to the ticks' heat (L, S, n), W."""
        T = np.zeros((len(heat) + 1, *self.tick.shape[:2]))
        if heat.any():
            of_tick = np.matmul(self.tick_core, heat.transpose(1, 2, 0))
            for k in range(len(heat)):
                T[k + 1] = np.matmul(self.tick, T[k, :, :, None])[:, :, 0] + of_tick[:, :, k]
        return T


def even(ticks: int) -> Floats:
    """Weights (L + 1,) of the instants that bound the ticks in a mean over the step: the trapezoidal rule."""
    w = np.full(ticks + 1, 1.0 / ticks)
    w[[0, -1]] = 0.5 / ticks
    return w


def _balances(p: StringParameters, dt: float, ticks: int, sensors: Ints) -> dict[str, Floats]:
    """Balances of one string, without the axis of the strings."""
    s, n = continuous(p), p.cells
    B_s = np.zeros((2 * n, n))
    B_s[np.arange(1, 2 * n, 2), np.arange(n)] = 1.0 / p.C_s
    d = discretize(ContinuousString(s.A, np.hstack((s.B_q, B_s)), s.B_f), dt / ticks)
    # state, heat in cores and at casings, inlet at start and end: one at a time, tick by tick
    R, always = np.zeros((2, 2 * n, 4 * n + 2))
    R[:, : 2 * n], always[:, 2 * n : 4 * n] = np.eye(2 * n), d.B_q
    casings = [R[1::2]]
    for k in range(ticks):
        R = d.A @ R + always
        R[:, -2] += d.B_f0 * (1.0 - k / ticks) + d.B_f1 * (1.0 - (k + 1) / ticks)
        R[:, -1] += d.B_f0 * (k / ticks) + d.B_f1 * ((k + 1) / ticks)
        casings.append(R[1::2])
    at = np.stack(casings, axis=1)  # (n, L + 1, 4n + 2)
    M, m = coolant_path(p)
    return {
        "end": R,
        "mean": np.matmul(even(ticks), at),
        "at": at[sensors],
        "tick": d.A,
        "tick_core": d.B_q[:, :n],
        "M": M,
        "m": m,
        "R_e": p.R_e,
        "R_u": p.R_u,
        "C": p.C_c + p.C_s,
    }


@dataclass(frozen=True, slots=True)
class Around:
    """Coolant at n cells of S strings.

    Attributes
    ----------
    gap, warming : ndarray (S, n), K
        Casing minus coolant, and coolant minus inlet.
    """

    gap: Floats
    warming: Floats

    @classmethod
    def of(cls, b: Balances, casings: Floats, inlet: Floats) -> "Around":
        """Compute it from the casings (S, n) and the inlet (S,), °C."""
        coolant = b.coolant(casings, inlet)
        return cls(casings - coolant, coolant - inlet[:, None])


@dataclass(frozen=True, slots=True)
class Unknown:
    """Heats through which the unknown numbers act in one step of S strings of n cells.

    Attributes
    ----------
    heat : ndarray (S, n), W
        Mean heat by the current.
    lost : ndarray (S, n), W
        Heat that the casings keep instead of giving it to the coolant, by the present numbers.
    film, own_film : ndarray (S, n), W
        Derivatives of `lost` by the lost share of all films, and by the cell's own.
    entropy : ndarray (S, n), A K
        Heat per entropic coefficient.
    stream : ndarray (S, n), W
        Heat that the casings keep if the coolant's warming along the string doubles.
    """

    heat: Floats
    lost: Floats
    film: Floats
    own_film: Floats
    entropy: Floats
    stream: Floats

    @classmethod
    def of(
        cls, b: Balances, at: Layout, z: Floats, q: Floats, around: Around, current: Floats, film: Floats
    ) -> "Unknown":
        """Compute them from the numbers.

        Parameters
        ----------
        b : Balances
        at : Layout
        z : ndarray (S, N)
        q : ndarray (S, n), W
            Mean heat by the current.
        around : Around
            Mean of the step, with the identified films.
        current : ndarray (S,), A
            Mean; 0 if unknown.
        film : ndarray (S,)
            Usual loss of all films; NaN if unknown.
        """
        own = np.matmul(at.told_of, z[:, at.own_flow, None])[:, :, 0]
        common = np.clip(z[:, at.flow, None], LEAST_LOSS, MOST_LOSS)
        # few sensors cannot distinguish a cell's own share from the common one
        several = at.fitted.sum(axis=1)[:, None] >= REFERENCE
        usual = np.minimum(film, MOST_LOSS)[:, None]
        evident = several & np.isfinite(usual)
        left = np.where(evident, np.minimum(1.0, MOST_WHOLE + (1.0 - common) / (1.0 - usual)), 1.0)
        share = np.clip(common + own * left, LEAST_LOSS, MOST_LOSS)
        # the heat that a film keeps already widens the gap within the step
        k = np.arange(at.cells)
        per_gap = 1.0 / (b.R_u - share * b.mean.casing[:, k, k])
        flux = around.gap * per_gap
        warm = z[:, 0 : at.nodes : 2] + KELVIN
        by_share = flux * b.R_u * per_gap
        by_film, own_film = by_share * np.where(left < 1.0, 1.0 - own, 1.0), by_share * left
        stream = around.warming * (1.0 - share) / b.R_u
        return cls(q, share * flux, by_film, own_film, -current[:, None] * warm, stream)


def coupling(r: Response, at: Layout, z: Floats, by: Unknown, heated: Floats) -> tuple[Floats, Floats]:
    """How the unknown numbers act on temperatures r.

    Parameters
    ----------
    r : Response
        Of these temperatures.
    at : Layout
    z : ndarray (S, N)
    by : Unknown
    heated : ndarray (S, r), K
        Effect of the heat by the current.

    Returns
    -------
    X : ndarray (S, r, N − 2n)
    moved : ndarray (S, r), K
        Present effect of the numbers.
    """
    o = at.nodes
    X = np.zeros((*heated.shape, at.states - o))
    core, casing = r.core, r.casing
    X[:, :, at.load - o] = X[:, :, at.brisk - o] = heated
    X[:, :, at.inlet - o] = r.inlet.sum(axis=-1)
    X[:, :, at.entropy - o] = np.matmul(core, by.entropy[:, :, None])[:, :, 0]
    X[:, :, at.stream - o] = np.matmul(casing, by.stream[:, :, None])[:, :, 0]
    cells = at.told_of  # (S, n, a)
    X[:, :, at.heat.start - o : at.heat.stop - o] = np.matmul(core, cells)
    X[:, :, at.own_load.start - o : at.own_load.stop - o] = np.matmul(core * by.heat[:, None, :], cells)
    moved = np.matmul(X, z[:, o:, None])[:, :, 0] + np.matmul(casing, by.lost[:, :, None])[:, :, 0]
    X[:, :, at.flow - o] = np.matmul(casing, by.film[:, :, None])[:, :, 0]
    X[:, :, at.own_flow.start - o : at.own_flow.stop - o] = np.matmul(casing * by.own_film[:, None, :], cells)
    return X, np.asarray(moved, dtype=np.float64)
