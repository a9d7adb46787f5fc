"""Effects that are in no catalogue: what a diagnosis has to call unknown. Each changes the `Terms` of one log.

`size` is 1 at medium strength. Where an effect needs chance (when does the sun come out), it takes its own generator.
Effects of what is read rather than of the pack change the readings: they return a function of the readings.
"""

import numpy as np


def _telegraph(rng, K, shortest, longest, edge=20):
    """0…1 (K,), switching at random times, with edges of so many seconds."""
    out, k, on = np.zeros(K), 0, bool(rng.random() < 0.5)
    while k < K:
        stay = int(rng.integers(shortest, longest))
        out[k : k + stay] = on
        k, on = k + stay, not on
    return np.convolve(np.pad(out, edge, mode="edge"), np.ones(edge) / edge, mode="same")[edge:-edge]


def sun_load(t, size, rng):
    """The sun lies on the first cells, and clouds pass."""
    shade = np.convolve(rng.uniform(0.6, 1.0, t.K // 120 + 2), [1.0], mode="same")
    haze = np.interp(np.arange(t.K), 120 * np.arange(len(shade)), shade)
    lit = np.zeros(t.n)
    lit[: max(1, t.n // 2)] = rng.uniform(0.7, 1.0, max(1, t.n // 2))
    t.casing_heat += 1.6 * size * (_telegraph(rng, t.K, 250, 700) * haze)[:, None] * lit


def bypass_opens(t, size, rng):
    """A valve sticks open midway: part of the air no longer passes the cells, and no sensor says so."""
    at = rng.uniform(0.35, 0.6) * t.K
    left = 1 - min(0.16 * size, 0.8) / (1 + np.exp(-(np.arange(t.K) - at) / 15))
    t.C_f *= left[:, None]
    t.R_u *= left[:, None] ** -0.63


def fan_by_temperature(t, size, rng):
    """A fan cuts in by temperature; its flow is not recorded. `integrate` closes the loop."""
    warm = t.start + rng.uniform(4.5, 6.0)
    t.fan = (warm, warm - 2.0, 1 + 0.5 * size)


def electronics_box(t, size, rng):
    """Heat of a converter beside the last cells, which follows its own load."""
    load = 0.5 * _telegraph(rng, t.K, 120, 500, edge=60) + 0.5 * _telegraph(rng, t.K, 300, 900, edge=120)
    near = np.exp(-np.arange(t.n)[::-1] / 1.2)
    t.casing_heat += 2.4 * size * load[:, None] * near


def moisture(t, size, rng):
    """Condensate on the casings evaporates until it is gone."""
    t.water = (700.0 * size, 0.35 * size, t.start + rng.uniform(0.5, 2.0))


def parallel_load(t, size, rng):
    """At times a second load draws a current that the shunt does not see; it shares the cells."""
    hidden = 30.0 * np.sqrt(size) * _telegraph(rng, t.K, 100, 500, edge=1) * rng.choice([0.6, 1.0])
    total = t.I + hidden
    t.rows = t.rows + hidden
    t.I2_charge = np.where(total < 0, total**2, 0.0)
    t.I2, t.I_abs, t.I = t.I2 + 2 * t.I * hidden + hidden**2, np.abs(total), total


def ambient_swing(t, size, rng):
    """The cabin's thermostat swings the air around the casings."""
    s = np.arange(t.K)
    wave = np.sin(2 * np.pi * s / rng.uniform(400, 800) + rng.uniform(0, 6))
    wave += 0.5 * np.sin(2 * np.pi * s / rng.uniform(900, 1400) + rng.uniform(0, 6))
    t.casing_heat += 0.75 * size * wave[:, None] * np.linspace(1.0, 0.6, t.n)


def self_heating(t, size, rng):
    """A slow reaction whose heat grows exponentially with the core's temperature."""
    t.reaction, t.reaction_K = 0.5 * size, rng.uniform(5.0, 7.0)


def balancing_resistor(t, size, rng):
    """The balancing resistor of one cell switches at times; its heat goes into that casing."""
    at = np.zeros(t.n)
    at[rng.integers(0, t.n)] = 1.0
    t.casing_heat += 2.8 * size * _telegraph(rng, t.K, 150, 450, edge=1)[:, None] * at


def loose_joint(t, size, rng):
    """The weld of one cell makes contact or not as the pack shakes: its heat enters casing and core in bursts."""
    at = np.zeros(t.n)
    at[rng.integers(0, t.n)] = 1.0
    loose = _telegraph(rng, t.K, 60, 400, edge=1) * (7e-4 * size)
    t.casing_heat += (0.6 * loose * t.I2)[:, None] * at
    t.core_heat += (0.4 * loose * t.I2)[:, None] * at


def thermal_break(t, size, rng):
    """The air path to half of the cells clogs and clears by itself."""
    clogged = _telegraph(rng, t.K, 300, 900, edge=60)[:, None]
    late = (np.arange(t.n) >= t.n // 2).astype(float)
    t.R_u *= 1 + 0.2 * size * clogged * late


def bubbles(t, size, rng):
    """Bubbles pass along a liquid-cooled string: each blankets a casing for some seconds, and less liquid flows by."""
    gas, k = np.zeros(t.K), int(rng.integers(0, 120))
    while k < t.K:
        lasts = int(rng.integers(15, 60))
        gas[k : k + lasts] = rng.uniform(0.6, 1.0)
        k += lasts + int(rng.integers(60, 300))
    dry = min(0.35 * size, 0.85)
    for c in range(t.n):
        here = np.concatenate([np.zeros(min(5 * c, t.K)), gas])[: t.K]
        t.R_u[:, c] /= 1 - dry * here
        t.C_f[:, c] *= 1 - 0.5 * dry * here


def foreign_sink(t, size, rng):
    """The ends of the rolls rest on a frame whose temperature is not the coolant's, wanders, and is not measured."""
    s = np.arange(t.K)
    t.sink = (
        t.start + rng.choice([-8.0, 8.0]) + 3.0 * np.sin(2 * np.pi * s / rng.uniform(1200, 2400) + rng.uniform(0, 6))
    )
    t.core_G += 0.06 * size * rng.uniform(0.8, 1.2, t.n)


STRANGE = {
    f.__name__: f
    for f in (
        sun_load,
        bypass_opens,
        fan_by_temperature,
        electronics_box,
        moisture,
        parallel_load,
        ambient_swing,
        self_heating,
        balancing_resistor,
        loose_joint,
        thermal_break,
        bubbles,
        foreign_sink,
    )
}


def loose_thermocouple(y, coolant, sensors, size, rng):
    """One thermocouple lifts off at times and then reads between casing and air: readings (K + 1, n) of all cells."""
    off = np.append(_telegraph(rng, len(y) - 1, 100, 500, edge=10), 0.0)
    c = rng.choice(sensors) - 1
    y = y.copy()
    y[:, c] += min(0.12 * size, 0.9) * off * (coolant[:, c] - y[:, c])
    return y


STRANGE_SENSING = {"loose_thermocouple": loose_thermocouple}
OUTSIDE = (*STRANGE, *STRANGE_SENSING)
"""All names."""
UNKNOWN = tuple(name for name in OUTSIDE if name not in ("bubbles", "foreign_sink"))
"""Those of the diagnosis's suite, whose packs are numbered by this order."""
