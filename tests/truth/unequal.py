"""A string of unlike cells under slow disturbances, its sensors and its cell voltages: the case of Fig 10, many times.

Nothing of the package is used. All seeds are integrated side by side (leading axis) by RK4 at the cells' heat
balances, written out in `tests.truth.string`. Nuisances are drawn per seed; disturbances are Ornstein-Uhlenbeck
processes of ten minutes.
"""

from dataclasses import dataclass

import numpy as np

from tests.truth.cycle import repeated
from tests.truth.string import C_F, TABLE_1

FIG_10 = np.array([3.5e-3, 4.3e-3, 4.3e-3, 4.3e-3, 3.5e-3])
"""Ohm: the unread cells are the hot ones."""
TAU = 600.0
"""s: of the disturbances."""
OCV_EMPTY, OCV_SPAN, CAPACITY_AH = 3.0, 0.6, 8.0


@dataclass(frozen=True)
class Scatter:
    """Relative sd of (string's mean, cell about it); K and W for the rest."""

    R_u: tuple = (0.10, 0.05)
    R_c: tuple = (0.05, 0.03)
    C_c: tuple = (0.05, 0.02)
    C_s: float = 0.05
    C_f: float = 0.05
    R_cc: float = 0.20
    offset: float = 0.1
    noise: float = 0.1
    heat_common: float = 0.5
    heat_cell: float = 0.15
    inlet: float = 0.5
    ratio: float = 0.03


@dataclass(frozen=True)
class Drives:
    """Records of S seeds: current (K,) A, inlet as measured (K + 1,), core and surface (S, K + 1, n), readings
    (S, K, n) at instants 1..K, R_e (S, n), ratio (S,) and the joints' errors in sd (S, n)."""

    seeds: list
    current: np.ndarray
    inlet: np.ndarray
    core: np.ndarray
    surface: np.ndarray
    readings: np.ndarray
    R_e: np.ndarray
    ratio: np.ndarray
    joints: np.ndarray

    def R_el(self, joint):
        """Electrical resistance by energy balance (S, n): R_e = ratio R_el (1 + eps), eps of sd `joint`."""
        return self.R_e / self.ratio[:, None] / (1 + joint * self.joints)

    def voltage(self, i, joint, skew_s=0.1):
        """Cell voltages of seed i (K, n), means over the steps, each cell's samples late by up to `skew_s`."""
        rng = np.random.default_rng([self.seeds[i], 3030])
        return cell_voltages(self.current, self.R_el(joint)[i], skew_s, rng)


def _slow(rng, K, shape, sd):
    """Ornstein-Uhlenbeck (K + 1, *shape) at 1 s, stationary."""
    a = np.exp(-1.0 / TAU)
    out = np.empty((K + 1, *shape))
    out[0] = rng.normal(0, sd, shape)
    steps = rng.normal(0, sd * np.sqrt(1 - a * a), (K, *shape))
    for k in range(K):
        out[k + 1] = a * out[k] + steps[k]
    return out


def drives(
    seeds, *, minutes=89, R_e=FIG_10, scatter=None, swing=3.0, coolant="ntu", cycle=0, spread=0.0, start=25.0, run=0
):
    """Simulate one record per seed; `spread` scatters R_e of the cells about `R_e`, relative.

    Runs of one seed share the pack, its sensors and its voltages' errors, not the disturbances and the noise.
    """
    s = scatter or Scatter()
    seeds = list(seeds)
    K, n = int(minutes * 60), len(R_e)
    rngs = [np.random.default_rng([seed, 1010]) for seed in seeds]

    def log_normal(common, own):
        return np.exp(np.array([rng.normal(0, common) + rng.normal(0, 1, n) * own for rng in rngs]))

    p = {k: TABLE_1[k] * log_normal(*getattr(s, k)) for k in ("R_u", "R_c", "C_c")}
    p["C_s"] = TABLE_1["C_s"] * log_normal(s.C_s, 0.0)
    C_f = C_F * log_normal(s.C_f, 0.0)[:, 0]
    R_cc = 4.0 * log_normal(s.R_cc, 0.0)[:, 0]
    R = R_e * log_normal(0.0, spread)
    offsets = np.array([rng.normal(0, s.offset, n) for rng in rngs])
    ratio = np.exp([rng.normal(0, s.ratio) for rng in rngs])
    joints = np.array([rng.normal(0, 1, n) for rng in rngs])
    rngs = [np.random.default_rng([seed, 2020, run]) for seed in seeds]
    current = repeated(minutes, cycle)
    t = np.arange(K + 1.0)
    w = 2 * np.pi / 300.0
    measured = 25.0 + swing * (0.8 * np.sin(w * t) + 0.2 * np.sin(2.7 * w * t + 1.0))
    true_inlet = measured[:, None] + np.stack([_slow(rng, K, (), s.inlet) for rng in rngs], axis=1)
    common = np.stack([_slow(rng, K, (1,), s.heat_common) for rng in rngs], axis=1)
    own = np.stack([_slow(rng, K, (n,), s.heat_cell) for rng in rngs], axis=1)
    heat = current[:, None, None] ** 2 * R + ((common + own)[1:] + (common + own)[:-1]) / 2
    core, surface = _integrate(p, C_f, R_cc, coolant, heat, true_inlet, start)
    noise = np.stack([rng.normal(0, s.noise, (K, n)) for rng in rngs])
    readings = surface[1:].transpose(1, 0, 2) + offsets[:, None] + noise
    core, surface = core.transpose(1, 0, 2), surface.transpose(1, 0, 2)
    return Drives(seeds, current, measured, core, surface, readings, R, ratio, joints)


