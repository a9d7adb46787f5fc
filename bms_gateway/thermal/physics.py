r"""The balances of a string with any effects of the catalogue: rates, readings, and their linear part.

State X = [T_c1, T_s1, T_c2, …, own states of the effects], °C, as in `thermal.string`; without effects the rates are
that module's A X + B u, with the coolant flow C_f following the flow ratio. For cell k

.. math::
    C_c \dot T_{c,k} &= q_k - j_k, \qquad q_k = \overline{I^2} R_e, \qquad j_k = (T_{c,k} - T_{s,k}) / R_c \\
    C_s \dot T_{s,k} &= j_k - f_k + \sum_j (T_{s,j} - T_{s,k}) / R_{cc} + s_k, \qquad
    f_k = C_f e_k (T_{s,k} - T_{f,k}) \\
    T_{f,k+1} &= T_{f,k} + e_k (T_{s,k} - T_{f,k})

where the effects may change each symbol (Lin et al., Eq 16–18, corrected as in `thermal.string`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bms_gateway.thermal.centre import probe_lever
from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects import Effect, effect_named
from bms_gateway.thermal.parameters import AddedEffect, Floats, StringModel, StringParameters
from bms_gateway.thermal.point import Point

Memory = Mapping[str, Floats]
REFERENCE_GAP = 5.0
"""K: gap surface to coolant at which R_u is stated if the film flux is not proportional to the gap."""
LEAST_GAP = 0.05
"""K: the film is linear below this gap, because its slope at zero gap would be zero or infinite."""


@dataclass(frozen=True, slots=True)
class Numbers:
    """One set of all numbers of a string.

    Attributes
    ----------
    string : StringParameters
    effects : mapping of effect key to mapping of parameter to float, SI
    inlet_offset : ndarray (…, 1) or float, K
        Error of the inlet thermocouple, positive if it reads too high (within its tolerance).
    surface_offset : ndarray (n,) or 0.0, K
        Errors of the surface thermocouples, positive if they read too high (within their tolerance).
    inlet_late, flow_late : float, s
        Delays of these readings: filters and time stamps of other devices (within what is usual).
    core_heat : ndarray (…, n) or float, W
        Additional heat in the cores beyond the model: the observer's disturbance.
    """

    string: StringParameters
    effects: Mapping[str, Mapping[str, float]]
    inlet_offset: float | Floats = 0.0
    surface_offset: float | Floats = 0.0
    inlet_late: float = 0.0
    flow_late: float = 0.0
    core_heat: float | Floats = 0.0


@dataclass(frozen=True, slots=True)
class _Placed:
    key: str
    effect: Effect
    at: Floats
    own: slice
    hooks: frozenset[str]


@dataclass(frozen=True, slots=True)
class _Given:
    """What inputs and numbers give whatever the states are: coolant inlet [°C], flow ratio, C_f [W/K]."""

    T_in: Floats
    flow: Floats
    C_f: Floats

    @classmethod
    def of(cls, u: Drive, v: Numbers) -> "_Given":
        flow = _earlier(u.flow, v.flow_late, u.dt)[:, None]
        # a constant flow leaves the stream's coefficients without a time axis, and its path a matrix
        still = flow[0] if np.all(flow == flow[0]) else flow
        T_in = _earlier(u.T_in, v.inlet_late, u.dt)[:, None] - v.inlet_offset
        return cls(T_in, flow, np.asarray(v.string.C_f * still))


class Physics:
    """Structure of one string and its effects; every method is a pure function of its arguments.

    Parameters
    ----------
    model : StringModel
    own : mapping of str to Effect, optional
        Effects by name, with priority over those of the catalogue.

    Raises
    ------
    ConfigError
        An effect is not in the catalogue, or is on a cell that does not exist.
    """

    def __init__(self, model: StringModel, own: Mapping[str, Effect] | None = None) -> None:
        self.model = model
        self.cells = model.cells
        placed, first = [], 2 * model.cells
        for added in model.effects:
            effect = (own or {}).get(added.name) or effect_named(added.name)
            width = effect.states * model.cells
            placed.append(
                _Placed(
                    added.key,
                    effect,
                    _share(added, model.cells),
                    slice(first, first + width),
                    frozenset(effect.hooks()),
                )
            )
            first += width
        self.probe = probe_lever(model).value
        self._placed = tuple(placed)
        self.states = first
        self.reads = any("reading" in e.hooks for e in placed)
        self.steep = any(e.effect.steep for e in placed)
        self._remembering = tuple(e for e in placed if type(e.effect).follow is not Effect.follow)
        self._given: tuple[Drive, Numbers, _Given] | None = None

    @property
    def remembering(self) -> tuple[str, ...]:
        """Keys of the effects with a memory of the inputs."""
        return tuple(e.key for e in self._remembering)

    def numbers(self, values: Mapping[str, float | Floats] | None = None) -> Numbers:
        """Numbers of the model; `values` by symbol (SI) replace the priors' medians."""
        return Numbers(self.model.parameters(values or {}), {e.key: e.values for e in self.model.effects})

    def memory(self, u: Drive, v: Numbers, carry: Memory | None = None) -> tuple[dict[str, Floats], dict[str, Floats]]:
        """Advance the effects' memories of the inputs over `u`.

        Returns
        -------
        memory, carry : dict of effect key to ndarray
            (N, k) over the intervals, and the input of the next call.
        """
        memory, after = {}, {}
        for e in self._remembering:
            got = e.effect.follow(u, v.effects[e.key], None if carry is None else carry[e.key])
            assert got is not None  # noqa: S101 - the class overrides follow
            memory[e.key], after[e.key] = got
        return memory, after

    def start(self, T_c: Floats, T_s: Floats, v: Numbers) -> Floats:
        """State (…, D) with cores and surfaces (…, n) given and the effects' own states in balance with them."""
        parts = [np.stack([T_c, T_s], axis=-1).reshape(*np.shape(T_c)[:-1], 2 * self.cells)]
        for e in self._placed:
            if e.effect.states:
                rest = e.effect.rest(T_c, T_s, v.effects[e.key])
                parts.append(rest.reshape(*np.shape(T_c)[:-1], -1))
        return np.concatenate(parts, axis=-1)

    def point(self, X: Floats, u: Drive, v: Numbers, memory: Memory) -> Point:
        """Balances at the states `X` (N, D) under the inputs of the N intervals of `u`."""
        z = self._open(X, u, v, memory)
        self._run("inputs", z, v)
        self._run("coefficients", z, v)
        z.core = np.multiply(z.I2, z.R_e, out=np.empty_like(z.T_c))
        self._run("heats", z, v)
        z.core = z.core + v.core_heat
        z.inner = (z.T_c - z.T_s) / z.R_c
        self._run("flux", z, v)
        self._stream(z, v.string.coolant)
        self._run("surroundings", z, v)
        return z

    def rates(self, X: Floats, u: Drive, v: Numbers, memory: Memory) -> Floats:
        """Rates of change (N, D) in 1/s at the states `X` (N, D) under the inputs of the N intervals of `u`."""
        return self.balances(self.point(X, u, v, memory), v)

    def balances(self, z: Point, v: Numbers) -> Floats:
        """Rates of change (N, D) in 1/s of a point from `point`."""
        out = np.empty((*z.T_c.shape[:-1], self.states), order="F")
        out[..., 0 : 2 * self.cells : 2] = (z.core - z.inner) / z.C_c
        net = z.inner - z.film + z.surface
        if np.isfinite(v.string.R_cc) and self.cells > 1:
            between = np.diff(z.T_s, axis=-1) / v.string.R_cc
            net[..., :-1] += between
            net[..., 1:] -= between
        out[..., 1 : 2 * self.cells : 2] = net / z.C_s
        for e in self._placed:
            if e.effect.states:
                out[..., e.own] = z.extra_rates[e.key].reshape(*z.T_c.shape[:-1], -1)
        return out

    def readings(self, X: Floats, u: Drive, v: Numbers, memory: Memory) -> Floats:
        """Return readings of thermocouples on all n cells (N, n), °C, at the states `X` under the inputs of `u`."""
        if not self.reads:
            return self.surfaces(X, v)
        z = self.point(X, u, v, memory)
        z.y = z.T_s
        self._run("reading", z, v)
        return np.asarray(z.y + v.surface_offset)

    def surfaces(self, X: Floats, v: Numbers) -> Floats:
        """Surfaces (N, n), °C, as read by thermocouples without effects."""
        return np.asarray(X[..., 1 : 2 * self.cells : 2] + v.surface_offset)

    def linearised(self, X: Floats, u: Drive, v: Numbers, memory: Memory) -> Floats:
        """Jacobian ∂(rates)/∂X (D, D), 1/s, at one state `X` (D,) under one interval `u`."""
        D = self.states
        probe = 0.05  # K: well above rounding, well below the curvature of any effect
        nudged = X + np.concatenate([np.eye(D), -np.eye(D)]) * probe
        f = self.rates(nudged, u, v, memory)
        return np.asarray((f[:D] - f[D:]).T / (2.0 * probe), dtype=np.float64)

    def _run(self, hook: str, z: Point, v: Numbers) -> None:
        for e in self._placed:
            if hook in e.hooks:
                z.key = e.key
                getattr(e.effect, hook)(z, v.effects[e.key], e.at)

    def _open(self, X: Floats, u: Drive, v: Numbers, memory: Memory) -> Point:
        s, n = v.string, self.cells
        T_c, T_s = X[..., 0 : 2 * n : 2], X[..., 1 : 2 * n : 2]
        last = self._given
        if last is not None and last[0] is u and last[1] is v:  # sweep after sweep under the same inputs
            given = last[2]
        else:
            given = _Given.of(u, v)
            self._given = (u, v, given)
        nothing = np.zeros_like(T_s)
        return Point(
            cells=n,
            I=u.I[:, None],
            I2=u.I2[:, None],
            I_abs=u.I_abs[:, None],
            T_in=given.T_in,
            flow=given.flow,
            soc=u.soc[:, None],
            V=u.V[:, None],
            IV=u.IV[:, None],
            hours=u.hours[:, None],
            T_c=T_c,
            T_s=T_s,
            R_e=s.R_e,
            R_c=s.R_c,
            R_u=s.R_u,
            C_c=s.C_c,
            C_s=s.C_s,
            C_f=given.C_f,
            core=nothing,
            surface=nothing,
            T_f=T_s,
            film=nothing,
            inner=nothing,
            y=T_s,
            memory=dict(memory),
            extra={
                e.key: X[..., e.own].reshape(*X.shape[:-1], n, e.effect.states) for e in self._placed if e.effect.states
            },
        )

    def _stream(self, z: Point, coolant: str) -> None:
        """Compute the coolant along the string: its temperature at each cell and the flux from each cell."""
        if not np.isfinite(z.C_f).all():
            z.T_f = z.T_in + np.zeros_like(z.T_s)
            z.film = (z.T_s - z.T_f) / z.R_u * _film(z.T_s - z.T_f, z.film_exponent)
            return
        if z.film_exponent == 0.0 and np.ndim(z.R_u) == 1 and np.ndim(z.C_f) == 1:
            share = _exchange(1.0 / (z.R_u * z.C_f), coolant)
            M, m = _path(share)
            z.T_f = (M @ z.T_s[..., None])[..., 0] if z.T_s.ndim != 2 else (M @ z.T_s.T).T
            z.T_f = z.T_f + z.T_in * m
            z.film = (z.T_s - z.T_f) * (z.C_f * share)
            return
        T_f = np.empty_like(z.T_s)
        stream = np.broadcast_to(z.T_in[..., 0], z.T_s.shape[:-1])
        if z.film_exponent == 0.0:
            share = _exchange(np.divide(1.0 / z.C_f, z.R_u, out=np.empty_like(z.T_s)), coolant)
            for k in range(self.cells):
                T_f[..., k] = stream
                stream = stream + share[..., k] * (z.T_s[..., k] - stream)
            z.T_f, z.film = T_f, (z.T_s - T_f) * (z.C_f * share)
            return
        film = np.empty_like(z.T_s)
        R_u = np.broadcast_to(z.R_u, z.T_s.shape)
        C_f = np.broadcast_to(z.C_f, z.T_s.shape)
        for k in range(self.cells):
            gap = z.T_s[..., k] - stream
            conductance = _film(gap, z.film_exponent) / R_u[..., k]
            taken = _exchange(conductance / C_f[..., k], coolant) * gap
            T_f[..., k], film[..., k] = stream, C_f[..., k] * taken
            stream = stream + taken
        z.T_f, z.film = T_f, film


