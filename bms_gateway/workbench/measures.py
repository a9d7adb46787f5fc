"""Measurements in a picture: values at two cursors, and statistics of the window, of every sample of a curve.

The samples are those kept by the tab's process. A picture may show fewer of them; the measurements do not depend on it.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bms_gateway.report.html_figures import STEPS
from bms_gateway.workbench.series import Floats, Kept, Shelves
from bms_gateway.workbench.steps import Window

Document = dict[str, Any]
ROLES = {"model": "yaxis", "each": "yaxis2"}
"""Measured curves of a step, with their axis: the model, and the residual of every reading."""


def measured_in(figure: Mapping[str, Any], folder: Path, window: Window | None, at: Window | None) -> list[Document]:
    """Measure every curve of a figure.

    Parameters
    ----------
    figure : mapping
        From `Desk.figure`, before numbers replace its keys.
    folder : Path
        Of the tab.
    window : tuple of float, optional
        Shown part of the axis; by default all of it.
    at : tuple of float, optional
        Positions of the two cursors.

    Returns
    -------
    list of dict
        `name`, `step` ("" for measurements), `unit`; `count`, `min`, `max`, `mean`, `rms` of the samples in the window;
        `a` and `b`, the values at the cursors. Missing values are None.
    """
    with Shelves(folder) as shelves:
        return [
            {"name": name, "step": step, "unit": unit, **_one(*shelves.series(kept), window, at, held)}
            for name, step, unit, kept, held in _curves(figure)
        ]


def _curves(figure: Mapping[str, Any]) -> Iterator[tuple[str, str, str, Kept, bool]]:
    """Yield name, step, unit and samples of each curve, and whether a value is constant around its sample."""
    layout = figure["layout"]
    for part in (figure, *figure.get("beside", ())):
        source = f"{part['source']}: " if "source" in part else ""
        for d in part["data"]:
            if "kept" in d:
                title, unit = _title(layout, f"yaxis{d.get('yaxis', 'y').removeprefix('y')}")
                name = d["name"].removesuffix(f", {unit}")
                what = name if title in ("", name) else f"{title}, {name}"
                what += f" ({d['meta']})" if "meta" in d else ""
                yield source + what, "", unit, d["kept"], d.get("line", {}).get("shape") == STEPS
        for s in part.get("steps", ()):
            for role, axis in ROLES.items():
                if role in s:
                    title, unit = _title(layout, axis)
                    yield f"{source}{title}, {s['name']}", s["name"], unit, s[role]["kept"], False


def _title(layout: Mapping[str, Any], axis: str) -> tuple[str, str]:
    """Divide the title of an axis into its quantity and its unit."""
    title, _, unit = layout[axis]["title"]["text"].rpartition(", ")
    return title, unit


def _one(t: Floats, y: Floats, window: Window | None, at: Window | None, held: bool) -> Document:
    y = y.astype(np.float64)
    inside = y if window is None else y[(t >= window[0]) & (t <= window[1])]
    inside = inside[np.isfinite(inside)]
    found: Document = {"count": len(inside), "min": None, "max": None, "mean": None, "rms": None}
    if len(inside):
        found |= {
            "min": float(inside.min()),
            "max": float(inside.max()),
            "mean": float(inside.mean()),
            "rms": float(np.sqrt(np.mean(inside**2))),
        }
    for key, place in zip("ab", at or (None, None), strict=True):
        found[key] = None if place is None else value_at(t, y, place, held=held)
    return found


def value_at(t: Floats, y: Floats, place: float, *, held: bool = False) -> float | None:
    """Return the value of a curve as drawn: interpolated between two samples, or that of the nearest one.

    Examples
    --------
    >>> t, y = np.array([0.0, 1.0, 2.0]), np.array([10.0, 20.0, np.nan])
    >>> value_at(t, y, 0.25), value_at(t, y, 0.25, held=True), value_at(t, y, 1.5), value_at(t, y, 3.0)
    (12.5, 10.0, None, None)
    """
    if not len(t) or not t[0] <= place <= t[-1]:
        return None
    after = min(int(np.searchsorted(t, place)), len(t) - 1)
    before = after if t[after] == place else max(after - 1, 0)
    if held:
        before = after = before if place - t[before] <= t[after] - place else after
    low, high = float(y[before]), float(y[after])
    share = 0.0 if before == after else (place - float(t[before])) / float(t[after] - t[before])
    value = low + share * (high - low)
    return value if np.isfinite(value) else None
