r"""Simulated drive cycles, each drawn from a seed: the current of the battery of a hybrid vehicle, second by second.

The paper drives its cell with an urban assault cycle of the US Army and with US06 and UDDS. The urban assault cycle is
not published; the paper states its length, its limits and its heat. The cycles here have these figures, or those of the
speed of US06 and UDDS, and are random otherwise: two seeds give different courses. Current is per cell, positive on
discharge, constant within each second, and without net charge, because the engine of a hybrid supplies the mean power.

For the cycles that follow a speed v, the power per mass of the vehicle is that of its road load

.. math::
    p = v\,(1.05\,\dot v + g c_r + c_w v^2), \qquad I = G\,p \; (p > 0), \quad I = 0.6\,G\,p \; (p < 0)

with the same vehicle for both, so that the currents of UDDS are lower than those of US06 as they are on the road.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from bms_gateway.thermal.parameters import Floats

# The urban assault cycle of the paper's 8 Ah cell: +160 A, −96 A, 62.2 A rms; here per Ah of capacity.
C_RATE_HIGH, C_RATE_LOW, C_RATE_RMS = 20.0, -12.0, 62.2 / 8.0
URBAN_ASSAULT_S, US06_S, UDDS_S = 1332, 596, 1369
CAPACITY_AH = 8.0
"""Capacity of the paper's cell."""

ROLLING, DRAG = 9.81 * 0.01, 2.4e-4
"""m/s² and 1/m: a passenger car's road load per mass."""
INERTIA = 1.05  # mass including the inertia of wheels and motor, over the mass
BRAKES_SHARE = 0.6  # share of the braking power that reaches the battery; the rest goes into brakes and losses
C_RATE_PER_POWER = C_RATE_HIGH / 30.0
"""1/h per W/kg: greatest current at 30 W/kg, which is the greatest acceleration of US06 at 70 km/h."""


def urban_assault(rng: np.random.Generator, capacity_Ah: float = CAPACITY_AH) -> Floats:
    """Draw one cycle of 1,332 s like the paper's urban assault cycle.

    Pulses of 2 to 20 s in calm and intense stretches; both limits are reached.

    Parameters
    ----------
    rng : numpy Generator
    capacity_Ah : float
        The cell's; limits and rms grow with it.

    Returns
    -------
    ndarray (1332,)
        A.

    References
    ----------
    Lin et al., Fig 3: +160 A, −96 A; the rms is what the temperatures of Fig 7 ask for.

    Examples
    --------
    >>> current = urban_assault(np.random.default_rng(1))
    >>> len(current), float(current.max().round(6)), round(float(np.sqrt(np.mean(current**2))), 1)
    (1332, 160.0, 62.2)
    """
    raw = np.empty(0)
    while len(raw) < URBAN_ASSAULT_S:
        intensity = rng.choice([0.1, 0.5, 1.0, 1.6], p=[0.2, 0.25, 0.35, 0.2])
        pulses = rng.normal(0.0, intensity, int(rng.integers(5, 20))) * (rng.random() < 0.9)
        raw = np.concatenate([raw, np.repeat(pulses, rng.integers(2, 21, len(pulses)))])
    raw = raw[:URBAN_ASSAULT_S]
    raw[[np.argmax(raw), np.argmin(raw)]] = 1e3, -1e3  # clipped below: both limits are reached
    gain, shift = C_RATE_RMS, 0.0
    for _ in range(100):  # clipping changes mean and rms: correct them in turn until both are right
        cycle = np.clip(gain * raw + shift, C_RATE_LOW, C_RATE_HIGH)
        gain *= C_RATE_RMS / float(np.sqrt(np.mean(cycle**2)))
        shift -= float(np.mean(cycle))
    return np.clip(gain * raw + shift, C_RATE_LOW, C_RATE_HIGH) * capacity_Ah


def us06(rng: np.random.Generator, capacity_Ah: float = CAPACITY_AH) -> Floats:
    """Draw one cycle of 596 s like US06: five trips with high power, up to 129 km/h, with short stops; (596,) A.

    References
    ----------
    Length, top speed and number of trips of the EPA's US06; the trips are drawn.
    """
    return _current(_speed(rng, US06_S, trips=5, fastest=35.9, pull=(1.5, 3.5), stand=(3, 10)), capacity_Ah)


def udds(rng: np.random.Generator, capacity_Ah: float = CAPACITY_AH) -> Floats:
    """Draw one cycle of 1,369 s like UDDS: seventeen trips in a town between stops, up to 91 km/h; (1369,) A.

    References
    ----------
    Length, top speed and number of trips of the EPA's UDDS; the trips are drawn.
    """
    return _current(_speed(rng, UDDS_S, trips=17, fastest=25.3, pull=(0.8, 1.5), stand=(8, 25)), capacity_Ah)


CYCLES: Mapping[str, Callable[[np.random.Generator, float], Floats]] = MappingProxyType(
    {"urban-assault": urban_assault, "us06": us06, "udds": udds}
)
"""Every cycle by its name."""


def _speed(
    rng: np.random.Generator,
    seconds: int,
    *,
    trips: int,
    fastest: float,
    pull: tuple[float, float],
    stand: tuple[int, int],
) -> Floats:
    """Speed (seconds + 1,) m/s of trips from stop to stop, one of which reaches `fastest`."""
    tops = fastest * rng.uniform(0.3, 0.75, trips)
    tops[int(rng.integers(trips))] = fastest
    standing = rng.integers(*stand, trips)
    legs = []
    for top in tops:
        away = np.arange(0.0, top, rng.uniform(*pull) * rng.uniform(0.7, 1.0))
        braking = np.arange(top, 0.0, -rng.uniform(1.0, 2.0))
        legs.append((away, top, braking))
    left = seconds + 1 - sum(len(a) + len(b) for a, _, b in legs) - int(standing.sum())
    shares = rng.dirichlet(np.full(trips, 3.0)) * max(left, 0)  # the trips cruise in the remaining time
    parts = []
    for (away, top, braking), share, stop in zip(legs, shares, standing, strict=True):
        sway = np.cumsum(rng.normal(0.0, 0.35, int(share)))
        sway -= np.linspace(0.0, sway[-1], len(sway)) if len(sway) else 0.0  # back at the top speed when it brakes
        cruise = np.clip(top + sway, 0.7 * top, min(1.1 * top, fastest))
        parts += [np.zeros(stop), away, cruise, braking]
    v = np.concatenate(parts)[: seconds + 1]
    return np.concatenate([v, np.zeros(seconds + 1 - len(v))])


def _current(v: Floats, capacity_Ah: float) -> Floats:
    """Convert a speed to the current of its road load; the engine supplies the mean."""
    mean, change = (v[1:] + v[:-1]) / 2.0, np.diff(v)
    power = mean * (INERTIA * change + ROLLING + DRAG * mean**2)
    rate = C_RATE_PER_POWER * np.where(power > 0.0, power, BRAKES_SHARE * power)
    rate = np.where(mean > 0.0, rate, 0.0)
    for _ in range(100):  # clipping changes the mean
        clipped = np.clip(rate, C_RATE_LOW, C_RATE_HIGH)
        rate = rate - float(np.mean(clipped))
    return np.clip(rate, C_RATE_LOW, C_RATE_HIGH) * capacity_Ah
