"""Pictures of the residual of a step: correlation with itself and with the inputs, and its size against the noise.

A model that lacks nothing leaves white noise of the sensor's size. The autocorrelation is within the bounds at all lags
except the first, there is no correlation with an input, and the histogram is that of the noise. MATLAB's `resid` shows
the same; the bounds are those of a white residual, 95 %.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bms_gateway.diagnosis.core_band import BAND_SD
from bms_gateway.diagnosis.regimes import interval_of, seconds_of
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.report.html_figures import HELD, axis, line
from bms_gateway.report.page import Figure, numbers
from bms_gateway.thermal import Floats

LONGEST_S = 600.0
"""Lag up to which correlations are shown: some time constants of a cell."""
MOST_LAGS = 400
LEAST_READINGS = 50
BIN, WIDEST = 0.25, 6.0
"""Limits of the histogram, in sd of the sensor's noise."""
HEIGHT = 230
INPUTS = {"heat": "the square of the current", "inlet": "the inlet"}
NOISE, BOUNDS = "noise of the sensor", "95 % bounds of white noise"
GREY = "#777777"


@dataclass(frozen=True, slots=True)
class _Left:
    """One sensor of one record, in order of time: residual in K and sd, interval of the inputs, spacing in s."""

    record: int
    cell: int
    error_K: Floats
    normal: Floats
    inputs: Mapping[str, Floats]
    dt: float


def figures(fit: MapFit) -> dict[str, Figure]:
    """Draw axes, bounds and the noise; `step` draws what depends on the model."""
    found: dict[str, Figure] = {}
    for x in _left_over(fit):
        n, lags = len(x.error_K), _lags(x)
        bound = BAND_SD / float(np.sqrt(n))
        for kind, first in (("auto", 0.0), ("heat", -lags[-1]), ("inlet", -lags[-1])):
            edge = [first, float(lags[-1])]
            own = [
                line(edge, [s * bound] * 2, BOUNDS, GREY, dash="dot", width=1, showlegend=False) for s in (1.0, -1.0)
            ]
            title = "autocorrelation" if kind == "auto" else f"correlation with {INPUTS[kind]}"
            span = {"yaxis": (-2.0 * bound, 1.0 if kind == "auto" else 2.0 * bound)}
            name = "lag, s" if kind == "auto" else "lag of the residual, s"
            found[f"{kind}-{x.record}-{x.cell}"] = {"data": own, "layout": _layout(name, title), "span": span}
        z = np.arange(-WIDEST, WIDEST + 0.05, 0.1)
        noise = line(
            z.tolist(), numbers(_normal(z)), NOISE, GREY, dash="dot", width=1.4, fill="tozeroy", fillcolor=HELD
        )
        layout = _layout("residual, in sd of the sensor's noise", "density of readings; dotted: noise alone")
        found[f"noise-{x.record}-{x.cell}"] = {"data": [noise], "layout": layout, "span": {"yaxis": (0.0, 0.45)}}
    return found


def step(fit: MapFit) -> dict[str, dict[str, Any]]:
    """Draw the residual of one model; `beyond` is the share of the readings outside the histogram."""
    found: dict[str, dict[str, Any]] = {}
    for x in _left_over(fit):
        place, lags = f"{x.record}-{x.cell}", _lags(x)
        few = np.unique(np.linspace(0, len(lags) - 1, MOST_LAGS).astype(np.int64))
        found[f"auto-{place}"] = _drawn(lags[few], correlation(x.error_K, x.error_K, len(lags))[few])
        for kind, u in x.inputs.items():
            moved = u - u.mean()
            if not moved.any():
                continue
            after = correlation(moved, x.error_K, len(lags))
            before = correlation(x.error_K, moved, len(lags))
            both = np.concatenate([before[:0:-1], after])
            at = np.concatenate([-lags[:0:-1], lags])
            few = np.unique(np.linspace(0, len(at) - 1, MOST_LAGS).astype(np.int64))
            found[f"{kind}-{place}"] = _drawn(at[few], both[few])
        edges = np.arange(-WIDEST, WIDEST + BIN / 2, BIN)
        count, _ = np.histogram(x.normal, edges)
        own = _drawn(edges[:-1] + BIN / 2, count / (BIN * len(x.normal)), shape="hvh")
        found[f"noise-{place}"] = own | {"beyond": 1.0 - float(count.sum()) / len(x.normal)}
    return found


def correlation(u: Floats, e: Floats, lags: int) -> Floats:
    """Correlate `e` (K,) with `u` (K,) of earlier readings, for lags from 0 on, over their root mean squares."""
    n = len(e)
    size = 2 * n
    both: Floats = np.fft.irfft(np.fft.rfft(e, size) * np.conj(np.fft.rfft(u, size)), size)[:lags]
    return np.asarray(both / np.sqrt(np.sum(u**2) * np.sum(e**2)), dtype=np.float64)


def _left_over(fit: MapFit) -> list[_Left]:
    found, first = [], 0
    for r, m in enumerate(fit.problem.records):
        model = fit.y[first : first + len(m.y)]
        first += len(m.y)
        at, t, interval = _order(m), seconds_of(m), interval_of(m)
        for j, (_, cell) in enumerate(m.channels):
            mine = at[m.channel[at] == j]
            if len(mine) < LEAST_READINGS:
                continue
            error = m.y[mine] - model[mine]
            inputs = {"heat": m.drive.I[interval[mine]] ** 2, "inlet": m.drive.T_in[interval[mine]]}
            dt = float(np.median(np.diff(t[mine])))
            found.append(_Left(r, cell, error, error / m.sigma[mine], inputs, dt))
    return found


def _order(m: Measured) -> np.ndarray:
    return np.argsort(seconds_of(m), kind="stable")


def _lags(x: _Left) -> Floats:
    """Lags, s: multiples of the most usual time between two readings."""
    count = max(min(int(LONGEST_S / x.dt), len(x.error_K) // 4), 2)
    return np.arange(count, dtype=np.float64) * x.dt


def _normal(z: Floats) -> Floats:
    return np.asarray(np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi))


def _drawn(x: Floats, y: Floats, shape: str = "linear") -> dict[str, Any]:
    low, high = float(np.min(y)), float(np.max(y))
    return {"model": {"x": numbers(x), "y": numbers(y, 4), "shape": shape}, "span": {"yaxis": (low, high)}}


def _layout(x: str, y: str) -> dict[str, Any]:
    return {
        "height": HEIGHT,
        "margin": {"l": 52, "r": 10, "t": 26, "b": 40},
        "font": {"family": "system-ui, Segoe UI, Liberation Sans, Arial, sans-serif", "size": 12, "color": "#1a1a1a"},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "showlegend": False,
        "title": {"text": y, "font": {"size": 13}, "x": 0.01, "xanchor": "left", "y": 0.97, "yanchor": "top"},
        "xaxis": axis(x),
        "yaxis": axis("", nticks=5),
    }
