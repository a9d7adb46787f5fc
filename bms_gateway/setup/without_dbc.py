"""Guesses from physics alone, without a DBC, which bits are the current, the pack's voltage and thermocouples.

Every message is cut into fields of usual sizes: bytes, pairs of bytes in both orders, twelve bits that begin at a
nibble. If the first byte changes from frame to frame and selects the meaning of the others, the message is split by
this byte. Then

* a voltage is large compared with its own changes. The current is the field whose steps occur in the voltage (Ohm's
  law) and whose integral lowers the voltage permanently. Torque and pedal move with the voltage too, but less exactly;
* a thermocouple is slow, follows no step of the voltage, and rises with the generated heat, the integral of the squared
  current. The thermocouples of one pack are adjacent and have similar readings.

The data do not show a scale. The factor is a usual one that makes the values plausible for a vehicle. All results are
guesses.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from bms_gateway.frames.batch import FrameBatch
from bms_gateway.setup.bit_cuts import likeliest_cuts
from bms_gateway.setup.bit_fields import FEWEST, FEWEST_OF_PAGE, Field, fields_of, name_of
from bms_gateway.setup.intervals import edges_of
from bms_gateway.thermal import Floats

STEP_S: Final = 0.5
FAST_Hz: Final = 1.5
"""Least sample rate of a field whose steps are compared with those of another."""
MOST_MEANS: Final = 20_000_000
"""Greatest number of interval means that are compared; with thousands of fields only the first hours are used."""
NOISE: Final = 0.75
"""Ratio of the mean step to that of the samples in random order, above which a field is not a measurement."""
LARGE: Final = 0.4
"""Largest spread over median of a pack's voltage while its contactors are closed."""
WITNESSES: Final = 5
BY_CHARGE: Final = 0.5
LARGEST: Final = 3.0
SAGS: Final = 0.65
TWINS: Final = 0.996
"""Correlation above which two fields may show one sensor: then only the effect of the charge proves that one is a
voltage."""
PASSING: Final = 0.02
OWN_CHARGE: Final = 0.4
"""Least share of the voltage's variance, after removal of the current, that the charge must explain if both fields are
so similar."""
MOST_TURNS: Final = 40
"""Greatest number of changes of a byte with two values that is still a temperature in steps of 1 K, and not a
switch."""
OHM: Final = 0.3
MOST_PAIRS: Final = 1500
SLOW: Final = 0.25
FOLLOWS_STEPS: Final = 0.35
WARMS: Final = 0.3
LEAKS_S: Final = 200.0
ALIKE: Final = 0.12
SHOWN: Final = 3
CURRENT_SCALES: Final = (0.1, 0.01, 1.0, 0.5, 0.05, 0.025, 0.001, 0.25)
MOST_A: Final = (15.0, 800.0)
VOLTAGE_SCALES: Final = (0.1, 1.0, 0.5, 0.01, 0.25, 0.001)
PACK_V: Final = (10.0, 950.0)
READINGS: Final = (
    (1.0, 0.0), (1.0, -40.0), (0.5, -40.0), (0.1, 0.0), (0.01, 0.0), (0.1, -273.15), (0.01, -100.0), (0.1, -40.0),
    (0.03125, -273.0), (0.01, -273.15),
)  # fmt: skip
"""How temperatures are written: scale and offset, the likeliest first."""
ROOM_C: Final = (5.0, 55.0)


@dataclass(frozen=True, slots=True)
class Guess:
    """What a field might be.

    Attributes
    ----------
    role : {"current", "voltage", "surface"}
    field : Field
    scale, offset : float
        To A, V, °C: a usual pair that gives plausible values.
    score : float
        To rank guesses of the same role.
    why : str
    beside : tuple of Field
        Thermocouples of the same group.
    """

    role: str
    field: Field
    scale: float
    offset: float
    score: float
    why: str
    beside: tuple[Field, ...] = ()

    def document(self) -> dict[str, Any]:
        """For machines."""
        bits = [name_of(f) for f in (self.field, *self.beside)]
        return {"role": self.role, "bits": bits, "scale": self.scale, "offset": self.offset, "why": self.why}


