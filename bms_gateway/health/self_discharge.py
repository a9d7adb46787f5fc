r"""Self-discharge: at rest, the voltage of a cell with a soft short falls against the median of its string.

A Kalman filter follows d = U − median(U) of each cell from the beginning of a rest:

.. math::
    d = a + s\,t + r_1 e^{-t/τ_1} + r_2 e^{-t/τ_2}, \qquad I = -s \,/\, (dU/dQ)

a is the constant difference of the cell, r its difference in relaxation after a drive, and s the slope of a leak. The
median removes what all cells have in common (relaxation, temperature). dU/dQ is the ratio of voltage and charge between
two rests; before the second rest it is a usual curve divided by the capacity in the model file.

The voltage of a cell that is balanced falls in the same way. Balancing lowers the highest cells to the others. A cell
is therefore named only when it has fallen to the median.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import exp, hypot, isfinite, nan
from typing import Any

import numpy as np

from bms_gateway.health.limit_words import BAND_SD
from bms_gateway.thermal import Floats

HOUR_S = 3600.0
REST_SHARE = 0.01
"""Current over capacity, 1/h, below which a string is at rest: such a current lets unequal cells drift apart by less
than the least slope that is reported."""
USUAL_AH = 8.0  # where the model file has no capacity
SETTLE_S = 600.0
"""Time from the end of the current to the beginning of a rest: the fast relaxation ends within this time."""
SAMPLE_S = 300.0
"""Time between two samples. At rest a voltage stays at one step of its converter, so that more samples tell no more."""
NOISE_V = 1e-3
"""Least sd of a reading; a coarser step of the voltages is used as the sd instead."""
UNLIKE_V = 0.1
RELAX_S, RELAX_V = (1200.0, 10800.0), 2e-3
WANDER_V = 2e-4
"""V per hour^½: random walk of d, because cells warm and cool differently."""
SLOPE_SD, SLOPE_WALK = 10e-3, 5e-5
"""Prior sd of the slope, V/h, and its random walk, V/h per hour^½."""
SURE_SD, LEAST_SLOPE = 4.5, 5e-4
"""A leak is reported if its slope is at least so many sd, and so many V/h,"""
STANDS = 2
"""in so many samples in a row."""
OVER_SHARE = 0.5
"""A leak has ended if its slope plus 2 sd is below this share of `LEAST_SLOPE` in as many samples in a row."""
USUAL_SPAN_V, USUAL_LN_SD = 0.8, 0.7
"""dU/dSOC of an unknown cell, V, and its sd, ln: right for most curves of NMC, NCA and LMO; LFP is flatter."""
CHORD_SHARE, CHORD_LN_SD = 0.05, 0.3
"""Least charge between two rests over the capacity for a measured dU/dQ, and the sd of the latter, ln."""
MOVED_V = 0.02
"""A larger change of the median between two samples shows that a current has flowed which was not measured."""
ALARM_W = 0.3
DOUBT = 1.5  # factor on the filter's sd: the steps of a converter are not white noise


@dataclass(frozen=True, slots=True)
class Leak:
    """A cell that discharges itself.

    Attributes
    ----------
    cell : int
        1-based.
    slope, slope_sd : float
        V/h, negative.
    current, current_sd : float
        A; NaN where neither the capacity nor a measured dU/dQ is known.
    watts : float
    since_ns : int
        Beginning of the rest in which the leak was found.
    hours : float
        Time for which the leak has been observed.
    """

    cell: int
    slope: float
    slope_sd: float
    current: float
    current_sd: float
    watts: float
    since_ns: int
    hours: float

    @property
    def level(self) -> int:
        """1 warning, 2 alarm."""
        return 2 if self.watts >= ALARM_W else 1

    @property
    def text(self) -> str:
        """Tell what was found, how sure it is, and what to do."""
        mA = ""
        if isfinite(self.current):
            mA = f"{1e3 * self.current:.2g} ± {1e3 * BAND_SD * self.current_sd:.1g} mA ({self.watts:.2g} W): "
        return (
            f"cell {self.cell} discharges itself: {mA}its voltage has fallen against its string's median by "
            f"{-1e3 * self.slope:.2g} ± {1e3 * BAND_SD * self.slope_sd:.1g} mV/h for {self.hours:.1f} h at rest "
            f"({-self.slope / self.slope_sd:.0f} sd); balancing would look the same: if this cell is not balanced, a "
            "soft short is likely: do not charge, watch its temperature, have the cell tested"
        )


class SelfDischarge:
    """Self-discharge of one string of n cells."""

    def __init__(self, cells: int, capacity_Ah: float | None) -> None:
        self._n, self._capacity = cells, capacity_Ah
        self._rest_A = REST_SHARE * (capacity_Ah or USUAL_AH)
        self._x = np.zeros((4, cells))
        self._P = np.zeros((4, 4))
        self._started: int | None = None  # ns; None while current flows
        self._still: int | None = None
        self._last = self._now = 0
        self._sum, self._count = np.zeros((2, cells))
        self._seen, self._step = np.full(cells, nan), np.inf
        self._stands, self._over = np.zeros((2, cells), np.int64)
        self._charge = 0.0  # Ah since the last rest's newest median
        self._level = nan
        self._chord = nan
        self.leaks: dict[int, Leak] = {}

    def take(self, now_ns: int, current: float, charge_Ah: float, V: Floats | None) -> list[tuple[Leak, bool]]:
        """Take in a tick.

        Parameters
        ----------
        now_ns : int
        current : float
            Mean, A; NaN where unknown: then a string that was at rest stays at rest.
        charge_Ah : float
            Charge that flowed in the tick; NaN where unknown.
        V : ndarray (n,) or None
            Voltages of the cells, NaN where none came.

        Returns
        -------
        list of (Leak, bool)
            Leaks that were found (True) or that have ended (False).
        """
        self._now = now_ns
        if isfinite(charge_Ah):
            self._charge += charge_Ah
        if isfinite(current):
            if abs(current) > self._rest_A:
                self._still = self._started = None
                self._sum, self._count = np.zeros((2, self._n))
                return []
            self._still = now_ns if self._still is None else self._still
        if V is None or self._still is None or now_ns - self._still < SETTLE_S * 1e9:
            return []
        self._gather(V)
        early = self._started is not None and now_ns - self._last < SAMPLE_S * 1e9
        if early or (self._count == 0).any():
            return []
        U = self._sum / self._count
        self._sum, self._count = np.zeros((2, self._n))
        return self._sample(now_ns, U)

    def _gather(self, V: Floats) -> None:
        """Add readings to the sample, and learn the step of the converter from the differences of readings."""
        here = np.isfinite(V)
        moved = np.abs(V - self._seen)
        moved = moved[np.isfinite(moved) & (moved > 1e-5)]
        if len(moved):
            self._step = min(self._step, float(moved.min()))
        self._seen = np.where(here, V, self._seen)
        self._sum += np.where(here, V, 0.0)
        self._count += here

    def _sample(self, now_ns: int, U: Floats) -> list[tuple[Leak, bool]]:
        middle = float(np.median(U))
        d = U - middle
        if self._started is None or abs(middle - self._level) > MOVED_V:
            self._begin(now_ns, d, middle)
            return []
        self._advance((now_ns - self._last) / 1e9)
        self._last = now_ns
        R = max(NOISE_V, self._step if isfinite(self._step) else 0.0) ** 2
        H = np.array([1.0, 0.0, 1.0, 1.0])
        PH = self._P @ H
        K = PH / (H @ PH + R)
        self._x += np.outer(K, d - H @ self._x)
        self._P -= np.outer(K, PH)
        self._P = (self._P + self._P.T) / 2.0
        self._level, self._charge = middle, 0.0
        return self._judge(now_ns, d, middle)

    def _begin(self, now_ns: int, d: Floats, middle: float) -> None:
        """Begin a rest; the charge since the last rest gives dU/dQ."""
        least = CHORD_SHARE * (self._capacity or USUAL_AH)
        if isfinite(self._level) and abs(self._charge) > least and (middle - self._level) * self._charge < 0.0:
            self._chord = (self._level - middle) / self._charge  # discharge is positive
        self._x[:] = 0.0
        self._x[0] = d
        self._P = np.diag([UNLIKE_V**2, SLOPE_SD**2, RELAX_V**2, RELAX_V**2])
        self._started = self._last = now_ns
        self._level, self._charge = middle, 0.0
        self._stands[:] = self._over[:] = 0

    def _advance(self, dt: float) -> None:
        h = dt / HOUR_S
        F = np.diag([1.0, 1.0, exp(-dt / RELAX_S[0]), exp(-dt / RELAX_S[1])])
        F[0, 1] = h
        self._x = F @ self._x
        self._P = F @ self._P @ F.T + np.diag([WANDER_V**2 * h, SLOPE_WALK**2 * h, 0.0, 0.0])

    def _judge(self, now_ns: int, d: Floats, middle: float) -> list[tuple[Leak, bool]]:
        s, sd = self._x[1], DOUBT * float(np.sqrt(self._P[1, 1]))
        step = max(NOISE_V, self._step if isfinite(self._step) else 0.0)
        falls = (s < -SURE_SD * sd) & (s < -LEAST_SLOPE) & (d < 2.0 * step)
        self._stands = np.where(falls, self._stands + 1, 0)
        self._over = np.where(s - 2.0 * sd > -OVER_SHARE * LEAST_SLOPE, self._over + 1, 0)
        told: list[tuple[Leak, bool]] = []
        for k in range(self._n):
            old = self.leaks.get(k + 1)
            if old is not None and self._over[k] >= STANDS:
                told.append((self.leaks.pop(k + 1), False))
            elif self._stands[k] >= STANDS or (old is not None and falls[k]):
                leak = self._leak(k, now_ns, float(s[k]), sd, middle, old)
                self.leaks[k + 1] = leak
                if old is None:
                    told.append((leak, True))
        return told

    def _leak(self, k: int, now_ns: int, s: float, sd: float, middle: float, old: Leak | None) -> Leak:
        assert self._started is not None  # noqa: S101 - a sample has begun a rest
        slope, ln_sd = (self._chord, CHORD_LN_SD) if isfinite(self._chord) else (nan, USUAL_LN_SD)
        if not isfinite(slope) and self._capacity is not None:
            slope = USUAL_SPAN_V / self._capacity
        amps = -s / slope
        since = self._started if old is None else old.since_ns
        hours = (now_ns - self._started) / (HOUR_S * 1e9)
        return Leak(k + 1, s, sd, amps, amps * hypot(ln_sd, sd / s), amps * middle, since, hours)

    def pass_time(self, gap_s: float | None) -> None:
        """Pass over a time without frames: a rest continues or begins; a time of unknown length ends it."""
        self._sum, self._count = np.zeros((2, self._n))
        if gap_s is None:
            self._still = self._started = None
            self._level = nan
        elif self._still is None:
            self._still = self._now

    def snapshot(self) -> dict[str, Any]:
        """State as JSON-able values."""
        return {
            "x": self._x.tolist(),
            "P": self._P.tolist(),
            "started": self._started,
            "still": self._still,
            "last": self._last,
            "now": self._now,
            "level": self._level if isfinite(self._level) else None,
            "chord": self._chord if isfinite(self._chord) else None,
            "step": self._step if isfinite(self._step) else None,
            "charge": self._charge,
            "stands": self._stands.tolist(),
            "over": self._over.tolist(),
            "leaks": [{k: None if v != v else v for k, v in asdict(x).items()} for x in self.leaks.values()],
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a snapshot of a string of as many cells.

        Raises
        ------
        KeyError, TypeError, ValueError
            `state` is not such a snapshot, or belongs to another string.
        """
        x, P = np.array(state["x"], np.float64), np.array(state["P"], np.float64)
        numbers = {k: nan if state[k] is None else float(state[k]) for k in ("level", "chord", "step", "charge")}
        started, still = (None if state[k] is None else int(state[k]) for k in ("started", "still"))
        stands, over = np.array(state["stands"], np.int64), np.array(state["over"], np.int64)
        leaks = [Leak(**{k: _plain(v) for k, v in x.items()}) for x in state["leaks"]]
        sound = x.shape == (4, self._n) and P.shape == (4, 4) and stands.shape == over.shape == (self._n,)
        sound = sound and bool(np.isfinite(x).all() and np.isfinite(P).all())
        if not sound or (np.diag(P) < 0.0).any() or not all(1 <= x.cell <= self._n and x.slope_sd > 0.0 for x in leaks):
            raise ValueError("self-discharge: not of this string")
        self._x, self._P, self._started, self._still = x, P, started, still
        self._last, self._now, self._stands, self._over = int(state["last"]), int(state["now"]), stands, over
        self._level, self._chord = numbers["level"], numbers["chord"]
        self._step = numbers["step"] if numbers["step"] > 0.0 else np.inf
        self._charge = numbers["charge"] if isfinite(numbers["charge"]) else 0.0
        self.leaks = {x.cell: x for x in leaks}


def _plain(value: object) -> Any:
    """Check a number of a stored leak; an unknown current is stored as None."""
    if value is None:
        return nan
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 2**63:
        raise ValueError("self-discharge: no number")
    return value
