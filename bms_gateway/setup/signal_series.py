"""One signal over a log: its values, resolution and rate, and the samples that are not measurements."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.quality import Quality
from bms_gateway.frames.signal_info import SignalInfo
from bms_gateway.setup.vehicle_logs import Traffic
from bms_gateway.thermal import Floats

FEWEST: Final = 5
"""Least number of samples of a series that is judged."""
PARKED: Final = 0.95
ALONE: Final = 8.0
"""A value at the end of the bits' range is not a measurement if it is so many spreads away from all others."""
COUNTS: Final = 0.9
_NOT_MEASURED = (int(Quality.NOT_AVAILABLE), int(Quality.ERROR), int(Quality.CRC))


@dataclass(slots=True)
class Series:
    """One signal's samples.

    Attributes
    ----------
    info : SignalInfo
    t : ndarray (n,), s
        From the beginning of the traffic.
    x : ndarray (n,)
        Physical values by the DBC, measurements only.
    seen : int
        Samples of all kinds.
    dropped : dict of str to int
        Number of samples that are not measurements, by reason.
    outside : int
        Samples outside the range that the DBC declares.
    """

    info: SignalInfo
    t: Floats
    x: Floats
    seen: int
    dropped: dict[str, int] = field(default_factory=dict)
    outside: int = 0
    distinct: int = 0
    step: float = 0.0
    mode_share: float = 1.0
    middle: float = np.nan
    low: float = np.nan
    high: float = np.nan

    @property
    def path(self) -> str:
        """Name as the config writes it."""
        return self.info.path

    @property
    def rate_Hz(self) -> float:
        """Samples per second, by the median of the gaps between them."""
        gaps = np.diff(self.t)
        gaps = gaps[gaps > 0]
        return float(1.0 / np.median(gaps)) if len(gaps) else 0.0

    @property
    def constant(self) -> bool:
        """Whether the value never changes."""
        return self.distinct <= 1

    @property
    def counts(self) -> bool:
        """Whether it rises by the same step each time, with wrap-around or without: a counter or a clock."""
        if len(self.x) < 20 or self.distinct < 8:
            return False
        d = np.diff(self.x)
        moved = d[d != 0]
        if len(moved) < 0.5 * len(d) or not len(moved):
            return False
        up = np.median(moved)
        wraps = np.sign(moved) != np.sign(up)
        return bool((np.abs(moved - up) <= 0.2 * abs(up) + 1e-12).mean() > COUNTS or (up > 0 and wraps.mean() < 0.002))

    @property
    def staircase(self) -> bool:
        """Whether it repeatedly rises step by step and falls back to its first value: no temperature does."""
        moved = np.diff(self.x)
        moved = moved[moved != 0]
        if self.distinct < 8 or len(moved) < 8:
            return False
        step = np.median(moved)
        up = np.isclose(moved, step)
        back = np.isclose(moved, -(self.distinct - 1) * step)
        return bool((up | back).all() and back.any())

    @property
    def roughness(self) -> float:
        """Mean step from sample to sample, relative to that of the samples in random order: near 0 smooth, 1 noise."""
        if len(self.x) < FEWEST or self.constant:
            return 0.0
        order = np.random.default_rng(1).permutation(len(self.x))
        shuffled = np.abs(np.diff(self.x[order])).mean()
        return float(np.abs(np.diff(self.x)).mean() / shuffled) if shuffled > 0 else 0.0

    def on_grid(self, edges: Floats) -> Floats:
        """Mean in each interval of a grid; the last one is held for up to three intervals, NaN beyond."""
        n = len(edges) - 1
        at = np.searchsorted(edges, self.t, side="right") - 1
        inside = (at >= 0) & (at < n)
        count = np.bincount(at[inside], minlength=n)
        total = np.bincount(at[inside], self.x[inside], minlength=n)
        y = np.full(n, np.nan)
        y[count > 0] = total[count > 0] / count[count > 0]
        for _ in range(3):
            hole = np.isnan(y[1:])
            y[1:][hole] = y[:-1][hole]
        return y


def all_series(traffic: Traffic, signals: Iterable[SignalInfo] | None = None) -> list[Series]:
    """Decode signals, by default all known ones, to series; signals without a sample are left out."""
    chosen = [
        s
        for s in (signals or [s for m in traffic.messages.values() for s in m.signals.values()])
        if s.scale != 0.0 and s.place.size <= 64 and all(len(step.values) > 0 for step in s.mux)
    ]
    if not chosen:
        return []
    samples = traffic.decode(chosen)
    order = np.argsort(samples.signal, kind="stable")
    which, value, flag = samples.signal[order], samples.value[order], samples.flag[order]
    time = (traffic.frames.time_ns[samples.frame[order]] - traffic.frames.time_ns[0]) * 1e-9
    edges = np.searchsorted(which, np.arange(len(chosen) + 1))
    found = []
    for k, info in enumerate(chosen):
        part = slice(edges[k], edges[k + 1])
        if edges[k + 1] > edges[k]:
            found.append(_series(info, time[part], value[part], flag[part]))
    return found


def _series(info: SignalInfo, t: Floats, x: Floats, flag: NDArray[np.uint8]) -> Series:
    dropped: dict[str, int] = {}
    stated = np.isin(flag, _NOT_MEASURED) | ~np.isfinite(x)
    if stated.any():
        dropped["not available or in error by the sender's word"] = int(stated.sum())
    keep = ~stated
    ends = _sentinels(info, x, keep)
    if ends.any():
        shown = ", ".join(f"{v:g}" for v in np.unique(x[ends])[:3])
        dropped[f"at the end of its bits ({shown})"] = int(ends.sum())
        keep &= ~ends
    outside = int((flag[keep] == int(Quality.OUT_OF_RANGE)).sum())
    return described(Series(info, np.asarray(t[keep]), np.asarray(x[keep]), len(x), dropped, outside))


def described(s: Series) -> Series:
    """Set the statistics of the values of a series, and return it."""
    if len(s.x):
        values, counts = np.unique(s.x, return_counts=True)
        s.distinct, s.mode_share = len(values), float(counts.max() / len(s.x))
        s.step = _resolution(values) if len(values) > 1 else abs(s.info.resolution)
        s.low, s.middle, s.high = (float(q) for q in np.quantile(s.x, (0.02, 0.5, 0.98)))
    return s


def _resolution(values: Floats) -> float:
    """Smallest step between values that differ by more than rounding."""
    steps = np.diff(values)
    return float(steps[steps > 1e-9 * np.abs(values[1:])].min(initial=np.inf)) if len(steps) else 0.0


def _sentinels(info: SignalInfo, x: Floats, keep: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Find samples at an end of the bits' range that are far from all others."""
    none = np.zeros(len(x), np.bool_)
    if info.is_float or info.place.size < 4 or not keep.any():
        return none
    raw = np.rint((x - info.offset) / info.scale)
    low, high = info.raw_limits
    special = (raw == high) | ((raw == low) & (info.place.signed or info.offset != 0.0)) | (raw == high - 1)
    special &= keep
    if not special.any() or special[keep].all():
        return none
    rest = x[keep & ~special]
    spread = max(float(np.quantile(rest, 0.95) - np.quantile(rest, 0.05)), 4 * abs(info.scale))
    middle = float(np.median(rest))
    return np.asarray(special & (np.abs(x - middle) > ALONE * spread / 2))