def guess(frames: FrameBatch) -> list[Guess]:
    """Propose candidates for current, voltage and thermocouples, up to three of each, the likeliest first."""
    if not len(frames):
        return []
    fields = likeliest_cuts([f for f in fields_of(frames) if _measures(f)])
    fast = [i for i, f in enumerate(fields) if f.rate_Hz >= FAST_Hz and len(np.unique(f.x)) >= 6]
    large = [i for i in fast if _large(fields[i])]
    if not large:
        return []
    edges = edges_of(frames.time_ns, STEP_S, STEP_S)[: max(MOST_MEANS // len(fields), FEWEST) + 1]
    grid = np.array([_on_grid(f, edges) for f in fields])
    electrical, voltage = _electrical(fields, grid, fast, large)
    warm = _warm(fields, grid, np.diff(edges), [g.field for g in electrical], voltage)
    taken = [f for g in warm for f in (g.field, *g.beside)]
    electrical[1:] = [g for g in electrical[1:] if not any(g.field.overlaps(f) for f in taken)]
    return [*electrical, *([voltage] if voltage else []), *warm]


def _measures(f: Field) -> bool:
    """Whether bits may be a measurement: they change, and are neither a counter nor a check sum."""
    values = np.unique(f.x)
    if len(values) < (2 if f.place.size == 8 else 3) or len(f.x) < FEWEST_OF_PAGE:
        return False
    if len(values) == 2:  # a temperature in steps of 1 K that has changed by one step
        return bool(np.ptp(values) == 1 and np.count_nonzero(np.diff(f.x)) <= MOST_TURNS)
    d = np.diff(f.x)
    moved = d[d != 0]
    up = np.median(moved)
    if len(moved) > 0.5 * len(d) and (np.abs(moved - up) <= 0.2 * abs(up)).mean() > 0.85:
        return False  # counts
    return _roughness(f) < NOISE


def _on_grid(f: Field, edges: Floats) -> Floats:
    """Mean in each interval; without samples the last value, unless it is too old."""
    n = len(edges) - 1
    at = np.searchsorted(edges, f.t, side="right") - 1
    inside = at < n
    count = np.bincount(at[inside], minlength=n)
    mean = np.bincount(at[inside], f.x[inside], minlength=n) / np.maximum(count, 1)
    last = np.searchsorted(f.t, edges[1:], side="right") - 1
    held = np.where(last >= 0, f.x[np.maximum(last, 0)], np.nan)
    old = edges[1:] - f.t[np.maximum(last, 0)] > max(3 * STEP_S, 4 / f.rate_Hz if f.rate_Hz > 0 else 0.0)
    return np.asarray(np.where(count > 0, mean, np.where(old, np.nan, held)))


def _steps(grid: Floats) -> Floats:
    """Give the steps of each row, limited and normalised: one switching-on does not outweigh a drive."""
    d = np.nan_to_num(np.diff(grid, axis=1))
    if not d.shape[1]:
        return d
    moved = np.count_nonzero(d, axis=1, keepdims=True)
    usual = np.abs(d).sum(axis=1, keepdims=True) / np.maximum(moved, 1)
    d = np.clip(d, -LARGEST * usual, LARGEST * usual)
    d -= d.mean(axis=1, keepdims=True)
    size = np.linalg.norm(d, axis=1, keepdims=True)
    return np.asarray(np.divide(d, size, out=np.zeros_like(d), where=size > 0))


def _electrical(
    fields: list[Field], grid: Floats, fast: list[int], large: list[int]
) -> tuple[list[Guess], Guess | None]:
    """Rank currents by the correlation of their steps with those of the voltage on which most messages agree."""
    d, slower = _steps(grid[fast]), _steps(grid[fast][:, ::4])
    rows = [fast.index(j) for j in large]
    r = 0.5 * (np.abs(d @ d[rows].T) + np.abs(slower @ slower[rows].T))
    found = _pairs(fields, fast, large, r)
    law = {(i, j): float(r[fast.index(i), large.index(j)]) for _, i, j in found}
    found = sorted(_explained_too(found, grid, law), reverse=True)
    agreed = _agreed(fields, found)
    if agreed is None:
        return [], None
    v = fields[agreed]
    guesses: list[Guess] = []
    for score, i, _ in (pair for pair in found if pair[2] == agreed):
        f = fields[i]
        if any(f.overlaps(g.field) for g in guesses):
            continue
        zero = _rest(f)
        scale = _scaled(np.abs(f.x - zero), CURRENT_SCALES, MOST_A)
        why = f"{name_of(v)}, which might be a voltage, takes its steps (correlation {law[i, agreed]:.2f})"
        guesses.append(Guess("current", f, scale, -scale * zero if zero else 0.0, score, why))
        if len(guesses) == SHOWN:
            break
    scale = _scaled(v.x, VOLTAGE_SCALES, PACK_V)
    return guesses, Guess("voltage", v, scale, 0.0, guesses[0].score, "large, and takes the steps of the current")


def _pairs(fields: list[Field], fast: list[int], large: list[int], r: Floats) -> list[tuple[float, int, int]]:
    """Pair candidates for current and voltage, the likeliest first: score, current, voltage."""
    rough = {i: _roughness(fields[i]) for i in fast}
    swing = {j: _swing(fields[j]) for j in large}
    found: list[tuple[float, int, int]] = []
    for k, i in enumerate(fast):
        if not _rests(fields[i]):
            continue
        own = 0.02 * min(fields[i].place.size, 12) + 0.05 * _both_signs(fields[i]) - 0.2 * rough[i]
        for m, j in enumerate(large):
            if r[k, m] > OHM and not fields[i].overlaps(fields[j]):
                found.append((float(r[k, m]) + own - 0.3 * rough[j] - swing[j], i, j))
    return sorted(found, reverse=True)[:MOST_PAIRS]


def _explained_too(
    found: list[tuple[float, int, int]], grid: Floats, r: dict[tuple[int, int], float]
) -> Iterator[tuple[float, int, int]]:
    """Add the explained share of the voltage to each pair's score; two readings of one sensor are no pair."""
    for score, i, j in found:
        share, by_charge = _explained(grid[i], grid[j])
        if r[i, j] <= TWINS or by_charge > OWN_CHARGE:
            yield score + share + BY_CHARGE * by_charge, i, j


def _agreed(fields: list[Field], found: list[tuple[float, int, int]]) -> int | None:
    """Find the voltage whose steps occur in the most messages: current, torque, power and pedal are four."""
    best: dict[int, dict[int, float]] = {}
    for score, i, j in found:
        mine = best.setdefault(j, {})
        mine[fields[i].can_id] = max(mine.get(fields[i].can_id, 0.0), score)
    return max(best, key=lambda j: sum(sorted(best[j].values())[-WITNESSES:]), default=None)


def _explained(I: Floats, V: Floats) -> tuple[float, float]:  # noqa: E741 — the field's
    """Share of a voltage's variance explained by a current and its charge, and the part that the charge adds.

    A charge that is drawn lowers the voltage permanently; a pedal returns to its value. If charge and current have
    opposite signs, the share is negative: then the "current" is the voltage.
    """
    on = np.isfinite(I) & np.isfinite(V)
    on &= np.greater(V, 0.5 * np.nanquantile(V, 0.95))
    if on.sum() < 20:
        return 0.0, 0.0
    ramp = np.linspace(-1.0, 1.0, len(I))  # the raw value of zero current is not known
    charge = np.nancumsum(I - np.nanmean(I))
    A = np.column_stack([np.ones(len(I)), ramp, I, charge])[on]
    A[:, 2:] /= np.maximum(np.abs(A[:, 2:] - A[:, 2:].mean(axis=0)).max(axis=0), 1e-9)
    y = V[on] - V[on].mean()
    b = np.linalg.lstsq(A, y, rcond=None)[0]
    left, alone = y - A @ b, y - A[:, :3] @ np.linalg.lstsq(A[:, :3], y, rcond=None)[0]
    lost = (left @ left) / max(float(y @ y), 1e-12)
    by_charge = 1.0 - (left @ left) / max(float(alone @ alone), 1e-12)
    return float(1.0 - lost), float(by_charge * np.sign(b[2] * b[3]))


def _swing(f: Field) -> float:
    """Spread divided by the median while it is on; for a pack a few per cent."""
    low, middle, high = np.quantile(f.x[f.x > 0.5 * np.quantile(f.x, 0.95)], (0.02, 0.5, 0.98))
    return float((high - low) / middle)


def _roughness(f: Field) -> float:
    """Mean step, relative to that of the samples in random order."""
    shuffled = np.abs(np.diff(np.random.default_rng(1).permutation(f.x))).mean()
    return float(np.abs(np.diff(f.x)).mean() / shuffled) if shuffled > 0 else 1.0


def _large(f: Field) -> bool:
    on = f.x[f.x > 0.5 * np.quantile(f.x, 0.95)]
    if len(on) < 0.3 * len(f.x) or f.place.signed:
        return False
    low, middle, high = np.quantile(on, (0.02, 0.5, 0.98))
    top = np.quantile(f.x, 0.95)
    between = (
        (f.x > 0.05 * top) & (f.x < 0.5 * top)
    ).mean()  # a speed passes there, a voltage once when it is switched
    sags = high - middle < SAGS * (high - low)  # it rests above, and what is drawn takes it down
    return bool(
        sags and middle > 50 and 0 < high - low < LARGE * middle and len(np.unique(on)) >= 6 and between < PASSING
    )


def _rest(f: Field) -> float:
    """Raw value of zero current: 0 if it occurs, otherwise the most frequent value."""
    if f.place.signed or f.x.min() == 0.0:
        return 0.0
    values, counts = np.unique(f.x, return_counts=True)
    return float(values[counts.argmax()])


def _rests(f: Field) -> bool:
    """Whether its spread is large relative to its median, as for a current."""
    zero = _rest(f)
    return bool(np.quantile(np.abs(f.x - zero), 0.98) > 5)


def _both_signs(f: Field) -> bool:
    y = f.x - _rest(f)
    return bool(min(-y.min(), y.max()) > 0.02 * max(-y.min(), y.max()))


def _scaled(x: Floats, scales: tuple[float, ...], ends: tuple[float, float]) -> float:
    top = float(np.quantile(x, 0.99))
    return next((s for s in scales if ends[0] <= s * top <= ends[1]), 1.0)


def _warm(
    fields: list[Field], grid: Floats, length_s: Floats, currents: list[Field], voltage: Guess | None
) -> list[Guess]:
    """Rank groups of slow fields that rise with the generated heat."""
    row = {id(f): i for i, f in enumerate(fields)}
    warmths = [w for f in currents for w in _warmths(grid[row[id(f)]], length_s, f)]
    if not warmths:
        return []
    d = _steps(grid)
    against = np.abs(d @ d[row[id(voltage.field)]]) if voltage else 0 * d[:, 0]
    taken = [currents[0], *([voltage.field] if voltage else [])]
    free = [i for i, f in enumerate(fields) if not any(f.overlaps(other) for other in taken)]
    slow = [i for i in free if against[i] < FOLLOWS_STEPS and _slow(fields[i])]
    kept = [(i, reading, _warms(grid[i], warmths)) for i in slow if (reading := _reading(fields[i])) is not None]
    groups: dict[tuple[int, int, bool, tuple[float, float]], list[tuple[int, float]]] = {}
    for i, reading, warms in kept:
        f = fields[i]
        groups.setdefault((f.can_id, f.place.size, f.place.big_endian, reading), []).append((i, warms))
    ranked: list[tuple[float, Guess]] = []
    for (_, size, _, reading), members in groups.items():
        alone: list[tuple[int, float]] = []
        for i, warms in sorted(members, key=lambda m: -m[1]):
            if not any(fields[i].overlaps(fields[j]) for j, _ in alone):
                alone.append((i, warms))
        middle = np.median([reading[0] * np.median(fields[i].x) for i, _ in alone])
        near = [(i, w) for i, w in alone if abs(reading[0] * np.median(fields[i].x) - middle) < ALIKE * 300]
        rising = [w for _, w in near if w > WARMS]
        if not rising:
            continue
        score = float(np.mean([w for _, w in near])) + 0.7 * np.log2(1 + len(near)) + 0.2 * (size == 16)
        first = fields[near[0][0]]
        told = f", as {len(near) - 1} more of the message do" if len(near) > 1 else ""
        why = f"slow, and rises with the heat that the likeliest current makes (correlation {near[0][1]:.2f}){told}"
        beside = tuple(fields[i] for i, _ in near[1:])
        ranked.append((score, Guess("surface", first, *reading, score, why, beside)))
    ranked.sort(key=lambda g: -g[0])
    chosen: list[Guess] = []
    for _, g in ranked:
        if not any(_shared(g, other) for other in chosen):
            chosen.append(g)
        if len(chosen) == SHOWN:
            break
    return chosen


def _shared(a: Guess, b: Guess) -> bool:
    return any(f.overlaps(g) for f in (a.field, *a.beside) for g in (b.field, *b.beside))


def _slow(f: Field) -> bool:
    """Whether it changes within a second by a small share of its range, or by one step."""
    span = float(np.ptp(np.quantile(f.x, (0.01, 0.99))))
    values = np.unique(f.x)
    per_s = np.abs(np.diff(f.x)) / np.maximum(np.diff(f.t), 1.0)
    return bool(np.quantile(per_s, 0.95) <= max(SLOW * span, float(np.min(np.diff(values)))))


def _reading(f: Field) -> tuple[float, float] | None:
    """Find a scale and offset that turn a field into plausible temperatures of cells, which change slowly."""
    low, middle, high = np.quantile(f.x, (0.02, 0.5, 0.98))
    for scale, offset in READINGS:
        if f.place.size == 8 and scale < 0.5:
            continue
        if ROOM_C[0] <= scale * middle + offset <= ROOM_C[1] and 0.2 <= scale * (high - low) <= 40.0:
            return scale, offset
    return None


def _warmths(current: Floats, length_s: Floats, f: Field) -> list[Floats]:
    """Heat of a current, integrated: without loss, and with a loss within minutes."""
    made = np.nan_to_num((current - _rest(f)) ** 2)
    return [np.cumsum(made), _leaky(made, np.exp(-length_s / LEAKS_S))] if made.any() else []


def _warms(x: Floats, warmths: list[Floats]) -> float:
    """Largest correlation with the integrated heat."""
    good = np.isfinite(x)
    if good.sum() < 10 or np.ptp(x[good]) == 0:
        return 0.0
    return max(float(np.corrcoef(x[good], w[good])[0, 1]) if np.ptp(w[good]) > 0 else 0.0 for w in warmths)


def _leaky(made: Floats, left: Floats) -> Floats:
    out, y = np.empty_like(made), 0.0
    for n, (q, k) in enumerate(zip(made, left, strict=True)):
        y = k * y + q
        out[n] = y
    return out
