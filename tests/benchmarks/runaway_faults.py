"""Faults of thermocouples and their amplifiers that look like heat: what is read of a sound cell, sample by sample.

Made without the detector, from how sensors, wires, filters and converters fail. A generator gets seconds since the
fault began `s` (n,), the true temperature `x` (n,), and a random generator; it gives what is read, NaN for what the
sender calls not available. `WITH_MATES` gets all thermocouples (n, m) of a string and gives all.
"""

import numpy as np

RAIL = 180.0  # what the upper end of a converter shows


def _steps(s, rng, lo, hi):
    return rng.uniform(lo, hi)


def _rc(target):
    def fault(tau_lo, tau_hi):
        def read(s, x, rng):
            tau = rng.uniform(tau_lo, tau_hi)
            return x[0] + (target - x[0]) * (1.0 - np.exp(-s / tau))

        return read

    return fault


def _ramp(lo, hi, hold=np.inf, back=False):
    def read(s, x, rng):
        rate = rng.uniform(lo, hi)
        top = rng.uniform(10.0, 60.0) if np.isfinite(hold) else np.inf
        rise = np.minimum(rate * s, top)
        if back:
            rise = np.maximum(np.minimum(rise, 2 * top - rate * s), 0.0)
        return x + rise

    return read


def _telegraph(value, share):
    def read(s, x, rng):
        return np.where(rng.random(len(s)) < share, value, x)

    return read


def _burst(lo, hi, grow=False):
    def read(s, x, rng):
        size = rng.uniform(lo, hi) * (s / 20.0 if grow else 1.0)
        return x + size * rng.standard_normal(len(s))

    return read


def _wave(shape, period_lo, period_hi, lo, hi):
    def read(s, x, rng):
        phase = (s / rng.uniform(period_lo, period_hi)) % 1.0
        a = rng.uniform(lo, hi)
        form = {
            "sine": np.sin(2 * np.pi * phase),
            "square": np.sign(0.5 - phase),
            "up": 2 * phase - 1.0,
            "down": 1.0 - 2 * phase,
            "sharp": np.exp(-5 * phase),
        }[shape]
        return x + a * form

    return read


def _gain(ramp):
    def read(s, x, rng):
        g = rng.uniform(1.1, 2.5)
        return x * (1.0 + (g - 1.0) * (np.minimum(s / rng.uniform(5, 60), 1.0) if ramp else 1.0))

    return read


def _bit(sticky):
    def read(s, x, rng):
        bit = 1 << int(rng.integers(4, 11))  # of tenths of a kelvin
        raw = np.round((x + 40.0) * 10).astype(int)
        hit = np.ones(len(s), bool) if sticky else rng.random(len(s)) < rng.uniform(0.05, 0.5)
        return np.where(hit, raw | bit if sticky else raw ^ bit, raw) / 10.0 - 40.0

    return read


def _polynomial(power):
    def read(s, x, rng):
        end, top = rng.uniform(10, 60), rng.uniform(20, 120)
        return x + top * (np.minimum(s, end) / end) ** power

    return read


def _stairs(every):
    def read(s, x, rng):
        return x + rng.uniform(0.6, 5.0) * np.floor(s / every)

    return read


def _stuck(back):
    def read(s, x, rng):
        until = rng.uniform(5, 40) if back else np.inf
        return np.where(s < until, x[0], x + (rng.uniform(5, 60) if back else 0.0))

    return read


def _contact(s, x, rng):
    """A wire that opens and closes before an RC filter."""
    tau, closed = rng.uniform(2, 20), rng.random(len(s)) < rng.uniform(0.05, 0.4)
    out, v = np.empty(len(s)), x[0]
    for i in range(len(s)):
        v = x[i] if closed[i] else v + (RAIL - v) * (1.0 - np.exp(-1.0 / tau))
        out[i] = v
    return out


def _walk(s, x, rng):
    return x + np.cumsum(rng.uniform(0.3, 3.0) * rng.standard_normal(len(s)))