def _integrate(p, C_f, R_cc, coolant, heat, inlet, start):
    """RK4, one step a second: heat (K, S, n) W held, inlet (K + 1, S)."""
    K, S, n = heat.shape
    units = 1 / (p["R_u"] * C_f[:, None])
    e = units if coolant == "bulk" else 1 - np.exp(-units)
    film = e * C_f[:, None]  # W/K: the casing gives off what the stream takes up
    core, surface = np.empty((K + 1, S, n)), np.empty((K + 1, S, n))
    x = np.full((2, S, n), float(start))
    core[0], surface[0] = x

    def rates(x, T_in, q):
        T_c, T_s = x
        out = (T_c - T_s) / p["R_c"]
        net = out.copy()
        stream = T_in
        for k in range(n):
            gap = T_s[:, k] - stream
            net[:, k] -= gap * film[:, k]
            stream = stream + e[:, k] * gap
        flux = (T_s[:, 1:] - T_s[:, :-1]) / R_cc[:, None]
        net[:, :-1] += flux
        net[:, 1:] -= flux
        return np.stack([(q - out) / p["C_c"], net / p["C_s"]])

    for k in range(K):
        a, b = inlet[k], inlet[k + 1]
        k1 = rates(x, a, heat[k])
        k2 = rates(x + 0.5 * k1, (a + b) / 2, heat[k])
        k3 = rates(x + 0.5 * k2, (a + b) / 2, heat[k])
        k4 = rates(x + k3, b, heat[k])
        x = x + (k1 + 2 * k2 + 2 * k3 + k4) / 6
        core[k + 1], surface[k + 1] = x
    return core, surface


def overpotential(current):
    """Loss voltage per ohm of energy-balance resistance (K,): ohmic and two relaxations, mean(I eta)/mean(I^2) = 1."""
    eta = 0.6 * current
    for share, tau in ((0.25, 20.0), (0.15, 300.0)):
        a, v = np.exp(-1.0 / tau), 0.0
        slow = np.empty_like(current)
        for k, amp in enumerate(current):
            slow[k] = tau * (1 - a) * v + (1 - tau * (1 - a)) * amp  # mean over the step
            v = a * v + (1 - a) * amp
        eta = eta + share * slow
    return eta * np.mean(current**2) / np.mean(current * eta)


def cell_voltages(current, R_el, skew_s, rng, noise=1e-3, step=1e-4):
    """Mean voltage of each step (K, n), V; each cell's samples late by up to `skew_s`."""
    K, n = len(current), len(R_el)
    eta = overpotential(current)
    charge = np.concatenate([[0.0], np.cumsum(current)[:-1]]) + current / 2
    out = np.empty((K, n))
    for k in range(n):
        late = rng.uniform(0.0, skew_s)
        skewed = (1 - late) * eta + late * np.concatenate([[0.0], eta[:-1]])
        soc = 0.7 + rng.normal(0, 0.02) - charge / 3600 / CAPACITY_AH
        out[:, k] = OCV_EMPTY + OCV_SPAN * soc - R_el[k] * skewed
    return np.round((out + rng.normal(0, noise, out.shape)) / step) * step