def _earlier(x: Floats, late: float, dt: float) -> Floats:
    """Signal `late` seconds before its reading, to first order, because the delay is short."""
    if late == 0.0 or len(x) < 2:
        return x
    slope = np.empty_like(x)
    slope[1:-1] = (x[2:] - x[:-2]) / 2.0
    slope[0], slope[-1] = x[1] - x[0], x[-1] - x[-2]
    return x + slope * (late / dt)


def _exchange(units: Any, coolant: str) -> Any:
    """Share of the gap that the stream takes up; with the bulk node it leaves no warmer than the surface."""
    return -np.expm1(-units) if coolant == "ntu" else np.minimum(units, 1.0)


def _path(share: Floats) -> tuple[Floats, Floats]:
    """Coolant at each cell as T_f = M T_s + m T_in, as `thermal.string.coolant_path`, with any share per cell."""
    n = len(share)
    M, m = np.zeros((n, n)), np.ones(n)
    for k in range(1, n):
        M[k] = (1.0 - share[k - 1]) * M[k - 1]
        M[k, k - 1] += share[k - 1]
        m[k] = (1.0 - share[k - 1]) * m[k - 1]
    return M, m


def _film(gap: Floats, exponent: float) -> Any:
    if exponent == 0.0:
        return 1.0
    return (np.maximum(np.abs(gap), LEAST_GAP) / REFERENCE_GAP) ** exponent


def _share(added: AddedEffect, cells: int) -> Floats:
    if added.cell is None:
        return np.ones(cells)
    at = np.zeros(cells)
    at[added.cell - 1] = 1.0
    return at


def with_effect(v: Numbers, key: str, values: Mapping[str, float]) -> Numbers:
    """Numbers with those of one effect replaced."""
    return replace(v, effects={**v.effects, key: values})
