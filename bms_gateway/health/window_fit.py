r"""Fit of one window of a commissioned string, independent of every other window.

The fit finds R_e, R_u, and factors on the commissioned R_c, C_c and C_s, each common to all cells, and an offset b of
each thermocouple against the inlet's sensor. Start temperatures, a gain of the inlet's changes and a slow model error
are marginalised. Windows have no result in common, so that their errors are independent in the `trend`.

R_e is referred to 25 °C within the fit: the current's square is weighted by

.. math:: \exp\bigl(B (1/T_c - 1/298.15\,\mathrm{K})\bigr)

with T_c computed from the measured surfaces and the current. An error of B changes every result of the window, offsets
by tenths of a K: if the heat falls while the core warms, the surfaces look like those of another time constant or of
another level. `Observed.by_B` has the derivative of the results by B, from which the trend learns B.

The noise of the inlet's readings adds to the sum of squares; its expected share is subtracted (`inlet_noise`).
Otherwise B would be 0.7 % too low, which makes half a point of growth between winter and summer.

The equations are those of Lin et al., Eq 1 and 16-18.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bms_gateway.identify.inlet_noise import Sight, inlet_noise, of_swing, slopes_by_noise
from bms_gateway.identify.model_noise import SIZES, Whitener, white_sd
from bms_gateway.identify.quadratic import Quadratic
from bms_gateway.identify.response import Inputs, Response, respond
from bms_gateway.identify.window_start import (
    FRESH,
    at_readings,
    first_start,
    lateness,
    start_information,
    start_map,
    swing_information,
)
from bms_gateway.thermal import Floats, StringParameters

KELVIN, REFERENCE_K = 273.15, 298.15
COLDEST = -60.0  # °C: least core temperature that the weights use; the fit may pass through colder starts
STRIDE_S = 4.0
STEP, STEP_B = 1e-4, 1.0  # steps for slopes: of a logarithm or K, and of B
SHAPE = ("R_u", "R_c", "C_c", "C_s")  # the surface is not linear in these numbers; it is linear in R_e
FIRST_OFFSET = 1 + len(SHAPE)
ROUNDS = 12  # at most; the third and fourth still change the start, and with it the core temperature
SETTLED = 0.05  # squared length of a step, in sd of its numbers: a shorter step changes no result of a window
UNLIKE_SD = 0.03
"""Relative: R_e of the last cell along the coolant over that of the middle cell. Only the differences of the surfaces
along the string separate R_e from R_u: a difference of a few per cent in R_e shifts both results by many per cent."""
TAU_S = 150.0  # time constant of the slow model error: shorter than the core's, longer than the casing's
FLOOR = 0.2  # K·√s: least white noise; the model of two nodes is not more exact
WIDE, WIDE_OFFSET = (1.0, 1.0, 0.3, 0.3, 0.3), 3.0
# ln of R_e and `SHAPE`, K: wide prior about the trend's guess, so that a window without information changes nothing
FARTHEST = 0.7  # largest change of a logarithm in one round: a factor of two


@dataclass(frozen=True, slots=True)
class DriveWindow:
    """K ticks of one string.

    Attributes
    ----------
    square : ndarray (K,)
        Mean I², A²; for a model with effects the one that makes the same heat by R_e.
    inlet : ndarray (K + 1,)
        °C at the instants.
    surface, age : ndarray (K, n)
        °C with NaN for none; s.
    dt : float
        s.
    soc : float
        Mean state of charge; NaN where unknown.
    flow : float
        Mean coolant flow over nominal; NaN where unknown.
    """

    square: Floats
    inlet: Floats
    surface: Floats
    age: Floats
    dt: float
    soc: float = float("nan")
    flow: float = float("nan")


@dataclass(frozen=True, slots=True)
class Observed:
    """Result of a window.

    Attributes
    ----------
    mean : ndarray (5 + m,)
        ln of R_e at 25 °C, R_u, R_c, C_c, C_s over the commissioned ones; offsets b, K.
    cov : ndarray (5 + m, 5 + m)
    B : float
        K: the exponent with which R_e was referred to 25 °C.
    by_B : ndarray (5 + m,)
        d mean / dB.
    warmth : float
        Heat-weighted mean of 1/T_c − 1/298.15 K, 1/K.
    core : float
        Heat-weighted mean core temperature, °C.
    soc, flow : float
        As of the window.
    rms : float
        Of the residual, K.
    slow : float
        Size of the slow model error that explains the readings best, K.
    """

    mean: Floats
    cov: Floats
    B: float
    by_B: Floats
    warmth: float
    core: float
    soc: float
    flow: float
    rms: float
    slow: float


def mean_surface(w: DriveWindow) -> Floats:
    """Mean measured surface of the ticks (K,), °C, interpolated where there was no reading."""
    count = np.isfinite(w.surface).sum(axis=1)
    read = np.flatnonzero(count)
    mean = np.nansum(w.surface[read], axis=1) / count[read]
    return np.asarray(np.interp(np.arange(len(count)), read, mean), dtype=np.float64)


def at_mean_charge(w: DriveWindow, current: Floats, capacity_Ah: float, slope: float) -> DriveWindow:
    """Give a window the heat that it would make at constant charge, because R_e also changes with the charge.

    A drive that empties the cells raises R_e while it warms them; without this step B would come out too small.

    Parameters
    ----------
    w : DriveWindow
    current : ndarray (K·j,)
        A, of each tick or of j equal parts of it.
    capacity_Ah : float
    slope : float
        Of ln R_e over the missing charge.
    """
    moved = -np.cumsum(current.reshape(len(w.square), -1).mean(axis=1)) * w.dt / (3600.0 * capacity_Ah)
    return replace(w, square=w.square * np.exp(slope * (moved.mean() - moved)))


def core_temperature(p: StringParameters, surface: Floats, square: Floats, B: float, start: float, dt: float) -> Floats:
    """Mean core of the ticks (K,), °C, from mean surfaces, the current's square, A², and the core at the start.

    The heat depends on the core's temperature. Each step therefore uses the heat at its middle, computed from the end
    of the step before. Several short ticks make one step of `STRIDE_S`, a hundredth of the core's time constant; the
    last step counts as a whole one.
    """
    first = np.arange(0, len(surface), max(1, round(STRIDE_S / dt)))
    count = np.diff(np.append(first, len(surface)))
    R_c, C_c = float(np.mean(p.R_c)), float(np.mean(p.C_c))
    a = math.exp(-dt * float(count[0]) / (R_c * C_c))
    fed = ((1.0 - a) * np.add.reduceat(surface, first) / count).tolist()
    heat = ((1.0 - a) * R_c * float(np.mean(p.R_e)) * np.add.reduceat(square, first) / count).tolist()
    core, T = [], start
    for s, h in zip(fed, heat, strict=True):
        warm = (T if T > COLDEST else COLDEST) + KELVIN
        q = h * math.exp(B * (1.0 / warm - 1.0 / REFERENCE_K))
        cold = a * T + s
        after = cold + q / (1.0 + 0.5 * B / warm**2 * (cold + q - T))
        core.append(0.5 * (T + after))
        T = after
    return np.repeat(core, count)


def fit_window(p: StringParameters, w: DriveWindow, sensed: Sequence[int], guess: Floats, B: float) -> Observed:
    """Fit one window.

    Parameters
    ----------
    p : StringParameters
        As commissioned, at nominal flow.
    w : DriveWindow
        With at least one reading.
    sensed : sequence of int
        0-based cells with a thermocouple (m of them).
    guess : ndarray (5 + m,)
        What the trend expects, as of `Observed.mean`.
    B : float
        K.
    """
    if w.flow > 0.0:
        p = p.with_flow_ratio(w.flow)
    if np.isfinite(p.C_f) and p.coolant == "bulk":
        p = replace(p, coolant="ntu")  # exists at every R_u; the difference is one of level, which cancels in growth
    y = w.surface[:, list(sensed)]
    valid = np.isfinite(y)
    late = lateness(w.age, w.dt, sensed)
    theta, m, n = guess.copy(), len(sensed), p.cells
    wide = np.array([*WIDE, *[WIDE_OFFSET] * m]) ** -2
    swing = np.array([swing_information(w.inlet), UNLIKE_SD**-2])
    start_info = start_information(n, *FRESH)
    s0 = first_start(y, w.dt, float(w.inlet[0]), n)
    xi = np.concatenate([[0.0, 0.0], s0])
    slow, square, searched, near = 0.12, w.square, False, False
    exponent, core, r, H, g_B, by_noise = square, square, y, np.eye(1), square, square
    along = np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1)
    for k in range(ROUNDS):
        own = replace(p, R_e=p.R_e * np.exp(xi[1] * along))
        sets = [_at(own, theta), *(_at(own, theta + STEP * e) for e in np.eye(len(theta))[:FIRST_OFFSET])]
        maps = [start_map(s, float(w.inlet[0])) for s in sets]
        starts = np.array([E @ xi[2:] + c for E, c in maps])
        exponent, shapes, core = _warmth(sets, w, B, starts[:, 0::2].mean(axis=1))
        square = w.square * np.exp(B * exponent)
        now = Inputs(
            square, np.zeros(len(square)), w.inlet, w.dt, shapes, np.zeros(shapes.shape[1]), 1.0 + float(xi[0])
        )
        unlike = replace(sets[0], R_e=sets[0].R_e * np.exp(STEP * along))
        R = respond([sets[0], *sets[2:], unlike], now, starts[[0, 2, 3, 4, 5, 0]], list(sensed))
        f = at_readings(R.surface.transpose(1, 2, 0), late)
        columns = _columns(R, f, maps[0][0], late, m)
        r = np.where(valid, y - f[:, :, 0] - theta[FIRST_OFFSET:], np.nan)
        white = white_sd(r, FLOOR / float(np.sqrt(w.dt)))
        final = not searched and (near or k >= ROUNDS - 3)
        if final:
            whitener, slow = _likeliest_whitener(valid, r, columns, white, w.dt)
        else:
            whitener = Whitener.of(valid, white, slow, TAU_S, w.dt)
        searched = searched or final
        by_B = at_readings(R.surface_by_input[:, :, -2:-1], late)
        both = whitener(np.concatenate([columns, by_B, r[:, :, None]], axis=2)).reshape(-1, columns.shape[2] + 2)
        M = both.T @ both
        H, g, g_B = M[:-2, :-2].copy(), M[:-2, -1].copy(), M[:-2, -2]
        q = len(theta)
        H[np.arange(q), np.arange(q)] += wide
        g[:q] += wide * (guess - theta)
        H[[q, q + 1], [q, q + 1]] += swing
        g[q : q + 2] -= swing * xi[:2]
        H[q + 2 :, q + 2 :] += start_info
        g[q + 2 :] += start_info @ (s0 - xi[2:])
        if final or not k:
            sight = Sight(sensed, partial(_seen, late=late, white=whitener))
            answer = slopes_by_noise([sets[0], *sets[2:]], STEP, len(square), w.dt, 1.0 + float(xi[0]), sight)
            by_noise = inlet_noise(w.inlet, w.dt) ** 2 * answer
        g[1:FIRST_OFFSET] += by_noise[:-1]
        g[q] += of_swing(float(by_noise[-1]), float(M[q, q]))
        step = Quadratic(H, g).step
        step[:FIRST_OFFSET] = np.clip(step[:FIRST_OFFSET], -FARTHEST, FARTHEST)
        theta, xi = theta + step[:q], xi + step[q:]
        near = float(step @ H @ step) < SETTLED
        if near and searched:
            break
    told = Quadratic(H, -g_B).marginal(np.arange(len(theta)))  # also the derivative of the result by B
    cov, moved = np.linalg.inv(told.H), told.step
    weight = w.square / max(float(w.square.sum()), 1e-9)
    return Observed(
        theta, 0.5 * (cov + cov.T), B, moved, float(weight @ exponent), float(weight @ core), w.soc, w.flow,
        float(np.sqrt(np.nanmean(r**2))), slow,
    )  # fmt: skip


def _at(p: StringParameters, theta: Floats) -> StringParameters:
    scaled = {name: getattr(p, name) * np.exp(x) for name, x in zip(("R_e", *SHAPE), theta[:FIRST_OFFSET], strict=True)}
    return replace(p, **scaled)


def _seen(Y: Floats, late: Floats, white: Whitener) -> Floats:
    """Whitened residuals (K, m, …) of surfaces (K + 1, m, …)."""
    return white(at_readings(Y, late))


def _columns(R: Response, f: Floats, E: Floats, late: Floats, m: int) -> Floats:
    """Slopes of the readings (K, m, 5 + m + 2 + 2n) by θ, the inlet's gain, the cells' differences and the start."""
    by_input = at_readings(R.surface_by_input, late)
    by_theta = by_input[:, :, :FIRST_OFFSET].copy()  # by R_e itself, and by the core temperature that weights the heat
    moved = (f[:, :, 1:] - f[:, :, :1]) / STEP
    by_theta[:, :, 1:] += moved[:, :, :-1]
    offsets = np.broadcast_to(np.eye(m), (len(f), m, m))
    start = at_readings(R.surface_by_start, late) @ E + by_input[:, :, FIRST_OFFSET, None] * E[0::2].mean(axis=0)
    return np.concatenate([by_theta, offsets, by_input[:, :, -1:], moved[:, :, -1:], start], axis=2)


def _warmth(
    sets: Sequence[StringParameters], w: DriveWindow, B: float, starts: Floats
) -> tuple[Floats, Floats, Floats]:
    """1/T_c − 1/298.15 K (K,); slopes of the heat's logarithm (K, 7) by θ, the core's start and B; T_c (K,)."""
    surface = mean_surface(w)
    cases = [(p, start, B, STEP) for p, start in zip(sets, starts, strict=True)]
    cases += [(sets[0], starts[0] + STEP, B, STEP), (sets[0], starts[0], B + STEP_B, STEP_B)]
    cores = [core_temperature(p, surface, w.square, at, float(start), w.dt) for p, start, at, _ in cases]
    exponents = [1.0 / (np.maximum(core, COLDEST) + KELVIN) - 1.0 / REFERENCE_K for core in cores]
    moved = [(at * e - B * exponents[0]) / step for e, (_, _, at, step) in zip(exponents, cases, strict=True)]
    slopes = np.array(moved[1:])
    slopes[0] += 1.0
    return exponents[0], slopes.T, cores[0]


def _likeliest_whitener(
    valid: np.ndarray, r: Floats, columns: Floats, white: float, dt: float
) -> tuple[Whitener, float]:
    """Find the slow noise under which the residual is likeliest, without the part that the numbers can still explain.

    Returns the noise and the size of its slow part, K.
    """
    best, chosen, size = np.inf, None, 0.0
    both = np.concatenate([columns, r[:, :, None]], axis=2)
    for slow in SIZES:
        W = Whitener.of(valid, white, slow, TAU_S, dt)
        A = W(both).reshape(-1, both.shape[2])
        M = A.T @ A
        H = M[:-1, :-1] + 1e-6 * np.diag(np.diag(M)[:-1] + 1.0)
        score = Quadratic(H, M[:-1, -1]).integrated(float(M[-1, -1]) + W.log_det)
        if score < best:
            best, chosen, size = score, W, slow
    assert chosen is not None  # noqa: S101 - the first of the sizes is better than infinity
    return chosen, size
