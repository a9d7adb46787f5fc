r"""Forecasts of plain strings: two nodes per cell, heat proportional to the square of the current.

The matrices are those of `transitions`, made anew for a string whose parameters or flow have changed. The sensitivities
advance by :math:`J_{b} = \Phi_{b-a} J_a + \Gamma_{b-a} F`, with F their forcing in the middle of the segment. As this
is linear in state and load, one call gives the course without a load and the response to one A².

Beyond Lin et al., whose observer estimates only the present.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from bms_gateway.observe.ahead import AT_ENDS, ENDS, PATH, STEP_S, Ahead, Certainty, Course, Spread, certainty
from bms_gateway.observe.flow import at_level
from bms_gateway.observe.forecast_start import Coming, Profile, Standing
from bms_gateway.observe.model import augmented, noise_intensity
from bms_gateway.observe.reversible import reversible
from bms_gateway.observe.sensitivity import ENTROPIC_AT, PARAMETERS, WARMTH_AT, Flows
from bms_gateway.observe.transitions import SEGMENTS, Reach, course
from bms_gateway.thermal import Disturbance, Floats, StringParameters
from bms_gateway.thermal.centre import followed, time_constant
from bms_gateway.thermal.entropy import PER_MV
from bms_gateway.thermal.warmth import warmth

PARTS = len(SEGMENTS)
FARTHEST = 5.0
"""Limit of the factor between the heat by a voltage and that by R_e; the error of R_e and the cold are within."""


@dataclass(slots=True)
class _Made:
    """Matrices of all strings, stacked, and the numbers from which they were made."""

    reach: Reach
    flows: Flows
    tau: Floats
    share: Floats
    R_e: Floats
    response: Course
    of: list[tuple[StringParameters, int]]


class Outlook:
    """Forecasts of S strings of n cells, and the matrices that they need."""

    def __init__(self) -> None:
        self._made: _Made | None = None

    def ahead(self, s: Standing, coming: Coming, known: Certainty | None = None) -> Ahead:
        """Forecast from the present state of the strings.

        Parameters
        ----------
        s : Standing
        coming : Coming
        known : Certainty, optional
            Of a recent forecast: variances change slowly, and are most of the work.

        Returns
        -------
        Ahead
            NaN for strings that are not available.
        """
        m, x = self._follow(s), _shifted(s, coming)
        R, n, M = m.reach, s.lag.shape[1], s.x.shape[1]
        amps = s.amps(coming.current)
        heat = coming.heat + reversible(s.entropic, amps, x[:, 0 : 2 * n : 2])
        path = np.matmul(R.path, _inputs(x, heat, s.inlet)[:, None, :, None])[..., 0]
        still = course(path, x, s.lag, R.by_path, R.by_now)
        c = self._heat_per_square(m, s, coming) * self._warmed(s, coming, s.x[:, 0 : 2 * n : 2])
        load = Course(*(c * a for a in (m.response.core, m.response.surface, m.response.lag)))
        if known is None:
            nothing, unit = np.zeros_like(x), c * m.share
            given = np.isfinite(coming.heat_per_square)[:, None]
            ends = [0, *AT_ENDS]
            later = np.matmul(R.path[:, :, :, M : M + n], unit[:, None, :, None])[..., 0]
            mids = [
                _middles(np.concatenate((a[:, None], b), axis=1)[:, ends]) for a, b in ((x, path), (nothing, later))
            ]
            flows = _with_own(m.flows, s)
            F0 = _forcing(flows, mids[0], (np.zeros_like(unit), coming.heat), s.inlet, np.repeat(amps, PARTS, axis=0))
            electric, measured = np.where(given, 0.0, unit), np.where(given, unit, 0.0)
            F1 = _forcing(m.flows, mids[1], (electric, measured), np.zeros_like(s.inlet))
            warmer = mids[1][:, :, 0 : 2 * n : 2] / m.flows.C_c.reshape(-1, PARTS, n)
            u = warmth(mids[0][:, :, 0 : 2 * n : 2]) - s.u_0[:, None, None]
            F1[:, :, 0 : 2 * n : 2, WARMTH_AT] = F1[:, :, 0 : 2 * n : 2, 2] * u
            F1[:, :, 0 : 2 * n : 2, ENTROPIC_AT] = -PER_MV * warmer[..., None] * amps[:, None, None]
            spread = self._spread(m, s, coming, np.concatenate((F0, F1), axis=-1))
            known = certainty(still, load, spread, replace(s.unlike, doubt=coming.doubt))
        return _told(Ahead(still, load, known, s.unlike.phi), s)

    def under(self, s: Standing, coming: Coming, profile: Profile) -> Ahead:
        """Forecast under a profile of the load; its response to a load is zero.

        Parameters
        ----------
        s : Standing
        coming : Coming
        profile : Profile
            At least as long as the last horizon.
        """
        m, n = self._follow(s), s.lag.shape[1]
        R, x, lag = m.reach, _shifted(s, coming), s.lag
        c = self._heat_per_square(m, s, coming) * m.share
        states, lags, one = [x], [lag], R.path[:, 0]
        amps = s.amps(np.nan_to_num(profile.current))
        for square, inlet, now in zip(profile.square[: ENDS[-1]], profile.inlet, amps, strict=False):
            core = x[:, 0 : 2 * n : 2]
            heat = coming.heat + square[:, None] * c * self._warmed(s, coming, core)
            heat = heat + reversible(s.entropic, now, core)
            x = np.matmul(one, _inputs(x, heat, inlet)[:, :, None])[:, :, 0]
            gap = ((x + states[-1]) / 2.0)[:, : 2 * n]
            lag = lag + followed(STEP_S, m.tau) * (gap[:, 0::2] - gap[:, 1::2] - lag)
            states.append(x)
            lags.append(lag)
        X, L = np.stack(states), np.stack(lags)
        at = [0, *PATH]
        N = 2 * n
        still = Course(X[at, :, 0:N:2], X[at, :, 1:N:2], L[at])
        nothing = Course(*(np.zeros_like(still.core) for _ in range(3)))
        given = np.isfinite(coming.heat_per_square)[:, None, None]
        middle = np.stack([((X[a:b] + X[a + 1 : b + 1]) / 2.0).mean(axis=0) for a, b in SEGMENTS], axis=1)
        square, inlet = (
            np.stack([v[a:b].mean(axis=0) for a, b in SEGMENTS], axis=1) for v in (profile.square, profile.inlet)
        )
        warmed = np.stack([self._warmed(s, coming, x[:, 0 : 2 * n : 2]) for x in middle.swapaxes(0, 1)], axis=1)
        heat = square[:, :, None] * c[:, None] * warmed
        electric, measured = np.where(given, 0.0, heat), np.where(given, heat, 0.0)
        of_parts = np.stack([amps[a:b].mean(axis=0) for a, b in SEGMENTS], axis=1).reshape(-1, amps.shape[-1])
        made = electric, coming.heat[:, None] + measured
        forcing = _forcing(_with_own(m.flows, s), middle, made, inlet, of_parts)
        spread = self._spread(m, s, coming, np.concatenate((forcing, np.zeros_like(forcing)), axis=-1))
        known = certainty(still, nothing, spread, replace(s.unlike, doubt=coming.doubt))
        return _told(Ahead(still, nothing, known, s.unlike.phi), s)

    def _heat_per_square(self, m: _Made, s: Standing, coming: Coming) -> Floats:
        """Heat (S, 1) of a mean cell per square of the current, W/A², with R_e where it is known."""
        told = np.clip(coming.heat_per_square * s.gain, m.R_e / FARTHEST, m.R_e * FARTHEST)
        return np.where(np.isfinite(told), told, m.R_e)[:, None]

    def _warmed(self, s: Standing, coming: Coming, core: Floats) -> Floats:
        """R_e (S, 1) of mean cores at `core` (S, n) over R_e where it is known; 1 where a voltage tells the heat."""
        given = np.isfinite(coming.heat_per_square)[:, None]
        return np.where(given, 1.0, s.by_warmth(core).mean(axis=1, keepdims=True))

    def _spread(self, m: _Made, s: Standing, coming: Coming, F: Floats) -> Spread:
        """Carry covariances and sensitivities, without a load and per A², by their forcing (S, PARTS, M, 2p)."""
        R, n, p = m.reach, s.lag.shape[1], s.J.shape[2]
        S, N = len(s.x), 2 * n
        J, carried = np.concatenate((s.J, np.zeros_like(s.J)), axis=2), []
        for k in range(PARTS):
            J = np.matmul(R.carry[:, k], J) + np.matmul(R.gather[:, k], F[:, k])
            carried.append(J[:, :N])
        slopes = np.matmul(np.stack(carried).reshape(PARTS, S, 2 * N, p), s.root[None]).reshape(PARTS, S, n, 4, p)
        Phi = R.Phi.swapaxes(0, 1)
        left = np.matmul(Phi, s.P)
        core, surface = Phi[:, :, 0::2], Phi[:, :, 1::2]
        still = R.Q.transpose(1, 2, 0, 3) + np.stack(
            (
                np.einsum("hsnm,hsnm->hsn", left[:, :, 0::2], core),
                np.einsum("hsnm,hsnm->hsn", left[:, :, 1::2], surface),
                np.einsum("hsnm,hsnm->hsn", left[:, :, 0::2], surface),
            )
        )
        at, M = np.arange(n), s.x.shape[1]
        ends = R.path[:, [k - 1 for k in AT_ENDS]].swapaxes(0, 1)
        by_inlet = ends[:, :, :N, -1] * coming.inlet_sd[:, :, None]
        by_heat = [ends[:, :, 2 * at + i, M + at] * coming.heat_sd for i in (0, 1)]
        by_core = [Phi[:, :, 2 * at + i, 2 * at] * coming.shift_sd for i in (0, 1)]
        pairs = [(by_inlet[:, :, 0::2], by_inlet[:, :, 1::2]), by_heat, by_core]
        more = sum(np.stack((a * a, b * b, a * b)) for a, b in pairs)
        return Spread(still + more, np.matmul(slopes, slopes.swapaxes(3, 4)))

    def _follow(self, s: Standing) -> _Made:
        """Make matrices anew for strings whose parameters or flow have changed."""
        made, phi = self._made, s.unlike.phi
        wanted = [(p, int(level)) for p, level in zip(s.parameters, s.level, strict=True)]
        was = [(None, 0)] * len(wanted) if made is None else made.of
        at = [i for i, (a, b) in enumerate(zip(was, wanted, strict=True)) if a[0] is not b[0] or a[1] != b[1]]
        if made is not None and not at:
            return made
        parts = [_reach(*wanted[i], float(phi[i, 0]), s.disturbance) for i in at]
        if made is None:
            reach = Reach(*(np.stack([getattr(r, f.name) for r in parts]) for f in fields(Reach)))
        else:
            reach = made.reach
            for i, part in zip(at, parts, strict=True):
                for f in fields(Reach):
                    getattr(reach, f.name)[i] = getattr(part, f.name)
        in_force = [at_level(p, level) for p, level in wanted]
        R_e = np.stack([p.R_e for p in in_force])
        share, n, M = R_e / R_e.mean(axis=1, keepdims=True), R_e.shape[1], s.x.shape[1]
        tau = time_constant(phi, np.stack([p.R_c for p in in_force]), np.stack([p.C_c for p in in_force]))
        later = np.matmul(reach.path[:, :, :, M : M + n], share[:, None, :, None])[..., 0]
        response = course(later, np.zeros_like(s.x), np.zeros_like(s.lag), reach.by_path, reach.by_now)
        flows = Flows.of(in_force)
        tiled = Flows(*(np.repeat(getattr(flows, f.name), PARTS, axis=0) for f in fields(Flows)))
        self._made = _Made(reach, tiled, tau, share, R_e.mean(axis=1), response, wanted)
        return self._made


def _reach(p: StringParameters, level: int, phi: float, disturbance: Disturbance) -> Reach:
    p = at_level(p, level)
    system = augmented(p, disturbance)
    B = np.hstack((system.B_q, system.B_f[:, None]))
    return Reach.of(system.A, B, noise_intensity(system.B_q, disturbance), time_constant(phi, p.R_c, p.C_c))


def _inputs(x: Floats, heat: Floats, inlet: Floats) -> Floats:
    return np.concatenate((x, heat, inlet[:, None]), axis=1)


def _shifted(s: Standing, coming: Coming) -> Floats:
    """State (S, M) with the cores shifted to their believed temperatures."""
    if not coming.shift.any():
        return s.x
    x = s.x.copy()
    x[:, 0 : 2 * coming.shift.shape[1] : 2] += coming.shift
    return x


def _middles(x: Floats) -> Floats:
    """Means (S, PARTS, M) of the states (S, PARTS + 1, M) at both ends of each segment."""
    return np.asarray((x[:, 1:] + x[:, :-1]) / 2.0, dtype=np.float64)


def _with_own(flows: Flows, s: Standing) -> Flows:
    """Give the coefficients of reversible heat, and where R_e is known, to flows of all parts."""
    return replace(flows, entropic=np.repeat(s.entropic, PARTS, axis=0), u_0=np.repeat(s.u_0, PARTS))


def _forcing(
    flows: Flows, middle: Floats, made: tuple[Floats, Floats], inlet: Floats, amps: Floats | None = None
) -> Floats:
    """Return the forcing (S, PARTS, M, p) of sensitivities at the states `middle`, for constant heat and inlet.

    `made` is the heat from I²R_e and that which is measured otherwise; `amps` (S PARTS, 2) makes reversible heat.
    """
    (S, parts, M), n = middle.shape, flows.C_c.shape[1]
    heat, known = ((np.repeat(a, parts, axis=0) if a.ndim == 2 else a).reshape(-1, n) for a in made)
    at = (np.repeat(inlet, parts) if inlet.ndim == 1 else inlet).reshape(-1)
    return flows.forcing(middle.reshape(S * parts, M), heat, known, at, amps).reshape(S, parts, M, len(PARAMETERS))


def _told(ahead: Ahead, s: Standing) -> Ahead:
    """Set the forecast of strings that are not available to NaN."""
    if s.available.all():
        return ahead
    c, there = ahead.still, s.available[:, None]
    return replace(ahead, still=Course(*(np.where(there, a, np.nan) for a in (c.core, c.surface, c.lag))))
