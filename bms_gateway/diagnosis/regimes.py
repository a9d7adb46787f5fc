"""The regimes in which a model fails: its error over bins of features of the drive, with correct error bars.

In a slow system, neighbouring errors are nearly equal. The sd of the mean over a bin therefore comes from the scatter
of whole stretches of time, not of single readings (cluster-robust variance). A feature counts by what the means of its
bins explain beyond that.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bms_gateway.identify.coordinates import Measured
from bms_gateway.thermal import Floats
from bms_gateway.thermal.drive import Drive

REST = 0.03
"""Share of the greatest current below which a string rests."""
SLOPE_S = 60.0
"""Time for the slope of the inlet; over a shorter time, the slope is noise of the sensor."""
RECENT_S = 300.0
"""Time constant of a cell's memory of its current: some minutes for most cells. It is the same for every model, so that
the errors of two models of one record can be compared bin by bin."""
SHORTEST_S = 60.0
"""Least length of a stretch of time whose errors count as one: surfaces follow within it."""
MOST_STRETCHES = 60
FEW = 10
"""Least number of stretches for which the scatter of a bin is used alone."""
SIGNIFICANT = 3.0
"""Distance of a mean error from zero, in sd, above which it is significant."""


@dataclass(frozen=True, slots=True)
class Bin:
    """Errors (reading minus model) in one bin.

    Attributes
    ----------
    label : str
        Words for a sentence: "while discharging above 60 A".
    low, high : float
        In the unit of the regime.
    readings : int
    mean_K, sd_K : float
        Mean error, and its standard deviation, which allows for the correlation of neighbouring errors.
    rmse_K : float
    """

    label: str
    low: float
    high: float
    readings: int
    mean_K: float
    sd_K: float
    rmse_K: float

    @property
    def significant(self) -> bool:
        """Whether the mean error is significant."""
        return abs(self.mean_K) > SIGNIFICANT * self.sd_K


@dataclass(frozen=True, slots=True)
class Regime:
    """Errors over the bins of one feature.

    Attributes
    ----------
    feature : str
        `always` (one bin), or a key of `FEATURES`.
    title, unit : str
    bins : tuple of Bin
    explained_K2 : float
        Mean square that the means of the bins explain, beyond chance.
    share : float
        Of the mean square above the noise, 0…1.
    """

    feature: str
    title: str
    unit: str
    bins: tuple[Bin, ...]
    explained_K2: float
    share: float


@dataclass(frozen=True, slots=True)
class _Kind:
    title: str
    unit: str
    least: float
    phrase: str


FEATURES: Mapping[str, _Kind] = {
    "current": _Kind("current, charging or discharging", "A", 1.0, ""),
    "recent_heat": _Kind(
        f"rms current of the last {RECENT_S / 60.0:g} min (I²)", "A", 5.0, "after an rms current {} A"
    ),
    "recent_current": _Kind(f"mean current of the last {RECENT_S / 60.0:g} min", "A", 2.0, "after a mean current {} A"),
    "magnitude": _Kind("magnitude of the current", "A", 2.0, "at a current {} A"),
    "soc": _Kind("SOC", "%", 5.0, "with the SOC {} %"),
    "surface": _Kind("surface temperature", "°C", 2.0, "while the surface is {} °C"),
    "inlet": _Kind("coolant inlet", "°C", 1.0, "while the inlet is {} °C"),
    "inlet_slope": _Kind("slope of the inlet", "K/min", 0.3, "while the inlet's slope is {} K/min"),
    "flow": _Kind("coolant flow over nominal", "%", 3.0, "with the flow {} % of nominal"),
    "time": _Kind("time since the start", "min", 1.0, "at times {} min"),
}
"""Features by which the errors are sorted: title, unit, least span for which bins are made, and words for a bin."""


def interval_of(m: Measured) -> NDArray[np.intp]:
    """Interval (M,) in which each reading lies: a span has one row more than intervals."""
    span = np.searchsorted(np.cumsum([len(s) + 1 for s in m.spans]), m.row, side="right")
    last = np.array([s.last for s in m.spans])[span] - 1
    return np.asarray(np.minimum(m.row - span, last), dtype=np.intp)


def instants_of(m: Measured) -> Floats:
    """Time (rows,) of the rows of a trajectory, s since the record began."""
    u = m.drive
    return np.concatenate([3600.0 * u.hours[s.first] + u.dt * (np.arange(len(s) + 1) - 0.5) for s in m.spans])


def seconds_of(m: Measured) -> Floats:
    """Time (M,) of the readings, s since the record began."""
    return np.asarray(instants_of(m)[m.row] + m.share * m.drive.dt)


def low_passed(x: Floats, dt: float, tau: float) -> Floats:
    """First-order low pass (N, …) that starts at the first value."""
    a = float(np.exp(-dt / tau))
    out = np.empty_like(x)
    y = x[0]
    for k in range(len(x)):
        y = a * y + (1.0 - a) * x[k]
        out[k] = y
    return out


def slope(u: Drive) -> Floats:
    """Slope (N,) of the inlet over about a minute, K/s."""
    width = max(round(SLOPE_S / u.dt), 1)
    ahead = np.minimum(np.arange(u.N) + width // 2 + 1, u.N - 1)
    back = np.maximum(np.arange(u.N) - width // 2, 0)
    return np.asarray((u.T_in[ahead] - u.T_in[back]) / np.maximum((ahead - back) * u.dt, u.dt))


def surfaces(m: Measured) -> Floats:
    """Measured surface (M,) at the readings of a record, °C: means of a minute, as noise must not choose the bin."""
    minute = np.floor(seconds_of(m) / SHORTEST_S)
    _, at, count = np.unique(np.stack([m.channel, minute]), axis=1, return_inverse=True, return_counts=True)
    at = at.ravel()
    return np.asarray((np.bincount(at, m.y) / count)[at], dtype=np.float64)


def string_features(u: Drive) -> dict[str, Floats]:
    """Features (N,) of a record that all cells share, in the units of `FEATURES`; unknown ones are left out."""
    recent = low_passed(np.stack([u.I2, u.I], axis=1), u.dt, RECENT_S)
    found = {
        "current": u.I,
        "recent_heat": np.sqrt(recent[:, 0]),
        "recent_current": recent[:, 1],
        "magnitude": u.I_abs,
        "inlet": u.T_in,
        "inlet_slope": 60.0 * slope(u),
        "time": 60.0 * u.hours,
    }
    if "soc" in u.known:
        found["soc"] = 100.0 * u.soc
    if "flow" in u.known:
        found["flow"] = 100.0 * u.flow
    return {name: found[name] for name in FEATURES if name in found}


def stretches(t: Floats, inflation: float, dt: float) -> NDArray[np.intp]:
    """Return the number (M,) of each reading's time stretch; stretches are long enough to be independent."""
    span = float(np.ptp(t)) + dt
    length = max(SHORTEST_S, 2.0 * inflation * dt, span / MOST_STRETCHES)
    length = min(length, span / 12.0)  # with fewer stretches the scatter is unknown
    return np.asarray((t - t.min()) / length, dtype=np.intp)