def _gaps(s, x, rng):
    return np.where(rng.random(len(s)) < rng.uniform(0.1, 0.7), np.nan, x)


def _logistic(s, x, rng):
    mid, width, top = rng.uniform(10, 40), rng.uniform(0.5, 6), rng.uniform(20, 120)
    return x + top / (1.0 + np.exp(-(s - mid) / width))


def _late(s, x, rng):
    """A sender that repeats old values and then catches up at once."""
    every = int(rng.integers(5, 30))
    return x[(np.arange(len(x)) // every) * every] + rng.uniform(0, 3) * (np.arange(len(x)) // every)


def _wrap(s, x, rng):
    return (x + rng.uniform(0.5, 8.0) * s) % RAIL


def _leak(s, x, rng):
    """Moisture across the terminals: a share of the rail that grows and settles."""
    tau, share = rng.uniform(3, 30), rng.uniform(0.05, 0.6)
    return x + share * (RAIL - x) * (1.0 - (1.0 + s / tau) * np.exp(-s / tau))


def _two_poles(s, x, rng):
    a, b = rng.uniform(0.5, 6.0), rng.uniform(0.5, 6.0)
    b = b + 0.01 * (a == b)
    return x[0] + (RAIL - x[0]) * (1.0 - (a * np.exp(-s / a) - b * np.exp(-s / b)) / (a - b))


def _const(value):
    return lambda s, x, rng: np.full(len(s), value)


ALONE = {
    "step of 5 to 30 K": lambda s, x, rng: x + _steps(s, rng, 5, 30),
    "step of 30 to 150 K": lambda s, x, rng: x + _steps(s, rng, 30, 150),
    "step down": lambda s, x, rng: x - _steps(s, rng, 5, 60),
    "one spike": lambda s, x, rng: x + np.where(s == 3, _steps(s, rng, 5, 100), 0.0),
    "spikes": lambda s, x, rng: x + np.where(rng.random(len(s)) < 0.2, _steps(s, rng, 3, 60), 0.0),
    "ramp 0.3 to 1 K/s": _ramp(0.3, 1.0),
    "ramp 1 to 2 K/s": _ramp(1.0, 2.0),
    "ramp 2 to 10 K/s": _ramp(2.0, 10.0),
    "ramp 10 to 40 K/s": _ramp(10.0, 40.0),
    "ramp that ends": _ramp(1.0, 6.0, hold=1.0),
    "triangle": _ramp(1.0, 6.0, hold=1.0, back=True),
    "open, filter 0.3 to 3 s": _rc(RAIL)(0.3, 3.0),
    "open, filter 3 to 10 s": _rc(RAIL)(3.0, 10.0),
    "open, filter 10 to 60 s": _rc(RAIL)(10.0, 60.0),
    "open, two poles": _two_poles,
    "short, filter": _rc(-40.0)(1.0, 30.0),
    "upper rail": _const(RAIL),
    "lower rail": _const(-40.0),
    "not available": _const(np.nan),
    "gaps": _gaps,
    "flickers to the upper rail": _telegraph(RAIL, 0.4),
    "flickers to the lower rail": _telegraph(-40.0, 0.4),
    "open contact with filter": _contact,
    "frozen": _stuck(back=False),
    "frozen, then a step": _stuck(back=True),
    "noise 1 to 5 K": _burst(1.0, 5.0),
    "noise 5 to 30 K": _burst(5.0, 30.0),
    "growing noise": _burst(1.0, 10.0, grow=True),
    "random walk": _walk,
    "slow sine": _wave("sine", 10, 60, 5, 40),
    "aliased sine": _wave("sine", 2.1, 5, 2, 30),
    "square wave": _wave("square", 4, 30, 2, 40),
    "saw tooth up": _wave("up", 6, 40, 5, 50),
    "saw tooth down": _wave("down", 6, 40, 5, 50),
    "pulses that decay": _wave("sharp", 8, 40, 5, 60),
    "gain": _gain(ramp=False),
    "gain that drifts": _gain(ramp=True),
    "drift 1 to 20 K/min": _ramp(1 / 60, 20 / 60),
    "bit that flips": _bit(sticky=False),
    "bit that sticks": _bit(sticky=True),
    "steps of 1 to 5 K": lambda s, x, rng: np.round(x / (q := rng.uniform(1, 5))) * q,
    "stairs every second": _stairs(1),
    "stairs every 3 s": _stairs(3),
    "quadratic drift": _polynomial(2),
    "cubic drift": _polynomial(3),
    "root drift": _polynomial(0.5),
    "S-shaped drift": _logistic,
    "late and repeated": _late,
    "overflow that wraps": _wrap,
    "leak": _leak,
}
"""By name; `x` is what the cell does."""


def _alike(s, X, rng):
    return X + (rng.uniform(0.5, 10.0) * s)[:, None]


def _junction(s, X, rng):
    tau = rng.uniform(2, 20)
    return X + (rng.uniform(10, 60) * (1 - np.exp(-s / tau)))[:, None]


def _sag(s, X, rng):
    return X * (1.0 + rng.uniform(0.1, 0.8) * np.minimum(s / rng.uniform(4, 40), 1.0))[:, None]


def _crosstalk(s, X, rng):
    share = np.where(np.arange(X.shape[1]) == 0, 1.0, rng.uniform(0.1, 0.6, X.shape[1]))
    return X + (rng.uniform(1.0, 10.0) * s)[:, None] * share


def _crosstalk_rc(s, X, rng):
    share = np.where(np.arange(X.shape[1]) == 0, 1.0, rng.uniform(0.1, 0.6, X.shape[1]))
    return X + (RAIL - X[0]) * share * (1 - np.exp(-s / rng.uniform(2, 20)))[:, None]


def _swapped(s, X, rng):
    return np.where((np.arange(len(s)) % int(rng.integers(2, 12)) == 0)[:, None], np.roll(X, 1, axis=1), X)


def _each_its_own(s, X, rng):
    kinds = list(ALONE.values())
    return np.stack([kinds[rng.integers(len(kinds))](s, X[:, j], rng) for j in range(X.shape[1])], axis=1)


WITH_MATES = {
    "all ramp alike": _alike,
    "reference junction": _junction,
    "supply of all": _sag,
    "ramp with crosstalk": _crosstalk,
    "open with crosstalk": _crosstalk_rc,
    "channels mixed up": _swapped,
    "each its own fault": _each_its_own,
}
CONTEXTS = {"cool": (20.0, 55.0, -0.02, 0.1), "warm": (60.0, 79.0, -0.05, 0.1), "hot": (82.0, 130.0, -0.1, 0.3)}
"""Temperature at the fault, °C, and rate, K/s: from, to."""
BEFORE, AFTER, MATES, NOISE = 60, 90, 4, 0.05


def truth(context, rng):
    """Temperatures (n, m) of the cells of a string, and seconds since the fault begins (n,)."""
    lo, hi, slow, fast = CONTEXTS[context]
    s = np.arange(-BEFORE, AFTER, dtype=float)
    rate = rng.uniform(slow, fast)
    at = rng.uniform(lo, hi) - np.r_[0.0, rng.uniform(0.0, 15.0, MATES - 1)]
    share = np.r_[1.0, rng.uniform(0.2, 1.0, MATES - 1)]
    return at + rate * s[:, None] * share, s


def read(kind, context, seed):
    """What is read of one string (n, m): the fault is in its first thermocouple, or in all."""
    rng = np.random.default_rng([seed, sorted([*ALONE, *WITH_MATES]).index(kind), list(CONTEXTS).index(context)])
    X, s = truth(context, rng)
    Y = X + NOISE * rng.standard_normal(X.shape)
    bad = s >= 0
    if kind in ALONE:
        Y[bad, 0] = ALONE[kind](s[bad], Y[bad, 0], rng)
    else:
        Y[bad] = WITH_MATES[kind](s[bad], Y[bad], rng)
    return np.minimum(Y, RAIL)
