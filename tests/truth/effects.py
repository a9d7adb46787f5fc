"""The catalogue's effects, from their equations, in the truth's own code: each changes the `Terms` of one log.

Cells are counted from 1. Effects of the measurement (thermocouples, inlet and current sensors) are in `sense`.
"""

import numpy as np
from scipy.signal import lfilter

RINGS = 32
"""Shells of the cylinder: within 0.01 K of the continuum at 100 A pulses."""
KNOTS = np.array([0.05, 0.35, 0.65, 0.95])
"""State of charge at which the entropic coefficient is given, where it varies."""


def entropic_heat(t, *, dUdT):
    """Heat −I T dU/dT, dUdT in mV/K, one value or one per knot."""
    value = np.atleast_1d(np.asarray(dUdT, float)) * 1e-3
    t.entropic += np.interp(t.soc, KNOTS, value) if value.size > 1 else value[0]


def voltage_heat(t, *, swing, periods, phases):
    """R_e wanders irregularly, which only the voltage sees; `swing` is its rms share."""
    s = sum(np.sin(2 * np.pi * 3600 * t.hours / p + a) for p, a in zip(periods, phases, strict=True))
    t.R_e *= np.exp(swing * s / np.sqrt(len(periods) / 2))[:, None]


def resistance_temperature(t, *, B):
    t.B += B


def resistance_soc(t, *, s_1, s_2):
    u = 1 - 2 * t.soc
    t.R_e *= (1 + s_1 * u + s_2 * u * u)[:, None]


def resistance_asymmetry(t, *, a):
    t.asymmetry += a


def charge_transfer(t, *, I_0, E):
    t.exchange_current, t.exchange_energy = I_0, E


def hysteresis(t, *, V, Q):
    """|I| V (1 − exp(−q/Q)), q [Ah] the charge moved since the current last changed its direction."""
    q, direction, mean = 0.0, 0.0, np.zeros(t.K)
    for k, amps in enumerate(t.I):
        if amps * direction < 0:
            q = 0.0
        direction = np.sign(amps) or direction
        step = abs(amps) / 3600
        z = step / Q
        mean[k] = 1 - np.exp(-q / Q) * (-np.expm1(-z) / z if z > 1e-12 else 1.0)
        q += step
    t.core_heat += (t.I_abs * V * mean)[:, None]
    t.drop += np.sign(t.I) * V * mean


def polarization(t, *, R_1, tau):
    """V_1' = (I R_1 − V_1)/τ exactly, current by current; heat V_1²/R_1 as its mean over each second."""
    a = np.exp(-1 / tau)
    target = t.I * R_1
    end = lfilter([1 - a], [1, -a], target)
    gap = np.concatenate([[0.0], end[:-1]]) - target
    one, two = tau * (1 - a), tau / 2 * (1 - a * a)
    t.core_heat += ((target**2 + 2 * target * gap * one + gap**2 * two) / R_1)[:, None]
    t.drop += target + gap * one


def radial_gradient(t, *, phi):
    t.rings, t.share = RINGS, phi


def resistance_drift(t, *, a):
    t.R_e *= 1 + a * t.hours[:, None]


def cooling_drift(t, *, a):
    t.R_u *= 1 + a * t.hours[:, None]


def flow_dependent_cooling(t, *, n):
    t.R_u *= t.flow[:, None] ** -n


def natural_convection(t, *, n):
    t.film_power += n


def ambient_loss(t, *, G, P):
    t.G += G
    t.casing_heat += P


def core_loss(t, *, G, P):
    t.core_G += G
    t.sink = np.full(t.K, 25.0)
    t.core_heat += P


def surface_joule(t, *, R_s):
    t.casing_heat += R_s * t.I2[:, None]


def _ends(t, value):
    at = np.zeros(t.n)
    at[[0, -1]] = value
    return at


def busbar_joule(t, *, R_s):
    t.casing_heat += _ends(t, R_s) * t.I2[:, None]


def end_plate(t, *, G, P):
    t.G += _ends(t, G)
    t.casing_heat += _ends(t, P)


def coolant_delay(t, *, tau):
    """Two thirds of τ, nearly, as a plug of air and the rest as a lag; constant before the log begins."""
    instants = np.arange(t.K + 1.0)
    t.inlet = lagged(np.interp(instants - 0.65 * tau, instants, t.inlet), 0.35 * tau)


def coolant_bypass(t, *, b, cell):
    """The share b leaves the stream after `cell`."""
    t.C_f[:, cell:] *= 1 - b


def cell_resistance(t, *, a, cell):
    t.R_e[:, cell - 1] *= 1 + a


def cell_cooling(t, *, a, cell):
    t.R_u[:, cell - 1] *= 1 + a


def cell_conduction(t, *, a, cell):
    t.R_c[cell - 1] *= 1 + a


def neighbour_heat(t, *, P, cell):
    t.casing_heat[:, cell - 1] += P


def phase_change(t, *, L, T_m, w):
    t.latent, t.melting, t.melting_width = L, T_m, w


CATALOGUE = {
    f.__name__: f
    for f in (
        entropic_heat,
        voltage_heat,
        resistance_temperature,
        resistance_soc,
        resistance_asymmetry,
        charge_transfer,
        hysteresis,
        polarization,
        radial_gradient,
        resistance_drift,
        cooling_drift,
        flow_dependent_cooling,
        natural_convection,
        ambient_loss,
        core_loss,
        surface_joule,
        busbar_joule,
        end_plate,
        coolant_delay,
        coolant_bypass,
        cell_resistance,
        cell_cooling,
        cell_conduction,
        neighbour_heat,
        phase_change,
    )
}
"""Effects of the pack."""

SENSING = ("thermocouple_lag", "thermocouple_offset", "thermocouple_contact", "inlet_offset", "current_offset")
"""Effects of what is measured."""


def lagged(x, tau):
    """First-order lag of a series of straight lines, exact: y' = (x − y)/τ from y = x at the start; 1 s steps."""
    if tau <= 0:
        return np.array(x, float)
    a = np.exp(-1.0 / tau)
    r = (1 - a) * tau
    start = np.asarray(x)[:1]
    rest = lfilter([1 - r, r - a], [1, -a], x[1:], axis=0, zi=(r - a) * start + a * start)[0]
    return np.concatenate([start, rest])


def sense(surface, coolant, inlet, current, effects):
    """Readings without noise: surface (K + 1, n), inlet (K + 1,), current (K,), as wrong as `effects` make them."""
    y, T_in, amps = surface.copy(), np.array(inlet, float), np.array(current, float)
    if p := effects.get("thermocouple_contact"):
        c = p["cell"] - 1
        y[:, c] += p["g"] * (coolant[:, c] - y[:, c])
    if p := effects.get("thermocouple_lag"):
        y = lagged(y, p["tau"])
    if p := effects.get("thermocouple_offset"):
        y[:, p["cell"] - 1] += p["b"]
    if p := effects.get("inlet_offset"):
        T_in += p["b"]
    if p := effects.get("current_offset"):
        amps += p["b"]
    return y, T_in, amps