def regimes(
    error: Floats, sigma: Floats, values: Mapping[str, Floats], stretch: NDArray[np.intp], peak: float
) -> tuple[Regime, ...]:
    """Errors of one sensor over the bins of each feature, the one that explains most first, after `always`.

    Parameters
    ----------
    error : ndarray (M,), K
        Reading minus model.
    sigma : ndarray (M,), K
    values : mapping of feature to ndarray (M,)
    stretch : ndarray (M,)
        Of `stretches`.
    peak : float, A
        Greatest current.
    """
    excess = max(float(np.mean(error**2) - np.mean(sigma**2)), 1e-12)
    whole = _binned(error, sigma, np.zeros(len(error), np.intp), stretch, ((0.0, 0.0),), ("on average",))
    mean = whole[0].mean_K
    constant = max(mean**2 - whole[0].sd_K ** 2, 0.0)
    found = []
    for name, x in values.items():
        cells = _bins(name, x, peak)
        if cells is None:
            continue
        edges, labels = cells
        index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(labels) - 1)
        edges = np.clip(edges, x.min(), x.max())
        bounds = tuple(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
        bins = _binned(error, sigma, index, stretch, bounds, labels)
        explained = sum(b.readings * ((b.mean_K - mean) ** 2 - b.sd_K**2) for b in bins) / len(error)
        explained = max(explained, 0.0)
        kind = FEATURES[name]
        found.append(Regime(name, kind.title, kind.unit, bins, explained, min(explained / excess, 1.0)))
    found.sort(key=lambda r: -r.explained_K2)
    return (Regime("always", "on average", "", whole, constant, min(constant / excess, 1.0)), *found)


def _bins(name: str, x: Floats, peak: float) -> tuple[Floats, tuple[str, ...]] | None:
    """Edges and labels of one feature's bins; None if it hardly changes."""
    kind = FEATURES[name]
    if float(np.ptp(x)) < kind.least:
        return None
    if name == "current":
        return directions(x, peak)
    inner = np.unique(rounded(np.quantile(x, [0.2, 0.4, 0.6, 0.8]), float(np.ptp(x))))
    inner = inner[(inner > x.min()) & (inner < x.max())]
    if not len(inner):
        return None
    edges = np.concatenate([[x.min()], inner, [x.max()]])
    labels = [f"below {inner[0]:g}", *(f"between {a:g} and {b:g}" for a, b in pairwise(inner.tolist()))]
    return edges, tuple(kind.phrase.format(t) for t in [*labels, f"above {inner[-1]:g}"])


def directions(x: Floats, peak: float) -> tuple[Floats, tuple[str, ...]] | None:
    """Divide a signed quantity into bins of both directions: edges and labels; None if there are too few."""
    edges: list[float] = [-np.inf]
    labels: list[str] = []
    rest = REST * peak
    for way, side in (("charging", -x[x < -rest]), ("discharging", x[x > rest])):
        # half of the range of this side: pulses of two sizes then get separate bins
        half = float(rounded(0.5 * np.quantile(side, [0.95]), peak)[0]) if len(side) > 20 else np.inf
        halves = [half] if rest < half < np.inf else []
        names = [f"while {way} below {h:g} A" for h in halves] + [f"while {way} above {h:g} A" for h in halves]
        names = names or [f"while {way}"]
        if way == "charging":
            edges += [*(-h for h in halves), -rest]
            labels += names[::-1]
        else:
            edges += [rest, *halves, np.inf]
            labels += ["at rest", *names]
    there = [bool(np.any((x >= a) & (x < b))) for a, b in pairwise(edges)]
    return (np.array(edges), tuple(labels)) if sum(there) > 1 else None


def rounded(x: Floats, span: float) -> Floats:
    """Round to a step of 1, 2 or 5 times a power of ten, about a fiftieth of the span."""
    rough = span / 50.0
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * min((1.0, 2.0, 5.0, 10.0), key=lambda s: abs(s * power - rough))
    return np.asarray(np.round(np.round(x / step) * step, 10) + 0.0)  # no −0


def _binned(
    error: Floats,
    sigma: Floats,
    index: NDArray[np.intp],
    stretch: NDArray[np.intp],
    bounds: Sequence[tuple[float, float]],
    labels: Sequence[str],
) -> tuple[Bin, ...]:
    K, C = len(labels), int(stretch.max()) + 1
    n = np.bincount(index, minlength=K)
    safe = np.maximum(n, 1)
    mean = np.bincount(index, error, K) / safe
    square = np.bincount(index, error**2, K) / safe
    white = np.bincount(index, sigma**2, K) / safe
    at = index * C + stretch
    sums = np.bincount(at, error - mean[index], K * C).reshape(K, C)
    clusters = (np.bincount(at, minlength=K * C).reshape(K, C) > 0).sum(axis=1)
    spread = (sums**2).sum(axis=1) / safe**2 * clusters / np.maximum(clusters - 1, 1)
    # one or two stretches have no scatter of their own: that of the whole sensor is used
    overall = np.bincount(stretch, error, C) / np.maximum(np.bincount(stretch, minlength=C), 1)
    few = np.var(overall) / np.maximum(clusters, 1)
    spread = np.where(clusters < FEW, np.maximum(spread, few), spread)
    # the scatter of few stretches is itself uncertain: the variance of Student's t
    variance = np.maximum(spread * (clusters + 1.0) / np.maximum(clusters - 1.0, 1.0), white / safe)
    return tuple(
        Bin(labels[k], *bounds[k], int(n[k]), float(mean[k]), float(np.sqrt(variance[k])), float(np.sqrt(square[k])))
        for k in range(K)
        if n[k]
    )
